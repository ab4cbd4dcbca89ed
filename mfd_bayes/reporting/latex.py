"""The paper's Tables I and II with uncertainty, as LaTeX tables in the manner of booktabs."""

from __future__ import annotations

import string
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

from mfd_bayes.evaluation.views import CampaignView, NoiseRow, Row, TestView
from mfd_bayes.reporting.symbols import maths, meaning, number, of_population, printable, unit_text

TESTS = 3
"""Most tests in one tabular, so that it fits the width of an article's page."""

LINES = 14
"""Most rows of one tabular of laws, so that it fits the height of a page."""

_ESCAPED = {
    **{character: f"\\{character}" for character in "_%&#${}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "''",
    "-": "-{}",  # two would become a dash
    "[": "{[}",  # after the end of a row it would be a length
    "*": "{*}",
    "·": r"$\cdot$",
    "²": "$^2$",
    "³": "$^3$",
    "−": "$-$",
    "–": "--",
    "…": r"\ldots{}",
    "γ": r"$\gamma$",
    "σ": r"$\sigma$",
    "ℓ": r"$\ell$",
}
_CAPTION = "posterior median and equal-tailed 95\\,\\% interval"


def parameters_tex(view: CampaignView) -> str:
    """Table I of the paper with uncertainty: a column for each calibrated test."""
    tests = [test for test in view.tests if test.rows]
    groups = [tests[i : i + TESTS] for i in range(0, len(tests), TESTS)]
    parts = [_parameter_lines(group) for group in groups]
    return _file(view, "parameters", "Parameters of the tests", parts)


def laws_tex(view: CampaignView) -> str:
    """Table II of the paper with uncertainty: slopes, shapes and scatter."""
    rows = view.law_rows
    groups = [rows[i : i + LINES] for i in range(0, len(rows), LINES)]
    return _file(view, "laws", "Constants of the laws", [_law_lines(group) for group in groups])


def escape(text: str) -> str:
    """Text escaped for LaTeX; a letter that fonts may not have becomes ``?``."""
    return "".join(_ESCAPED.get(c) or _letter(c) for c in text)


def symbol(name: str) -> str:
    """Symbol of a quantity as maths; an unknown name as text."""
    if known := maths(name):
        return f"${known}$"
    word, of, more = of_population(name)
    if word:
        return f"{escape(word)} {symbol(of)}{escape(more)}"
    return escape(name.replace("_", " "))


def figure(value: float) -> str:
    """A number with three digits, for use inside maths."""
    text = number(value, 3).replace("−", "-").replace("∞", r"\infty").replace("–", r"\mbox{--}")
    mantissa, _, power = text.partition("e")
    return rf"{mantissa}\times 10^{{{power}}}" if power else mantissa


def _letter(character: str) -> str:
    """A character if every font has it, else a question mark; a space for a control."""
    if not character.isprintable():
        return " "
    base = unicodedata.normalize("NFD", character)[0]
    return character if base.isascii() and character < "\u0180" else "?"


def _parameter_lines(tests: Sequence[TestView]) -> list[str]:
    """One tabular of Table I, with its notes."""
    found = {test.id: {row.name: row for row in test.rows} for test in tests}
    units = {row.name: row.unit for test in tests for row in test.rows}
    marks = _marks(row for test in tests for row in test.rows)
    lines = [
        " & ".join(["", "", *(escape(test.id) for test in tests)]),
        " & ".join(["Parameter", "Unit", *(escape(test.actuation) for test in tests)]),
    ]
    body = []
    for name, unit in units.items():
        rows = [found[test.id].get(name) for test in tests]
        body.append(" & ".join([symbol(name), _unit(unit), *(_median(r, marks) for r in rows)]))
        body.append(" & ".join(["", "", *(rf"\scriptsize {_interval(r)}" for r in rows)]))
        body += _other_lines(rows)
    return _tabular("ll" + "l" * len(tests), lines, body, marks)


def _other_lines(rows: Sequence[Row | None]) -> list[str]:
    """A line for each noise that decides a value, with the value under it."""
    found = [{o.other: o for o in row.others} if row else {} for row in rows]
    lines = []
    for noise in dict.fromkeys(name for others in found for name in others):
        cells = (_other(others.get(noise)) for others in found)
        lines.append(" & ".join(["", rf"\scriptsize {escape(noise)}:", *cells]))
    return lines


def _other(row: NoiseRow | None) -> str:
    if row is None:
        return ""
    bounds = f"[{figure(row.other_lower)},\\,{figure(row.other_upper)}]"
    return rf"\scriptsize ${figure(row.other_median)}$ ${bounds}$"


def _law_lines(rows: Sequence[Row]) -> list[str]:
    """One tabular of Table II, with its notes."""
    marks = _marks(rows)
    body = [
        f"{symbol(row.name)} & {escape(meaning(row.name))} & {_unit(row.unit)} & "
        f"{_median(row, marks)} {_interval(row)}"
        for row in rows
    ]
    head = [r"Constant & Meaning & Unit & Median [95\,\%]"]
    text = r">{\raggedright\arraybackslash}p"
    return _tabular(rf"{text}{{0.2\linewidth}}{text}{{0.33\linewidth}}ll", head, body, marks)


def _median(row: Row | None, marks: Mapping[str, str]) -> str:
    """Median with the letter of its note."""
    if row is None:
        return "--"
    mark = f"{{}}^{{{marks[row.note]}}}" if row.note else ""
    return f"${figure(row.median)}{mark}$"


def _interval(row: Row | None) -> str:
    return "" if row is None else f"$[{figure(row.lower)},\\,{figure(row.upper)}]$"


def _marks(rows: Iterable[Row]) -> dict[str, str]:
    """A letter for each note."""
    notes = dict.fromkeys(row.note for row in rows if row.note)
    return dict(zip(notes, string.ascii_lowercase, strict=False))


def _unit(unit: str) -> str:
    return escape(unit_text(unit)) or "--"


def _tabular(
    columns: str, head: Sequence[str], body: Sequence[str], marks: Mapping[str, str]
) -> list[str]:
    notes = [f"$^{{{mark}}}$ {escape(note)}." for note, mark in marks.items()]
    return [
        rf"  \begin{{tabular}}{{@{{}}{columns}@{{}}}}",
        r"    \toprule",
        *(rf"    {line} \\" for line in head),
        r"    \midrule",
        *(rf"    {line} \\" for line in body),
        r"    \bottomrule",
        r"  \end{tabular}",
        *([r"  \par\smallskip", *(f"  {note}" for note in notes)] if notes else []),
    ]


def _file(view: CampaignView, name: str, what: str, parts: Sequence[list[str]]) -> str:
    """Text of a file of tables, which are numbered if there are several."""
    lines = [
        f"% {printable(view.title)}: {what.lower()}, {_CAPTION}.",
        r"% \usepackage{booktabs,array} in the preamble, then " + f"\\input{{{name}.tex}} here.",
    ]
    for i, part in enumerate(parts, start=1):
        which, label = (f" ({i} of {len(parts)})", f"-{i}") if len(parts) > 1 else ("", "")
        lines += [
            r"\begin{table}[htbp]",
            r"  \centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"  \caption{{{what}: {_CAPTION}{which}.}}",
            rf"  \label{{tab:{name}{label}}}",
            *part,
            r"\end{table}",
        ]
    return "\n".join(lines) + "\n"
