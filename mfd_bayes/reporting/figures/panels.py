"""Figures of many small panels, whose axes and ticks may serve again.

Matplotlib takes longer to make axes and their ticks than to draw what is in them, and a report
draws the same kinds of figures for one test after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.symbols import plain

COLUMNS = 4
"""Small panels side by side."""

Sheet = tuple[Figure, list[Axes]]
"""A figure and the axes of its panels."""


class Sheets:
    """Figures with panels that serve again.

    Where a figure of the same kind and number of panels is asked for, the earlier one is emptied
    and given again: it must no longer be needed then.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[str, int], Sheet] = {}

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Draw figures on these."""
        before = _IN_USE.set(self)
        try:
            yield
        finally:
            _IN_USE.reset(before)

    def sheet(self, kind: str, number: int, make: Callable[[int], Sheet]) -> Sheet:
        """A sheet of a kind with a number of panels, made if there is none."""
        if (kind, number) in self._kept:
            _empty(*self._kept[kind, number])
        else:
            self._kept[kind, number] = make(number)
        return self._kept[kind, number]


_IN_USE: ContextVar[Sheets | None] = ContextVar("_IN_USE", default=None)


def in_rows(kind: str, title: str, number: int) -> Sheet:
    """Small panels in four columns; fixed margins are much faster than constrained layout."""
    figure, panels = _sheet(kind, number, _make_rows)
    above = 0.08 / figure.get_figheight()
    figure.suptitle(plain(title), x=0.01, y=1.0 - above, ha="left", va="top")
    return figure, panels


def of_pairs(title: str, number: int) -> Sheet:
    """Panels row by row: in each row the pairs with earlier quantities, then the quantity alone."""
    figure, panels = _sheet("pairs", number, _make_pairs)
    figure.suptitle(plain(title), x=0.01, y=0.985, ha="left")
    return figure, panels


def _sheet(kind: str, number: int, make: Callable[[int], Sheet]) -> Sheet:
    sheets = _IN_USE.get() or Sheets()  # a new figure where none are in use
    return sheets.sheet(kind, number, make)


def _make_rows(number: int) -> Sheet:
    columns = min(COLUMNS, max(1, number))
    rows = max(1, -(-number // columns))
    height = 1.4 * rows + 0.75
    figure = Figure(figsize=(10, height), dpi=look.DPI)
    edges = {"left": 0.065, "right": 0.985, "top": 1 - 0.55 / height, "bottom": 0.65 / height}
    figure.subplots_adjust(**edges, wspace=0.28, hspace=0.65)
    return figure, [figure.add_subplot(rows, columns, at + 1) for at in range(number)]


def _make_pairs(number: int) -> Sheet:
    size = max(1.15 * number, 4.0)
    figure = Figure(figsize=(size, size), dpi=look.DPI)
    edges = {"left": 0.12, "bottom": 0.11, "right": 0.985, "top": 0.945}
    grid = figure.add_gridspec(number, number, wspace=0.05, hspace=0.05, **edges)
    at = [(row, column) for row in range(number) for column in range(row + 1)]
    return figure, [figure.add_subplot(grid[place]) for place in at]


def _empty(figure: Figure, panels: list[Axes]) -> None:
    """Remove what was drawn; axes and ticks stay, with the limits and scales of new ones."""
    for legend in list(figure.legends):
        legend.remove()
    for axes in panels:
        for artist in [*axes.lines, *axes.patches, *axes.collections]:
            artist.remove()
        axes.set_title("")
        axes.set_xscale("linear")
        axes.relim()
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
        axes.set_autoscale_on(True)
