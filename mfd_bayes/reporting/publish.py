"""The files of a report: tables, figures, pages and what is made only where it is asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.views import CampaignView, TestView
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.local import run_in_processes
from mfd_bayes.jobs.parallel import meanwhile
from mfd_bayes.reporting.conversion import system_of
from mfd_bayes.reporting.page import render
from mfd_bayes.reporting.symbols import of_model
from mfd_bayes.reporting.tables import (
    datasheet_frame,
    datasheet_sheet,
    paper_sheets,
    record_table,
    report_tables,
    shared_tables,
    to_csv,
    to_excel,
    to_latex,
    to_word,
)
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import write_bytes, write_text

if TYPE_CHECKING:
    from mfd_bayes.evaluation.datasheet import Datasheet

ALL_DRAWN = 12
"""In a run of more tests, the pictures of single tests are drawn only where asked for."""

ALONE = 3
"""Drawings that one process has done before another has started."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Programs that can print a page, in order of preference."""

_PRINTING = 180.0
"""Longest time for printing, s; a report takes a few."""


@dataclass(frozen=True)
class Forms:
    """Parts of a report that are made only where asked for: they need more software or time.

    Attributes
    ----------
    pdf, word, excel, next_test : bool
        PDFs of the pages, the tables for Word and Excel, the section on the next test.
    tests : tuple of str
        Tests whose pictures are drawn, where there are more than `ALL_DRAWN`.
    all_tests : bool
        Whether those of all tests are.
    at : tuple of str
        Conditions that the data sheet has besides those that were tested: "500 psi, 1 in, 0.5 Hz".
    """

    pdf: bool = False
    word: bool = False
    excel: bool = False
    next_test: bool = False
    tests: tuple[str, ...] = ()
    all_tests: bool = False
    at: tuple[str, ...] = ()

    def drawn(self, names: Sequence[str]) -> tuple[str, ...]:
        """Those of a report's tests whose pictures are drawn."""
        if self.all_tests or len(names) <= ALL_DRAWN:
            return tuple(names)
        return tuple(name for name in names if name in self.tests)

    def check(self, names: Sequence[str]) -> None:
        """Refuse what cannot be made of a run with these tests, before anything is written.

        Raises
        ------
        ReportError
            When a library, or for a PDF a browser, is not there, or the run has no such test.
        """
        for name in self.tests:
            if name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(names)}"
                raise ReportError(f"--tests: the run has no test {name!r}; {hint}")
        if self.pdf:
            find_browser()
        for requested, library, extra in (
            (self.word, "docx", "word"),
            (self.excel, "openpyxl", "excel"),
        ):
            if requested and find_spec(library) is None:
                raise ReportError(
                    f"this form needs {library}, which is not installed: pip install "
                    f'"mfd_bayes[{extra}]"'
                )


PLAIN = Forms()


def publish(
    view: CampaignView,
    out: Path,
    processes: int,
    observe: Callable[[Step], None],
    forms: Forms = PLAIN,
    sheet: Datasheet | None = None,
    model: Model | None = None,
) -> None:
    """Write tables, figures and pages of a report into the run folder, with a model's symbols.

    Raises
    ------
    MfdError
        When something cannot be written, or no browser prints the PDF.
    """
    with of_model(model):
        _publish(view, out, processes, observe, forms, sheet, model)


def _publish(
    view: CampaignView,
    out: Path,
    processes: int,
    observe: Callable[[Step], None],
    forms: Forms,
    sheet: Datasheet | None,
    model: Model | None,
) -> None:
    system = system_of(view)
    texts, sheets = report_tables(view), {}
    if sheet is not None:
        sheets["Data sheet"] = datasheet_sheet(sheet.rows, system, view.title)
        texts["datasheet.csv"] = to_csv(datasheet_frame(sheet.rows, system))
        texts["datasheet.tex"] = to_latex("datasheet", sheets["Data sheet"])
    for name, text in texts.items():
        write_text(out / name, text)
    sheets |= dict(zip(("Table I", "Table II"), paper_sheets(view, system), strict=True))
    if forms.word:
        write_bytes(out / "tables.docx", to_word(view.title, sheets.values()))
    if forms.excel:
        write_bytes(out / "tables.xlsx", to_excel(sheets))
    observe(Step("report", "figures"))
    images = _draw(view, out, processes, forms, model)
    for name, text in shared_tables(view):
        write_text(out / name, text)
    observe(Step("report", "pages"))
    for name, page in render(view, images, sheet).items():
        write_text(out / name, page)
    if forms.pdf:
        observe(Step("report", "PDF"))
        for name in ("report", *(["datasheet"] if sheet is not None else [])):
            write_bytes(out / f"{name}.pdf", print_page(out / f"{name}.html"))
    observe(Step("report", State.DONE))


@dataclass(frozen=True, eq=False)
class Drawing:
    """A job that draws the figures of one test and writes the tables behind them."""

    test: TestView
    system: System
    actuation_unit: str
    model: Model | None = None

    @property
    def id(self) -> str:
        """Id of the test."""
        return self.test.id

    @property
    def pictures(self) -> tuple[str, ...]:
        """Keys of all figures that a test can have."""
        from mfd_bayes.reporting.figures import OF_TEST

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
        (out / f"tests/{self.id}/record.csv").unlink(missing_ok=True)

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Write figures and tables; remove a picture that now has nothing to show."""
        from mfd_bayes.reporting import figures

        began = time.perf_counter()
        with of_model(self.model):
            drawn = dict(figures.draw_test(self.test, self.system, self.actuation_unit))
        for key in self.pictures:
            if key in drawn:
                write_bytes(out / f"{key}.png", drawn[key])
            else:
                (out / f"{key}.png").unlink(missing_ok=True)
        write_text(out / f"tests/{self.id}/record.csv", record_table(self.test, self.system))
        return Outcome(self.id, State.DONE, time.perf_counter() - began)


def _draw(
    view: CampaignView, out: Path, processes: int, forms: Forms, model: Model | None
) -> dict[str, bytes]:
    """Draw all figures; the bytes that the pages need, by the figures' keys."""
    names = forms.drawn([test.id for test in view.tests])
    system, unit = system_of(view), view.actuation_unit
    every = [Drawing(test, system, unit, model) for test in view.tests]
    drawings = [drawing for drawing in every if drawing.id in names]
    for drawing in every:
        if drawing.id not in names:
            drawing.remove(out)
    if len(drawings) > ALONE and processes > 1:
        with meanwhile(processes) as submit:  # the processes draw, this one meanwhile too
            drawn = submit(partial(_draw_in_processes, drawings, out, processes))
            images = _draw_shared(view, out)
            drawn()
    else:
        images = _draw_shared(view, out)
        for drawing in drawings:
            drawing.run(out, lambda _: None)
    for key in (key for drawing in drawings for key in drawing.pictures):
        if (out / f"{key}.png").is_file():
            with (out / f"{key}.png").open("rb") as file:
                images[key] = file.read(24)  # up to the picture's size: it stands beside its page
    return images


def _draw_in_processes(drawings: Sequence[Drawing], out: Path, processes: int) -> None:
    for _ in run_in_processes(drawings, out, processes, lambda _: None):
        pass


def _draw_shared(view: CampaignView, out: Path) -> dict[str, bytes]:
    """Draw the figures that show all tests; their bytes by their keys."""
    from mfd_bayes.reporting import figures

    images = dict(figures.draw_shared(view))
    for key, png in images.items():
        write_bytes(out / "figures" / f"{key}.png", png)
    return images


def find_browser() -> str:
    """Path of a browser that can print.

    Raises
    ------
    ReportError
        When none is installed.
    """
    for name in BROWSERS:
        path = shutil.which(name)
        if path:
            return path
    raise ReportError(
        f"a PDF needs a Chromium, and none of {', '.join(BROWSERS)} is installed; "
        "print report.html from any browser instead"
    )


def print_page(page: Path) -> bytes:
    """PDF of a page, A4, printed by an installed Chromium.

    Raises
    ------
    ReportError
        When no browser is installed, or it does not print.
    """
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="mfd_bayes_pdf_") as folder:
        made = Path(folder) / "page.pdf"
        root = hasattr(os, "geteuid") and os.geteuid() == 0
        command = [
            *(browser, "--headless", "--disable-gpu", "--disable-quic", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *("--no-pdf-header-footer", f"--user-data-dir={folder}/profile"),
            *(["--no-sandbox"] if root else []),  # Chromium's own does not work for root
            *(f"--print-to-pdf={made}", page.resolve().as_uri()),
        ]
        try:
            done = subprocess.run(command, capture_output=True, timeout=_PRINTING, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ReportError(f"{browser} did not print {page}: {error}") from error
        if done.returncode != 0 or not made.is_file() or made.stat().st_size == 0:
            said = done.stderr.decode("utf-8", "replace").strip().splitlines()
            reason = said[-1] if said else "no reason"
            raise ReportError(f"{browser} did not print {page}: {reason}")
        return made.read_bytes()
