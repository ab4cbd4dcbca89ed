import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import (
    Convergence,
    autocorrelation_time,
    find_directions,
    find_pairs,
    measure,
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


@pytest.mark.parametrize(("share", "reached"), [(1.0, False), (0.25, True)])
def test_a_tail_may_have_a_share_of_what_is_asked_of_the_bulk(share, reached):
    ones, bulk, tail = np.ones(2), np.array([500.0, 450.0]), np.array([480.0, 120.0])
    convergence = Convergence(ones, bulk, tail, np.array([1.0, share]))
    assert convergence.reached(1.01, 400.0) is reached
    assert convergence.worst_ess == min(450.0, 120.0 / share)


def test_a_shifted_ensemble_and_a_drift_in_time_raise_r_hat():
    chains = np.random.default_rng(6).normal(size=(4, 200, 20, 3))
    chains[2, :, :, 1] += 1.5
    chains[:, :, :, 2] += np.linspace(0, 3, 200)[None, :, None]
    convergence = measure(chains)
    assert convergence.r_hat[0] < 1.01
    assert np.all(convergence.r_hat[1:] > 1.1)
    assert not convergence.reached(1.01, 1)


# --- which directions and pairs the data inform

PRIOR_SD = np.array([1.0, 0.5, 2.0])
DESIGN = np.array([[3.0, 1.0, 0.0], [0.5, -2.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
NOISE = 0.4
NAMES = ("a", "b", "c")


def exact_draws(covariance, n=4000, seed=0):
    """Draws (n, dim) whose covariance is exactly the given one."""
    draws = np.random.default_rng(seed).normal(size=(n, len(covariance)))
    draws -= draws.mean(axis=0)
    root = np.linalg.cholesky(np.cov(draws, rowvar=False))
    return np.linalg.solve(root, draws.T).T @ np.linalg.cholesky(covariance).T


def linear_posterior(design=DESIGN):
    """Covariance of a linear model's posterior."""
    precision = np.diag(PRIOR_SD**-2.0) + design.T @ design / NOISE**2
    return np.linalg.inv(precision)


def test_directions_of_a_linear_model_are_those_of_its_curvature():
    curvature = (DESIGN * PRIOR_SD).T @ (DESIGN * PRIOR_SD) / NOISE**2
    values, vectors = np.linalg.eigh(curvature)
    directions = find_directions(NAMES, PRIOR_SD, exact_draws(linear_posterior()))
    np.testing.assert_allclose(directions.curvature, values[::-1], rtol=1e-6, atol=1e-9)
    alignment = np.abs(np.sum(directions.axes * vectors[:, ::-1], axis=0))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-9)
    assert directions.informed == 2
    assert directions.carriers(2) == ("c",)  # which the data do not see


@pytest.mark.parametrize(("draws", "dim"), [(100, 20), (60, 20), (100, 5)])
def test_few_draws_without_information_inform_no_direction(draws, dim):
    rng, names = np.random.default_rng(2), tuple("x" * dim)
    counts = [
        find_directions(names, np.ones(dim), rng.normal(size=(draws, dim))).informed
        for _ in range(200)
    ]
    assert np.mean(counts) < 0.05  # 3 without the limit, of 100 draws in 20 dimensions


def test_draws_that_follow_each_other_count_as_fewer():
    rng = np.random.default_rng(4)
    repeats = np.repeat(rng.normal(size=(100, 20)), 30, axis=0)
    names = tuple("x" * 20)
    assert find_directions(names, np.ones(20), repeats, 100.0).informed == 0
    assert find_directions(names, np.ones(20), repeats).informed > 0  # the control
    assert find_directions(names, np.ones(20), repeats, 15.0).informed == 0  # fewer than dimensions


def test_pairs_that_trade_off_are_named():
    r = -0.85
    normal = exact_draws(np.array([[1.0, r, 0.0], [r, 1.0, 0.0], [0.0, 0.0, 1.0]]), 20000)
    (pair,) = find_pairs(NAMES, np.exp(3 * normal))  # ranks are the same on any scale
    assert (pair.first, pair.second) == ("a", "b")
    assert pair.correlation == pytest.approx(6 / np.pi * np.arcsin(r / 2), abs=0.01)
    # independent parameters do not
    assert find_pairs(NAMES, np.random.default_rng(2).normal(size=(4000, 3))) == ()
    assert find_pairs(("a",), np.random.default_rng(2).normal(size=(4000, 1))) == ()
