import numpy as np
import pytest
from scipy import special, stats

from mfd_bayes.calibration.mixture import (
    ANCHORED,
    Either,
    Mixture,
    Warp,
    Warped,
    learn,
    log_sum_exp,
)

RNG = np.random.default_rng(0)
DIM = 3
FACTORS = RNG.normal(size=(2, DIM, DIM)) + 2 * np.eye(DIM)
COVARIANCES = FACTORS @ FACTORS.transpose(0, 2, 1)
MEANS = np.array([[0.0, 1.0, -2.0], [4.0, 0.0, 3.0]])
MIXTURE = Mixture.of(np.array([0.3, 0.7]), MEANS, COVARIANCES, np.array([5.0, 12.0]))


def test_density_is_that_of_scipy():
    points = RNG.normal(0, 3, size=(50, DIM))
    parts = [
        weight * stats.multivariate_t(mean, covariance, df=dof).pdf(points)
        for weight, mean, covariance, dof in zip(
            MIXTURE.weights, MEANS, COVARIANCES, MIXTURE.dof, strict=True
        )
    ]
    np.testing.assert_allclose(np.exp(MIXTURE.log_density(points)), sum(parts), rtol=1e-10)


@pytest.mark.parametrize("scale", [0.1, 30.0, 2000.0])
def test_the_log_of_a_sum_is_that_of_scipy(scale):
    rng = np.random.default_rng(3)
    terms = scale * rng.normal(size=(5, 400))
    terms[rng.random(terms.shape) < 0.2] = -np.inf
    terms[:, 0] = -np.inf  # a sum of nothing
    terms[:, 1] = 7.0  # all alike
    terms[2, 2:5] = np.nan, np.inf, -np.inf
    for weights in (rng.dirichlet(np.ones(5)), np.array([0.0, 0.2, 0.3, 0.1, 0.4])):
        with np.errstate(over="ignore"):
            known = special.logsumexp(terms, axis=0, b=weights[:, None])
        np.testing.assert_allclose(log_sum_exp(terms, weights), known, rtol=1e-14, atol=1e-15)
    assert log_sum_exp(terms, weights)[0] == -np.inf


def test_draws_have_the_density():
    # the mean of f/q over draws from q is the integral of f, here 1, for any density f
    draws = MIXTURE.draw(np.random.RandomState(1), 20000)
    for scale in (0.3, 1.0):
        f = stats.multivariate_normal(MEANS[1], scale * COVARIANCES[1])
        ratios = f.pdf(draws) / np.exp(MIXTURE.log_density(draws))
        assert np.mean(ratios) == pytest.approx(1.0, abs=4 * np.std(ratios) / np.sqrt(20000))
        # the control: the density of another mixture is detected
        other = Mixture(MIXTURE.weights[::-1], MIXTURE.means, MIXTURE.factors, MIXTURE.dof)
        wrong = f.pdf(draws) / np.exp(other.log_density(draws))
        assert abs(np.mean(wrong) - 1.0) > 6 * np.std(wrong) / np.sqrt(20000)


@pytest.mark.parametrize("parts", [1, 4])
def test_a_learned_mixture_resembles_its_draws(parts):
    draws = np.concatenate(
        [
            stats.multivariate_normal(m, c).rvs(1500, random_state=2)
            for m, c in zip(MEANS, COVARIANCES, strict=True)
        ]
    )
    found = learn(draws, parts, np.random.default_rng(3))
    again = found.draw(np.random.RandomState(4), 20000)
    np.testing.assert_allclose(again.mean(axis=0), draws.mean(axis=0), atol=0.35)
    # a little wider than the draws, never narrower
    ratio = again.std(axis=0) / draws.std(axis=0)
    assert np.all((ratio > 1.0) & (ratio < 1.35))


def test_more_parts_follow_a_bent_density_better():
    rng = np.random.default_rng(5)
    x = rng.normal(size=4000)
    bent = np.stack([x, x**2 + 0.2 * rng.normal(size=4000)], axis=1)
    one, many = (learn(bent, parts, np.random.default_rng(6)) for parts in (1, 6))
    assert np.mean(many.log_density(bent)) > np.mean(one.log_density(bent)) + 0.3


def test_anchors_keep_their_place_in_a_learned_mixture():
    anchors = Mixture.of(np.ones(1), np.full((1, DIM), 50.0), np.eye(DIM)[None], np.array([5.0]))
    draws = RNG.normal(size=(2000, DIM))
    found = learn(draws, 2, np.random.default_rng(7), anchors)
    far = np.mean(found.draw(np.random.RandomState(8), 5000)[:, 0] > 25)
    assert far == pytest.approx(ANCHORED, abs=0.03)


def test_draws_that_hardly_differ_are_fitted_all_the_same():
    draws = np.tile(np.arange(4.0), (300, 1)) + 1e-9 * RNG.normal(size=(300, 4))
    found = learn(draws, 3, np.random.default_rng(9))
    assert np.all(np.isfinite(found.log_density(draws)))


SKEWED = np.exp(RNG.normal(0, [0.3, 0.6, 0.1], size=(4000, DIM)))


def test_warped_coordinates_are_about_normal_and_come_back():
    warp = Warp.of(SKEWED)
    z, slope = warp.normal(SKEWED)
    np.testing.assert_allclose(warp.original(z), SKEWED, rtol=1e-9)
    for column, before in zip(z.T, SKEWED.T, strict=True):
        assert abs(stats.skew(column)) < 0.15 < abs(stats.skew(before))
        assert np.std(column) == pytest.approx(1.0, abs=0.1)
    step = 1e-6
    ahead, _ = warp.normal(SKEWED + step)
    behind, _ = warp.normal(SKEWED - step)
    slopes = np.log((ahead - behind) / (2 * step)).sum(axis=1)
    np.testing.assert_allclose(slope, slopes, atol=1e-5)


def test_density_of_what_is_warped_or_either_integrates_to_one():
    warped = Warped(MIXTURE, Warp.of(SKEWED))
    either = Either(np.array([0.6, 0.4]), (warped, MIXTURE))
    random = np.random.RandomState(11)
    for proposal in (warped, either):
        draws = proposal.draw(random, 20000)
        # a bounded density, well inside: the middle of the draws
        middle, spread = np.median(draws, axis=0), np.quantile(draws, 0.6, axis=0)
        f = stats.multivariate_normal(middle, np.diag((0.5 * (spread - middle)) ** 2))
        ratios = f.pdf(draws) / np.exp(proposal.log_density(draws))
        assert np.mean(ratios) == pytest.approx(1.0, abs=5 * np.std(ratios) / np.sqrt(20000))


def test_a_skewed_density_is_followed_with_one_part():
    fresh = np.exp(np.random.default_rng(12).normal(0, [0.3, 0.6, 0.1], size=(2000, DIM)))
    learned = learn(SKEWED, 1, np.random.default_rng(13)).log_density(fresh).mean()
    normal = stats.multivariate_normal(SKEWED.mean(axis=0), np.cov(SKEWED.T))
    exact = stats.lognorm([0.3, 0.6, 0.1]).logpdf(fresh).sum(axis=1).mean()
    assert learned > normal.logpdf(fresh).mean() + 0.1
    assert learned == pytest.approx(exact, abs=0.15)
