import re
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

from mfd_bayes.evaluation.views import Marginal
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.colours import BANDS
from mfd_bayes.reporting.conversion import convert_test, shown_in
from mfd_bayes.reporting.figures import laws, loops
from mfd_bayes.reporting.figures.campaign import figures_of_test, shared_figures
from mfd_bayes.reporting.figures.loops import (
    Marks,
    draw_history,
    draw_loops,
    draw_overview,
    stretches,
)
from mfd_bayes.reporting.figures.posteriors import draw_corner, draw_marginals, draw_truth
from mfd_bayes.reporting.figures.posteriors import draw_residuals
from mfd_bayes.reporting.figures.style import to_png

UNIT = re.compile(r", (in|in/s|s|kip|kip/in|ksi)$")


def labels(figure):
    found = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())]
    return [text for text in found if text]


def figures_of(view):
    found = dict(shared_figures(view))
    system = shown_in(view)
    for test in view.tests:
        shown = convert_test(test, system, view.actuation_unit)
        found |= figures_of_test(shown, system)
    return found


@pytest.fixture(scope="module")
def drawn(campaign):
    return figures_of(campaign)


def test_every_figure_is_drawn_once_under_its_key(drawn):
    kinds = ("loops", "history", "residuals", "corner", "trace", "marginals")
    per_test = {f"tests/p800_f0.25/{kind}" for kind in kinds}
    predicted = {"tests/held/loops", "tests/held/history"}
    assert set(drawn) == {"overview", "laws", "truth"} | per_test | predicted


@pytest.mark.parametrize("key", ["overview", "laws", "tests/held/loops", "tests/held/history"])
def test_axes_have_units(drawn, key):
    assert labels(drawn[key])
    for text in labels(drawn[key]):
        assert UNIT.search(text), text


def test_a_metric_report_is_drawn_in_metric_units(campaign, drawn):
    metric = figures_of(replace(campaign, metric=True))
    for key in ("overview", "tests/p800_f0.25/loops", "tests/p800_f0.25/history"):
        texts = " ".join(labels(metric[key]))
        assert "mm" in texts
        assert "kN" in texts
        assert "kip" not in texts
    inches = drawn["tests/held/loops"].axes[0].get_xlim()
    millimetres = metric["tests/held/loops"].axes[0].get_xlim()
    assert millimetres == pytest.approx([25.4 * limit for limit in inches])


def test_residuals_are_shown_by_stage(campaign):
    test = campaign.tests[0]
    stage = np.tile([2, 3, 1, 1, 1], test.trace.samples // 5).astype(np.int8)
    staged = replace(test, stage=stage, travel=np.abs(test.trace.displacement))
    figure = draw_residuals("residuals", staged)
    ticks = [text.get_text() for text in figure.axes[0].get_xticklabels()]
    assert [tick.split("\n")[0] for tick in ticks] == ["stick", "build-up", "slip"]
    assert ticks[2].endswith("60%")
    assert "travel" in figure.axes[1].get_xlabel()


@pytest.mark.parametrize("key", ["overview", "laws", "truth", "tests/p800_f0.25/loops"])
def test_figures_say_what_they_show(drawn, key):
    assert drawn[key].get_suptitle()


def test_quantities_carry_their_units(drawn):
    texts = labels(drawn["tests/p800_f0.25/corner"])
    assert any(text.endswith(", kip/in") for text in texts)
    titles = [axes.get_title(loc="left") for axes in drawn["tests/p800_f0.25/trace"].axes]
    assert titles[0].endswith(", kip")


def test_uninformed_quantities_are_marked(drawn):
    titles = [axes.get_title(loc="left") for axes in drawn["tests/p800_f0.25/marginals"].axes]
    assert titles == ["", "", "not informed by the data"]


def test_wide_positive_priors_are_logarithmic_and_uniform_ones_are_not():
    rng = np.random.default_rng(1)
    wide, uniform = np.exp(rng.normal(size=500)), rng.uniform(size=500)
    marginals = [Marginal("k3", "kip/in", p, p[:60], 0.9) for p in (wide, uniform)]
    figure = draw_marginals("priors", marginals)
    assert [axes.get_xscale() for axes in figure.axes] == ["log", "linear"]


def test_pngs_are_the_same_each_time(campaign, images, draw):
    assert draw(campaign) == images


def test_the_users_settings_neither_matter_nor_change(test_view):
    test = test_view("a")
    plain = to_png(draw_loops("a", test.trace, [test.observation]))
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "red"}):
        before = dict(mpl.rcParams)
        assert to_png(draw_loops("a", test.trace, [test.observation])) == plain
        assert dict(mpl.rcParams) == before


def test_bands_follow_each_stretch_of_motion(test_view):
    trace = test_view("a").trace
    parts = stretches(trace.turning_points, trace.samples)
    assert len(parts) == trace.turning_points.size + 1
    for part in parts:
        steps = np.diff(trace.displacement[part])
        assert np.all(steps >= 0) or np.all(steps <= 0)


def test_forward_and_backward_bands_do_not_close_the_loop(test_view):
    test = test_view("a")
    figure = draw_loops("a", test.trace, [test.observation])
    bands = figure.axes[0].collections[0].get_paths()
    # in mid-stroke the force is near ±1 kip; no band may reach from one branch to the other
    assert not any(path.contains_point((0.0, 0.0)) for path in bands[1:])
    assert sum(path.contains_point((0.0, 1.0)) for path in bands[1:]) > 0


def test_predicted_tests_have_no_band_of_the_device(drawn):
    legend = [text.get_text() for text in drawn["tests/held/loops"].legends[0].get_texts()]
    assert not any("parameters only" in text for text in legend)
    assert any("50 and 95 %" in text for text in legend)


def test_a_motion_without_a_force_can_be_drawn(test_view):
    test = test_view("a")
    trace = Trace.from_arrays(test.trace.time, test.trace.displacement, 0.8)
    assert to_png(draw_loops("a", trace, [test.observation]))
    assert to_png(draw_history("a", trace, [test.observation]))
    assert to_png(draw_history("a", test.trace))


@pytest.mark.parametrize("kind", ["device", "new_test", "observation", "prior"])
def test_every_kind_of_band_can_be_drawn(test_view, kind):
    test = test_view("a")
    fan = replace(test.observation, kind=kind, intervals=test.observation.intervals[1:])
    figure = draw_loops("a", test.trace, [fan])
    assert "95 %" in figure.legends[0].get_texts()[1].get_text()


def test_long_records_show_the_strongest_motion(test_view):
    test = test_view("a", samples=12_000)
    figure = draw_history("a", test.trace, [test.observation], marks=Marks(test.first))
    assert len(figure.axes) == 6
    assert all(len(line.get_xdata()) <= 4500 for axes in figure.axes for line in axes.lines)


def test_constant_quantities_are_left_out_of_the_corner(test_view):
    test = test_view("a")
    still = replace(test.marginals[0], posterior=np.ones(60))
    assert draw_corner("a", [still, *test.marginals[1:]], test.corner) is None
    wanted = ("Fc_fwd", "k3", "gamma1", "unknown")
    assert (
        len(draw_corner("a", test.marginals, wanted).axes) == 6
    )  # of three: pairs below the diagonal
    assert len(draw_corner("a", [still, *test.marginals[1:]], wanted).axes) == 3


def test_names_from_files_are_text_for_matplotlib_too(test_view):
    test = test_view("$\\frac{x$ 試験 \n<script>")
    figure = draw_loops(test.id, test.trace, [test.observation])
    assert to_png(figure)


def test_truths_that_are_not_positive_are_left_out(campaign):
    figure = draw_truth("truth", campaign.truth)
    assert len(figure.axes[0].get_yticks()) == 2
    assert draw_truth("truth", campaign.truth[2:]) is None


def test_no_laws_no_figure():
    assert laws.draw_laws("laws", (), "ksi") is None


def test_tests_at_zero_are_drawn_inside_the_panel(campaign):
    (law, *_) = campaign.laws
    idle = tuple((name, 0.0, 0.1, 0.2, 0.3) for name in ("a", "b", "c", "d"))
    (axes,) = laws.draw_laws("laws", (replace(law, tested=law.tested + idle),), "ksi").axes
    places = np.concatenate([line.get_xdata() for line in axes.lines])
    assert places.min() < 0.0  # the control: they stand side by side
    assert places.min() > axes.get_xlim()[0]
    (plain,) = laws.draw_laws("laws", (law,), "ksi").axes
    assert plain.get_xlim()[0] == 0.0


def test_more_tests_than_panels_are_announced(test_view, monkeypatch):
    monkeypatch.setattr(loops, "PANELS", 4)
    figure = draw_overview("all", [test_view("a", samples=30)] * 5)
    assert "first 4 of 5" in figure.get_suptitle()
    assert len([axes for axes in figure.axes if axes.lines]) == 4


def test_one_colour_has_one_meaning():
    colours = [colour for kind in BANDS.values() for colour in kind]
    assert len(set(colours)) == len(colours)


@pytest.mark.parametrize("number", [1, 3, 50])
def test_tests_at_one_level_stay_near_it(number):
    levels = np.array([0.5, 0.6, 1.5])
    shifted = laws._apart(np.repeat(levels, number)).reshape(3, number)
    assert np.max(np.abs(shifted - levels[:, None])) < 0.05  # half of the way to the next one
    assert len(np.unique(shifted)) == 3 * number
    np.testing.assert_allclose(shifted.mean(axis=1), levels)
