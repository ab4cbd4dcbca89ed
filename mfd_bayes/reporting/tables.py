"""Tables of a report: frames, CSV, JSON, LaTeX, Word and Excel."""

from __future__ import annotations

import csv
import io
import json
import math
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.evaluation.scores import QuantileBand, Row, Rows
from mfd_bayes.evaluation.views import CampaignView, TestView
from mfd_bayes.population.bands import KIND_NAMES
from mfd_bayes.reporting.symbols import Symbols, number, printable, unit_text
from mfd_bayes.runs.manifest import ComparisonRow
from mfd_bayes.runs.unit_system import US, UnitSystem
from mfd_bayes.units import Axes, percent

if TYPE_CHECKING:
    import pandas as pd


_OF_UNIT = frozenset(
    {
        *("mean", "sd", "lower", "median", "upper", "measured", "truth", "nominal", "value"),
        *("q2.5", "q50", "q97.5", "other_q2.5", "other_q50", "other_q97.5", "loop_estimate"),
        *("other_lower", "other_median", "other_upper", "smallest", "largest"),
        *("measured_low", "measured_high", "first_three", "observed", "expected"),
        *("joint_q2.5", "joint_q50", "joint_q97.5", "before", "after"),
    }
)
"""Keys of a row, and columns of a table, that are in the unit that the row names."""

_ENDINGS = {"_kip": "kip", "_in": "in", "_in_per_s": "in/s"}
"""Internal units at the ends of columns' names."""


def to_units(frame: pd.DataFrame, system: UnitSystem) -> pd.DataFrame:
    """A table in the units of a system.

    A column `unit` is the unit of the numbers in its row; other columns have theirs at the end of
    their name: "width_95_kip".
    """
    if system == US:
        return frame
    table, axes = frame.copy(), system.axes
    if not axes.of_damper:
        for name in {"quantity", "feature", "condition", "note"}.intersection(frame.columns):
            table[name] = [_renamed(words, axes) for words in frame[name]]
    if "unit" in frame:
        factors = frame["unit"].map(system.factor)
        for name in _OF_UNIT.intersection(frame.columns):
            table[name] = frame[name] * factors
        table["unit"] = frame["unit"].map(system.unit)
    names = {}
    for name in frame.columns:
        for ending, internal in _ENDINGS.items():
            if name.endswith(ending):
                names[name] = system.column(name.removesuffix(ending), internal)
                table[name] = frame[name] * system.factor(internal)
    if not axes.timed:
        names["time_s"] = "sample"
        rates = [n for n in map(str, frame) if n == "frequency_Hz" or n.endswith("_in_per_s")]
        table = table.drop(columns=rates)
    return table.rename(columns=names)


def _renamed(words: Any, axes: Axes) -> Any:
    """Words of the package in the names of a model's axes; a parameter's name stays."""
    if words == "peak_force":
        return f"peak_{axes.response.name}"
    is_ours = isinstance(words, str) and (" " in words or words == "stroke")
    return axes.text(words) if is_ours else words


def convert_rows(rows: Rows, system: UnitSystem) -> Rows:
    """Rows with a key `unit`, in the units of a system."""
    return tuple(
        {
            name: value * system.factor(row["unit"]) if name in _OF_UNIT else value
            for name, value in row.items()
        }
        | {"unit": system.unit(row["unit"])}
        for row in rows
    )


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
    "joint_median:joint_q50 joint_upper:joint_q97.5 joint_conflict",
    "laws": f"test:group name:constant {_POSTERIOR}",
    "derived": f"test role name:quantity unit mean sd {_INTERVAL} measured note",
    "loop_estimates": f"test name:quantity unit value:loop_estimate {_INTERVAL} tolerance missed",
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
        "fitted_crps:fitted_crps_kip width_ratio crps_ratio simultaneous_95"
    ),
    "sensitivity": (
        "group condition name:quantity of prior:prior_sensitivity data:data_sensitivity "
        "pareto_k verdict"
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
    "design": ("name:property unit basis of:name nominal lower upper lower_ratio upper_ratio note"),
}
"""Columns of each table, as "column", or "key:column" where the rows call it otherwise."""


def _columns(table: str) -> dict[str, str]:
    """Column of each key of a table's rows."""
    pairs = (word.partition(":") for word in _COLUMNS[table].split())
    return {key: column or key for key, _, column in pairs}


def frame_of(table: str, rows: Iterable[Any], system: UnitSystem = US) -> pd.DataFrame:
    """A table of `_COLUMNS` with a line for each of its rows, dicts or dataclasses."""
    import pandas as pd

    columns = _columns(table)
    records = [row if isinstance(row, dict) else vars(row) for row in rows]
    return to_units(pd.DataFrame(records, columns=list(columns)).rename(columns=columns), system)


def report_frames(view: CampaignView) -> dict[str, pd.DataFrame]:
    """Tables of a report in its units, by name."""
    tests = view.tests
    rows: dict[str, Iterable[Any]] = {
        "parameters": (row for test in tests for row in test.rows),
        "derived": (row for test in tests for row in test.derived),
        "loop_estimates": (row for test in tests for row in test.loop_estimates),
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
    return {name: frame_of(name, lines, view.system) for name, lines in rows.items()}


def to_csv(frame: pd.DataFrame, comments: Iterable[str] = ()) -> str:
    """A table as CSV, below lines of comments: six digits, and no text that a spreadsheet runs."""
    text = _safe(frame).to_csv(index=False, float_format="%.6g", lineterminator="\n")
    return _comments(comments) + text


def _comments(lines: Iterable[str]) -> str:
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)


def _safe(frame: pd.DataFrame) -> pd.DataFrame:
    """A table with no text that a spreadsheet takes for a formula, and "yes" or "no" for truths."""

    def safe(value: object) -> object:
        if isinstance(value, bool | np.bool_):
            return "yes" if value else "no"
        if not isinstance(value, str):
            return value
        text = printable(value)
        return f"'{text}" if text.lstrip().startswith(_FORMULA) else text

    table = frame.copy()
    for name in frame.columns:
        if frame[name].dtype.kind not in "fiu":
            table[name] = frame[name].astype(object).map(safe)
    return table


def _csv(comments: Iterable[str], columns: Mapping[str, Iterable[Any]], digits: int = 6) -> str:
    """CSV of columns without pandas, which takes long to import."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        cells = (f"{c:.{digits}g}" if isinstance(c, float) else c for c in row)
        table.writerow("" if cell == "nan" else cell for cell in cells)
    return _comments(comments) + text.getvalue()


def to_json(title: str, name: str, frame: pd.DataFrame) -> str:
    """JSON with the meaning of its figures; null where one is not finite."""
    frame = frame.rename(columns={"q2.5": "lower", "q50": "median", "q97.5": "upper"})
    content = {
        "title": title,
        "table": name,
        "interval": {"kind": "equal-tailed", "probability": 0.95, "bounds": ["lower", "upper"]},
        "null": "not defined, or not finite",
        "rows": json.loads(frame.to_json(orient="records", double_precision=15)),
    }
    return json.dumps(content, indent=1) + "\n"


# --- tables for reading


@dataclass(frozen=True)
class Line:
    """Numbers in their places in a text: "[{}, {}]" and (1.1, 1.4), in the unit of the row.

    A marked line is a measured value outside of its bounds.
    """

    template: str
    numbers: tuple[float, ...]
    marked: bool = False

    @property
    def finite(self) -> bool:
        """Whether it has a number."""
        return any(map(math.isfinite, self.numbers))

    def text(self, factor: float = 1.0) -> str:
        """The line with three digits, its numbers times a factor."""
        return self.template.format(*(number(factor * value, 3) for value in self.numbers))


@dataclass(frozen=True)
class Cell:
    """What a cell of a sheet shows: a line each, with the unit of its row."""

    lines: tuple[Line, ...] = ()
    note: str = ""


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
        return sorted({i for c in self.cells for i, line in enumerate(c.lines) if line.finite})


@dataclass(frozen=True)
class Sheet:
    """A table for reading: quantities as rows, tests as columns.

    `heads` are those of the columns, `lines` what each line of a cell is, and `conditions` those of
    the columns of a data sheet: values with their internal units.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[SheetRow, ...]
    lines: tuple[str, ...] = ()
    conditions: tuple[tuple[tuple[float, str], ...], ...] = ()

    def blocks(self, max_columns: int) -> list[Sheet]:
        """Parts of the sheet with about as many columns each, and at most so many."""
        max_columns = -(-len(self.heads) // max(-(-len(self.heads) // max_columns), 1)) or 1
        return [
            replace(
                self,
                heads=self.heads[start : start + max_columns],
                conditions=self.conditions[start : start + max_columns],
                rows=tuple(
                    replace(row, cells=row.cells[start : start + max_columns]) for row in self.rows
                ),
            )
            for start in range(0, len(self.heads), max_columns)
        ]


def paper_sheets(view: CampaignView, symbols: Symbols) -> tuple[Sheet, Sheet]:
    """The paper's Tables I and II, with uncertainty."""
    tests = {test.id: test for test in view.tests if test.rows}
    levels = {n: view.system.actuation(t.trace, view.actuation_unit) for n, t in tests.items()}
    heads = {n: ", ".join(filter(None, (printable(n), level))) for n, level in levels.items()}
    rows = [row for test in tests.values() for row in test.rows]
    laws = [row | {"test": "all tests"} for row in view.law_rows]
    return (
        _sheet("Table I: parameters of the tests", rows, heads, symbols),
        _sheet("Table II: constants of the laws", laws, {"all tests": "all tests"}, symbols),
    )


def _sheet(title: str, rows: Sequence[Row], heads: Mapping[str, str], symbols: Symbols) -> Sheet:
    """Sheet of posteriors: the median, and below it the interval.

    Where there is a joint posterior of all tests, it comes first.
    """
    cells: dict[tuple[str, str], dict[str, Cell]] = {}
    for row in rows:
        test_values = row["median"], row["lower"], row["upper"]
        joint = tuple(row.get(f"joint_{key}", math.nan) for key in ("median", "lower", "upper"))
        middle, *ends = joint if math.isfinite(joint[0]) else test_values
        lines = [Line("{}", (middle,)), Line("[{}, {}]", tuple(ends))]
        if row.get("joint_conflict", False):
            lines.append(Line("alone: {} [{}, {}]", test_values, marked=True))
        of_quantity = cells.setdefault((row["name"], row["unit"]), {})
        of_quantity[row["test"]] = Cell(tuple(lines), row["note"])
    sheet_rows = tuple(
        SheetRow(
            name, unit, tuple(test_cells.get(test, Cell()) for test in heads), symbols.meaning(name)
        )
        for (name, unit), test_cells in cells.items()
    )
    title = f"{title}, posterior median and equal-tailed 95 % interval"
    return Sheet(title, tuple(heads.values()), sheet_rows)


def with_motion(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with the units of the motion in the heads of its columns."""
    names = {"stroke": "stroke_in", "frequency": "frequency_Hz", "speed": "speed_in_per_s"}
    return rows.rename(columns=names)


def datasheet_frame(rows: pd.DataFrame, system: UnitSystem) -> pd.DataFrame:
    """Rows of a data sheet in the units of a system, with those of its conditions in the heads."""
    frame = with_motion(rows)
    if not system.axes.actuated:
        return to_units(frame.drop(columns=["actuation", "actuation_unit"]), system)
    levels = rows["actuation_unit"].map(system.of_actuation)
    frame["actuation"] = rows["actuation"] * levels.str[0].astype(float)
    return to_units(frame.assign(actuation_unit=levels.str[1]), system)


def datasheet_sheet(rows: pd.DataFrame, title: str, symbols: Symbols, axes: Axes) -> Sheet:
    """The properties of a data sheet for reading: conditions are columns."""
    conditions: dict[str, tuple[tuple[float, str], ...]] = {}
    properties: dict[tuple[str, str, str], dict[str, Cell]] = {}
    order = list(dict.fromkeys(rows["quantity"]))
    table: list[Row] = rows.to_dict("records")  # type: ignore[assignment]
    table = [row for row in table if not row["cycle"]]  # single cycles are in the CSV alone
    for row in sorted(table, key=lambda row: order.index(row["quantity"])):
        quantities = [(row["stroke"], "in")]
        if axes.actuated:
            quantities.insert(0, (row["actuation"], ACTUATION + row["actuation_unit"]))
        if axes.timed:
            quantities += [(row["frequency"], "Hz"), (row["speed"], "in/s")]
        conditions.setdefault(row["condition"], tuple(p for p in quantities if math.isfinite(p[0])))
        several, is_outside = row["n_cycles"] > 1, row["n_outside"] > 0
        ends = (row["measured_low"], row["measured_high"]) if several else (math.nan, math.nan)
        lines = (
            Line("{}", (row["measured"],), marked=is_outside),
            Line("{}–{}", ends),
            Line("{}", (row["first_three"],)),
            Line("{}", (row["nominal"],)),
            Line("{}–{}", (row["lower"], row["upper"])),
        )
        key = row["quantity"], row["direction"], row["unit"]
        properties.setdefault(key, {})[row["condition"]] = Cell(lines, row["note"])
    sheet_rows = []
    for (quantity, direction, unit), cells in properties.items():
        name = axes.text(quantity.replace("_", " "))
        meaning = ", ".join(filter(None, (symbols.meaning(name), direction)))
        of = tuple(cells.get(condition, Cell()) for condition in conditions)
        sheet_rows.append(SheetRow(name, unit, of, meaning, direction))
    lines_of = ("measured", "cycles", "first three", "nominal", "bounds")
    heads, values = tuple(conditions), tuple(conditions.values())
    return Sheet(f"{title}: data sheet", heads, tuple(sheet_rows), lines_of, values)


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
    ("whole history inside 95 %", "simultaneous_95", "%"),
)


def score_sheet(rows: Sequence[Row], title: str = "Scores") -> Sheet:
    """Scores of predicted tests: tests are columns."""
    sheet_rows = []
    for words, name, unit in _SCORE_ROWS:
        values = [(100.0 if unit == "%" else 1.0) * row.get(name, math.nan) for row in rows]
        if any(map(math.isfinite, values)):
            cells = tuple(Cell((Line("{}", (value,)),)) for value in values)
            sheet_rows.append(SheetRow(words, unit, cells))
    return Sheet(title, tuple(row["test"] for row in rows), tuple(sheet_rows))


# --- LaTeX, Excel and Word

WIDE = 3
"""Columns of tests side by side in LaTeX and Word, so that they fit the width of a page."""

_TEX = {
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
    "∞": r"$\infty$",
    "γ": r"$\gamma$",
    "λ": r"$\lambda$",
    "σ": r"$\sigma$",
    "ℓ": r"$\ell$",
}


def escape_tex(text: str) -> str:
    """Text escaped for LaTeX; a letter that its fonts may not have becomes ``?``."""

    def letter(character: str) -> str:
        base = unicodedata.normalize("NFD", character)[0]
        return character if base.isascii() and character < "\u0180" else "?"

    return "".join(_TEX.get(c) or letter(c) for c in printable(text))


def symbol_tex(name: str, symbols: Symbols) -> str:
    """Symbol of a quantity as maths; an unknown name as text."""
    return str(symbols.written_as(name, lambda maths, _: f"${maths}$", escape_tex))


def _on_paper(
    sheet: Sheet, system: UnitSystem
) -> Iterator[tuple[Sheet, dict[str, int], list[Any]]]:
    """Parts of a sheet, each with the numbers of its notes, and its rows in the units of a system.

    A row is a `SheetRow`, its unit, and for each cell its lines and its note's number, 0 for none.
    """
    for block in sheet.blocks(WIDE) if sheet.rows else ():
        texts = dict.fromkeys(c.note for row in block.rows for c in row.cells if c.note)
        notes, rows = {note: index for index, note in enumerate(texts, start=1)}, []
        for row in block.rows:
            factor, cells = system.factor(row.unit), []
            for cell in row.cells:
                lines = [line.text(factor) for line in cell.lines if line.finite]
                cells.append((lines or ["–"], notes.get(cell.note, 0)))
            rows.append((row, unit_text(system.unit(row.unit)) or "–", cells))
        yield block, notes, rows


def to_latex(name: str, sheet: Sheet, symbols: Symbols, system: UnitSystem = US) -> str:
    """A file of longtables in the manner of booktabs, in the units of a system."""
    texts = [
        f"% {printable(sheet.title)}.\n% \\usepackage{{booktabs,longtable,array}} in the preamble, "
        f"then \\input{{{name}.tex}} here.\n"
    ]
    small = r"\newline\scriptsize "
    for index, (block, notes, rows) in enumerate(_on_paper(sheet, system), start=1):
        lines = []
        for row, unit, cells in rows:
            quantity = filter(None, (symbol_tex(row.name, symbols), escape_tex(row.meaning)))
            lines.append([small.join(quantity), escape_tex(unit)])
            for texts_of, note in cells:
                first_line, *more_lines = map(escape_tex, texts_of)
                first_line += f"$^{{{note}}}$" if note else ""
                lines[-1].append(small.join([first_line, *more_lines]))
        column = r">{{\raggedright\arraybackslash}}p{{{:.2f}\linewidth}}"
        widths = (0.25, 0.1, *[0.55 / len(block.heads)] * len(block.heads))
        heads = ["Quantity", "Unit", *map(escape_tex, block.heads)]
        head, *body = (" & ".join(cells) + " \\\\\n" for cells in [heads, *lines])
        table = (
            f"\\begin{{longtable}}{{{''.join(map(column.format, widths))}}}\n"
            f"\\caption{{{escape_tex(block.title)}.}} \\label{{tab:{name}-{index}}} \\\\\n"
            f"\\toprule\n{head}\\midrule\n\\endfirsthead\n"
            f"\\toprule\n{head}\\midrule\n\\endhead\n\\bottomrule\n\\endfoot\n"
            f"{''.join(body)}\\end{{longtable}}\n"
        )
        footnotes = "".join(
            rf"$^{{{i}}}$ {escape_tex(note)}.\par" "\n" for note, i in notes.items()
        )
        texts.append(f"{{\\footnotesize\\setlength{{\\tabcolsep}}{{3pt}}\n{table}{footnotes}}}\n")
    return "".join(texts)


def to_excel(frames: Mapping[str, pd.DataFrame]) -> bytes:
    """A workbook (.xlsx) with a sheet for each table, whose lines can be filtered."""
    import pandas as pd

    stream = io.BytesIO()
    with pd.ExcelWriter(stream, engine="openpyxl") as writer:
        writer.book.properties.creator = "mfd_bayes"
        for name, frame in frames.items():
            _safe(frame).to_excel(writer, sheet_name=name, index=False, freeze_panes=(1, 2))
            page = writer.sheets[name]
            page.auto_filter.ref = page.dimensions
    return stream.getvalue()


def to_word(title: str, sheets: Iterable[Sheet], symbols: Symbols, system: UnitSystem) -> bytes:
    """A Word document (.docx) in the units of a system; each part of a sheet begins a page."""
    from docx import Document
    from docx.shared import Pt

    document = Document()
    document.core_properties.author = "mfd_bayes"
    document.styles["Normal"].font.size = Pt(9)
    document.add_heading(printable(title), level=1)
    blocks = (block for sheet in sheets for block in _on_paper(sheet, system))
    for index, (block, notes, rows) in enumerate(blocks):
        caption = document.add_paragraph(printable(block.title), style="Caption")
        caption.paragraph_format.page_break_before = index > 0
        grid = document.add_table(rows=1, cols=2 + len(block.heads), style="Light List")
        for cell, head in zip(grid.rows[0].cells, ("Quantity", "Unit", *block.heads), strict=True):
            cell.text = printable(head)
        for row, unit_name, cells in rows:
            name, unit, *value_cells = grid.add_row().cells
            for text, low in symbols.parts(row.name):
                name.paragraphs[0].add_run(text).font.subscript = low
            if row.meaning:
                name.add_paragraph().add_run(row.meaning).font.size = Pt(7.5)
            unit.text = unit_name
            for target, (lines, note) in zip(value_cells, cells, strict=True):
                target.text = "\n".join(lines)
                if note:
                    target.paragraphs[0].add_run(f" {note}").font.superscript = True
        for note, i in notes.items():
            document.add_paragraph(f"{i} {printable(note)}.")
    stream = io.BytesIO()
    document.save(stream)
    return stream.getvalue()


# --- tables of other commands


def comparison_csv(rows: Iterable[ComparisonRow]) -> str:
    """Scores of each model on unseen cycles, per test and in all."""
    return to_csv(frame_of("comparison", rows))


def _by_column(table: str, rows: Rows) -> dict[str, list[Any]]:
    return {name: [row[key] for row in rows] for key, name in _columns(table).items()}


# --- tables behind the figures

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
            frame = _record(test)[:: max(1, test.trace.samples // _LOOP)]
            frame = frame.drop(columns=["time_s", "velocity_in_per_s"])
            frame.insert(0, "role", test.role)
            frame.insert(0, "test", test.id)
            loops.append(frame)
        yield table_of("overview"), to_csv(to_units(pd.concat(loops), system))
    if view.laws:
        yield table_of("laws"), to_csv(_laws(view, system))
    if view.truth:
        yield table_of("truth"), to_csv(frame_of("truth", view.truth, system))


def record_table(test: TestView, system: UnitSystem) -> str:
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


def _bands(fan: QuantileBand, name: str = "") -> dict[str, Any]:
    """Median and bounds of a fan by column."""
    columns = {f"{name}median_kip": fan.median}
    for interval in fan.intervals:
        share = percent(interval.probability)
        columns[f"{name}lower_{share}_kip"] = interval.lower
        columns[f"{name}upper_{share}_kip"] = interval.upper
    return columns


def _laws(view: CampaignView, system: UnitSystem) -> pd.DataFrame:
    """Every law's curve with its bands, and the tests beside it."""
    import pandas as pd

    actuation_factor, frames = system.factor(view.actuation_unit), []
    for law in view.laws:
        curves: list[tuple[Any, ...]] = [
            (
                f"{KIND_NAMES[fan.kind]}, {percent(fan.widest.probability)} %",
                *(law.actuation, fan.widest.lower, fan.median, fan.widest.upper),
            )
            for fan in (law.device, law.new_test)
        ]
        curves += [(f"test {name}, 95 %", *values) for name, *values in law.tested]
        head = {"quantity": law.name, "unit": system.unit(law.unit), "law": law.law}
        for label, actuation, *bounds in curves:
            columns = {
                f"actuation_{system.unit(view.actuation_unit)}": np.atleast_1d(
                    actuation * actuation_factor
                )
            }
            for name, bound in zip(("lower", "median", "upper"), bounds, strict=True):
                columns[name] = np.atleast_1d(bound * system.factor(law.unit))
            frames.append(pd.DataFrame({**head, "what": label, **columns}))
    return pd.concat(frames)
