"""A figure of a test is added by one function and one line: see docs/pages/architecture.md."""

from types import MappingProxyType

from matplotlib.figure import Figure

from mfd_bayes.reporting import publication
from mfd_bayes.reporting.figures import campaign as figures
from mfd_bayes.reporting.publication import Drawing
from mfd_bayes.runs.unit_system import US


def draw_velocity(test, system):
    """Toy: the velocity over time."""
    figure = Figure()
    figure.subplots().plot(test.trace.time, system.factor("in") * test.trace.velocity)
    return figure


def test_a_figure_that_is_registered_is_drawn_and_written(test_view, tmp_path, monkeypatch):
    registered = MappingProxyType({"velocity": draw_velocity, "empty": lambda *_: None})
    for module in (figures, publication):
        monkeypatch.setattr(module, "OF_TEST", registered)
    Drawing(test_view("a"), US, "ksi").run(tmp_path, lambda _: None)
    assert (tmp_path / "tests/a/velocity.png").read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "tests/a/empty.png").exists()
