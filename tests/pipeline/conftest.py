"""What tests of whole commands may leave out: pictures that they do not look at."""

import pytest

from mfd_bayes.reporting import figures, publication
from mfd_bayes.reporting.figures.style import new_figure


@pytest.fixture(scope="session")
def dot() -> bytes:
    """PNG of an empty figure, in the form of every picture of the package."""
    return figures.to_png(new_figure(1, 1))


@pytest.fixture
def small_pictures(monkeypatch, dot) -> None:
    """The pictures of a prediction and an inspection are empty ones, which are drawn at once."""
    for name in ("draw_loops", "draw_history", "draw_inspection"):
        monkeypatch.setattr(figures, name, lambda *_, **__: None)
    monkeypatch.setattr(figures, "to_png", lambda _: dot)


@pytest.fixture
def no_figures_of_tests(monkeypatch) -> None:
    """A report has the figures that all tests share, but none of a single test.

    A report of more than three tests is else drawn by other processes, which know nothing of this.
    """
    monkeypatch.setattr(publication, "_ALONE", 100)
    monkeypatch.setattr(publication, "draw_test", lambda *_: iter(()))
