import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import autocorrelation_time, measure


def autoregressive(phi, steps=3000, seed=0, shape=(4, 20)):
    """Stationary AR(1) walkers of unit variance, (ensemble, step, walker, 1)."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(steps, *shape))
    walk = np.empty_like(noise)
    walk[0] = noise[0]
    for k in range(1, steps):
        walk[k] = phi * walk[k - 1] + np.sqrt(1 - phi**2) * noise[k]
    return walk.transpose(1, 0, 2)[..., None]


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_autocorrelation_time_and_effective_size_of_ar1_are_their_closed_forms(phi):
    chains = autoregressive(phi)  # of which either has an error of 4 %
    time = (1 + phi) / (1 - phi)
    assert autocorrelation_time(chains) == pytest.approx([time], rel=0.16)
    assert measure(chains).ess_bulk[0] == pytest.approx(chains.size / time, rel=0.16)


def test_stuck_walkers_have_a_long_autocorrelation_time():
    steps = 400
    places = np.random.default_rng(2).normal(size=(4, 1, 20, 1))
    stuck = np.broadcast_to(places, (4, steps, 20, 1))
    assert autocorrelation_time(stuck)[0] >= steps
    # nearly stuck: each walker moves only about a point of its own
    jitter = places + 0.1 * np.random.default_rng(3).normal(size=(4, steps, 20, 1))
    assert autocorrelation_time(jitter)[0] >= steps / 5
    # the control: the same places visited in a random order by every walker
    order = np.random.default_rng(4).normal(size=(4, steps, 20, 1))
    assert autocorrelation_time(order)[0] < 2


def test_independent_draws_converge():
    chains = np.random.default_rng(5).normal(size=(4, 200, 20, 3))
    found = measure(chains)
    assert found.worst_r_hat < 1.01
    assert found.worst_ess > 0.5 * 4 * 200 * 20
    assert found.reached(1.01, 400)
    assert not found.reached(1.01, 1e6)
    assert not found.reached(found.worst_r_hat - 1e-6, 400)


def test_a_shifted_ensemble_and_a_drift_in_time_raise_r_hat():
    chains = np.random.default_rng(6).normal(size=(4, 200, 20, 3))
    chains[2, :, :, 1] += 1.5
    chains[:, :, :, 2] += np.linspace(0, 3, 200)[None, :, None]
    found = measure(chains)
    assert found.r_hat[0] < 1.01
    assert np.all(found.r_hat[1:] > 1.1)
    assert not found.reached(1.01, 1)
