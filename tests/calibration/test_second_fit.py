"""A second fit by importance: right against a closed form, and honest where weights fail."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.calibration import second_fit
from mfd_bayes.calibration.map_fit import Mode
from mfd_bayes.calibration.second_fit import AT_ONCE, BY_WALKERS, fit_again
from mfd_bayes.errors import FitError

DIM = 5
NAMES = tuple("abcde")


class Normal:
    """A posterior that is normal, with the priors' coordinates as its own."""

    names, dim = NAMES, DIM

    def __init__(self, mean, sd, correlation=0.6):
        self.mean = np.full(DIM, float(mean))
        self.covariance = sd**2 * ((1 - correlation) * np.eye(DIM) + correlation)
        plain = SimpleNamespace(coordinate=lambda values: values)
        self.priors = dict.fromkeys(NAMES, plain)

    def log_prob(self, q, _=-np.inf):
        away = q - self.mean
        return -0.5 * np.einsum("ni,ij,nj->n", away, np.linalg.inv(self.covariance), away)

    def draw_prior(self, rng, n):
        return dict(zip(NAMES, 3.0 * rng.normal(size=(DIM, n)), strict=True))

    def coordinates(self, values):
        return np.stack([values[name] for name in NAMES], axis=1)

    def to_own(self, q):
        return q.copy()

    def from_own(self, own):
        return own.copy()


def named(points, names=NAMES):
    return dict(zip(names, np.atleast_2d(points).T, strict=False))


def first_draws(seed=0, n=4000):
    """Draws of a first fit: a normal about 0 with standard deviation 1."""
    return np.random.default_rng(seed).normal(size=(n, DIM))


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 1.0), (3.0, 0.2), (-8.0, 0.5)])
def test_medians_and_intervals_are_those_of_the_second_posterior(mean, sd):
    found = fit_again(Normal(mean, sd), named(first_draws()), np.random.default_rng(1))
    assert found.k <= second_fit.LARGEST_K
    assert found.weights.sum() == pytest.approx(1.0)
    for column in found.q.T:
        low, middle, high = np.quantile(
            column, [0.025, 0.5, 0.975], weights=found.weights, method="inverted_cdf"
        )
        assert middle == pytest.approx(mean, abs=0.25 * sd)
        assert high - low == pytest.approx(3.92 * sd, rel=0.2)


def test_draws_of_the_same_posterior_need_no_new_proposal():
    first = Normal(0.0, 1.0)
    draws = np.random.default_rng(0).multivariate_normal(first.mean, first.covariance, 4000)
    found = fit_again(first, named(draws), np.random.default_rng(1))
    assert found.how == AT_ONCE


def test_what_the_first_fit_does_not_have_is_found():
    known = {name: column for name, column in named(first_draws()).items() if name < "d"}
    found = fit_again(Normal(2.0, 0.3), known, np.random.default_rng(1))
    assert found.q[:, 4] @ found.weights == pytest.approx(2.0, abs=0.1)


def test_the_same_seed_gives_the_same_bits():
    def fit(seed):
        rng = np.random.default_rng(seed)
        return fit_again(Normal(1.0, 0.5), named(first_draws()), rng)

    assert np.array_equal(fit(3).q, fit(3).q)
    assert not np.array_equal(fit(3).q, fit(4).q)


@pytest.fixture
def weights_fail(monkeypatch):
    """Fits whose weights are never trusted; a search of modes finds those of the list."""
    modes = []
    monkeypatch.setattr(second_fit, "LARGEST_K", -np.inf)
    monkeypatch.setattr(second_fit, "ROUNDS", 1)
    monkeypatch.setattr(second_fit, "find_modes", lambda posterior, rng, starts: tuple(modes))
    return modes


@pytest.mark.parametrize("searched", [True, False])
def test_walkers_start_at_better_modes_than_those_near_the_first_fit(weights_fail, searched):
    near, far = Normal(0.0, 0.2), Normal(-6.0, 0.2)

    class Both(Normal):
        def log_prob(self, q, _=-np.inf):
            return np.logaddexp(near.log_prob(q) - 12.0, far.log_prob(q))

    if searched:
        weights_fail.append(Mode(far.mean, 0.0, far.covariance))
    found = fit_again(Both(0, 1), named(0.2 * first_draws()), np.random.default_rng(1))
    assert np.median(found.q[:, 0]) == pytest.approx(-6.0 if searched else 0.0, abs=0.2)


def test_walkers_are_sent_where_the_weights_fail(weights_fail):
    rng = np.random.default_rng(1)
    found = fit_again(Normal(3.0, 0.2), named(first_draws()), rng)
    assert found.how == BY_WALKERS
    assert found.size >= second_fit.WALK.ess
    assert np.median(found.q, axis=0) == pytest.approx(np.full(DIM, 3.0), abs=0.06)


def test_no_density_at_any_start_is_said():
    class Nothing(Normal):
        def log_prob(self, q, _=-np.inf):
            return np.full(len(q), -np.inf)

    rng = np.random.default_rng(1)
    with pytest.raises(FitError, match="no density around the first fit"):
        fit_again(Nothing(0, 1), named(first_draws()), rng)
