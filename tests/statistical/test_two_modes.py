"""A density with two modes far apart: shares, and what happens when one mode is not known."""

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.proposal import climb, nearest_modes
from mfd_bayes.calibration.sampling import sample_density

pytestmark = pytest.mark.slow

DIM, APART, MINOR = 5, 9.0, 0.2
EFFORT = Effort(ess=400, limit=3000)


def density(q):
    """0.8 of a unit normal at 0 and 0.2 of one half as wide, 9 sd away in every dimension."""
    main = -0.5 * np.sum(q**2, axis=1) + np.log(1 - MINOR)
    far = (q - APART) / 0.5
    minor = -0.5 * np.sum(far**2, axis=1) - DIM * np.log(0.5) + np.log(MINOR)
    return np.logaddexp(main, minor)


def modes_at(*places):
    return tuple(climb(density, np.full(DIM, place), np.ones(DIM)) for place in places)


@pytest.fixture(scope="module")
def chains():
    return sample_density(density, modes_at(0.3, APART + 0.1), EFFORT, np.random.default_rng(1))


def test_both_modes_get_their_shares(chains):
    assert chains.convergence.reached(EFFORT.r_hat, EFFORT.ess)
    shares = np.mean(chains.q[..., 0] > APART / 2, axis=1)
    assert np.mean(shares) == pytest.approx(MINOR, abs=0.04)
    np.testing.assert_allclose(shares, MINOR, atol=0.1)
    nearest = nearest_modes(modes_at(0.0, APART), chains.q)
    np.testing.assert_allclose(nearest.mean(axis=1), shares, atol=1e-3)


def test_each_mode_has_its_own_width(chains):
    minor = chains.q[..., 0] > APART / 2
    assert np.std(chains.q[minor]) == pytest.approx(0.5, rel=0.1)
    assert np.std(chains.q[~minor]) == pytest.approx(1.0, rel=0.1)


def test_an_ensemble_that_is_stuck_is_seen(chains):
    # one ensemble that never left the main mode, beside three that mix
    from mfd_bayes.calibration.diagnostics import measure_draws

    stuck = chains.q[..., 0].copy()
    home = stuck[0][stuck[0] < APART / 2]
    stuck[0] = np.resize(home, stuck.shape[1])
    assert measure_draws(chains.q[..., 0], chains.walkers).worst_r_hat < EFFORT.r_hat
    assert measure_draws(stuck, chains.walkers).worst_r_hat > EFFORT.r_hat
