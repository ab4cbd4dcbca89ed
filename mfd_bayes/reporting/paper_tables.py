"""The paper's Tables I and II with uncertainty, as cells that Word and Excel files are made of."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import unescape
from importlib.util import find_spec

from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.views import CampaignView, Row, TestView
from mfd_bayes.reporting.symbols import in_html, meaning, printable, unit_text

_PART = re.compile(r"<sub>(.*?)</sub>|<[^>]+>|([^<]+)")


@dataclass(frozen=True)
class Symbol:
    """A symbol as parts of text, each with whether it is a subscript."""

    parts: tuple[tuple[str, bool], ...]

    @property
    def text(self) -> str:
        """In one line: "F_c,fwd"."""
        return "".join(f"_{part}" if low else part for part, low in self.parts)


@dataclass(frozen=True)
class Line:
    """A quantity, and its values in each column; None where a column has none."""

    symbol: Symbol
    meaning: str
    unit: str
    values: tuple[Row | None, ...]


@dataclass(frozen=True)
class PaperTable:
    """A table: its title, the heads of its columns of values, and its lines."""

    title: str
    heads: tuple[str, ...]
    lines: tuple[Line, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of its values, each once."""
        rows = (row for line in self.lines for row in line.values if row is not None)
        return tuple(dict.fromkeys(printable(row.note) for row in rows if row.note))


def paper_tables(view: CampaignView) -> tuple[PaperTable, PaperTable]:
    """Tables I and II of a report, in its units."""
    return _parameters([test for test in view.tests if test.rows]), _laws(view.law_rows)


def symbol_of(name: str) -> Symbol:
    """Symbol of a quantity: "F" and the subscript "c,fwd"."""
    found = _PART.finditer(str(in_html(name)))
    parts = ((unescape(m[1] or m[2] or ""), m[1] is not None) for m in found)
    return Symbol(tuple(part for part in parts if part[0]))


def check_library(library: str, extra: str) -> None:
    """Refuse to write a form whose library is not installed.

    Raises
    ------
    ReportError
        When it is not.
    """
    if find_spec(library) is None:
        raise ReportError(
            f'this form needs {library}, which is not installed: pip install "mfd_bayes[{extra}]"'
        )


def _parameters(tests: Sequence[TestView]) -> PaperTable:
    found = [{row.name: row for row in test.rows} for test in tests]
    units = {row.name: row.unit for test in tests for row in test.rows}
    return PaperTable(
        "Table I: parameters of the tests, posterior median and equal-tailed 95 % interval",
        tuple(f"{printable(test.id)}, {test.actuation}" for test in tests),
        tuple(
            _line(name, unit, (rows.get(name) for rows in found)) for name, unit in units.items()
        ),
    )


def _laws(rows: Iterable[Row]) -> PaperTable:
    return PaperTable(
        "Table II: constants of the laws, posterior median and equal-tailed 95 % interval",
        ("all tests",),
        tuple(_line(row.name, row.unit, [row]) for row in rows),
    )


def _line(name: str, unit: str, values: Iterable[Row | None]) -> Line:
    return Line(symbol_of(name), meaning(name), unit_text(unit) or "–", tuple(values))
