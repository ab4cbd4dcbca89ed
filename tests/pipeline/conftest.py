"""The finished run for tests of whole commands, and pictures that they do not look at."""

from contextlib import nullcontext

import pytest

import mfd_bayes as mb
from mfd_bayes.jobs.local import in_turn
from mfd_bayes.reporting import figures, page


@pytest.fixture(scope="session")
def out(finished_run):
    return finished_run.out


@pytest.fixture(scope="session")
def run(out):
    return mb.open_run(out)


@pytest.fixture
def no_figures_of_tests(monkeypatch) -> None:
    """A report has the figures that all tests share, but none of a single test.

    A report of more than three tests is else drawn by other processes, which know nothing of this.
    """
    monkeypatch.setattr(page, "several_processes", lambda fs, _: nullcontext(in_turn(fs)))
    monkeypatch.setattr(figures, "draw_test", lambda *_: iter(()))
