"""The files of a report: tables, figures and pages, drawn in several processes if many."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mfd_bayes.evaluation.views import CampaignView, TestView
from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.local import run_in_processes
from mfd_bayes.jobs.parallel import meanwhile
from mfd_bayes.reporting.conversion import convert_test, in_tables, shown_in
from mfd_bayes.reporting.exports import export_tables
from mfd_bayes.reporting.figure_data import shared_tables, table_of, tables_of_test
from mfd_bayes.reporting.figures import OF_TEST, draw_shared, draw_test
from mfd_bayes.reporting.forms import PLAIN, Forms
from mfd_bayes.reporting.html import needed, render
from mfd_bayes.reporting.pdf import print_page
from mfd_bayes.reporting.tables import report_tables
from mfd_bayes.reporting.word import word_tables
from mfd_bayes.reporting.workbook import excel_tables
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import write_bytes, write_text

_ALONE = 3
"""Drawings that one process has done before another has started."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """A job that draws the figures of one test and writes the tables behind them."""

    test: TestView
    system: System
    actuation_unit: str

    @property
    def id(self) -> str:
        """Id of the test."""
        return self.test.id

    @property
    def pictures(self) -> tuple[str, ...]:
        """Keys of all figures that a test can have."""
        return tuple(f"tests/{self.id}/{name}" for name in OF_TEST)

    @property
    def makes(self) -> tuple[str, ...]:
        """Files of these figures."""
        return tuple(f"{key}.png" for key in self.pictures)

    def needs(self, out: Path) -> tuple[str, ...]:
        """Nothing: the test is in memory."""
        return ()

    def remove(self, out: Path) -> None:
        """Remove the figures, and the tables behind them, that an earlier report has made."""
        for key in self.pictures:
            (out / f"{key}.png").unlink(missing_ok=True)
            (out / table_of(key)).unlink(missing_ok=True)

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Write figures and tables; remove a picture that now has nothing to show."""
        began = time.perf_counter()
        drawn = dict(draw_test(self.test, self.system, self.actuation_unit))
        for key in self.pictures:
            if key in drawn:
                write_bytes(out / f"{key}.png", drawn[key])
            else:
                (out / f"{key}.png").unlink(missing_ok=True)
        shown = convert_test(self.test, self.system, self.actuation_unit)
        for name, text in tables_of_test(shown, self.system):
            write_text(out / name, text)
        return Outcome(self.id, State.DONE, time.perf_counter() - began)


def publish(
    view: CampaignView,
    out: Path,
    processes: int,
    observe: Callable[[Step], None],
    forms: Forms = PLAIN,
) -> None:
    """Write tables, figures and pages of a report into the run folder.

    Raises
    ------
    MfdError
        When something cannot be written, or no browser prints the PDF.
    """
    system = shown_in(view)
    shown = in_tables(view, system)
    for name, text in (report_tables(shown, system) | export_tables(shown)).items():
        write_text(out / name, text)
    if forms.word:
        write_bytes(out / "tables.docx", word_tables(shown))
    if forms.excel:
        write_bytes(out / "tables.xlsx", excel_tables(shown))
    observe(Step("report", "figures"))
    images = _draw(view, out, processes, forms)
    for name, text in shared_tables(view):
        write_text(out / name, text)
    observe(Step("report", "pages"))
    for name, page in render(view, images).items():
        write_text(out / name, page)
    if forms.pdf:
        observe(Step("report", "PDF"))
        write_bytes(out / "report.pdf", print_page(out / "report.html"))
    observe(Step("report", State.DONE))


def _draw(view: CampaignView, out: Path, processes: int, forms: Forms) -> dict[str, bytes]:
    """Draw all figures; the bytes that the pages need, by the figures' keys."""
    system, names = shown_in(view), forms.drawn([test.id for test in view.tests])
    every = [Drawing(test, system, view.actuation_unit) for test in view.tests]
    drawings = [drawing for drawing in every if drawing.id in names]
    for drawing in every:
        if drawing.id not in names:
            drawing.remove(out)
    if len(drawings) > _ALONE and processes > 1:
        with meanwhile(processes) as beside:  # the processes draw, this one meanwhile too
            drawn = beside(partial(_draw_in_processes, drawings, out, processes))
            images = _draw_shared(view, out)
            drawn()
    else:
        images = _draw_shared(view, out)
        for drawing in drawings:
            drawing.run(out, lambda _: None)
    for key in (key for drawing in drawings for key in drawing.pictures):
        path = out / f"{key}.png"
        if path.is_file():
            with path.open("rb") as file:
                images[key] = needed(view, key, file)
    return images


def _draw_in_processes(drawings: Sequence[Drawing], out: Path, processes: int) -> None:
    for _ in run_in_processes(drawings, out, processes, lambda _: None):
        pass


def _draw_shared(view: CampaignView, out: Path) -> dict[str, bytes]:
    """Draw the figures that show all tests; their bytes by their keys."""
    images = {}
    for key, png in draw_shared(view):
        write_bytes(out / "figures" / f"{key}.png", png)
        images[key] = png
    return images
