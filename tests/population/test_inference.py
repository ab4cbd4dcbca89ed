"""Populations of synthetic campaigns, from records to bands."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import PredictionOptions, Predictor
from mfd_bayes.population.inference import InferenceSettings, infer_population
from mfd_bayes.population.population import slip_force_of, strokes_of
from mfd_bayes.records.trace import Trace

TIME = np.arange(160) / 32.0
MOTION = 0.8 * np.sin(1.2 * np.pi * TIME)
TRACE = Trace.from_arrays(TIME, MOTION, 1.0)
NOISE, SCATTER = 0.03, 0.05
LAW = {"Fc_fwd": "affine", "Fc_bwd": "affine", "sigma0": "constant"}
LEVELS = (0.5, 0.5, 1.0, 1.0, 1.5, 1.5)
SHORT = Effort(ess=25.0, limit=1, r_hat=1.3, kept=1200)


def slip(p):
    """The true law: 0.4 + 0.8 p."""
    return 0.4 + 0.8 * np.asarray(p)


def made_test(priors, name, actuation, rng, luck=0.0):
    """A result of one test: its record is made of the law, with scatter and noise."""
    model = find_model(name)
    blank = Trace.from_arrays(TIME, MOTION, actuation, np.ones(TIME.size))
    posterior = Posterior(blank, priors, "iid", model, initial="sample")
    names = [n for n in posterior.names if n in priors.parameters]
    values = {n: priors.parameters[n].median for n in names}
    force = slip(blank.reference_actuation) * np.exp(luck)
    values |= {"Fc_fwd": force, "Fc_bwd": 1.2 * force, "offset": 0.0, "noise_sd": NOISE}
    values |= {"start": 0.5, "gamma1": 1.0}
    computed = posterior.force({k: np.array([v]) for k, v in values.items()})[0]
    measured = computed + NOISE * rng.standard_normal(TIME.size)
    trace = Trace.from_arrays(TIME, MOTION, actuation, measured)
    intervals = {k: (v * 1.02 if k != "offset" else 0.01, v, v) for k, v in values.items()}
    fit = Posterior(trace, priors, "iid", model, initial="sample")
    return SimpleNamespace(trace=trace, posterior=fit, intervals=intervals)


def made_tests(priors, name, actuations, lucks=None):
    """Results by name; they scatter, or have these deviations of log slip force."""
    rng = np.random.default_rng(3)
    tests = {}
    for i, p in enumerate(actuations):
        luck = SCATTER * rng.standard_normal() if lucks is None else lucks[i]
        tests[f"t{i}"] = made_test(priors, name, p, rng, luck)
    return tests


def infer(priors, tests, laws=LAW, seed=(1, 2), **options):
    settings = InferenceSettings(laws, "ksi", SHORT, seed, **options)
    return infer_population(tests, priors, settings)


@pytest.mark.parametrize("name", ["lugre", "three_stage"])
def test_the_law_that_records_are_made_with_is_found_and_predicts(priors, name):
    population = infer(priors, made_tests(priors, name, LEVELS)).population
    median = population.median("Fc_fwd", [0.5, 1.0, 1.5])
    error = np.abs(np.median(median, axis=(0, 1)) - slip([0.5, 1.0, 1.5]))
    assert np.all(error < 4.0 * median.std(axis=(0, 1)) + 0.01)
    assert np.all(error < 0.15 * slip([0.5, 1.0, 1.5]))
    assert population.law_weights["Fc_fwd"] == {"affine": 1.0}
    assert np.all(np.isfinite(population.convergence.r_hat))
    predictor = Predictor(population, find_model(name), find_noise("iid"))
    rng, covered, widths = np.random.default_rng(9), [], []
    for p in (0.5, 0.8, 1.2, 1.5):
        test = made_test(priors, name, p, rng, SCATTER * rng.standard_normal())
        band = predictor.predict(test.trace, PredictionOptions("observation", draws=300))
        covered.append(np.mean((test.trace.force >= band.lower) & (test.trace.force <= band.upper)))
        widths.append(np.mean(band.upper - band.lower) / np.ptp(test.trace.force))
    assert np.mean(covered) > 0.85
    assert np.mean(widths) < 0.35


def test_the_same_seed_gives_the_same_population_however_many_processes(priors):
    tests = made_tests(priors, "lugre", (0.5, 1.0))
    serial, parallel = (infer(priors, tests, jobs=jobs) for jobs in (1, 2))
    np.testing.assert_array_equal(serial.tests, parallel.tests)
    np.testing.assert_array_equal(serial.population.draws.h, parallel.population.draws.h)


def test_tests_without_actuation_inform_a_law_with_an_intercept_alone(priors):
    tests = made_tests(priors, "lugre", (1e-6, 0.5, 1.0, 1.5))
    inference = infer(priors, tests, LAW | {"Fc_fwd": "proportional"})
    population, design = inference.population, inference.population.design
    assert np.all(np.isfinite(inference.tests))
    assert np.median(population.median("Fc_bwd", 0.0)) == pytest.approx(1.2 * 0.4, rel=0.3)
    assert np.all(population.median("Fc_fwd", 0.0) == 0.0)
    # it is known from its own record all the same
    assert np.median(inference.values(0)["Fc_fwd"]) == pytest.approx(0.4, rel=0.3)
    informs = design.informs[0, [design.names.index(name) for name in ("Fc_fwd", "Fc_bwd")]]
    assert informs.tolist() == [False, True]


def test_beyond_the_levels_what_tests_share_is_as_they_say(priors, monkeypatch):
    """Gaussian likelihoods are off by 0.6 sd in σ1: these posteriors are bent."""
    monkeypatch.setattr("mfd_bayes.population.inference.ALTERNATIVES", 2000)
    population = infer(priors, made_tests(priors, "lugre", (1.0, 1.0))).population
    common = np.flatnonzero(population.design.common)
    of_tests = population.draws.z[..., common].reshape(-1, common.size)
    beyond = population.alternatives.z[:, common]
    off = np.abs(np.median(beyond, axis=0) - np.median(of_tests, axis=0)) / of_tests.std(axis=0)
    se = 1.25 / np.sqrt(len(beyond))  # of the median of so many that are taken again
    assert off.max() < 4.0 * se
    assert beyond.std(axis=0) == pytest.approx(of_tests.std(axis=0), rel=4.0 / np.sqrt(len(beyond)))


def test_beyond_the_levels_a_law_is_as_wide_as_between_them(priors, monkeypatch):
    monkeypatch.setattr("mfd_bayes.population.inference.ALTERNATIVES", 2000)
    population = infer(priors, made_tests(priors, "lugre", LEVELS)).population
    weight, shares = population.alternative_weight, population.shapes("Fc_fwd")[0]
    # those under the affine law, which come first
    beyond = population.alternatives.share[np.isclose(weight, weight[0], rtol=1e-9), 0]
    assert beyond.std() == pytest.approx(shares.std(), rel=0.25)
    assert np.median(beyond) == pytest.approx(np.median(shares), abs=0.25 * shares.std())


# --- what parameters are confounded with


def test_what_a_discrepancy_takes_away_parameters_give(priors):
    """Of two tests whose force falls after each turn as no slip force does."""
    tests, stroke = made_tests(priors, "lugre", (1.0, 1.0), (0.0, 0.02)), strokes_of(TRACE)
    turns = np.array([MOTION[stroke == i][0] for i in range(stroke[-1] + 1)])
    travel, direction = np.abs(MOTION - turns[stroke]), np.sign(np.gradient(MOTION))
    for test in tests.values():
        fallen = test.trace.force + 0.3 * direction * np.exp(-travel / 0.3)
        test.trace = replace(test.trace, force=fallen)
        test.posterior = Posterior(test.trace, priors, "iid", test.posterior.model)
    result, model = infer(priors, tests), find_model("lugre")
    values = {name: v.reshape(-1) for name, v in result.values(0).items()} | {"gamma1": 1.0}
    population = result.population
    predictor, slip = Predictor(population, model, find_noise("iid")), slip_force_of(model, values)
    force, knots = predictor.model_force(TRACE, values, {}), population.knots(np.arange(slip.size))
    discrepancy = population.residual.discrepancy(TRACE, slip, knots)

    force, discrepancy = (v[:, 60:] - v[:, 60:].mean(axis=0) for v in (force, discrepancy))
    rng = np.random.default_rng(0)
    of_others = [np.sum(force * rng.permutation(discrepancy)) for _ in range(50)]
    assert np.sum(force * discrepancy) < -5.0 * np.std(of_others)
    assert np.max(np.abs(of_others)) < 4.0 * np.std(of_others)
