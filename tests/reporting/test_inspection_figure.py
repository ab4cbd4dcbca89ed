import numpy as np
import pytest

from mfd_bayes.records.data_quality import Fault, find_faults
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.figures import draw_inspection, to_png


def trace_of(*, force=True, spikes=()):
    time = np.arange(1201) / 100.0
    signal = np.tanh(4 * np.cos(np.pi * time)) + 1e-3 * np.sin(50 * time)
    signal[list(spikes)] += 3.0
    return Trace.from_arrays(time, np.sin(np.pi * time), force=signal if force else None)


def drawn(trace, faults=()):
    return draw_inspection("a $test$", trace, find_loops(trace), faults)


def test_a_record_has_loop_displacement_force_and_energy():
    figure = drawn(trace_of())
    titles = {axes.get_title(loc="left") for axes in figure.axes}
    assert {"Force–displacement", "Force"} < titles
    assert len(figure.axes) == 4
    assert not figure.legends
    assert to_png(figure).startswith(b"\x89PNG")


def test_faults_are_marked_where_they_are_and_all_are_named():
    trace = trace_of(spikes=[300, 700])
    nowhere = Fault("time unit", "everywhere", np.empty(0, dtype=np.intp))
    faults = (*(f for f in find_faults(trace) if f.name == "spikes"), nowhere)
    figure = drawn(trace, faults)
    marks = [
        line.get_xdata()
        for line in figure.axes[1].lines
        if line.get_marker() not in ("None", "", ".", None)
    ]
    assert any(np.array_equal(mark, trace.time[[300, 700]]) for mark in marks)
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["warning: spikes", "warning: time unit"]
    assert to_png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("force", [True, False])
def test_a_record_without_force_or_full_loop_is_drawn(force):
    full = trace_of(force=force)
    cut = Trace.from_arrays(
        full.time[:180], full.displacement[:180], force=full.force[:180] if force else None
    )
    figure = drawn(cut)
    assert len(figure.axes) == (4 if force else 1)
    assert to_png(figure).startswith(b"\x89PNG")
