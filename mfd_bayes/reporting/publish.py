"""The files of a report: tables, figures, pages and what is made only where it is asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from mfd_bayes.errors import ReportError
from mfd_bayes.jobs.job import State, Step, several_processes
from mfd_bayes.reporting.page import render
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import (
    datasheet_frame,
    datasheet_sheet,
    paper_sheets,
    record_table,
    report_frames,
    shared_tables,
    to_csv,
    to_excel,
    to_json,
    to_latex,
    to_word,
)
from mfd_bayes.store.files import write_bytes, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mfd_bayes.evaluation.properties import Datasheet
    from mfd_bayes.evaluation.views import CampaignView, TestView

ALL_DRAWN = 12
"""In a run of more tests, the pictures of single tests are drawn only where asked for."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Programs that can print a page, in order of preference."""

_PRINTING = 180.0
"""Longest time for printing, s; a report takes a few."""


@dataclass(frozen=True)
class Forms:
    """Parts of a report that are made only where asked for: they need more software or time.

    PDFs of the pages, the tables for Word and Excel, the section on the next test; pictures of
    `tests` where there are more than `ALL_DRAWN`, or of all; and conditions that the data sheet has
    besides those that were tested: `at` "500 psi, 1 in, 0.5 Hz".
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
        """Refuse what cannot be made of a run with these tests, before anything is written."""
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
) -> None:
    """Write tables, figures and pages of a report into the run folder."""
    system, symbols, frames = view.system, Symbols(view.model), report_frames(view)
    sheets = dict(zip(("parameters", "laws"), paper_sheets(view, symbols), strict=True))
    if sheet is not None:
        frames["datasheet"] = datasheet_frame(sheet.rows, system)
        sheets["datasheet"] = datasheet_sheet(sheet.rows, view.title, symbols, system.axes)
    for name, frame in frames.items():
        write_text(out / f"{name}.csv", to_csv(frame))
    for name in ("parameters", "laws"):
        write_text(out / f"{name}.json", to_json(view.title, name, frames[name]))
    for name, table in sheets.items():
        write_text(out / f"{name}.tex", to_latex(name, table, symbols, system))
    if forms.word:
        made = to_word(view.title, sheets.values(), symbols, system)
        write_bytes(out / "tables.docx", made)
    if forms.excel:
        write_bytes(out / "tables.xlsx", to_excel({name: frames[name] for name in sheets}))
    observe(Step("report", "figures"))
    images = _draw(view, out, processes, forms)
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


def _draw(view: CampaignView, out: Path, processes: int, forms: Forms) -> dict[str, bytes]:
    """Draw all figures; the bytes that the pages need, by the figures' keys.

    Those of a test stand beside its page, which needs only the size at the begin of each.
    """
    from mfd_bayes.reporting import figures

    chosen = forms.drawn([test.id for test in view.tests])
    tests = [test for test in view.tests if test.id in chosen]
    for test in view.tests:  # what an earlier report has drawn may have nothing to show now
        for name in (*(f"{name}.png" for name in figures.OF_TEST), "record.csv"):
            (out / "tests" / test.id / name).unlink(missing_ok=True)
    functions = [partial(draw_test, out, replace(view, tests=()))] * len(tests)
    with several_processes(functions, processes) as evaluate:
        of_tests = list(evaluate(enumerate(tests)))
    images = {key: figures.to_png(figure) for key, figure in figures.draw_shared(view)}
    for key, png in images.items():
        write_bytes(out / "figures" / f"{key}.png", png)
    return images | {key: png for drawn in of_tests for key, png in drawn.items()}


def draw_test(out: Path, view: CampaignView, test: TestView) -> dict[str, bytes]:
    """Write figures and table of a test; the first bytes of each figure, by its key."""
    from mfd_bayes.reporting import figures

    drawn = {}
    for key, figure in figures.draw_test(test, view):
        drawn[key] = figures.to_png(figure)
        write_bytes(out / f"{key}.png", drawn[key])
    write_text(out / "tests" / test.id / "record.csv", record_table(test, view.system))
    return {key: png[:24] for key, png in drawn.items()}


def find_browser() -> str:
    """Path of a browser that can print."""
    for name in BROWSERS:
        path = shutil.which(name)
        if path:
            return path
    raise ReportError(
        f"a PDF needs a Chromium, and none of {', '.join(BROWSERS)} is installed; "
        "print report.html from any browser instead"
    )


def print_page(page: Path) -> bytes:
    """PDF of a page, A4, printed by an installed Chromium."""
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
