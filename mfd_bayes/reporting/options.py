"""The options of the command `report`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from typer import Option

from mfd_bayes.options import Quiet, RunFolder, TrustModel, Units, this_command


@dataclass(frozen=True)
class ReportOptions:
    """Remake the report, tables and figures of a run from what is stored, without sampling.

    Writes OUT/report.html, the tables beside it, OUT/figures and the pictures
    of every test; with --pdf OUT/report.pdf too. All are in the units of the
    campaign, or in those of --units; the page has a switch for both. In a run
    of more than 12 tests, pictures of single tests are drawn only with --tests
    or --all-tests.

    Example:
      mfd-bayes report out
      mfd-bayes report out --pdf
      mfd-bayes report out --units si --word --excel
      mfd-bayes report out --tests p500_f0.05 --tests p800_f0.05
    """

    out: RunFolder
    quiet: Quiet = False
    pdf: Annotated[bool, Option("--pdf", help="Write a PDF too; needs a Chromium.")] = False
    word: Annotated[bool, Option("--word", help="Write Tables I and II as tables.docx too.")] = (
        False
    )
    excel: Annotated[bool, Option("--excel", help="Write Tables I and II as tables.xlsx too.")] = (
        False
    )
    next_test: Annotated[
        bool, Option("--next", help="Add a section on which test to make next.")
    ] = False
    tests: Annotated[
        tuple[str, ...],
        Option(help="Draw this test's pictures, in a run of more than 12; may be repeated."),
    ] = ()
    all_tests: Annotated[
        bool, Option("--all-tests", help="Draw the pictures of every test of such a run.")
    ] = False
    at: Annotated[
        tuple[str, ...], Option(help='Add a condition to the data sheet: "500 psi, 1 in, 0.5 Hz".')
    ] = ()
    units: Units = ""
    trust_model: TrustModel = False

    def resumption(self) -> str:
        """The command that makes the report once more."""
        return this_command()
