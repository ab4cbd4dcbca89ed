"""Bands of a population with given values, not sampled."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.friction.models import find_model
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import band_of
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.settings import NESTED
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.settings import setting_of
from mfd_bayes.records.trace import Trace

TIME = np.arange(401) / 100
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
SLIDING = (np.abs(MOTION) < 0.3) & (TIME > 0.5)
"""Well after every gap."""
NOISE = find_noise("ou")


@pytest.fixture(scope="module")
def population(make_population):
    return make_population()


def ask(population, actuation, session="", **forecast):
    trace = Trace.from_arrays(TIME, MOTION, actuation)
    return predict(population, trace, Forecast(**forecast, session=session))


def predict(population, trace, forecast):
    return Predictor(population, ThreeStage(), NOISE).predict(trace, forecast)


def width(population, actuation=1.0, **forecast):
    band = ask(population, actuation, draws=400, **forecast)
    return float(np.mean((band.upper - band.lower)[SLIDING]))


def test_bands_are_nested_by_kind(population):
    device, new_test, observation = (width(population, kind=kind) for kind in NESTED)
    assert 1.2 * device < new_test
    assert 1.02 * new_test < observation


def test_without_scatter_a_new_test_is_the_device(make_population):
    same = make_population(scatter=0.0)
    device, new_test = (ask(same, 1.0, kind=kind, draws=400) for kind in ("device", "new_test"))
    np.testing.assert_allclose(
        np.mean(device.upper[SLIDING]), np.mean(new_test.upper[SLIDING]), rtol=0.02
    )


def test_a_run_without_a_gap_predicts_what_the_gap_does_not_need(population):
    # runs of a model without γ1 and a sampled start: only γ2/γ1 reaches the force, the start is ½
    known = {n: p for n, p in population.priors.items() if n not in ("gamma1", "start")}
    device = Forecast("device", draws=20)
    trace = Trace.from_arrays(TIME, MOTION, 1.0)
    without = predict(replace(population, priors=known), trace, device)
    np.testing.assert_array_equal(without.values["start"], 0.5)
    fixed = predict(population, trace, device)
    late = TIME > 2.0  # the start no longer matters
    np.testing.assert_allclose(without.draws[:, late], fixed.draws[:, late], rtol=1e-9, atol=1e-9)


def test_a_tested_level_is_known_better_than_one_that_is_not(make_population):
    """Levels deviate from the law, and the deviation of tested levels is known."""
    known = make_population(effect=0.15, scatter=0.05)
    tested, near, far = (width(known, p, kind="new_test") / p for p in (1.0, 1.3, 8.0))
    assert 1.1 * tested < near
    assert 1.1 * near < far
    none = make_population(effect=1e-6, scatter=0.05)  # the control
    tested, near = (width(none, p, kind="new_test") / p for p in (1.0, 1.3))
    assert near < 1.05 * tested


def test_a_new_session_is_known_less_than_one_that_was_seen(make_population):
    known = make_population(effect=0.1, scatter=0.05, sessions=["a", "a", "b"])
    seen, new = (width(known, 1.0, kind="new_test", session=s) for s in ("a", "c"))
    assert 1.2 * seen < new


def test_a_band_says_what_it_is(population):
    band = ask(population, 0.7, kind="observation", probability=0.5, draws=60)
    assert (band.kind, band.probability, band.interval) == ("observation", 0.5, "equal-tailed")
    assert "population" in band.source
    assert band.draws.shape == (60, TIME.size)
    np.testing.assert_array_equal(band.time, TIME)
    assert np.all(band.lower <= band.median)
    assert np.all(band.median <= band.upper)


def test_bounds_are_the_quantiles_of_the_draws(population):
    band = ask(population, 0.7, probability=0.9, draws=200)
    low, mid, high = np.quantile(band.draws, [0.05, 0.5, 0.95], axis=0)
    np.testing.assert_allclose(band.lower, low)
    np.testing.assert_allclose(band.median, mid)
    np.testing.assert_allclose(band.upper, high)
    again = band_of(band.time, band.draws, Forecast(band.kind, 0.9), band.source)
    np.testing.assert_array_equal(again.upper, band.upper)


def test_a_wider_probability_gives_a_wider_band(population):
    half, most = (ask(population, 1.0, probability=p, draws=200) for p in (0.5, 0.95))
    np.testing.assert_array_equal(half.median, most.median)
    assert np.all(most.upper >= half.upper)
    assert np.mean(most.upper - most.lower) > 2 * np.mean(half.upper - half.lower)


def test_the_same_seed_gives_the_same_band(population):
    first, again, other = (ask(population, 1.0, seed=seed, draws=50) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert np.any(first.draws != other.draws)


def test_slip_force_is_in_proportion_to_the_actuation(population):
    half, whole = (np.abs(ask(population, p, kind="device").median[SLIDING]) for p in (0.5, 1.0))
    viscous = 0.015 * np.pi  # does not follow the actuation
    np.testing.assert_allclose((whole - viscous) / (half - viscous), 2.0, rtol=0.08)


def test_without_actuation_there_is_no_slip_force(population):
    band = ask(population, 0.0, kind="new_test", draws=100)
    assert np.all(np.isfinite(band.draws))
    speed = np.abs(np.gradient(MOTION, TIME))
    # in slip only the viscous part remains: 0.015 kip·s/in, with scatter at most twice that
    assert np.all(np.abs(band.draws[:, SLIDING]) < 2 * (0.015 + 0.02) * speed[SLIDING])
    assert np.median(np.abs(ask(population, 1.0).median[SLIDING])) > 1.0  # the control


@pytest.mark.parametrize("level", [0.8, 0.0])
@pytest.mark.parametrize("law", ["proportional", "affine", "residual_power"])
def test_a_history_that_never_changes_is_the_constant(law, level, make_population):
    population = make_population({"Fc_fwd": law, "Fc_bwd": law})
    constant = ask(population, level, kind="new_test", draws=40)
    history = ask(population, np.full(TIME.size, level), kind="new_test", draws=40)
    np.testing.assert_allclose(history.draws, constant.draws, atol=1e-9)


@pytest.mark.parametrize("law", ["proportional", "affine", "power"])
def test_a_history_of_two_levels_follows_either_of_them(law, make_population):
    population = make_population({"Fc_fwd": law, "Fc_bwd": law}, level_sd=1e-9)
    step = np.where(TIME < 2.0, 0.5, 1.5)
    history = ask(population, step, kind="device", draws=20).median
    before, after = (ask(population, p, kind="device", draws=20).median for p in (0.5, 1.5))
    early = (TIME > 0.8) & (TIME < 1.95)
    late = TIME > 2.6  # after the first reversal behind the step, at 2.5 s, and after the gap
    np.testing.assert_allclose(history[early & SLIDING], before[early & SLIDING], atol=0.01)
    np.testing.assert_allclose(history[late & SLIDING], after[late & SLIDING], atol=0.03)
    assert np.mean(np.abs(before[late] - after[late])) > 0.3  # the control


def ordinary(name):
    """Medians of a model's quantities and of the noise, from the priors."""
    known = load_priors("mfd").parameters
    names = [quantity.name for quantity in find_model(name).quantities if quantity.name in known]
    drawn = {n: known[n].draw(np.random.default_rng(0), 999) for n in (*names, "noise_sd")}
    found = {n: float(np.median(values)) for n, values in drawn.items()}
    others = {"offset": 0.03, "noise_time": 0.1}
    return {n: v for n, v in {**found, **others}.items() if n not in ("gamma1", "start")}


@pytest.mark.parametrize("name", ["lugre", "three_stage", "bouc_wen", "backlash"])
def test_every_model_follows_a_history(name, make_population):
    """Twice the actuation is about twice the force in slip."""
    population = make_population(medians=ordinary(name), level_sd=1e-9)
    predictor = Predictor(population, find_model(name), NOISE)
    step = np.where(TIME < 2.0, 0.5, 1.0)
    forces = [
        predictor.predict(Trace.from_arrays(TIME, MOTION, p), Forecast("device", draws=20)).median
        for p in (0.5, 1.0, step)
    ]
    before, after, history = forces
    early = SLIDING & (TIME > 0.8) & (TIME < 1.95)
    late = SLIDING & (TIME > 3.3)
    np.testing.assert_allclose(history[early], before[early], atol=0.03)
    np.testing.assert_allclose(history[late], after[late], atol=0.03)
    assert np.mean(np.abs(after[late])) > 1.4 * np.mean(np.abs(before[late]))  # the control


def test_a_valve_that_closes_leaves_no_friction(population):
    history = np.where(TIME < 2.0, 1.0, 0.0)
    band = ask(population, history, kind="new_test", draws=40)
    assert np.all(np.isfinite(band.draws))
    slides = (TIME > 3.3) & (np.abs(MOTION) < 0.3)
    assert np.all(np.abs(band.draws[:, slides]) < 0.3)


@pytest.mark.parametrize("history", [1.0, 1.0 + 0.3 * np.sin(TIME)], ids=["constant", "history"])
def test_friction_falls_after_a_turn_whatever_the_actuation(history, make_population):
    model = find_model("three_stage+weakening")
    fallen = make_population(also={"weakening_fwd": 0.2, "weakening_bwd": -0.1}, level_sd=1e-6)
    trace = Trace.from_arrays(TIME, MOTION, history)
    band = Predictor(fallen, model, NOISE).predict(trace, Forecast("device", draws=20))
    plain = make_population(level_sd=1e-6)
    without = Predictor(plain, model.base, NOISE).predict(trace, Forecast("device", draws=20))
    slip = SLIDING & (np.abs(trace.velocity) > 2.5)
    travel = np.where(trace.velocity > 0, MOTION + 1.0, 1.0 - MOTION)[slip]
    w = np.where(trace.velocity > 0, 0.2, -0.1)[slip]
    found = np.median(band.draws, axis=0)[slip] / np.median(without.draws, axis=0)[slip]
    assert found == pytest.approx(1.0 + w * (np.exp(-travel / 0.5) - np.exp(-1.0)), abs=0.01)


def test_the_device_does_not_change_its_meaning_beside_a_tested_level(make_population):
    """It is the law with the effect of its level, without scatter, tested or a percent away."""
    known = make_population(effect=0.02, scatter=0.1)
    for kind in ("device", "new_test"):
        at, beside = (width(known, p, kind=kind) for p in (1.0, 1.02))
        assert beside == pytest.approx(at, rel=0.25)
    # scatter of the slip force is not in it: it would be ten times the parameters' uncertainty
    device, new_test = (width(known, 1.0, kind=kind) for kind in ("device", "new_test"))
    assert 2.5 * device < new_test


def test_the_device_holds_what_is_unknown_of_an_untested_level(make_population):
    known = make_population(effect=0.15, scatter=0.05)
    tested, far = (width(known, p, kind="device") / p for p in (1.0, 8.0))
    assert 1.5 * tested < far
    none = make_population(effect=1e-6, scatter=0.05)  # the control
    tested, far = (width(none, p, kind="device") / p for p in (1.0, 8.0))
    assert far < 1.5 * tested


@pytest.mark.parametrize("law", ["affine", "residual_power"])
def test_a_valve_that_closes_leaves_the_residual_friction(law, make_population):
    population = make_population({"Fc_fwd": law, "Fc_bwd": law}, level_sd=1e-9)
    history = np.where(TIME < 2.0, 1.0, 0.0)
    closed, open_ = (ask(population, p, kind="device", draws=40) for p in (history, 0.0))
    slides = (TIME > 3.3) & (np.abs(MOTION) < 0.3)
    np.testing.assert_allclose(closed.median[slides], open_.median[slides], atol=0.05)
    assert np.median(np.abs(open_.median[slides])) > 0.3


def test_this_very_test_is_the_draws_of_that_test(population, medians):
    n = 30
    own = {name: np.full(n, value) for name, value in medians.items()} | {"Fc_fwd": np.full(n, 2.6)}
    trace = Trace.from_arrays(TIME, MOTION, 1.0)
    predictor = Predictor(population, ThreeStage(), NOISE)
    told = predictor.repeat(trace, Forecast("this_test"), own)
    forward = SLIDING & (np.gradient(MOTION) > 0)
    slip = 2.6 * (1 + 0.15 * np.exp(-((3.1 / 0.4) ** 2))) + 0.015 * 3.1
    assert np.mean(told.median[forward]) == pytest.approx(slip, rel=0.05)
    assert "this test" in told.source
    late = TIME > 2.0  # the start, which is unknown, no longer matters: all draws agree
    assert np.max((told.upper - told.lower)[late]) < 1e-6
    for name in medians:
        np.testing.assert_allclose(told.values[name], own[name][0], rtol=1e-9)
    assert np.ptp(told.values["start"]) > 0.5


def test_a_setting_is_what_the_trace_shows():
    setting = setting_of(Trace.from_arrays(TIME, MOTION, 0.8), "a")
    assert (setting.actuation, setting.session) == (0.8, "a")
    assert setting.covariates["velocity"] == pytest.approx(np.pi, rel=0.02)
    assert setting.covariates["amplitude"] == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (
            {"kind": "sometimes"},
            "unknown kind 'sometimes'.*device, new_test, observation, this_test",
        ),
        ({"probability": 1.5}, "between 0 and 1, got 1.5"),
        ({"probability": 0.0}, "between 0 and 1"),
        ({"probability": float("nan")}, "between 0 and 1"),
        ({"probability": "0.9"}, "between 0 and 1, got '0.9'"),
        ({"probability": None}, "between 0 and 1, got None"),
        ({"probability": [0.9]}, r"between 0 and 1, got \[0.9\]"),
        ({"draws": 3}, "draws must be a whole number, 10 or more, got 3"),
        ({"draws": "20"}, "draws must be a whole number, 10 or more, got '20'"),
        ({"session": ["a"]}, r"session must be text, got \['a'\]"),
        ({"whole": "no"}, "whole must be True or False, got 'no'"),
    ],
)
def test_a_forecast_that_makes_no_sense_is_refused(fault, words):
    with pytest.raises(FitError, match=words):
        Forecast(**fault)


def test_ten_draws_make_a_band():
    assert Forecast(draws=10).draws == 10


def test_a_prediction_needs_an_actuation(population):
    trace = Trace.from_arrays(TIME, MOTION)
    with pytest.raises(FitError, match=r"needs the trace's actuation.*ksi"):
        predict(population, trace, Forecast())


def test_a_prediction_beyond_all_range_ends_in_a_sentence(make_population):
    known = make_population({"Fc_fwd": "power"})
    begin = len(known.layout.names) + len(known.layout.effects)
    h = known.h.copy()
    h[..., begin + known.layout.shapes.index(("Fc_fwd", "exponent"))] = 10.0
    assert ask(replace(known, h=h), 1.0).median.size
    with pytest.raises(RecordError, match=r"predicted .* too large"):
        ask(replace(known, h=h), 1e9)


def test_new_tests_begin_in_the_gap_as_near_to_its_middle_as_calibrated_ones(make_population):
    population = make_population()
    rng = np.random.default_rng(5)
    shape = population.h.shape[:2]
    near = replace(population, starts=rng.beta(40.0, 40.0, (*shape, 12)))
    anywhere = replace(population, starts=rng.random((*shape, 12)))
    n, like_others = 20_000, population.layout.settings[0]
    found = near.draw_starts(rng, n, like_others)
    assert found.std() == pytest.approx(rng.beta(40, 40, n).std(), rel=0.25)
    assert found.mean() == pytest.approx(0.5, abs=0.01)
    assert anywhere.draw_starts(rng, n, like_others).std() > 0.8 / np.sqrt(12.0)
    none = population.draw_starts(rng, n, like_others)
    assert stats.kstest(none, "uniform").pvalue > 1e-3


def test_a_motion_shorter_than_all_calibrated_ones_may_begin_anywhere_in_the_gap(make_population):
    population = make_population()
    rng = np.random.default_rng(5)
    starts = rng.beta(40.0, 40.0, (*population.h.shape[:2], 12))
    strokes = np.linspace(0.5, 1.5, len(population.layout.settings))
    settings = [
        replace(setting, covariates={"amplitude": stroke})
        for setting, stroke in zip(population.layout.settings, strokes, strict=True)
    ]
    near = replace(population, starts=starts, layout=replace(population.layout, settings=settings))
    for stroke, uniform in ((0.2, True), (0.44, True), (0.46, False), (1.0, False), (9.0, False)):
        setting = replace(settings[0], covariates={"amplitude": stroke})
        found = near.draw_starts(rng, 4000, setting)
        assert (stats.kstest(found, "uniform").pvalue > 1e-3) == uniform
    unknown_motion = near.draw_starts(rng, 4000)
    assert stats.kstest(unknown_motion, "uniform").pvalue > 1e-3


def test_one_test_hardly_says_where_others_begin(make_population):
    population = make_population()
    rng = np.random.default_rng(6)
    one = replace(population, starts=np.full((*population.h.shape[:2], 1), 0.5))
    setting = population.layout.settings[0]
    assert one.draw_starts(rng, 20_000, setting).std() > 0.3 / np.sqrt(12.0)
