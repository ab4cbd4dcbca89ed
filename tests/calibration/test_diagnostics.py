import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import (
    Convergence,
    autocorrelation_time,
    contraction,
    log_if_positive,
    measure,
    measure_draws,
    tempering,
)


def autoregressive(phi, steps=3000, seed=0, shape=(4, 20)):
    """Stationary AR(1) walkers of unit variance, (ensemble, step, walker, 1)."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(steps, *shape))
    walk = np.empty_like(noise)
    walk[0] = noise[0]
    for k in range(1, steps):
        walk[k] = phi * walk[k - 1] + np.sqrt(1 - phi**2) * noise[k]
    return walk.transpose(1, 0, 2)[..., None]


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.97])
def test_autocorrelation_time_of_ar1_is_its_closed_form(phi):
    found = autocorrelation_time(autoregressive(phi))
    assert found.shape == (1,)
    assert found[0] == pytest.approx((1 + phi) / (1 - phi), rel=0.1)


def test_autocorrelation_time_is_taken_coordinate_by_coordinate():
    chains = np.concatenate([autoregressive(0.2), 1e6 + 100 * autoregressive(0.9, seed=1)], axis=-1)
    np.testing.assert_allclose(autocorrelation_time(chains), [1.5, 19.0], rtol=0.1)


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


def test_a_coordinate_that_never_moves_has_no_finite_time():
    assert autocorrelation_time(np.ones((2, 50, 4, 1)))[0] == np.inf


def test_independent_draws_converge():
    chains = np.random.default_rng(5).normal(size=(4, 200, 20, 3))
    found = measure(chains)
    assert found.worst_r_hat < 1.01
    assert found.worst_ess > 0.5 * 4 * 200 * 20
    assert found.reached(1.01, 400)
    assert not found.reached(1.01, 1e6)
    assert not found.reached(found.worst_r_hat - 1e-6, 400)


@pytest.mark.parametrize("shift", [1.5, -3.0])
def test_one_shifted_ensemble_raises_r_hat(shift):
    chains = np.random.default_rng(6).normal(size=(4, 200, 20, 2))
    chains[2, :, :, 1] += shift
    found = measure(chains)
    assert found.r_hat[0] < 1.01
    assert found.r_hat[1] > 1.1
    assert not found.reached(1.01, 1)


def test_a_drift_in_time_raises_r_hat():
    chains = np.random.default_rng(7).normal(size=(4, 200, 20, 1))
    chains += np.linspace(0, 3, 200)[None, :, None, None]
    assert measure(chains).worst_r_hat > 1.1


def test_one_wide_ensemble_raises_r_hat():
    chains = np.random.default_rng(8).normal(size=(4, 200, 20, 1))
    chains[0] *= 5
    assert measure(chains).worst_r_hat > 1.05


def test_effective_size_of_ar1_walkers_is_their_closed_form():
    chains = autoregressive(0.9, steps=1000)
    expected = chains.size * (1 - 0.9) / (1 + 0.9)
    assert measure(chains).ess_bulk[0] == pytest.approx(expected, rel=0.15)


def test_a_handful_of_steps_has_converged_to_nothing():
    found = measure(np.random.default_rng(9).normal(size=(4, 7, 20, 2)))
    assert found.worst_r_hat == np.inf
    assert found.worst_ess == 0


def test_worst_figures_are_over_bulk_and_tail():
    found = Convergence(np.array([1.0, 1.2]), np.array([500.0, 900.0]), np.array([700.0, 300.0]))
    assert (found.worst_r_hat, found.worst_ess) == (1.2, 300.0)


def test_contraction_is_the_share_of_variance_that_the_data_removed():
    draws = np.random.default_rng(10).normal(size=(20000, 3)) * [0.1, 1.0, 2.0]
    np.testing.assert_allclose(contraction(np.ones(3), draws), [0.99, 0.0, -3.0], atol=0.15)


def test_logarithms_are_taken_only_if_every_sample_is_positive():
    ones, mixed = np.array([1.0, np.e]), np.array([-1.0, 1.0])
    np.testing.assert_allclose(log_if_positive(ones, ones)[1], [0, 1])
    assert log_if_positive(ones, mixed)[0] is ones


@pytest.mark.parametrize(
    ("r_hat", "ess", "share"),
    [
        (1.005, 800.0, 1.0),
        (1.005, 100.0, 0.25),
        (1.04, 800.0, 0.25),
        (1.04, 40.0, 0.1),
        (0.9999, 400.0, 1.0),
        (np.inf, 0.0, 0.0),
    ],
)
def test_the_way_to_the_limits_is_as_long_as_its_worst_part(r_hat, ess, share):
    found = Convergence(np.array([1.0, r_hat]), np.array([ess, 900.0]), np.array([900.0, 900.0]))
    assert found.share(1.01, 400.0) == pytest.approx(share)


def test_draws_that_never_move_have_no_r_hat_and_no_warning():
    measured = measure_draws(np.full((2, 40), 0.1064174), walkers=2)
    assert np.isnan(measured.r_hat[0])


def test_weights_that_are_nearly_all_nothing_can_be_tempered():
    log_weights = np.full(100, -np.inf)
    log_weights[:5] = [0.0, -1.0, -2.0, -3.0, -4.0]
    assert 0.0 < tempering(log_weights, 0.5) < 1e-3
