"""Tables of a report as CSV, JSON, LaTeX, Excel and Word.

A frame has a row for each value, for other programs. A `Sheet` is for reading: quantities are rows,
tests are columns. Both are made in internal units, and converted once. pandas is imported late, for
many commands need no table.
"""

from __future__ import annotations

import csv
import io
import json
import math
import string
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.axes import Axes
from mfd_bayes.evaluation.next_test import advice_rows
from mfd_bayes.evaluation.views import CampaignView, Fan, Row, Rows, TestView
from mfd_bayes.planning.study import Advice
from mfd_bayes.population.bands import Band
from mfd_bayes.population.settings import KIND_NAMES
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.conversion import convert_rows, to_units
from mfd_bayes.reporting.symbols import Symbols, number, printable, split_population, unit_text
from mfd_bayes.runs.scores import ComparisonRow
from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.units import percent

if TYPE_CHECKING:
    import pandas as pd

CROSSVALIDATION = "crossvalidation.csv"

ACTUATION = "actuation in "
"""Before the internal unit of an actuation, which is given in psi, and not in ksi."""

_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")
_INTERVAL = "lower:q2.5 median:q50 upper:q97.5"
_POSTERIOR = f"unit mean sd {_INTERVAL} ess_bulk ess_tail r_hat contraction note"
_SCORES = (
    "coverage_50 coverage_90 coverage_95 width_95:width_95_kip "
    "interval_score:interval_score_95_kip crps:crps_kip rrse"
)
_COLUMNS = {
    "parameters": f"test name:parameter {_POSTERIOR} joint_lower:joint_q2.5 "
    "joint_median:joint_q50 joint_upper:joint_q97.5 disagrees",
    "laws": f"test:group name:constant {_POSTERIOR}",
    "derived": f"test role name:quantity unit mean sd {_INTERVAL} measured note",
    "loop_estimates": f"test name:quantity unit value:loop_estimate {_INTERVAL} tolerance missed",
    "noises": (
        f"test name:quantity unit noise {_INTERVAL} other:other_noise "
        "other_lower:other_q2.5 other_median:other_q50 other_upper:other_q97.5 decides"
    ),
    "law_scores": (
        "quantity law chosen elpd elpd_se difference:elpd_difference "
        "difference_se:elpd_difference_se weight pareto_k"
    ),
    "checks": (
        "test check feature observed expected unit difference tolerance p_value status note"
    ),
    "scores": f"test role {_SCORES}",
    "crossvalidation": (
        f"part test {_SCORES} fitted_width:fitted_width_95_kip "
        "fitted_crps:fitted_crps_kip width_ratio crps_ratio whole_95"
    ),
    "tested_range": "name:condition unit lowest:smallest highest:largest",
    "drift": (
        "quantity condition per change:change_percent lower:lower_percent upper:upper_percent "
        "probability limit:limit_percent left:left_at_last_test leaves:leaves_ahead when "
        "when_lower:when_q5 when_upper:when_q95"
    ),
    "comparison": (
        "subject:test model cycles elpd elpd_se p_loo worst_k:worst_pareto_k bad:share_bad_k "
        "unsettled:share_unsettled difference:elpd_difference difference_se:elpd_difference_se "
        "rrse:rrse_in_sample log_evidence log_evidence_se evidence_k:evidence_pareto_k "
        "evidence_trusted"
    ),
    "truth": f"test name:quantity unit truth {_INTERVAL} inside informed",
    "prediction": "name:quantity unit mean sd lower median upper measured note",
    "design": ("name:property unit basis of:name nominal lower upper lambda_min lambda_max note"),
}
"""Columns of each table, as "column", or "key:column" where the rows call it otherwise."""


def _columns(table: str) -> dict[str, str]:
    """Column of each key of a table's rows."""
    pairs = (word.partition(":") for word in _COLUMNS[table].split())
    return {key: column or key for key, _, column in pairs}


def frame_of(table: str, rows: Iterable[Any], system: System = US) -> pd.DataFrame:
    """A table of `_COLUMNS` with a line for each of its rows, dicts or dataclasses."""
    import pandas as pd

    columns = _columns(table)
    records = [row if isinstance(row, dict) else vars(row) for row in rows]
    frame = pd.DataFrame(records, columns=list(columns)).rename(columns=columns)
    return to_units(frame, system)


def report_tables(view: CampaignView) -> dict[str, str]:
    """CSV and JSON tables in the units of a report, by the name of the file."""
    tests, system = view.tests, view.system
    rows: dict[str, Iterable[Any]] = {
        "parameters": (row for test in tests for row in test.rows),
        "derived": (row for test in tests for row in test.derived),
        "loop_estimates": (row for test in tests for row in test.loop_estimates),
        "noises": (row for test in tests for row in test.noises),
        "laws": view.law_rows,
        "law_scores": view.law_scores,
        "checks": view.checks,
        "scores": (test.score for test in tests),
        "tested_range": view.tested,
    }
    if view.drifts:
        rows["drift"] = view.drifts
    if view.left_out is not None:
        rows["crossvalidation"] = (*view.left_out.rows, view.left_out.mean)
    frames = {name: frame_of(name, lines, system) for name, lines in rows.items()}
    texts = {f"{name}.csv": to_csv(frame) for name, frame in frames.items()}
    others = [
        convert_rows(_deciding(test, row["name"]), system) for test in tests for row in test.rows
    ]
    parameters, notes = frames["parameters"], []
    for note, noises in zip(parameters["note"], others, strict=True):
        values = "; ".join(_other_line(row).text for row in noises)
        decides = f"the noise model decides: {values}" if values else ""
        notes.append("; ".join(filter(None, (note, decides))))
    texts["parameters.csv"] = to_csv(parameters.assign(note=notes))
    texts["parameters.json"] = _to_json(view.title, "parameters", parameters, others)
    texts["laws.json"] = _to_json(view.title, "laws", frames["laws"], [()] * len(frames["laws"]))
    return texts


def _deciding(test: TestView, name: str) -> Rows:
    """A quantity of a test under other noises, where the choice of the noise decides it."""
    return tuple(row for row in test.noises if row["decides"] and row["name"] == name)


def _other_line(row: Row) -> Line:
    name = row["other"].replace("{", "{{").replace("}", "}}")
    figures = row["other_median"], row["other_lower"], row["other_upper"]
    return Line(f"{name}: {{}} [{{}}, {{}}]", figures)


def to_csv(frame: pd.DataFrame, about: Sequence[str] = ()) -> str:
    """A table as CSV, below lines of comments: six digits, and no text that a spreadsheet runs."""
    shown = frame.copy()
    for name in frame.columns:
        if frame[name].dtype.kind == "b":
            shown[name] = frame[name].map({True: "yes", False: "no"})
        elif frame[name].dtype.kind not in "fiu":
            shown[name] = frame[name].map(_safe)
    lines = "".join(f"# {' '.join(line.split())}\n" for line in about)
    return lines + shown.to_csv(index=False, float_format="%.6g", lineterminator="\n")


def _csv_text(
    about: Iterable[str], names: Iterable[str], rows: Iterable[Iterable[object]], digits: int = 6
) -> str:
    """CSV below lines of comments, without pandas, which takes long to import."""
    text = io.StringIO()
    text.writelines(f"# {' '.join(line.split())}\n" for line in about)
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    for row in rows:
        cells = ("" if isinstance(cell, float) and math.isnan(cell) else cell for cell in row)
        table.writerow(f"{c:.{digits}g}" if isinstance(c, float) else c for c in cells)
    return text.getvalue()


def _records_csv(table: str, rows: Iterable[Row], about: Iterable[str] = ()) -> str:
    """Rows of a table of `_COLUMNS` as CSV."""
    columns = _columns(table)
    cells = ([_safe(row[key]) for key in columns] for row in rows)
    return _csv_text(about, columns.values(), cells)


def _safe(value: object) -> object:
    """A text that no spreadsheet takes for a formula; "yes" or "no" of a truth; numbers stay."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if not isinstance(value, str):
        return value
    text = printable(str(value))
    return f"'{text}" if text.lstrip().startswith(_FORMULA) else text


def _to_json(title: str, name: str, frame: pd.DataFrame, others: Iterable[Sequence[Row]]) -> str:
    """JSON with the meaning of its figures; null where one is not finite."""
    figures = {"q2.5": "lower", "q50": "median", "q97.5": "upper"}
    rows = []
    for row, noises in zip(frame.rename(columns=figures).to_dict("records"), others, strict=True):
        rows.append({str(key): _finite(value) for key, value in row.items()})
        rows[-1]["other_noises"] = [
            {"noise": o["other"]}
            | {key: _finite(o[f"other_{key}"]) for key in ("lower", "median", "upper")}
            for o in noises
        ]
    content = {
        "title": title,
        "table": name,
        "interval": {"kind": "equal-tailed", "probability": 0.95, "bounds": ["lower", "upper"]},
        "null": "not defined, or not finite",
        "rows": rows,
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """A text, or a number with six digits; None where it is not finite."""
    if isinstance(value, str):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


# --- tables for reading


@dataclass(frozen=True)
class Line:
    """Numbers in their places in a text: "[{}, {}]" and (1.1, 1.4), in the unit of the row.

    A ratio has no unit. A marked line is a measured value outside of its bounds.
    """

    template: str
    numbers: tuple[float, ...]
    ratio: bool = False
    marked: bool = False

    @property
    def finite(self) -> bool:
        """Whether it has a number."""
        return any(map(math.isfinite, self.numbers))

    @property
    def text(self) -> str:
        """The line with three digits."""
        return self.template.format(*(number(value, 3) for value in self.numbers))


NONE = Line("–", ())
"""What a cell without a number shows."""


@dataclass(frozen=True)
class Cell:
    """What a cell of a sheet shows: a line each, with the unit of its row."""

    lines: tuple[Line, ...] = ()
    note: str = ""

    @property
    def shown(self) -> list[Line]:
        """Lines that have a number; a dash where none has."""
        return [line for line in self.lines if line.finite] or [NONE]

    @property
    def marked(self) -> bool:
        """Whether one of its lines is."""
        return any(line.marked for line in self.lines)


@dataclass(frozen=True)
class SheetRow:
    """A quantity, by its name in `Symbols` or in words, with its cells; `meaning` is what it is."""

    name: str
    unit: str
    cells: tuple[Cell, ...]
    meaning: str = ""
    detail: str = ""

    @property
    def used(self) -> list[int]:
        """Numbers of the lines that a cell has."""
        size = max((len(cell.lines) for cell in self.cells), default=0)
        cells = [cell for cell in self.cells if cell.lines]
        return [at for at in range(size) if any(cell.lines[at].finite for cell in cells)]


@dataclass(frozen=True)
class Sheet:
    """A table for reading: quantities as rows, tests as columns.

    Attributes
    ----------
    heads : tuple of str
        Of the columns.
    numbers, lines : tuple of str
        What each number of a cell is, in their order, and what each of its lines is.
    conditions : tuple of tuple of (float, str)
        Of the columns of a data sheet: values with their internal units.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[SheetRow, ...]
    numbers: tuple[str, ...] = ("median", "2.5 %", "97.5 %")
    lines: tuple[str, ...] = ("median", "95 % interval")
    conditions: tuple[tuple[tuple[float, str], ...], ...] = ()

    def to_units(self, system: System) -> Sheet:
        """The sheet in the units of a system, from internal ones."""

        def line(line: Line, by: float) -> Line:
            return (
                line if line.ratio else replace(line, numbers=tuple(by * v for v in line.numbers))
            )

        def row(row: SheetRow) -> SheetRow:
            by = system.factor(row.unit)
            cells = (replace(c, lines=tuple(line(one, by) for one in c.lines)) for c in row.cells)
            return replace(row, unit=system.unit(row.unit), cells=tuple(cells))

        return replace(self, rows=tuple(map(row, self.rows)))

    def blocks(self, most: int) -> list[Sheet]:
        """Parts of the sheet with at most so many columns, numbered if there are several."""
        parts = -(-len(self.heads) // most)
        most = max(-(-len(self.heads) // max(parts, 1)), 1)
        return [
            replace(
                self,
                title=f"{self.title} ({at // most + 1} of {parts})" if parts > 1 else self.title,
                heads=self.heads[at : at + most],
                conditions=self.conditions[at : at + most],
                rows=tuple(replace(row, cells=row.cells[at : at + most]) for row in self.rows),
            )
            for at in range(0, len(self.heads), most)
        ]

    def marks(self) -> dict[str, str]:
        """A letter for each note of the cells: a to z, then aa, ab, and so on."""
        cells = (cell for row in self.rows for cell in row.cells)
        notes = dict.fromkeys(printable(cell.note) for cell in cells if cell.note)
        words = (product(string.ascii_lowercase, repeat=length) for length in count(1))
        return dict(zip(notes, ("".join(word) for group in words for word in group), strict=False))


def paper_sheets(view: CampaignView, symbols: Symbols) -> tuple[Sheet, Sheet]:
    """The paper's Tables I and II, with uncertainty, in internal units."""
    tests = {test.id: test for test in view.tests if test.rows}
    heads = {
        name: ", ".join(
            filter(None, (printable(name), view.system.actuation(test.trace, view.actuation_unit)))
        )
        for name, test in tests.items()
    }
    rows = [(row, _deciding(test, row["name"])) for test in tests.values() for row in test.rows]
    laws = [(row | {"test": "all tests"}, ()) for row in view.law_rows]
    return (
        _sheet("Table I: parameters of the tests", rows, heads, symbols),
        _sheet("Table II: constants of the laws", laws, {"all tests": "all tests"}, symbols),
    )


def _sheet(
    title: str,
    rows: Iterable[tuple[Row, Rows]],
    heads: Mapping[str, str],
    symbols: Symbols,
) -> Sheet:
    """Sheet of posteriors: the median, below it the interval and the values under other noises."""
    cells: dict[tuple[str, str], dict[str, Cell]] = {}
    for row, noises in rows:
        interval = row["lower"], row["upper"]
        lines = [Line("{}", (row["median"],)), Line("[{}, {}]", interval)]
        if row.get("disagrees", False):
            joint = tuple(row[f"joint_{key}"] for key in ("median", "lower", "upper"))
            lines.append(Line("with the others: {} [{}, {}]", joint, marked=True))
        lines += map(_other_line, noises)
        of_quantity = cells.setdefault((row["name"], row["unit"]), {})
        of_quantity[row["test"]] = Cell(tuple(lines), row["note"])
    made = tuple(
        SheetRow(name, unit, tuple(own.get(test, Cell()) for test in heads), symbols.meaning(name))
        for (name, unit), own in cells.items()
    )
    title = f"{title}, posterior median and equal-tailed 95 % interval"
    return Sheet(title, tuple(heads.values()), made)


_PROPERTY_LINES = ("measured", "cycles", "nominal", "bounds", "λ")
_PROPERTY_NUMBERS = (
    *("measured", "smallest cycle", "largest cycle"),
    *("nominal", "lower", "upper", "λ min", "λ max"),
)


def datasheet_frame(rows: pd.DataFrame, system: System) -> pd.DataFrame:
    """Rows of a data sheet in the units of a system, with those of its conditions in the heads."""
    frame = rows.rename(columns={"stroke": "stroke_in", "frequency": "frequency_Hz"})
    levels = [system.of_actuation(unit) for unit in rows["actuation_unit"]]
    frame["actuation"] = rows["actuation"] * np.array([by for by, _ in levels])
    frame["actuation_unit"] = [name for _, name in levels]
    if not system.axes.actuated:
        frame = frame.drop(columns=["actuation", "actuation_unit"])
    return to_units(frame, system)


def _records(frame: pd.DataFrame) -> list[Row]:
    return [{str(key): value for key, value in row.items()} for row in frame.to_dict("records")]


def datasheet_sheet(rows: pd.DataFrame, title: str, symbols: Symbols, axes: Axes) -> Sheet:
    """The properties of a data sheet for reading, in internal units: conditions are columns."""
    conditions: dict[str, tuple[tuple[float, str], ...]] = {}
    for row in _records(rows.drop_duplicates("condition")):
        parts = [(row["stroke"], "in")]
        if axes.actuated:
            parts.insert(0, (row["actuation"], ACTUATION + row["actuation_unit"]))
        if axes.timed:
            parts.append((row["frequency"], "Hz"))
        conditions[row["condition"]] = tuple(part for part in parts if math.isfinite(part[0]))
    made = []
    order = {name: at for at, name in enumerate(dict.fromkeys(rows["quantity"]))}
    ordered = rows.sort_values("quantity", key=lambda names: names.map(order), kind="stable")
    for key, group in ordered.groupby(["quantity", "direction", "cycle", "unit"], sort=False):
        quantity, direction, cycle, unit = map(str, key)
        cells = {}
        for row in _records(group):
            several, outside = row["n_cycles"] > 1, row["n_outside"] > 0
            ends = (row["measured_low"], row["measured_high"]) if several else (math.nan, math.nan)
            lines = (
                Line("{}", (row["measured"],), marked=outside and not several),
                Line("{}–{}", ends, marked=outside),
                Line("{}", (row["nominal"],)),
                Line("{}–{}", (row["lower"], row["upper"])),
                Line("{}–{}", (row["lambda_min"], row["lambda_max"]), ratio=True),
            )
            cells[row["condition"]] = Cell(lines, row["note"])
        name = axes.text(quantity.replace("_", " ").replace("gap", "gap width"))
        detail = ", ".join(filter(None, (direction, f"cycle {cycle}" if cycle != "0" else "")))
        of = tuple(cells.get(condition, Cell()) for condition in conditions)
        meaning = ", ".join(filter(None, (symbols.meaning(name), detail)))
        made.append(SheetRow(name, unit, of, meaning, detail))
    return Sheet(
        f"{title}: data sheet",
        tuple(conditions),
        tuple(made),
        _PROPERTY_NUMBERS,
        _PROPERTY_LINES,
        tuple(conditions.values()),
    )


_SCORE_ROWS = (
    ("coverage of the 50 % band", "coverage_50", "%"),
    ("coverage of the 90 % band", "coverage_90", "%"),
    ("coverage of the 95 % band", "coverage_95", "%"),
    ("width of the 95 % band", "width_95", "kip"),
    ("ratio of the width", "width_ratio", "1"),
    ("interval score", "interval_score", "kip"),
    ("CRPS", "crps", "kip"),
    ("ratio of the CRPS", "crps_ratio", "1"),
    ("error (RRSE)", "rrse", "1"),
    ("whole history inside 95 %", "whole_95", "%"),
)


def score_sheet(rows: Sequence[Row], title: str = "Scores") -> Sheet:
    """Scores of predicted tests, in internal units: tests are columns."""
    made = []
    for words, name, unit in _SCORE_ROWS:
        values = [(100.0 if unit == "%" else 1.0) * row.get(name, math.nan) for row in rows]
        if any(map(math.isfinite, values)):
            cells = tuple(Cell((Line("{}", (value,)),)) for value in values)
            made.append(SheetRow(words, unit, cells))
    return Sheet(title, tuple(row["test"] for row in rows), tuple(made))


# --- LaTeX

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
    "λ": r"$\lambda$",
    "σ": r"$\sigma$",
    "ℓ": r"$\ell$",
}

WIDE = 3
"""Columns of tests side by side in LaTeX and Word, so that they fit the width of a page."""

LONG = 14
"""Rows of one tabular in LaTeX, so that it fits the height of a page."""


def escape_tex(text: str) -> str:
    """Text escaped for LaTeX; a letter that its fonts may not have becomes ``?``."""

    def letter(character: str) -> str:
        if not character.isprintable():
            return " "
        base = unicodedata.normalize("NFD", character)[0]
        return character if base.isascii() and character < "\u0180" else "?"

    return "".join(_ESCAPED.get(c) or letter(c) for c in text)


def symbol_tex(name: str, symbols: Symbols) -> str:
    """Symbol of a quantity as maths; an unknown name as text."""
    if symbol := symbols.maths(name):
        return f"${symbol}$"
    word, of, more = split_population(name)
    if word:
        return f"{escape_tex(word)} {symbol_tex(of, symbols)}{escape_tex(more)}"
    return escape_tex(name.replace("_", " "))


def number_tex(value: float) -> str:
    """A number with three digits as maths."""
    text = number(value, 3).replace("−", "-").replace("∞", r"\infty").replace("–", r"\mbox{--}")
    mantissa, _, power = text.partition("e")
    return rf"${mantissa}\times 10^{{{power}}}$" if power else f"${mantissa}$"


def to_latex(name: str, sheet: Sheet, symbols: Symbols) -> str:
    """A file of tables in the manner of booktabs, numbered if there are several."""
    parts = [
        replace(part, rows=part.rows[at : at + LONG])
        for part in sheet.blocks(WIDE)
        for at in range(0, len(part.rows), LONG)
    ]
    lines = [
        f"% {printable(sheet.title)}.",
        r"% \usepackage{booktabs,array} in the preamble, then " + f"\\input{{{name}.tex}} here.",
    ]
    text = r">{\raggedright\arraybackslash}p"
    for at, part in enumerate(parts, start=1):
        label = f"{name}-{at}" if len(parts) > 1 else name
        columns = (
            rf"@{{}}{text}{{0.28\linewidth}}{text}{{0.08\linewidth}}{'l' * len(part.heads)}@{{}}"
        )
        marks = part.marks()
        notes = [rf"  $^{{{mark}}}$ {escape_tex(note)}." for note, mark in marks.items()]
        rows = (line for row in part.rows for line in _tex_lines(row, marks, symbols))
        lines += [
            r"\begin{table}[htbp]",
            r"  \centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"  \caption{{{escape_tex(part.title)}.}}",
            rf"  \label{{tab:{label}}}",
            rf"  \begin{{tabular}}{{{columns}}}",
            r"    \toprule",
            f"    {' & '.join(['Quantity', 'Unit', *map(escape_tex, part.heads)])} \\\\",
            r"    \midrule",
            *(f"    {line} \\\\" for line in rows),
            r"    \bottomrule",
            r"  \end{tabular}",
            *([r"  \par\smallskip"] if notes else []),
            *notes,
            r"\end{table}",
        ]
    return "\n".join(lines) + "\n"


def _tex_lines(row: SheetRow, marks: Mapping[str, str], symbols: Symbols) -> Iterator[str]:
    """Lines of a quantity: the first line of each cell, below it the others and its meaning."""
    cells = [cell.shown for cell in row.cells]
    for at in range(max(map(len, cells))):
        head = [symbol_tex(row.name, symbols), escape_tex(unit_text(row.unit)) or "--"]
        if at:
            head = [rf"\scriptsize {escape_tex(row.meaning)}" if at == 1 else "", ""]
        shown = []
        for cell, lines in zip(row.cells, cells, strict=True):
            text = _tex_line(lines[at]) if at < len(lines) else ""
            if at == 0 and cell.note:
                text += f"$^{{{marks[printable(cell.note)]}}}$"
            shown.append(rf"\scriptsize {text}" if at and text else text)
        yield " & ".join([*head, *shown])


def _tex_line(line: Line) -> str:
    texts = map(escape_tex, line.template.split("{}"))
    values = (*map(number_tex, line.numbers), "")
    return "".join(text + value for text, value in zip(texts, values, strict=True))


# --- Excel and Word


def to_excel(sheets: Mapping[str, Sheet], symbols: Symbols) -> bytes:
    """A workbook (.xlsx) with a sheet of each name; every number of a cell has a column."""
    import pandas as pd
    from openpyxl.styles import Alignment, Font
    from openpyxl.utils import get_column_letter

    stream = io.BytesIO()
    with pd.ExcelWriter(stream, engine="openpyxl") as writer:
        writer.book.properties.creator = "mfd_bayes"
        for name, sheet in sheets.items():
            frame = _flat(sheet, symbols)
            frame.map(_safe).to_excel(writer, sheet_name=name, index=False, freeze_panes=(1, 3))
            page = writer.sheets[name]
            for at, column in enumerate(frame.columns, start=1):
                letter, texts = get_column_letter(at), frame[column].dtype.kind != "f"
                longest = max((len(str(value)) for value in frame[column]), default=0)
                page.column_dimensions[letter].width = max(min(longest + 2, 60) * texts, 11)
                head, *cells = page[letter]
                head.alignment = Alignment(vertical="top", wrap_text=True)
                for cell in cells if not texts else ():
                    cell.number_format = _format(abs(cell.value or 0.0))
            for at, row in enumerate(sheet.rows, start=2):
                for head, cell in enumerate(row.cells):
                    if cell.marked:
                        first = page.cell(at, 4 + head * len(sheet.numbers))
                        first.font = Font(bold=True, color="C00000")
            page.row_dimensions[1].height = 48
            page.page_setup.orientation = "landscape"
            page.print_title_rows, page.print_title_cols = "1:1", "A:A"
    return stream.getvalue()


def _flat(sheet: Sheet, symbols: Symbols) -> pd.DataFrame:
    """A line for each quantity, a column for each number of each test, and the notes."""
    import pandas as pd

    heads = [f"{head}: {what}" for head in sheet.heads for what in sheet.numbers]
    size, lines = len(sheet.numbers), []
    for row in sheet.rows:
        symbol = "".join(f"_{text}" if low else text for text, low in symbols.parts(row.name))
        numbers: list[float] = []
        notes: dict[str, list[str]] = {}
        for head, cell in zip(sheet.heads, row.cells, strict=True):
            values = [value for line in cell.lines for value in line.numbers][:size]
            finite = [value if math.isfinite(value) else math.nan for value in values]
            numbers += finite + [math.nan] * (size - len(finite))
            more = (f"with {line.text}" for line in cell.lines[len(sheet.lines) :])
            for note in filter(None, (cell.note, *more)):
                notes.setdefault(note, []).append(head)
        texts = (
            note if len(where) == len(sheet.heads) else f"{note} ({', '.join(where)})"
            for note, where in notes.items()
        )
        unit = unit_text(row.unit) or "–"
        lines.append([symbol, row.meaning, unit, *numbers, "; ".join(texts)])
    return pd.DataFrame(lines, columns=["quantity", "meaning", "unit", *heads, "note"])


def _format(size: float) -> str:
    """Format of a cell that shows four digits of a number of this size: "0.00" of 12.3456."""
    if not 1e-4 <= size < 1e6:
        return "General" if size == 0.0 else "0.000E+00"
    places = max(3 - math.floor(math.log10(size)), 0)
    return f"0.{'0' * places}" if places else "0"


_MARGIN, _UNIT, _VALUE = 0.75, 0.8, 1.3
"""Margins of a page in Word, and widths of the columns of units and values, in."""


def to_word(title: str, sheets: Iterable[Sheet], symbols: Symbols) -> bytes:
    """A Word document (.docx); each part of a sheet begins a page and is as wide as the page."""
    from docx import Document
    from docx.shared import Inches

    document = Document()
    document.core_properties.author = "mfd_bayes"
    page = document.sections[0]
    page.left_margin = page.right_margin = page.top_margin = page.bottom_margin = Inches(_MARGIN)
    document.add_heading(printable(title), level=1)
    parts = [part for sheet in sheets for part in sheet.blocks(WIDE)]
    for at, sheet in enumerate(parts):
        caption = document.add_paragraph(printable(sheet.title), style="Caption")
        caption.paragraph_format.page_break_before = at > 0
        caption.paragraph_format.keep_with_next = True
        marks = sheet.marks()
        _add_table(document, sheet, marks, symbols)
        for note, mark in marks.items():
            paragraph = document.add_paragraph()
            paragraph.paragraph_format.space_after = 0
            paragraph.add_run(mark).font.superscript = True
            _small(paragraph, f" {note[:1].upper()}{note[1:]}.")
    stream = io.BytesIO()
    document.save(stream)
    return stream.getvalue()


def _add_table(document: Any, sheet: Sheet, marks: Mapping[str, str], symbols: Symbols) -> None:
    """Add a sheet, with a head that is repeated on each page."""
    from docx.oxml import OxmlElement
    from docx.shared import Inches, Pt, RGBColor

    heads = ("Quantity", "Unit", *sheet.heads)
    grid = document.add_table(rows=1, cols=len(heads), style="Light List")
    grid.autofit = False
    for cell, head in zip(grid.rows[0].cells, heads, strict=True):
        cell.text = printable(head)
    for row in sheet.rows:
        name, unit, *others = grid.add_row().cells
        for text, low in symbols.parts(row.name):
            name.paragraphs[0].add_run(text).font.subscript = low
        if row.meaning:
            _small(name.add_paragraph(), row.meaning)
        unit.text = unit_text(row.unit) or "–"
        for place, value in zip(others, row.cells, strict=True):
            first, *more = value.shown
            run = place.paragraphs[0].add_run(first.text)
            if value.marked:
                run.font.color.rgb = RGBColor(0xC0, 0, 0)
            if value.note:
                run = place.paragraphs[0].add_run(marks[printable(value.note)])
                run.font.superscript = True
            for line in more:
                _small(place.add_paragraph(), line.text)
    for at, row in enumerate(grid.rows):
        for element in ("w:cantSplit", *(["w:tblHeader"] if at == 0 else [])):
            row._tr.get_or_add_trPr().append(OxmlElement(element))
    values = [_VALUE] * len(sheet.heads)
    width = document.sections[0].page_width.inches - 2 * _MARGIN - _UNIT - sum(values)
    for column, inches in zip(grid.columns, (width, _UNIT, *values), strict=True):
        column.width = Inches(inches)
        for cell in column.cells:  # Word reads the column's width, LibreOffice that of the cells
            cell.width = Inches(inches)
            for run in (run for paragraph in cell.paragraphs for run in paragraph.runs):
                run.font.size = run.font.size or Pt(9)


def _small(paragraph: Any, text: str) -> None:
    from docx.shared import Pt

    run = paragraph.add_run(text)
    run.font.size, run.bold = Pt(7.5), False


# --- tables of other commands


def comparison_csv(rows: Iterable[ComparisonRow]) -> str:
    """Scores of each model on unseen cycles, per test and in all."""
    return _records_csv("comparison", map(vars, rows))


def next_csv(advice: Advice, system: System, actuation_unit: str) -> str:
    """Candidates for the next test, the best first, and what each is expected to tell."""
    rows = advice_rows(advice, system, actuation_unit)
    return _csv_text((), rows[0], (map(_safe, row.values()) for row in rows))


def predicted_csv(rows: Rows, actuation: str, probability: float, force: str = "force") -> str:
    """Derived quantities of a prediction, with intervals of this probability."""
    about = (
        f"derived quantities of the device, without offset and noise, of kind {rows[0]['role']}: "
        f"equal-tailed {percent(probability)} % intervals",
        f"{actuation and f'actuation {actuation}; '}measured: of the {force} in the motion's file, "
        "as it is",
    )
    return _records_csv("prediction", rows, about)


def design_csv(rows: Rows, actuation: str, probability: float) -> str:
    """Mean and bounding properties with their factors, by property, then by basis."""
    about = (
        "mean and bounding properties; each bound is exceeded with a probability of "
        f"{50.0 * (1.0 - probability):g} %",
        "lambda: bound over the nominal value, which is the mean of the mean property",
        *([f"actuation {actuation}"] if actuation else []),
    )
    return _records_csv("design", rows, about)


def bands_csv(trace: Trace, band: Band, about: Sequence[str], system: System) -> str:
    """Band of a prediction at every sample, with the measured force of the trace if it has one.

    `about` are lines of its head, besides what the band is; the columns are in the units of
    `system`.
    """
    columns: dict[str, Any] = {
        # may be seconds since 1970
        "time_s" if system.axes.timed else "sample": [f"{time:.15g}" for time in trace.time],
        system.column("displacement", "in"): trace.displacement * system.factor("in"),
    }
    forces = {"force": trace.force, "lower": band.lower, "median": band.median, "upper": band.upper}
    forces |= {"whole_lower": band.whole_lower, "whole_upper": band.whole_upper}
    for name, values in forces.items():
        if values is not None:
            columns[system.column(name, "kip")] = values * system.factor("kip")
    if band.given is not None:
        columns["given"] = band.given.holds(trace.time).astype(np.float64)
    head = [
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({KIND_NAMES[band.kind]}), for each sample by itself; from {band.source}"
    ]
    if band.whole_lower is not None:
        head.append("whole: band of the whole history, of the same probability")
    if band.given is not None:
        head.append(system.text("given: 1 where the force was given, 0 elsewhere"))
    head += [system.text(f"warning: {remark}") for remark in band.remarks] + list(about)
    return _csv_text(head, list(columns), zip(*columns.values(), strict=True), 8)


_LOOP = 400
"""Most samples of each loop in the overview's table; a test's own table holds all."""


def table_of(key: str) -> str:
    """Path from the run folder of the table behind a figure, by the figure's key; "" for none."""
    folder, _, name = key.rpartition("/")
    if not folder:
        return f"figures/{key}.csv"
    return f"{folder}/record.csv" if name in ("loops", "history", "residuals") else ""


def shared_tables(view: CampaignView) -> Iterator[tuple[str, str]]:
    """Path and text of the tables behind the figures of all tests together."""
    import pandas as pd

    system = view.system
    if view.tests:
        loops = []
        for test in view.tests:
            step = max(1, test.trace.samples // _LOOP)
            frame = _record(test)[::step].drop(columns=["time_s", "velocity_in_per_s"])
            loops.append(frame.assign(test=test.id, role=test.role))
        frame = to_units(pd.concat(loops), system)
        yield table_of("overview"), to_csv(frame[["test", "role", *frame.columns[:-2]]])
    if view.laws:
        yield table_of("laws"), to_csv(_laws(view, system))
    if view.truth:
        yield table_of("truth"), to_csv(frame_of("truth", view.truth, system))
    if view.next_test is not None:
        yield table_of("next"), next_csv(view.next_test, system, view.actuation_unit)


def record_table(test: TestView, system: System = US) -> str:
    """The table behind the loops, history and residuals of one test, in the units of a system."""
    record = _record(test)
    if test.trace.force is not None:
        record["residual_kip"] = test.trace.force - test.observation.median
    if test.device is not None:
        record = record.assign(**_bands(test.device, "model_"))
    if test.stage is not None and test.travel is not None:
        record = record.assign(stage=test.stage, travel_in=test.travel)
    fitted = (np.arange(len(record)) >= test.first) & (test.role != "validate")
    return to_csv(to_units(record.assign(fitted=fitted.astype(int)), system))


def _record(test: TestView) -> pd.DataFrame:
    """One test at every sample: motion, force and bands, in internal units."""
    import pandas as pd

    trace = test.trace
    columns = {
        "time_s": trace.time,
        "displacement_in": trace.displacement,
        "velocity_in_per_s": trace.velocity,
        "force_kip": np.full(trace.samples, np.nan) if trace.force is None else trace.force,
    }
    return pd.DataFrame(columns | _bands(test.observation))


def _bands(fan: Fan, name: str = "") -> dict[str, Any]:
    """Median and bounds of a fan by column."""
    columns = {f"{name}median_kip": fan.median}
    for interval in fan.intervals:
        share = percent(interval.probability)
        columns[f"{name}lower_{share}_kip"] = interval.lower
        columns[f"{name}upper_{share}_kip"] = interval.upper
    return columns


def _laws(view: CampaignView, system: System) -> pd.DataFrame:
    """Every law's curve with its bands, and the tests beside it."""
    import pandas as pd

    unit = view.actuation_unit
    along, lines = system.factor(unit), []
    for law in view.laws:
        by = system.factor(law.unit)
        what = law.name, system.unit(law.unit), law.law
        for fan in (law.device, law.new_test):
            widest = fan.widest
            about = f"{KIND_NAMES[fan.kind]}, {percent(widest.probability)} %"
            curve = zip(law.actuation, widest.lower, fan.median, widest.upper, strict=True)
            lines += [(*what, about, at * along, a * by, b * by, c * by) for at, a, b, c in curve]
        lines += [
            (*what, f"test {name}, 95 %", at * along, a * by, b * by, c * by)
            for name, at, a, b, c in law.tested
        ]
    head = ("quantity", "unit", "law", "what", f"actuation_{system.unit(unit)}")
    return pd.DataFrame(lines, columns=[*head, "lower", "median", "upper"])
