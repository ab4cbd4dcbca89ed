"""Noise that is larger, and decorrelates faster, where the force builds up."""

import itertools
import warnings

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration import noise as staged_noise
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

STAGED = NOISES["staged"]
VALUES = {
    "noise_sd": np.array([0.1, 0.2, 0.3]),
    "noise_time": np.array([0.2, 1.0, 0.01]),
    "noise_build": np.array([0.3, 0.2, 0.06]),
    "noise_fade": np.array([0.1, 0.3, 0.5]),
    "noise_build_time": np.array([0.01, 0.1, 2.0]),
    "d2": np.array([0.2, 0.1, 0.3]),
    "d3": np.array([0.1, 0.2, 0.05]),
}
UNIFORM = np.arange(60) / 64.0
IRREGULAR = np.sort(np.random.default_rng(0).uniform(0, 1.0, 60))


def travels(rng, time):
    return rng.uniform(-0.2, 1.5, (3, time.size))


def weight(i, travel):
    """The build-up's weight by its definition."""
    d2, d3 = VALUES["d2"][i], VALUES["d3"][i]
    rise = np.clip((travel - d2) / d3, 0.0, 1.0)
    return rise * np.exp(-np.maximum(travel - d2 - d3, 0.0) / VALUES["noise_fade"][i])


def covariance(i, time, travel):
    """Dense covariance of one vector's noise."""
    h = weight(i, travel)
    sd = VALUES["noise_sd"][i] + VALUES["noise_build"][i] * h
    slow, fast = 1.0 / VALUES["noise_time"][i], 1.0 / VALUES["noise_build_time"][i]
    decay = np.concatenate([[0.0], np.diff(time) * (slow + (fast - slow) * h[1:])])
    passed = np.cumsum(decay)
    return np.exp(-np.abs(passed[:, None] - passed)) * np.outer(sd, sd)


@pytest.mark.parametrize("time", [UNIFORM, IRREGULAR], ids=["uniform", "irregular"])
@pytest.mark.parametrize("piece", [1 << 15, 24], ids=["one piece", "pieces"])
def test_the_density_is_that_of_its_gaussian_process(time, piece, monkeypatch):
    monkeypatch.setattr(staged_noise, "PIECE", piece)
    rng = np.random.default_rng(1)
    travel = travels(rng, time)
    residual = 0.2 * rng.normal(size=(3, time.size))
    got = STAGED.log_density(residual, time, VALUES, travel)
    for i in range(3):
        dense = stats.multivariate_normal(
            np.zeros(time.size), covariance(i, time, travel[i]), allow_singular=True
        )
        assert got[i] == pytest.approx(dense.logpdf(residual[i]), rel=1e-9)


def test_without_build_up_it_is_ornstein_uhlenbeck():
    rng = np.random.default_rng(2)
    residual = 0.2 * rng.normal(size=(3, 60))
    slipping = np.full((3, 60), -0.1)
    got = STAGED.log_density(residual, UNIFORM, VALUES, slipping)
    expected = NOISES["ou"].log_density(residual, UNIFORM, VALUES)
    np.testing.assert_allclose(got, expected, rtol=1e-10)
    building = np.full((3, 60), 0.34)
    other = STAGED.log_density(residual, UNIFORM, VALUES, building)
    assert np.all(np.abs(other - expected) > 1.0)


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 8, 9, 24])
def test_records_of_any_length_have_their_density(samples, monkeypatch):
    monkeypatch.setattr(staged_noise, "PIECE", 24)  # pieces of 8 samples
    rng = np.random.default_rng(4)
    time = UNIFORM[:samples]
    travel, residual = travels(rng, time), 0.2 * rng.normal(size=(3, samples))
    got = STAGED.log_density(residual, time, VALUES, travel)
    for i in range(3):
        dense = stats.multivariate_normal(
            np.zeros(samples), covariance(i, time, travel[i]), allow_singular=True
        )
        assert got[i] == pytest.approx(dense.logpdf(residual[i]), rel=1e-9)


class Impulses:
    """Replaces a generator: in draw i of n, normal number i is 1 and the others are 0."""

    def standard_normal(self, shape):
        return np.eye(*shape)


@pytest.mark.parametrize("time", [UNIFORM, IRREGULAR], ids=["uniform", "irregular"])
@pytest.mark.parametrize("i", range(3))
def test_draws_are_the_root_of_the_covariance(time, i):
    n = time.size
    values = {name: np.full(n, column[i]) for name, column in VALUES.items()}
    travel = travels(np.random.default_rng(6), time)[i]
    root = STAGED.draw(Impulses(), time, values, np.tile(travel, (n, 1)))
    expected = covariance(i, time, travel)
    np.testing.assert_allclose(root.T @ root, expected, rtol=1e-9, atol=1e-15)


def test_draws_have_the_covariance_of_the_density():
    rng = np.random.default_rng(3)
    time = UNIFORM[:12]
    travel = np.tile(np.linspace(0.0, 0.9, 12), (40_000, 1))
    values = {name: np.full(40_000, column[0]) for name, column in VALUES.items()}
    found = np.cov(STAGED.draw(rng, time, values, travel), rowvar=False)
    expected = covariance(0, time, travel[0])
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.025)


def test_it_needs_the_travel():
    with pytest.raises(FitError, match="travel since the last slip"):
        STAGED.log_density(np.zeros((3, 60)), UNIFORM, VALUES)
    with pytest.raises(FitError, match="travel since the last slip"):
        STAGED.draw(np.random.default_rng(0), UNIFORM, VALUES)


THETA = {
    "sigma0": 50.0,
    "sigma1": 0.02,
    "sigma2": 0.01,
    "Fc_fwd": 1.0,
    "Fc_bwd": 1.0,
    "static_excess_fwd": 0.1,
    "static_excess_bwd": 0.1,
    "k2": 0.5,
    "k3": 20.0,
    "d2": 0.08,
    "d3": 0.06,
    "ell": 0.01,
    "gamma1": 1.0,
    "v_s": 0.5,
}


def motion():
    """Forward by 1 in, back by 0.1 (inside the gap), forward, then back by 1 in."""
    corners = np.array([0.0, 1.0, 0.9, 1.05, 0.05])
    x = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(corners)])
    return Trace.from_arrays(np.arange(x.size) / 50.0, x)


def test_travel_grows_from_each_slip_and_retraces_inside_the_gap():
    trace = motion()
    values = {name: np.array([value]) for name, value in THETA.items()}
    model = ThreeStage()
    travel = model.travel(model.theta(values), trace, np.array([0.5]))[0]
    x = trace.displacement
    np.testing.assert_allclose(travel[:50], 0.5 * 0.14 + x[:50], atol=1e-12)
    np.testing.assert_allclose(travel[51:100], 1.0 - x[51:100], atol=1e-12)
    # forward again: the gap was entered by 0.1 only, and is left on the side it came from
    np.testing.assert_allclose(travel[101:150], 1.0 - x[101:150], atol=1e-12)
    np.testing.assert_allclose(travel[151:], 1.05 - x[151:], atol=1e-12)


def test_a_device_without_a_gap_travels_from_its_turns():
    trace = motion()
    theta = np.tile([50.0, 0.02, 0.01, 1.1, 1.0, 1.1, 1.0, 0.5], (2, 1))
    travel = LuGre().travel(theta, trace)
    assert travel.shape == (2, trace.samples)
    np.testing.assert_allclose(travel[0, 51:100], 1.0 - trace.displacement[51:100], atol=1e-12)


def test_a_posterior_prefers_staged_noise_for_a_record_that_rings():
    rng = np.random.default_rng(5)
    time = np.arange(600) / 50.0
    x = np.sin(np.pi * time)
    blank = Trace.from_arrays(time, x)
    values = {name: np.array([value]) for name, value in THETA.items()} | {
        "start": np.array([0.5]),
        "offset": np.zeros(1),
        "noise_sd": np.array([0.02]),
        "noise_time": np.array([0.05]),
        "noise_build": np.array([0.3]),
        "noise_fade": np.array([0.2]),
        "noise_build_time": np.array([0.02]),
    }
    model = ThreeStage()
    theta = model.theta(values)
    travel = model.travel(theta, blank, 0.5)
    force = model.force(theta, blank, 0.5) + STAGED.draw(rng, time, values, travel)
    trace = Trace.from_arrays(time, x, 0.8, force[0])
    staged, plain = Posterior(trace, "mfd", "staged"), Posterior(trace, "mfd", "ou")
    best = staged.log_likelihood(staged.coordinates(values))[0]
    residual = (force - model.force(theta, blank, 0.5))[0]
    rival = values | {"noise_sd": np.array([residual.std()])}
    assert best > plain.log_likelihood(plain.coordinates(rival))[0] + 100.0


def test_noise_that_never_forgets_is_refused_without_a_warning():
    """Its time is so long that a sample tells the next one to the last digit."""
    time = np.arange(200) / 25.0
    force = np.tanh(4.0 * np.cos(np.pi * time))
    posterior = Posterior(
        Trace.from_arrays(time, np.sin(np.pi * time), 0.5, force), "mfd", "staged"
    )
    q = posterior.coordinates(posterior.draw_prior(np.random.default_rng(0), 5))
    q[:, posterior.names.index("noise_time")] += 37.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        density = posterior.log_likelihood(q)
    assert np.any(np.isneginf(density))
    assert np.all(density < -1e10)
