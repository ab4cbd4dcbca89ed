"""Tests of devices that are put to rest without load begin inside the gap."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.friction.weakened import Weakened
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import values_of
from mfd_bayes.population.inference import _unloaded
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.starts import standing_of
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.population.starts import Standing, anywhere
from mfd_bayes.population.unloaded import BEFORE, Unloaded, chance_of
from mfd_bayes.records.trace import Trace
from tests.friction.backlash_cases import loads

N = 4000

THETA = {
    "k_fwd": 45.0,
    "k_bwd": 50.0,
    "gap": 0.2,
    "ell": 0.01,
    "k_0": 0.5,
    "Fc_fwd": 7.0,
    "Fc_bwd": 6.0,
    "n": 1.5,
    "sigma2": 0.01,
    "static_excess_fwd": 0.1,
    "static_excess_bwd": 0.1,
    "v_s": 0.5,
}


def values(n=1, **others):
    """Quantities of n dampers of the backlash model."""
    return {name: np.full(n, value) for name, value in (THETA | others).items()}


def part(lower=0.3, upper=0.7, edge=0.04, n=N):
    """Where n devices bear no load."""
    return Unloaded(*(np.full(n, value) for value in (lower, upper, edge)))


def test_a_device_without_load_bears_a_fifth_of_its_slip_force_at_most():
    model, known = BacklashLuGre(), values()
    theta = model.theta(known)
    lower, upper, edge = (float(value[0]) for value in model.unloaded(known))

    def force(start):
        return float(model.start(theta, np.array([start])).bent[1][0])

    assert force(lower) == pytest.approx(-0.2 * 6.0, rel=1e-3)
    assert force(upper) == pytest.approx(0.2 * 7.0, rel=1e-3)
    assert force(upper + edge) == pytest.approx(0.4 * 7.0, rel=0.1)
    assert abs(force(0.5 * (lower + upper))) < 0.01 * 6.0
    # control: half way from the gap to slip it bears far more
    assert min(force(0.5 * (1.0 + upper)), -force(0.5 * lower)) > 0.4 * 6.0


@pytest.mark.parametrize(
    "others", [{"gap": 0.0}, {"gap": 0.0, "ell": 90.0}, {"gap": 1e6}, {"ell": 1e-9}]
)
def test_odd_gaps_have_a_density_too(others):
    part = Unloaded(*BacklashLuGre().unloaded(values(50, **others)))
    drawn = part.draw(np.random.default_rng(0))
    assert np.all((drawn > 0.0) & (drawn < 1.0))
    assert np.all(np.isfinite(part.log_density(drawn)))


def test_models_say_where_load_begins_or_that_there_is_none():
    assert ThreeStage().unloaded(values()) is None
    weakened = Weakened(BacklashLuGre()).unloaded(values())
    np.testing.assert_array_equal(weakened, BacklashLuGre().unloaded(values()))


@pytest.mark.parametrize("shape", [(0.3, 0.7, 0.04), (0.0, 0.4, 0.2), (0.45, 0.5, 9.0)])
def test_the_density_is_that_of_what_is_drawn(shape):
    one = part(*shape, n=1)
    total = quad(lambda w: np.exp(one.log_density(np.array([w]))[0]), 0.0, 1.0, limit=200)[0]
    assert total == pytest.approx(1.0, abs=1e-6)
    drawn = part(*shape).draw(np.random.default_rng(2))
    at = np.linspace(0.0, 1.0, 2001)
    some = Unloaded(*(np.full(at.size, value) for value in shape))
    curve = np.exp(some.log_density(at))
    curve = np.concatenate([[0.0], np.cumsum(0.5 * (curve[1:] + curve[:-1]) * np.diff(at))])
    assert stats.kstest(drawn, lambda w: np.interp(w, at, curve)).pvalue > 1e-3
    # control
    assert (
        stats.kstest(np.clip(drawn + 0.05, 0, 1), lambda w: np.interp(w, at, curve)).pvalue < 1e-3
    )


def test_tests_that_begin_without_load_say_that_others_do():
    rng = np.random.default_rng(3)
    without = [(part().draw(rng), part()) for _ in range(8)]
    assert chance_of(without) > 0.99
    one = 2.4 * BEFORE  # the gap is two fifths of the range, but for its soft ends
    assert chance_of(without[:1]) == pytest.approx(one / (one + 1.0 - BEFORE), abs=0.01)
    assert chance_of([]) == pytest.approx(BEFORE)
    loaded = [(rng.uniform(0.9, 1.0, N), part()), *without[1:]]
    assert chance_of(loaded) < 0.1


def test_what_is_not_finite_counts_as_the_whole_range():
    bad = [np.array([0.3, np.nan, 0.3, 0.3]), np.array([0.7, 0.7, np.inf, 0.7])]
    one = Unloaded.checked(*bad, np.array([0.01, 0.01, 0.01, np.nan]))
    np.testing.assert_array_equal(one.lower, [0.3, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(one.upper, [0.7, 1.0, 1.0, 1.0])
    assert np.all(np.abs(one.draw(np.random.default_rng(0)) - 0.5) <= 0.5)


def test_without_a_chance_nothing_is_drawn_for_it():
    before, after = np.random.default_rng(5), np.random.default_rng(5)
    found = anywhere(after, N, 0.0).draw(after, lambda: part())
    np.testing.assert_array_equal(found, before.beta(np.ones(N), np.ones(N)))
    assert anywhere(after, N, 0.5).without_load.mean() == pytest.approx(0.5, abs=0.05)


def test_short_motions_begin_without_load_where_the_tests_did(make_population):
    known = make_population()
    settings = [replace(s, covariates={"amplitude": 1.0}) for s in known.layout.settings]
    begun = np.broadcast_to(0.5, (*known.h.shape[:2], len(settings)))
    layout = replace(known.layout, settings=tuple(settings))
    population = replace(known, layout=layout, starts=begun, unloaded=1.0)
    rng = np.random.default_rng(6)
    like, shorter = (Setting(1.0, "", {"amplitude": a}) for a in (1.0, 0.5))
    standing = Standing(unloaded=part)
    within = [
        np.mean(np.abs(population.draw_starts(rng, N, setting, standing) - 0.5) < 0.25)
        for setting in (shorter, None, like)
    ]
    assert min(within[:2]) > 0.95
    free = replace(population, unloaded=0.0).draw_starts(rng, N, shorter, standing)
    assert stats.kstest(free, "uniform").pvalue > 1e-3
    # those like the tests begin where these show it, whatever load that is
    same = Standing(unloaded=lambda: part(0.0, 0.1))
    assert abs(population.draw_starts(rng, N, like, same).mean() - 0.5) < 0.05


@pytest.fixture(scope="module")
def study(benchmark_module):
    """A population of the backlash model, whose tests begin without load in four of five."""
    return benchmark_module("given.study").make_study("backlash")


def prior_of(predictor, motion):
    """What is known of a test under a motion."""
    setting = setting_of(motion)
    standing = partial(standing_of, predictor.population, predictor.model, trace=motion)
    around, rng = predictor.around(motion, setting), np.random.default_rng(8)
    return TestPrior.of(around, rng, N, standing)


def both(study):
    """Quantities of tests that are predicted alone, and of those before a part is given."""
    predictor, motion = study.predictor, study.motion
    forecast = Forecast(draws=N)
    alone = predictor.values(predictor.draw(motion, forecast, np.random.default_rng(7)))
    prior, labels = prior_of(predictor, motion), np.arange(N)
    points = prior.draw(labels, np.random.default_rng(9))
    return alone, values_of(predictor, prior, labels, points)


def test_alone_and_given_begin_alike(study):
    theta = study.predictor.model.theta
    found = [loads(theta(one), one["start"]) for one in both(study)]
    for load in found:
        assert np.mean(np.abs(load) < 0.25) > 0.8
        assert np.mean(np.abs(load) > 0.5) > 0.05  # those that begin anywhere
    assert stats.ks_2samp(*found).pvalue > 1e-3
    # control: where nothing is known of it
    loaded = replace(study.predictor, population=replace(study.predictor.population, unloaded=0.0))
    given = both(replace(study, predictor=loaded))[1]
    free = loads(theta(given), given["start"])
    assert stats.ks_2samp(found[1], free).pvalue < 1e-6


def test_the_prior_of_a_test_is_normalised_whether_it_begins_with_load_or_not(study):
    prior = prior_of(study.predictor, study.motion)
    kinds = [np.flatnonzero(prior.start.without_load == kind)[:3] for kind in (False, True)]
    labels = np.concatenate(kinds)
    points = prior.draw(labels, np.random.default_rng(1))
    t = np.linspace(-25.0, 25.0, 6001)
    along = np.repeat(points[:, None], t.size, axis=1)
    along[..., -1] = t
    log = prior.log_density(np.repeat(labels[:, None], t.size, axis=1), along)
    # what is left is the Gaussian density of the other coordinates
    away = (prior.mean[labels] - points[:, :-1])[:, :, None]
    standard = np.linalg.solve(prior.root[labels], away)[..., 0]
    sizes = np.log(np.diagonal(prior.root[labels], axis1=1, axis2=2)).sum(axis=1)
    expected = -0.5 * (standard**2).sum(axis=1) - sizes
    found = np.log(np.trapezoid(np.exp(log - expected[:, None]), t, axis=1))
    np.testing.assert_allclose(found, 0.0, atol=2e-3)


def test_inference_learns_it_from_the_tests(motion_of_a_test):
    def chance(start, model="backlash", prior=None, known="sample"):
        priors = load_priors("mfd")
        if prior is not None:
            priors = replace(priors, parameters={**priors.parameters, "start": prior})
        posterior = Posterior(motion_of_a_test, priors, "iid", model, start=known)
        drawn = posterior.draw_prior(np.random.default_rng(0), 400)
        drawn["start"] = np.random.default_rng(1).uniform(*start, 400)
        q = posterior.coordinates(drawn).reshape(4, 100, -1)
        one = SimpleNamespace(own=("start",), posterior=posterior, points=lambda x: x)
        return _unloaded([one] * 6, [q] * 6)

    assert chance((0.45, 0.55)) > 0.95
    assert chance((0.0, 0.02)) < BEFORE
    assert chance((0.45, 0.55), "three_stage") == 0.0
    assert chance((0.45, 0.55), "lugre") == 0.0  # it has no start
    assert chance((0.45, 0.55), known="mask") == 0.0  # it is not known
    beta = Prior("truncated_normal", {"mean": 0.5, "sd": 0.1, "lower": 0.0, "upper": 1.0})
    assert chance((0.45, 0.55), prior=beta) == 0.0
    narrow = Prior("uniform", {"lower": 0.4, "upper": 0.6})
    assert chance((0.45, 0.55), prior=narrow) == 0.0


@pytest.fixture
def motion_of_a_test():
    """Two cycles with a force."""
    time = np.arange(200) / 50.0
    x = np.sin(np.pi * time)
    return Trace.from_arrays(time, x, 1.0, np.sign(np.cos(np.pi * time)))
