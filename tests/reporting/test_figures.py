"""The figures of a report, of a record that is inspected, and of a prediction."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np

from mfd_bayes.messages import Message
from mfd_bayes.records.data_quality import Fault, find_faults
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.figures import (
    draw_corner,
    draw_history,
    draw_inspection,
    draw_loops,
    draw_ranks,
    draw_shared,
    draw_truth,
    stretches,
    to_png,
)
from mfd_bayes.reporting.symbols import Symbols

NAMES = Symbols()


def test_pngs_are_the_same_each_time_whatever_the_users_settings(campaign, published):
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "red"}):
        settings = dict(mpl.rcParams)
        for name, figure in draw_shared(campaign):
            assert to_png(figure) == (published / "figures" / f"{name}.png").read_bytes()
        assert dict(mpl.rcParams) == settings


# --- posteriors


def test_ranks_show_a_chain_that_differs(campaign):
    marginal = campaign.tests[0].marginals[0]
    draws = np.random.default_rng(1).normal(size=4000)

    def highest():
        figure = draw_ranks("ranks", [replace(marginal, posterior=draws)], 4, NAMES)
        return max(patch.get_data().values.max() for patch in figure.axes[0].patches)

    assert highest() < 1.3
    draws[:1000] += 1.0  # the first of four chains
    assert highest() > 2.0
    assert draw_ranks("ranks", [marginal], 1, NAMES) is None


def test_what_cannot_be_drawn_is_left_out(campaign):
    test = campaign.tests[0]
    marginals = [replace(test.marginals[0], posterior=np.ones(60)), *test.marginals[1:]]
    names = ("Fc_fwd", "k3", "gamma1", "unknown")
    assert draw_corner("a", marginals, test.corner, NAMES) is None
    assert len(draw_corner("a", test.marginals, names, NAMES).axes) == 9  # of three
    assert len(draw_corner("a", marginals, names, NAMES).axes) == 4
    truths = draw_truth("truth", campaign.truth, NAMES)  # one is not positive
    assert len(truths.axes[0].get_yticks()) == 2
    assert draw_truth("truth", campaign.truth[2:], NAMES) is None


# --- loops and histories


def test_bands_follow_each_stretch_of_motion_and_do_not_close_the_loop(campaign):
    test = campaign.tests[0]
    pieces = stretches(test.trace.turning_points, test.trace.samples)
    assert len(pieces) == test.trace.turning_points.size + 1
    for piece in pieces:
        steps = np.diff(test.trace.displacement[piece])
        assert np.all(steps >= 0) or np.all(steps <= 0)
    figure = draw_loops("a", test.trace, [test.observation])
    bands = figure.axes[0].collections[0].get_paths()
    # in mid-stroke the force is near ±1 kip; no band may reach from one branch to the other
    assert not any(path.contains_point((0.0, 0.0)) for path in bands[1:])
    assert sum(path.contains_point((0.0, 1.0)) for path in bands[1:]) > 0


def test_every_kind_of_band_a_motion_without_force_and_odd_names_are_drawn(campaign):
    test = replace(campaign.tests[0], id="$\\frac{x$ 試験 \n<script>")
    for kind in ("mean", "prior"):
        fan = replace(test.observation, kind=kind, intervals=test.observation.intervals[1:])
        figure = draw_loops(test.id, test.trace, [fan])
        assert "95 %" in figure.legends[0].get_texts()[1].get_text()
    assert to_png(figure)
    silent = replace(test.trace, force=None)
    assert to_png(draw_loops("a", silent, [test.observation]))
    assert to_png(draw_history("a", silent))


def test_long_records_show_the_strongest_motion(test_view):
    test = test_view("a", samples=12_000)
    figure = draw_history("a", test.trace, [test.observation], start=test.first)
    assert len(figure.axes) == 6
    assert all(len(line.get_xdata()) <= 4500 for axes in figure.axes for line in axes.lines)


# --- laws


# --- records as they were read


def trace_of(spikes=()):
    time = np.arange(1201) / 100.0
    signal = np.tanh(4 * np.cos(np.pi * time)) + 1e-3 * np.sin(50 * time)
    signal[list(spikes)] += 3.0
    return Trace.from_arrays(time, np.sin(np.pi * time), force=signal)


def test_faults_of_a_record_are_marked_where_they_are_and_all_are_named():
    trace = trace_of(spikes=[300, 700])
    nowhere = Fault("time unit", Message("everywhere"), np.empty(0, dtype=np.intp))
    faults = (*(f for f in find_faults(trace) if f.name == "spikes"), nowhere)
    figure = draw_inspection("a $test$", trace, faults)
    kinds = ("None", "", ".", None)
    marks = [line.get_xdata() for line in figure.axes[1].lines if line.get_marker() not in kinds]
    assert any(np.array_equal(mark, trace.time[[300, 700]]) for mark in marks)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["warning: spikes", "warning: time unit"]


def test_a_record_without_force_or_full_loop_is_drawn():
    full = trace_of()
    for force, panels in ((full.force[:180], 4), (None, 1)):
        cut = Trace.from_arrays(full.time[:180], full.displacement[:180], force=force)
        figure = draw_inspection("a", cut)
        assert len(figure.axes) == panels
        assert not figure.legends
