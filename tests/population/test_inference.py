"""Populations of synthetic campaigns, from records to bands."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.friction.models import find_model
from mfd_bayes.population import inference
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.inference import InferenceSettings, infer_population
from mfd_bayes.records.trace import Trace

TIME = np.arange(160) / 32.0
NOISE = 0.03
SCATTER = 0.05
LAW = {"Fc_fwd": "affine", "Fc_bwd": "affine", "sigma0": "constant"}


def slip(p):
    """The true law: 0.4 + 0.8 p."""
    return 0.4 + 0.8 * np.asarray(p)


def typical(priors, names):
    values = {n: priors.parameters[n].typical for n in names if n in priors.parameters}
    return values | {"offset": 0.0, "noise_sd": NOISE, "start": 0.5, "gamma1": 1.0}


def made_test(priors, name, actuation, rng, luck=0.0):
    """A result of one test: its record is made of the law, with scatter and noise."""
    model = find_model(name)
    motion = 0.8 * np.sin(1.2 * np.pi * TIME)
    blank = Trace.from_arrays(TIME, motion, actuation, np.ones(TIME.size))
    posterior = Posterior(blank, priors, "iid", model, start="sample")
    values = typical(priors, posterior.names)
    level = blank.reference_actuation
    values["Fc_fwd"] = slip(level) * np.exp(luck)
    values["Fc_bwd"] = 1.2 * slip(level) * np.exp(luck)
    arrays = {k: np.array([v]) for k, v in values.items()}
    scales = {}
    if np.ndim(actuation):
        along = (slip(actuation) / slip(level))[None]
        scales = dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fs_fwd", "Fs_bwd"), along)
        scales = {k: v for k, v in scales.items() if k in model.parameters}
    force = posterior.force(arrays, scales=scales or None)[0] + NOISE * rng.standard_normal(
        TIME.size
    )
    trace = Trace.from_arrays(TIME, motion, actuation, force)
    near = {k: (v * 1.02 if k != "offset" else 0.01, v, v) for k, v in values.items()}
    own = Posterior(trace, priors, "iid", model, start="sample")
    return SimpleNamespace(trace=trace, posterior=own, intervals=near)


LEVELS = (0.5, 0.5, 1.0, 1.0, 1.5, 1.5)


@pytest.fixture
def quickly(monkeypatch):
    """Fewer steps, which are enough here."""
    monkeypatch.setitem(inference.SWEEPS, "quick", 160)
    monkeypatch.setattr(inference, "ALTERNATIVES", 60)


def infer(priors, name, actuations, seed=3, laws=LAW, scatter=SCATTER):
    rng = np.random.default_rng(seed)
    tests = {
        f"t{i}": made_test(priors, name, p, rng, scatter * rng.standard_normal())
        for i, p in enumerate(actuations)
    }
    settings = InferenceSettings(laws, "ksi", "quick", (1, 2))
    return tests, infer_population(tests, priors, settings)


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize("name", ["lugre", "three_stage"])
def test_the_law_that_records_are_made_with_is_found_and_predicts(priors, name):
    _, found = infer(priors, name, LEVELS)
    population, median = found.population, found.population.median("Fc_fwd", [0.5, 1.0, 1.5])
    away = np.abs(np.median(median, axis=(0, 1)) - slip([0.5, 1.0, 1.5]))
    assert np.all(away < 4.0 * median.std(axis=(0, 1)) + 0.01)
    assert np.all(away < 0.15 * slip([0.5, 1.0, 1.5]))
    assert population.law_weights["Fc_fwd"] == {"affine": 1.0}
    assert np.all(np.isfinite(population.convergence.r_hat))
    predictor = Predictor(population, find_model(name), find_noise("iid"))
    rng, inside, widths = np.random.default_rng(9), [], []
    for p in (0.5, 0.8, 1.2, 1.5):
        new = made_test(priors, name, p, rng, SCATTER * rng.standard_normal())
        band = predictor.predict(new.trace, Forecast("observation", draws=300))
        inside.append(np.mean((new.trace.force >= band.lower) & (new.trace.force <= band.upper)))
        widths.append(np.mean(band.upper - band.lower) / np.ptp(new.trace.force))
    assert np.mean(inside) > 0.85
    assert np.mean(widths) < 0.35


@pytest.mark.usefixtures("quickly")
def test_the_same_seed_gives_the_same_population_however_many_processes(priors):
    rng = np.random.default_rng(3)
    tests = {f"t{p}": made_test(priors, "lugre", p, rng) for p in (0.5, 1.0, 1.5)}
    one, two, other = (
        infer_population(tests, priors, InferenceSettings(LAW, "ksi", "quick", seed, jobs=jobs))
        for seed, jobs in (((1, 2), 1), ((1, 2), 2), ((1, 3), 1))
    )
    np.testing.assert_array_equal(one.tests, two.tests)
    np.testing.assert_array_equal(one.population.draws.h, two.population.draws.h)
    assert np.any(one.tests != other.tests)


@pytest.mark.usefixtures("quickly")
def test_tests_without_actuation_inform_a_law_with_an_intercept_alone(priors):
    levels = (1e-6, 0.5, 1.0, 1.5)
    _, found = infer(priors, "lugre", levels)
    at_zero = found.population.median("Fc_fwd", 0.0)
    assert np.median(at_zero) == pytest.approx(0.4, rel=0.3)
    proportional = dict.fromkeys(("Fc_fwd", "Fc_bwd"), "proportional")
    _, without = infer(priors, "lugre", levels, laws=LAW | proportional)
    assert np.all(np.isfinite(without.tests))
    assert np.all(without.population.median("Fc_fwd", 0.0) == 0.0)
    # it is known from its own record all the same
    assert np.median(without.values(0)["Fc_fwd"]) == pytest.approx(0.4, rel=0.3)
    informs = without.population.design.informs
    assert not informs[0, without.population.design.names.index("Fc_fwd")]


@pytest.mark.usefixtures("quickly")
def test_sessions_that_differ_are_told_from_scatter(priors):
    rng = np.random.default_rng(5)
    lucks = (0.15, 0.15, 0.15, -0.15, -0.15, -0.15)
    tests = {
        f"t{i}": made_test(priors, "lugre", p, rng, luck)
        for i, (p, luck) in enumerate(zip((0.5, 1.0, 1.5) * 2, lucks, strict=True))
    }
    sessions = {f"t{i}": "ab"[i // 3] for i in range(6)}
    settings = InferenceSettings(LAW, "ksi", "quick", (1, 2), sessions=sessions)
    found = infer_population(tests, priors, settings).population
    plain = infer_population(
        tests, priors, InferenceSettings(LAW, "ksi", "quick", (1, 2))
    ).population
    assert np.median(found.effect_sds["session_friction"]) > 2.0 * np.median(
        found.scatters["Fc_fwd"]
    )
    assert np.median(plain.scatters["Fc_fwd"]) > 2.0 * np.median(found.scatters["Fc_fwd"])
    assert "session_friction" not in plain.effect_sds
