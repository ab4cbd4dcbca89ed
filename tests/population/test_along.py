"""Deviations from the laws along a history of actuation."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population import follow, given, tempering
from mfd_bayes.population.along import Along
from mfd_bayes.population.follow import Forecaster
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.records.trace import Trace

SD = 0.3
NAME = "Fc_fwd"
HISTORY = np.geomspace(0.1, 1.8, 80)
LEVEL = 0.9
TESTED = (0.5, 1.0, 2.0)
TIME = np.arange(401) / 100
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
EARLY, LATE = 175, 375  # samples in forward slip
STEP = np.where(TIME < 2.0, 0.6, 1.5)
TESTS = 10


def correlation(one, other):
    """Matérn 3/2 along the octaves of the actuation."""
    r = np.sqrt(3.0) * np.abs(np.log2(np.divide.outer(one, other)))
    return (1.0 + r) * np.exp(-r)


def size(actuation):
    return np.clip(1.0 / np.asarray(actuation), 0.5, 2.0)


def covariance(one, other):
    return SD**2 * np.outer(size(one), size(other)) * correlation(one, other)


@pytest.fixture(scope="module")
def population(make_population):
    """Levels of the session "" deviate by what is in `latent`."""
    made = make_population(level_sd=1e-6, scatter=1e-6, effect=SD)
    latent = made.latent.copy()
    latent[:, :, 1:] = np.random.default_rng(2).standard_normal(latent[:, :, 1:].shape)
    latent[:, :, 1:] *= SD / made.layout.spread
    return replace(made, latent=latent)


def draws(population, session, n=20_000):
    """Logarithms of what the slip force is over the law along the history, and in the level."""
    around = Along.of(population, Setting(LEVEL, session), HISTORY)
    rng = np.random.default_rng(3)
    index, k = np.zeros(n, dtype=np.intp), population.layout.names.index(NAME)
    numbers = rng.standard_normal((n, around.size))
    level = population.layout.spread[k] * around.unknown(index, numbers)[:, k]
    return level, around.log_factors(index, numbers, HISTORY)[NAME].T + level[:, None]


def test_a_new_session_deviates_as_its_levels_do(population):
    level, found = draws(population, "another")
    every = np.append(HISTORY, LEVEL)
    wanted = covariance(every, every)
    ours = np.cov(np.column_stack([found, level]), rowvar=False)
    np.testing.assert_allclose(ours, wanted, rtol=0.04, atol=0.06 * SD**2)
    assert np.max(np.abs(ours - np.diag(np.diag(wanted)))) > 0.2 * SD**2  # the control
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.02)


def test_calibrated_levels_are_known(population):
    _, found = draws(population, "")
    layout = population.layout
    k, begin = layout.names.index(NAME), 0
    effect = next(e for e in layout.effects if e.name == "level" and k in e.members)
    for other in layout.effects:
        if other is effect:
            break
        begin += len(other.cells)
    parts = population.latent[0, 0, 1 + begin : 1 + begin + len(effect.cells), k]
    cells = effect.root @ (layout.spread[k] * parts)  # deviations of the calibrated levels
    weights = np.linalg.solve(covariance(TESTED, TESTED), covariance(TESTED, HISTORY)).T
    at_level = np.linalg.solve(covariance(TESTED, TESTED), covariance(TESTED, [LEVEL])).T @ cells
    # factors are over the level, whose known deviation the test's parameters have
    np.testing.assert_allclose(found.mean(axis=0), weights @ cells - at_level, atol=0.05)
    assert np.ptp(weights @ cells) > 0.1  # the control
    wanted = covariance(HISTORY, HISTORY) - weights @ covariance(TESTED, HISTORY)
    np.testing.assert_allclose(np.cov(found, rowvar=False), wanted, atol=0.15 * SD**2)
    # what differs between near actuations is not lost beside the large variance of low ones
    sd = np.sqrt(np.diag(wanted)[20:] + np.diag(wanted)[:-20] - 2.0 * np.diag(wanted, 20))
    np.testing.assert_allclose(np.std(found[:, 20:] - found[:, :-20], axis=0), sd, atol=0.1 * SD)


def test_one_level_or_too_few_need_no_numbers(population, make_population):
    constant = Along.of(population, Setting(LEVEL), np.full(9, LEVEL))
    without = replace(population, layout=population.layout.without("level"))
    assert constant.size == Along.of(without, Setting(LEVEL), HISTORY).size == 0
    assert Along.of(population, Setting(0.0), np.zeros(9)).size == 0
    assert Along.of(population, Setting(LEVEL), HISTORY).size > 0
    below = np.array([0.0, 0.5, 1.0])  # a valve that opens
    around = Along.of(population, Setting(0.5), below)
    numbers = np.ones((4, around.size))
    assert np.all(np.isfinite(around.log_factors(np.arange(4), numbers, below)[NAME]))


def ask(population, actuation):
    predictor = Predictor(population, ThreeStage(), find_noise("iid"))
    trace = Trace.from_arrays(TIME, MOTION, actuation)
    return predictor.predict(trace, Forecast("device", draws=1500, session="another")).draws


def test_a_history_scatters_as_constant_tests_at_its_levels(population, monkeypatch):
    constant = [np.std(np.log(ask(population, p)[:, LATE])) for p in (0.6, 1.5)]
    forces = np.log(ask(population, STEP)[:, [EARLY, LATE]])
    np.testing.assert_allclose(forces.std(axis=0), constant, rtol=0.1)
    together = correlation([0.6], [1.5])[0, 0]
    assert np.corrcoef(forces.T)[0, 1] == pytest.approx(together, abs=0.08)
    # the control: laws that hold exactly along the history
    monkeypatch.setattr(Along, "of", lambda population, one, _: Along(population, one, np.zeros(1)))
    forces = np.log(ask(population, STEP)[:, [EARLY, LATE]])
    assert np.corrcoef(forces.T)[0, 1] > 0.99


@pytest.fixture(scope="module")
def tools(benchmark_module):
    return benchmark_module("given.study")


@pytest.fixture(scope="module")
def study(tools):
    """Tests along which the actuation doubles."""
    return tools.make_study(level_sd=SD)


@pytest.fixture(scope="module")
def few():
    """Fewer draws and points than users get."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(given, "TRIED", 500)
        patch.setattr(given, "POINTS", 300)
        patch.setattr(follow, "TRIED", 500)
        patch.setattr(tempering, "MOST", 12)
        patch.setattr(tempering, "MOST_LAST", 40)
        yield


@pytest.mark.slow
def test_ranks_are_uniform_given_half_of_a_history(tools, study, few, benchmark_module):
    truths = [tools.draw_truth(study, np.random.default_rng([20, j])) for j in range(TESTS)]
    lawful = replace(study, predictor=tools.make_study().predictor)
    uniform = benchmark_module("common.uniformity").Uniformity(TESTS, tools.DRAWS, 4000)
    p = []
    for those in (study, lawful):  # the second is the control
        bands = [tools.ask(those, truth, 0.5, seed=j) for j, truth in enumerate(truths)]
        ranks = [tools.ranks_of(t, b) for t, b in zip(truths, bands, strict=True)]
        p.append({name: uniform.p_value([one[name] for one in ranks]) for name in ranks[0]})
    assert min(p[0].values()) > 0.01 / len(p[0]), p[0]
    assert min(p[1].values()) < 0.01 / len(p[1]), p[1]


@pytest.mark.parametrize("varying", [True, False])
def test_a_followed_test_knows_what_a_given_part_says(tools, study, few, varying):
    if not varying:  # a level at which no test was made
        study = replace(study, motion=replace(study.motion, actuation=0.7))
    truth, at = tools.draw_truth(study, np.random.default_rng(12)), 64
    trace = truth.trace
    setting = setting_of(trace, study.session)
    forecast = Forecast(draws=300, session=study.session)
    forecaster = Forecaster(study.predictor, setting, forecast, study.pace)
    actuation = np.broadcast_to(trace.actuation, trace.time.shape)
    columns = (trace.time, trace.displacement, actuation, trace.force)
    forecaster.update(*(column[:at] for column in columns))
    rest = Trace.from_arrays(trace.time[at:], trace.displacement[at:], actuation[at:])
    band = forecaster.band(rest)
    window = 0.0, float(trace.time[at - 1])
    whole = predict_given(study.predictor, trace, forecast, window, study.pace)
    width = np.mean((whole.upper - whole.lower)[at:])
    assert np.mean(band.upper - band.lower) == pytest.approx(width, rel=0.25)
    assert np.mean(np.abs(band.median - whole.median[at:])) < 0.25 * width
    alone = tools.ask(study, truth, 0.0)
    assert width < 0.7 * np.mean((alone.upper - alone.lower)[at:])  # the control
