"""Bands of tests of which a first part is known, on synthetic tests of a known population."""

import numpy as np
import pytest

from mfd_bayes.assessment.bands import compare
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.population import given
from mfd_bayes.population.given import Conditioned
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.given_part import given_part
from mfd_bayes.population.strokes import strokes_of
from mfd_bayes.records.trace import Trace

TESTS = 10
SHARE = 0.5


@pytest.fixture(scope="module")
def tools(benchmark_module):
    return benchmark_module("given.study")


@pytest.fixture(scope="module")
def study(tools):
    return tools.make_study()


@pytest.fixture(scope="module")
def few():
    """Fewer draws and points than users get."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(given, "TRIED", 500)
        patch.setattr(given, "POINTS", 300)
        yield


@pytest.fixture(scope="module")
def asked(tools, study, few):
    """Some tests, and the bands of each given half of its record."""
    # the first of the benchmark's tests
    truths = [tools.draw_truth(study, np.random.default_rng([20, j])) for j in range(TESTS)]
    return truths, [tools.ask(study, truth, SHARE, seed=j) for j, truth in enumerate(truths)]


def p_values(tools, uniform, truths, bands):
    """p-value of the ranks of each quantity and force, by name."""
    ranks = [tools.ranks_of(truth, band) for truth, band in zip(truths, bands, strict=True)]
    return {name: uniform.p_value([one[name] for one in ranks]) for name in ranks[0]}


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform(tools, asked, benchmark_module):
    truths, bands = asked
    uniform = benchmark_module("common.uniformity").Uniformity(TESTS, tools.DRAWS, 4000)
    found = p_values(tools, uniform, truths, bands)
    assert min(found.values()) > 0.01 / len(found), found
    # the negative control: bands of other tests
    wrong = p_values(tools, uniform, truths, bands[1:] + bands[:1])
    assert min(wrong.values()) < 0.01 / len(wrong)
    assert wrong["force at 3.4 s"] < 0.01 / len(wrong)


def test_the_rest_is_covered_and_narrower_than_before(tools, study, asked):
    truths, bands = asked
    rest = ~bands[0].given.holds(study.motion.time)
    inside = [
        np.mean(((b.lower <= t.damper) & (t.damper <= b.upper))[rest])
        for t, b in zip(truths, bands, strict=True)
    ]
    assert 0.88 < np.mean(inside) < 0.99
    before = tools.ask(study, truths[0], 0.0)
    half = np.mean((bands[0].upper - bands[0].lower)[rest])
    assert half < 0.5 * np.mean((before.upper - before.lower)[rest])


@pytest.mark.slow
def test_more_that_is_given_makes_it_narrower(tools, study, asked):
    truths, bands = asked
    whole = [tools.ask(study, truths[j], 1.0, seed=j) for j in range(3)]
    widths = [[float(np.mean(b.upper - b.lower)) for b in those] for those in (bands[:3], whole)]
    assert np.mean(widths[1]) < 0.9 * np.mean(widths[0])
    assert {b.given.method for b in whole} == {"sampling"}


def test_only_the_force_in_the_window_matters(tools, study, few):
    truth = tools.draw_truth(study, np.random.default_rng(5))
    other = np.where(study.motion.time > 1.0, 1e6, truth.trace.force)
    traces = [
        truth.trace,
        Trace.from_arrays(study.motion.time, study.motion.displacement, 1.0, other),
    ]
    one, two = (
        predict_given(study.predictor, trace, Forecast(draws=50), (0.0, 1.0), study.pace)
        for trace in traces
    )
    np.testing.assert_array_equal(one.draws, two.draws)


@pytest.mark.slow
def test_weights_and_sampling_agree_where_both_can_be_trusted(tools, study, monkeypatch):
    truth = tools.draw_truth(study, np.random.default_rng(8))
    ask = Forecast(draws=1000)
    window = 0.0, 0.07
    monkeypatch.setattr(given, "TRIED", 20_000)
    found = []
    for fewest in (0.0, 1e9):
        monkeypatch.setattr(given, "FEWEST", fewest)
        found.append(predict_given(study.predictor, truth.trace, ask, window, study.pace))
    by_weights, sampled = found
    assert (by_weights.given.method, sampled.given.method) == ("weights", "sampling")
    assert by_weights.given.pareto_k <= 0.7
    for name in ("start", "offset", "noise_sd"):
        one, two = by_weights.values[name], sampled.values[name]
        assert abs(one.mean() - two.mean()) < 0.2 * one.std(), name
        assert two.std() == pytest.approx(one.std(), rel=0.2), name
    width = [np.mean(b.upper - b.lower) for b in found]
    assert width[1] == pytest.approx(width[0], rel=0.1)


def test_a_band_of_observations_has_offset_and_noise(tools, study, few):
    truth = tools.draw_truth(study, np.random.default_rng(9))
    damper, seen = (
        predict_given(study.predictor, truth.trace, Forecast(kind, draws=200), (0, 2), study.pace)
        for kind in ("new_test", "observation")
    )
    wide = [np.mean((b.upper - b.lower)[-20:]) for b in (damper, seen)]
    assert wide[1] > 1.5 * wide[0]
    assert seen.source.startswith(
        "population laws with scatter, and the force given from 0 s to 2 s"
    )


def test_a_band_of_the_whole_history_holds_with_it(tools, study, few):
    truth = tools.draw_truth(study, np.random.default_rng(9))
    forecast = Forecast(draws=100, whole=True)
    band = predict_given(study.predictor, truth.trace, forecast, (0, 2), study.pace)
    assert np.all(band.whole_lower <= band.lower)
    assert np.all(band.upper <= band.whole_upper)


@pytest.mark.parametrize(
    ("window", "said"),
    [
        ((2.0, 1.0), "given must be two times in s, the earlier one first"),
        ((0.0,), "given must be two times"),
        ((0.0, 9.0), "must lie within the record, which goes from 0 s to 3.96875 s"),
        ((-2.0, 1.0), "must lie within the record"),
        ((0.0, 0.04), "holds 2 samples, too few: at least 3"),
        ((0.001, 0.002), "holds 0 samples, too few: at least 3"),
    ],
)
def test_a_window_that_is_none_is_refused(tools, study, window, said):
    truth = tools.draw_truth(study, np.random.default_rng(5))
    with pytest.raises(FitError, match=said):
        predict_given(study.predictor, truth.trace, Forecast(draws=50), window, study.pace)


def test_a_force_that_is_not_there_is_named(study):
    for force, said in ((None, "the trace has no force"), (0.0, "the force is zero in the whole")):
        column = None if force is None else np.full(study.motion.samples, force)
        motion = study.motion
        trace = Trace.from_arrays(motion.time, motion.displacement, 1.0, column)
        with pytest.raises(FitError, match=said):
            predict_given(study.predictor, trace, Forecast(draws=50), (0.0, 1.0), study.pace)


@pytest.mark.parametrize(
    ("forecast", "said"),
    [
        (Forecast("device"), "given is for the kinds new_test and observation, not for device"),
        (Forecast("this_test"), "not for this_test"),
    ],
)
def test_what_cannot_be_combined_is_refused(tools, study, forecast, said):
    truth = tools.draw_truth(study, np.random.default_rng(5))
    with pytest.raises(FitError, match=said):
        predict_given(study.predictor, truth.trace, forecast, (0.0, 1.0), study.pace)


def test_a_sampler_that_hardly_moves_is_remarked():
    told = Conditioned((0.0, 1.0), 30, 3.0, "sampling", 500.0, 12, 0.01)
    assert "accepted only 1.0 % of its last steps" in told.remarks[0]
    assert not Conditioned((0.0, 1.0), 30, 3.0, "sampling", 500.0, 12, 0.2).remarks


def test_nothing_is_left_to_compare_where_all_is_given(tools, study, few):
    truth = tools.draw_truth(study, np.random.default_rng(5))
    band = tools.ask(study, truth, 1.0)
    with pytest.raises(CampaignError, match="the whole record was given"):
        compare(band, truth.trace)


def test_strokes_are_those_of_the_whole_record():
    time = np.arange(4000) / 1000.0
    wave = np.sin(2.0 * np.pi * 0.5 * time) + 0.08 * np.sin(2.0 * np.pi * 12.0 * time)
    trace = Trace.from_arrays(time, wave, 1.0, np.ones(time.size))
    part = given_part(trace, (0.0, 3.0), 0.09)
    whole = strokes_of(trace)
    assert strokes_of(part.trace)[-1] < whole[3000]  # the thinned record has lost some
    assert abs(part.strokes[part.counted][-1] - whole[2955]) <= 1
    assert np.all(np.diff(part.strokes) >= 0)
