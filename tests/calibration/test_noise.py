"""Noises: densities beside those of their processes, and draws with the density's moments."""

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.noises import NOISES, find_noise
from mfd_bayes.errors import FitError

UNIFORM = np.arange(40) / 64.0
IRREGULAR = np.sort(np.random.default_rng(0).uniform(0, 1.0, 40))
TIMES = pytest.mark.parametrize("time", [UNIFORM, IRREGULAR], ids=["uniform", "irregular"])
VALUES = {
    "noise_sd": np.array([0.1, 0.3, 2.0]),
    "noise_time": np.array([0.005, 0.05, 3.0]),
    "noise_dof": np.array([1.5, 4.0, 60.0]),
    "noise_build": np.array([0.3, 0.2, 0.06]),
    "noise_fade": np.array([0.1, 0.3, 0.5]),
    "noise_build_time": np.array([0.01, 0.1, 2.0]),
    "d2": np.array([0.2, 0.1, 0.3]),
    "d3": np.array([0.1, 0.2, 0.05]),
}


def travel_of(time, seed=1):
    return np.random.default_rng(seed).uniform(-0.2, 1.5, (3, time.size))


def covariance(name, i, time, travel):
    """Dense covariance of one vector's noise, by its definition."""
    v = {key: column[i] for key, column in VALUES.items()}
    h = np.zeros(time.size)
    if name == "staged":
        rise = np.clip((travel - v["d2"]) / v["d3"], 0.0, 1.0)
        h = rise * np.exp(-np.maximum(travel - v["d2"] - v["d3"], 0.0) / v["noise_fade"])
    slow, fast = 1.0 / v["noise_time"], 1.0 / v["noise_build_time"]
    passed = np.cumsum(np.append(0.0, np.diff(time) * (slow + (fast - slow) * h[1:])))
    sd = v["noise_sd"] + v["noise_build"] * h
    if name == "iid":
        return np.diag(sd**2)
    return np.exp(-np.abs(passed[:, None] - passed)) * np.outer(sd, sd)


@TIMES
@pytest.mark.parametrize("name", ["iid", "ou", "staged"])
@pytest.mark.parametrize("samples", [2, 40])
def test_the_density_is_that_of_its_gaussian_process(name, time, samples):
    time = time[:samples]
    travel, residual = travel_of(time), np.random.default_rng(2).normal(size=(3, samples))
    density = NOISES[name].log_density(residual, time, VALUES, travel)
    for i in range(3):
        matrix = covariance(name, i, time, travel[i])
        dense = stats.multivariate_normal(np.zeros(samples), matrix, allow_singular=True)
        assert density[i] == pytest.approx(dense.logpdf(residual[i]), rel=1e-9)


@TIMES
def test_student_t_is_autoregressive_with_t_innovations(time):
    residual = np.random.default_rng(1).normal(size=(3, time.size))
    density = NOISES["student_t"].log_density(residual, time, VALUES)
    for i in range(3):
        sd, tau, dof = (VALUES[key][i] for key in ("noise_sd", "noise_time", "noise_dof"))
        phi = np.exp(-np.diff(time) / tau)
        scale = np.append(sd, sd * np.sqrt(1 - phi**2))
        centre = np.append(0.0, phi * residual[i, :-1])
        expected = stats.t(dof, loc=centre, scale=scale).logpdf(residual[i]).sum()
        assert density[i] == pytest.approx(expected, rel=1e-9)


@TIMES
@pytest.mark.parametrize("name", ["iid", "ou", "staged"])
def test_draws_have_the_covariance_of_their_density(name, time):
    time, n = time[:12], 40_000
    travel = np.linspace(0.0, 0.9, 12)
    values = {key: np.full(n, column[1]) for key, column in VALUES.items()}
    draws = NOISES[name].draw(np.random.default_rng(3), time, values, np.tile(travel, (n, 1)))
    expected = covariance(name, 1, time, travel)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    error = np.abs(np.cov(draws, rowvar=False) - expected) / scale
    assert np.max(error) < 0.03
    wider = np.abs(np.cov(1.03 * draws, rowvar=False) - expected) / scale  # the control
    assert np.max(wider) > 0.03


def test_draws_of_student_t_noise_have_its_innovations():
    time = np.arange(4000) / 64.0
    columns = {"noise_sd": 0.2, "noise_time": 0.05, "noise_dof": 6.0}
    values = {key: np.full(25, value) for key, value in columns.items()}
    noise = NOISES["student_t"].draw(np.random.default_rng(2), time, values)
    phi = np.exp(-1 / 64 / 0.05)
    white = (noise[:, 1:] - phi * noise[:, :-1])[:, ::5].ravel() / (0.2 * np.sqrt(1 - phi**2))
    assert stats.kstest(white, stats.t(6.0).cdf).pvalue > 0.001
    assert stats.kstest(white, stats.norm(0, np.sqrt(1.5)).cdf).pvalue < 0.001
    assert stats.kstest(white * 1.1, stats.t(6.0).cdf).pvalue < 0.001


def test_a_noise_that_is_none_is_refused():
    for name in ("pink", ["ou"], None):
        with pytest.raises(FitError, match="ou, iid, student_t"):
            find_noise(name)
