"""The exact sampler against closed forms and quadrature."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special

from mfd_bayes.calibration.proposal import Proposal
from mfd_bayes.population.design import TestConditions, design_of
from mfd_bayes.population.exact_sampler import ExactSampler
from mfd_bayes.population.joint_fit import JointFit
from mfd_bayes.population.mixed_model import Coefficients, MixedModel

CHAINS = 32
SWEEPS = 600


class Campaign:
    """Tests of one slip force at one level, known by any likelihoods and by Gaussian ones."""

    def __init__(self, priors, mean, sd, functions=None):
        laid = design_of(priors, ("Fc_fwd",), [TestConditions(1.0)] * len(mean))
        self.design = replace(laid, common=np.zeros(1, dtype=bool))
        self.mean, self.precision = mean[:, None], sd[:, None, None] ** -2.0
        self.functions = functions or self.gaussians()
        self.mixed = MixedModel(self.design, self.mean, self.precision)
        self.choice = np.zeros((CHAINS, 1), dtype=np.intp)
        self.h = np.linspace(-7.0, 1.5, 200)[:, None] + np.log(self.mixed.scale)

    def gaussians(self):
        pairs = zip(self.mean[:, 0], self.precision[:, 0, 0], strict=True)
        return [lambda x, m=m, p=p: -0.5 * p * (x - m) ** 2 for m, p in pairs]

    def sampler(self, seed=0, evaluated=None):
        """The sampler; what is evaluated may be other functions than the exact ones."""
        rng = np.random.default_rng(seed)
        functions = evaluated or self.functions
        tests = [SimpleNamespace(log_likelihood=lambda x, f=f: f(x[:, 0])) for f in functions]
        fit = JointFit(tests, self.mean, self.precision, *3 * (None,))
        flags = np.zeros(self.mean.shape, dtype=bool)
        return ExactSampler(fit, self.approximate, flags, self.choice, rng)

    def approximate(self, fit):
        """Mixed model of Gaussian likelihoods, and a Student t near the posterior of h."""
        mixed = MixedModel(self.design, fit.mean, fit.precision)
        density, _, _ = mixed.importance_sample(self.choice[0], np.random.default_rng(2))
        return mixed, density

    def integrals(self):
        """Levels (L,), and moments 0 to 2 of the tests' coordinates at each, (H, L, 3, J).

        The likelihoods are integrated over the deviations of each scatter, (H,), and level.
        """
        x, level = np.linspace(-3.0, 3.0, 1501), np.linspace(-2.5, 2.5, 161)
        likelihoods = np.exp([f(x) for f in self.functions])
        moments = []
        for t in self.mixed.tau(self.h)[:, 0]:
            fine = max(t, 0.004)  # as narrow as the grid of x can hold
            normal = np.exp(-0.5 * ((x - level[:, None]) / fine) ** 2) / fine
            moments.append(
                np.stack([normal @ (likelihoods * x**k).T + 1e-300 for k in (0, 1, 2)], axis=1)
            )
        return level, np.array(moments)

    def likelihood_of_level(self):
        """Levels, and their log likelihood without prior, scatter and coordinates integrated."""
        level, moments = self.integrals()
        log = np.log(moments[:, :, 0]).sum(axis=2) + self.mixed.log_prior(self.h)
        return level, special.logsumexp(log, axis=0)

    def truth(self):
        """Means and sds of log scatter, level and coordinates by quadrature."""
        level, moments = self.integrals()
        log = np.log(moments[:, :, 0]).sum(axis=2) + self.mixed.log_prior(self.h)
        weight = special.softmax(log - 0.5 * level**2)
        flat, ratios = np.ones(weight.shape), moments[:, :, 1:] / moments[:, :, :1]
        pairs = [(v, v**2) for v in (self.h[:, [0]] * flat, level * flat)]
        pairs += [(ratios[..., 0, j], ratios[..., 1, j]) for j in range(len(self.mean))]
        means = np.array([np.sum(weight * v) for v, _ in pairs])
        squares = np.array([np.sum(weight * v) for _, v in pairs])
        return np.stack([means, np.sqrt(squares - means**2)], axis=1)


def moments_of(sampler, sweeps=SWEEPS):
    """Means and standard deviations by chain, (chain, 2 + J) each, after a warm-up."""
    draws = sampler.run(0.0, np.inf, sweeps, 10**9, lambda *_: None)
    blocks = draws.h, draws.z[..., :1], draws.x[..., 0]
    flat = np.concatenate([block.reshape(CHAINS, -1, block.shape[-1]) for block in blocks], axis=2)
    return flat.mean(axis=1), flat.std(axis=1)


def errors(by_chain, expected):
    """Differences of means over chains from what is expected, in standard errors."""
    se = by_chain.std(axis=0, ddof=1) / np.sqrt(len(by_chain))
    return (by_chain.mean(axis=0) - expected) / se


Y, SD = np.array([0.3, -0.1, 0.5]), np.array([0.05, 0.08, 0.06])


@pytest.mark.parametrize("seed", [0, 1])
def test_with_gaussian_likelihoods_draws_are_exact(priors, seed):
    campaign = Campaign(priors, Y, SD)
    sampler = campaign.sampler(seed)
    means, sds = moments_of(sampler, 1200)
    assert np.all(np.array(sampler.accepted) == 1.0)
    # the level given h in closed form, on a grid of the one h; the rest by quadrature
    h, mixed = campaign.h, campaign.mixed
    log, gaussian = mixed.marginal(h, campaign.choice[0])
    expected = campaign.truth()
    level = special.softmax(mixed.log_prior(h).sum(axis=1) + log) @ gaussian.mean[:, 0]
    assert expected[1, 0] == pytest.approx(level, abs=0.01)
    assert np.abs(errors(means, expected[:, 0])).max() < 4.0
    squares = sds**2 + (means - expected[:, 0]) ** 2
    assert np.abs(errors(squares, expected[:, 1] ** 2)).max() < 4.0
    control = Campaign(priors, Y + 0.1, SD).truth()[1:, 0]
    assert np.abs(errors(means[:, 1:], control)).min() > 8.0


def test_h_that_is_not_weighed_would_be_seen(priors, monkeypatch):
    campaign = Campaign(priors, Y, SD)
    monkeypatch.setattr(ExactSampler, "_log_weight", lambda self, g: np.zeros(len(g)))
    means, _ = moments_of(campaign.sampler())
    assert np.abs(errors(means, campaign.truth()[:, 0])).max() > 8.0


@pytest.fixture(scope="module")
def skewed(priors):
    """Likelihoods of the shape k (u - exp u), whose Gaussians at the mode are far from them.

    With smaller k the tails are so long that chains of this length seldom see them.
    """
    shapes = (12.0, 8.0, 16.0)
    functions = [
        lambda x, y=y, s=6.0 * s, k=k: k * ((x - y) / s - np.exp((x - y) / s))
        for y, s, k in zip(Y, SD, shapes, strict=True)
    ]
    return Campaign(priors, Y, 6.0 * SD / np.sqrt(shapes), functions)


def test_with_other_likelihoods_draws_are_those_of_quadrature(skewed):
    expected = skewed.truth()
    sampler = skewed.sampler(seed=1)
    means, sds = moments_of(sampler, 2400)
    assert 0.1 < np.mean(sampler.accepted_together) < 0.999
    assert np.abs(errors(means, expected[:, 0])).max() < 4.0
    squares = sds**2 + (means - expected[:, 0]) ** 2
    assert np.abs(errors(squares, expected[:, 1] ** 2)).max() < 4.0


def test_accepting_every_move_would_be_seen(skewed):
    expected, gaussians = skewed.truth(), skewed.gaussians()
    means, _ = moments_of(skewed.sampler(seed=1, evaluated=gaussians))
    assert np.abs(errors(means, expected[:, 0])).max() > 8.0


SLOPE = 2.0  # of the common quantity in what the tests see


@pytest.fixture(scope="module")
def common(skewed, priors):
    """The same tests, which see the free quantity plus SLOPE times one that all of them share.

    One test sees the shared one too, with a likelihood of two peaks.
    """
    laid = design_of(priors, ("Fc_fwd", "v_s"), [TestConditions(1.0)] * len(Y))
    design = replace(laid, common=np.array([False, True]))
    direction = np.array([1.0, SLOPE])
    precision = skewed.precision * np.outer(direction, direction)
    precision[0, 1, 1] += 10.0
    mean = np.column_stack([skewed.mean[:, 0], np.zeros(len(Y))])
    functions = [lambda x, f=f: f(x @ direction) for f in skewed.functions]
    functions[0] = lambda x, f=functions[0]: f(x) + two_peaks(x[:, 1])
    return SimpleNamespace(design=design, mean=mean, precision=precision, functions=functions)


def two_peaks(level):
    return np.logaddexp(-50.0 * (level + 0.4) ** 2, np.log(0.5) - 50.0 * (level - 0.4) ** 2)


def common_draws(common, sweeps):
    """Means and mean squares of the two levels by chain, (chain, 2) each."""
    choice = np.zeros((CHAINS, len(common.design.laws)), dtype=np.intp)

    def approximate(fit):
        mixed = MixedModel(common.design, fit.mean, fit.precision)
        density, _, _ = mixed.importance_sample(choice[0], np.random.default_rng(2))
        return mixed, density

    tests = [SimpleNamespace(log_likelihood=f) for f in common.functions]
    fit = JointFit(tests, common.mean, common.precision, *3 * (None,))
    flags = np.zeros(common.mean.shape, dtype=bool)
    sampler = ExactSampler(fit, approximate, flags, choice, np.random.default_rng(0))
    draws = sampler.run(0.0, np.inf, sweeps, 10**9, lambda *_: None)
    levels = draws.z[..., :2].reshape(CHAINS, -1, 2)
    return levels.mean(axis=1), (levels**2).mean(axis=1)


def common_truth(skewed):
    """The same by quadrature, with the likelihood of their sum from the tests without it."""
    grid, (seen, likelihood) = np.linspace(-2.5, 2.5, 801), skewed.likelihood_of_level()
    level, shared = grid[:, None], grid[None]
    log = np.interp(level + SLOPE * shared, seen, likelihood, left=-1e9, right=-1e9)
    weight = special.softmax(log + two_peaks(shared) - 0.5 * level**2 - 0.5 * shared**2)
    pairs = [np.array([np.sum(weight * level**k), np.sum(weight * shared**k)]) for k in (1, 2)]
    return pairs[0], pairs[1]


def test_what_all_tests_share_has_the_draws_of_quadrature(common, skewed):
    means, squares = common_draws(common, 800)
    expected_means, expected_squares = common_truth(skewed)
    assert np.abs(errors(means, expected_means)).max() < 4.0
    assert np.abs(errors(squares, expected_squares)).max() < 4.0


@pytest.mark.parametrize("term", ["mixture", "shift"])
def test_common_moves_without_a_term_would_be_seen(common, skewed, monkeypatch, term):
    """The mixture's density, or the Gaussian of what is shifted, left out of the ratio."""
    if term == "mixture":
        monkeypatch.setattr(Proposal, "log_density", lambda self, q: np.zeros(len(q)))
    else:
        monkeypatch.setattr(Coefficients, "log_density", lambda self, z: np.zeros(len(z)))
    means, squares = common_draws(common, 600)
    expected_means, expected_squares = common_truth(skewed)
    off = [errors(means, expected_means), errors(squares, expected_squares)]
    assert np.abs(off).max() > 8.0
