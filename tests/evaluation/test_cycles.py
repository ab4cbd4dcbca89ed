"""The density of a cycle given all others, against a dense normal distribution."""

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.cycles import (
    FEWEST_CYCLES,
    conditional_density,
    cycle_log_likelihood,
    find_cycles,
)
from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.records.trace import Trace

FILE = load_priors("brfd")
TIMES = {
    "uniform": np.arange(24) / 64,
    "irregular": np.sort(np.random.default_rng(0).uniform(0, 0.4, 24)),
}
STARTS = np.array([0, 5, 6, 17])
VALUES = {
    "noise_sd": np.array([0.2, 0.3]),
    "noise_time": np.array([0.05, 0.02]),
    "noise_build": np.array([2.0, 0.5]),
    "noise_fade": np.array([0.3, 0.1]),
    "noise_build_time": np.array([0.01, 0.1]),
    "d2": np.array([0.1, 0.2]),
    "d3": np.array([0.1, 0.05]),
}


def noise_of(name, time):
    rng = np.random.default_rng(1)
    travel = np.abs(rng.normal(0.2, 0.2, (2, time.size)))
    return rng.normal(0, 0.3, (2, time.size)), travel, NOISES[name].memory(time, VALUES, travel)


def dense(decay, scale):
    """Covariance of the noise: the product of all φ between two samples, (T, T)."""
    cumulative = np.cumsum(np.where(np.isinf(decay), 1e3, decay))
    return np.exp(-np.abs(cumulative[:, None] - cumulative)) * np.outer(scale, scale)


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("name", ["ou", "iid", "staged"])
def test_density_of_a_left_out_block_is_that_of_a_dense_normal(name, times):
    time = TIMES[times]
    residual, travel, (decay, scale) = noise_of(name, time)
    conditional, joint = conditional_density(residual, decay, scale, STARTS)
    assert conditional.shape == (2, 4)
    for row in range(2):
        covariance = dense(decay[row], scale[row])
        total = stats.multivariate_normal(cov=covariance).logpdf(residual[row])
        assert joint[row] == pytest.approx(total, rel=1e-9)
        for block, (begin, end) in enumerate(zip(STARTS, [*STARTS[1:], time.size], strict=True)):
            indices = np.r_[0:begin, end : time.size]
            marginal = stats.multivariate_normal(cov=covariance[np.ix_(indices, indices)])
            expected = total - marginal.logpdf(residual[row, indices])
            assert conditional[row, block] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    # the noise model's own density is the same, and the gap matters where the noise is correlated
    log_density = NOISES[name].log_density(residual, time, VALUES, travel)
    np.testing.assert_allclose(joint, log_density, rtol=1e-9)
    independent = np.add.reduceat(stats.norm.logpdf(residual, scale=scale), STARTS, axis=1)
    assert (np.abs(conditional - independent).max() > 0.1) == (name != "iid")


# --- cycles


def harmonic(hertz=1.0, seconds=6.0, rate=64):
    time = np.arange(0, seconds, 1 / rate)
    motion = np.sin(2 * np.pi * hertz * time)
    return Trace.from_arrays(time, motion, 0.03, 2 * np.tanh(9 * np.cos(2 * np.pi * hertz * time)))


def test_cycles_of_a_harmonic_record_are_its_periods():
    trace = harmonic()
    cycles = find_cycles(trace)
    assert (cycles[0], cycles[-1], len(cycles) - 1) == (0, trace.samples, 6)
    assert set(cycles[1:-1]) <= set(trace.turning_points)
    np.testing.assert_allclose(np.diff(trace.time[cycles[1:-1]]), 1.0, atol=0.02)
    assert find_cycles(trace, start=100)[0] == 100
    # what is left at the end is joined to the last cycle: a quarter of a period after a turn
    assert np.diff(find_cycles(harmonic(seconds=4.0))).min() >= 0.5 * 64
    with pytest.raises(FitError, match=rf"at least {FEWEST_CYCLES} cycles, got 2"):
        find_cycles(harmonic(seconds=2.2))


@pytest.mark.parametrize(
    ("model", "noise", "initial"),
    [("three_stage", "staged", "sample"), ("backlash", "student_t", "discard")],
)
def test_cycles_have_the_posteriors_own_likelihood(model, noise, initial):
    posterior = Posterior(harmonic(), FILE, noise, model, initial=initial)
    q = posterior.coordinates(posterior.sample_prior(7, 0))
    cycles = find_cycles(posterior.trace, posterior.first)
    conditional, joint = cycle_log_likelihood(posterior, posterior.values(q), cycles)
    assert conditional.shape == (7, len(cycles) - 1)
    np.testing.assert_allclose(joint, posterior.log_likelihood(q), rtol=1e-8)
