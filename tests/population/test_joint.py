"""Every move of a sweep leaves a linear-Gaussian joint posterior invariant; broken ones do not."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import kstest, norm

from mfd_bayes.population.chains import Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.moves import one_test
from mfd_bayes.population.moves.hyperparameters import draw_latent, evolve_hyperparameters
from mfd_bayes.population.moves.lines import Lines, transport
from mfd_bayes.population.moves.redraw import Profile, redraw
from mfd_bayes.population.sweep import Sampler
from mfd_bayes.population.test_likelihood import TestLikelihood

CHAINS = 4096
LEVELS = (0.5, 0.5, 0.9, 1.6)
FAR = 5.0
"""Standard errors; some 20 moments are looked at in each test."""


class Case:
    """Exact draws of a campaign's joint posterior, which every move must leave invariant."""

    def __init__(self, linear, seed=3):
        rng = np.random.default_rng(seed)
        self.linear, self.exact = linear, linear.solve(rng, CHAINS)
        self.tests, self.rng = linear.likelihoods(rng), rng

    def chains(self) -> Chains:
        """Chains at the exact draws."""
        layout, exact = self.linear.layout, self.exact
        cells = sum(len(e.cells) for e in layout.effects)
        d = len(layout.names)
        latent = np.zeros((CHAINS, 1 + cells, d))
        latent[:, 0] = exact.u[:, :d]
        sds = d + len(layout.effects)
        h = np.zeros((CHAINS, layout.dim))
        h[:, :sds] = exact.h
        for i, _ in enumerate(layout.effects):
            sd = np.exp(exact.h[:, d + i, None]) / layout.spread[0]
            latent[:, 1:, 0] = sd * exact.u[:, d : d + cells]
        if layout.laws:
            h[:, -1] = 1.0 + 0.5 * exact.u[:, -1]
        x = [exact.x[:, j].copy() for j in range(len(self.tests))]
        likelihoods = [t.log_likelihood(v) for t, v in zip(self.tests, x, strict=True)]
        ensemble = np.repeat(np.arange(4), CHAINS // 4)
        return Chains(h, latent, x, likelihoods, layout.draw_choice(CHAINS), ensemble)


@pytest.fixture(scope="module")
def case(make_linear):
    """Friction at three levels: scatter, an effect of the level, a power law."""
    return Case(make_linear(LEVELS, ("Fc_fwd",), seed=2))


@pytest.fixture(scope="module")
def pair(make_linear):
    """Two quantities with correlated likelihoods, without effects."""
    return Case(make_linear((0.5, 0.5, 0.9, 0.9), ("Fc_fwd", "offset"), seed=3))


@pytest.fixture(scope="module")
def vague(make_linear):
    """Friction about which each test says less than its prior, far from the prior's median."""
    return Case(make_linear((0.5, 0.5, 0.9, 0.9), ("Fc_fwd",), level=2.5, noise=6.0, seed=3))


def features(chains: Chains) -> np.ndarray:
    """Features whose means must not change, (n, features): all values, and some products."""
    x = np.concatenate(chains.x, axis=1)
    first = np.concatenate([chains.h, chains.latent.reshape(len(x), -1), x], axis=1)
    first = first[:, first.std(axis=0) > 0]
    centred = first - first.mean(axis=0)
    return np.concatenate([first, centred**2, centred[:, :1] * centred[:, 1:]], axis=1)


def sampler_of(case: Case, tests=None, layout=None) -> Sampler:
    joint = Joint(layout or case.linear.layout, tests or case.tests)
    return Sampler(joint, np.random.default_rng(4))


def shift(case: Case, move, times: int = 30, sampler: Sampler | None = None) -> float:
    """Largest change of a moment by a move, in standard errors."""
    chains = case.chains()
    before = features(chains)
    sampler = sampler or sampler_of(case)
    for _ in range(times):
        move(sampler, chains)
    after = features(chains)
    assert np.any(after != before)
    # an upper bound: the draws before and after are taken as independent
    error = np.sqrt((before.var(axis=0) + after.var(axis=0)) / CHAINS)
    return float(np.max(np.abs(after.mean(axis=0) - before.mean(axis=0)) / error))


def of_one_test(move):
    """Update of all tests' coordinates by one kind of proposal."""

    def kernel(sampler: Sampler, chains: Chains) -> None:
        given = sampler.joint.conditional(chains)
        sampler._note(move(sampler.joint, chains, sampler.rng, given))

    return kernel


def latent(sampler: Sampler, chains: Chains) -> None:
    """Update of levels and effects."""
    draw_latent(sampler.joint, chains, sampler.rng)


def hyper(sampler: Sampler, chains: Chains) -> None:
    """Update of scatter and shapes with levels integrated out, then of the levels."""
    evolve_hyperparameters(sampler.joint, chains, sampler.rng)
    latent(sampler, chains)


def together(move, sampler: Sampler, chains: Chains, k: int = 0):
    """One move of a quantity's scatter and level with its tests; returns its acceptance."""
    return move(sampler.joint, chains, sampler.rng, sampler.tuning, k)[0][1]


def along_lines(move):
    """Update of each quantity's scatter and level in turn, with the tests' values of it."""

    def kernel(sampler: Sampler, chains: Chains) -> None:
        for k in range(sampler.joint.d):
            assert np.any(together(move, sampler, chains, k))

    return kernel


MOVES = {
    "hyper": hyper,
    "latent": latent,
    "stored": of_one_test(one_test.choose_stored),
    "near": of_one_test(one_test.step_near),
    "evolution": of_one_test(one_test.evolve_tests),
    "transport": along_lines(transport),
    "redraw": along_lines(redraw),
    "together": lambda sampler, chains: sampler.move_together(chains),
    "sweep": lambda sampler, chains: sampler.sweep(chains),
}


FULL = {"redraw": 10, "together": 10, "sweep": 10}
"""Times of those kernels that move everything far at once."""


@pytest.mark.parametrize("name", MOVES)
def test_a_move_leaves_the_posterior_as_it_is(case, name):
    assert shift(case, MOVES[name], FULL.get(name, 30)) < FAR


@pytest.mark.parametrize("name", ["hyper", "stored", "near", "transport", "redraw", "sweep"])
def test_a_move_keeps_quantities_that_are_known_together(pair, name):
    assert shift(pair, MOVES[name], FULL.get(name, 20)) < FAR


@pytest.mark.parametrize("name", ["stored", "near", "transport", "redraw", "sweep"])
def test_a_move_keeps_tests_that_tell_little(vague, name):
    assert shift(vague, MOVES[name], FULL.get(name, 20)) < FAR


def broken_prior(case: Case) -> Sampler:
    """Prior with the Jacobian of log sds counted three times."""

    class Wrong(Layout):
        def log_prior(self, h):
            density = super().log_prior(h)
            for i in range(len(self.sd_scale)):
                density[:, self.block[i]] += 2.0 * h[:, i]
            return density

    layout = object.__new__(Wrong)
    vars(layout).update(vars(case.linear.layout))
    return sampler_of(case, layout=layout)


def broken_weights(case: Case) -> Sampler:
    """Stored draws that are not weighted by the interim prior."""
    tests = [replace(t, draws_log_prior=np.zeros(len(t.draws))) for t in case.tests]
    tests = [replace(t, log_interim_prior=lambda x: np.zeros(len(x))) for t in tests]
    return sampler_of(case, tests)


def broken_scatter(case: Case) -> Sampler:
    """Scatter that is half of its true value."""

    class Wrong(Layout):
        def scatter(self, h):
            return 0.5 * super().scatter(h)

    layout = object.__new__(Wrong)
    vars(layout).update(vars(case.linear.layout))
    return sampler_of(case, layout=layout)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("hyper", broken_prior),
        ("hyper", broken_scatter),
        ("latent", broken_scatter),
        ("transport", broken_prior),
        ("redraw", broken_prior),
    ],
)
def test_a_broken_move_does_not(case, name, wrong):
    assert shift(case, MOVES[name], 2 * FULL.get(name, 50), sampler=wrong(case)) > 1.5 * FAR


def test_proposals_near_a_gaussian_whose_density_is_forgotten_do_not(case, monkeypatch):
    square = one_test.GaussianConditional.square
    monkeypatch.setattr(
        one_test.GaussianConditional, "square", lambda self, away: 0.0 * square(self, away)
    )
    assert shift(case, MOVES["near"], 100) > 1.5 * FAR


def test_transport_that_forgets_how_it_spreads_the_tests_does_not(vague, monkeypatch):
    gaussian = Lines.gaussian

    def narrow(lines, at):
        centre, sd, weight = gaussian(lines, at)
        return centre, np.ones_like(sd), weight

    assert shift(vague, MOVES["transport"], 20) < FAR
    monkeypatch.setattr(Lines, "gaussian", narrow)  # preserves distances: no Jacobian, still exact
    assert shift(vague, MOVES["transport"], 20) < FAR
    monkeypatch.setattr(Lines, "accept", forgetful(Lines.accept))
    assert shift(vague, MOVES["transport"], 40) > 1.5 * FAR


def forgetful(accept):
    """Acceptance that ignores the population's density of the tests."""

    def wrong(lines, new, t, log_ratio, log_uniform):
        lost = lines.log_population(t, new)
        lost = lost - lines.log_population(lines.chains.values(lines.k), lines.here)
        return accept(lines, new, t, log_ratio - lost.sum(axis=1), log_uniform)

    return wrong


def test_redraws_whose_densities_are_forgotten_do_not(vague, monkeypatch):
    monkeypatch.setattr(Profile, "log_density", lambda self, t, *_: np.zeros_like(t))
    assert shift(vague, MOVES["redraw"], 20) > 1.5 * FAR


def test_redraws_keep_a_likelihood_that_no_polynomial_follows(vague):
    """The likelihood has a kink and a step within a test's sd, where profiles fit badly."""

    def bent(test: TestLikelihood) -> TestLikelihood:
        def log_likelihood(x):
            away = np.abs(x[:, 0] - test.mean[0])
            return test.log_likelihood(x) - 0.5 * away - 0.7 * (away < 0.4)

        return replace(test, log_likelihood=log_likelihood)

    tests = [bent(test) for test in vague.tests]
    sampler, chains = sampler_of(vague, tests), vague.chains()
    sampler.take_over(chains)
    for _ in range(60):  # warm-up to the new joint posterior, without the tested move
        hyper(sampler, chains)
        MOVES["near"](sampler, chains)
        together(transport, sampler, chains)
    before = features(chains)
    for _ in range(20):
        together(redraw, sampler, chains)
    after = features(chains)
    error = np.sqrt((before.var(axis=0) + after.var(axis=0)) / CHAINS)
    assert np.max(np.abs(after.mean(axis=0) - before.mean(axis=0)) / error) < FAR


def test_redraws_are_taken_where_lines_are_smooth(vague):
    """Also where they are not parabolas, and for any constant in a likelihood."""

    def smooth(test: TestLikelihood) -> TestLikelihood:
        def log_likelihood(x):
            away = x[:, 0] - test.mean[0]
            return test.log_likelihood(x) - 9.0 * np.log(np.cosh(away)) - 1e4

        return replace(test, log_likelihood=log_likelihood)

    for tests, least in ((vague.tests, 0.95), ([smooth(test) for test in vague.tests], 0.6)):
        sampler, chains = sampler_of(vague, tests), vague.chains()
        sampler.take_over(chains)
        shares = [together(redraw, sampler, chains).mean() for _ in range(5)]
        assert np.mean(shares) > least


def test_a_quantity_whose_redraws_are_refused_is_transported(case):
    sampler = sampler_of(case)
    sampler.accepted["redraw Fc_fwd"] = [0.05, 0.1]
    sampler.choose_moves()
    sampler.move_together(case.chains())
    assert sampler.accepted["transport Fc_fwd"]


def test_stored_draws_with_wrong_weights_do_not(vague):
    assert shift(vague, MOVES["stored"], sampler=broken_weights(vague)) > 2 * FAR


def test_proposals_near_a_gaussian_likelihood_are_all_taken(case):
    tests = [test.approximated() for test in case.tests]
    sampler, chains = sampler_of(case, tests), case.chains()
    for j, test in enumerate(tests):
        chains.log_likelihood[j] = test.log_likelihood(chains.x[j])
    MOVES["near"](sampler, chains)
    assert all(np.mean(sampler.accepted[f"near {j}"]) == 1.0 for j in range(len(tests)))


def test_stored_likelihoods_are_those_of_the_coordinates(case):
    chains = case.chains()
    sampler = sampler_of(case)
    for _ in range(5):
        sampler.sweep(chains)
    for test, x, density in zip(case.tests, chains.x, chains.log_likelihood, strict=True):
        np.testing.assert_allclose(density, test.log_likelihood(x), rtol=1e-9, atol=1e-9)


def test_chains_never_leave_the_support_of_a_test(case):
    """The likelihood is zero on one side, where its Gaussian approximation is not."""
    edge = case.tests[0].mean[0]

    def bounded(test: TestLikelihood) -> TestLikelihood:
        def log_likelihood(x):
            return np.where(x[:, 0] > edge, test.log_likelihood(x), -np.inf)

        kept = test.draws[:, 0] > edge
        draws, prior = test.draws[kept], test.draws_log_prior[kept]
        return replace(test, log_likelihood=log_likelihood, draws=draws, draws_log_prior=prior)

    tests = [bounded(case.tests[0]), *case.tests[1:]]
    sampler, chains = sampler_of(case, tests), case.chains()
    assert np.any(chains.x[0] <= edge)
    sampler.take_over(chains)
    for _ in range(10):
        sampler.sweep(chains)
    assert np.all(chains.x[0] > edge)
    assert all(np.all(np.isfinite(density)) for density in chains.log_likelihood)


def test_partners_are_two_others_of_the_same_ensemble(case):
    chains = case.chains()
    everyone = []
    for own, first, second in chains.partners(np.random.default_rng(4)):
        assert np.all(first != second)
        assert not np.isin(first, own).any()
        for other in (first, second):
            np.testing.assert_array_equal(chains.ensemble[own], chains.ensemble[other])
        everyone.append(own)
    np.testing.assert_array_equal(np.sort(np.concatenate(everyone)), np.arange(CHAINS))


def test_products_are_of_the_standardised_places_summed_over_tests(pair):
    chains, layout = pair.chains(), pair.linear.layout
    found = Joint(layout, pair.tests).products(chains)
    for i in (0, 7):
        mean = chains.latent[i, 0] + layout.offsets(chains.h[i : i + 1], chains.choice[:1])[0]
        tau = np.exp(chains.h[i, :2]) / layout.spread
        places = (np.stack([x[i] for x in chains.x]) - mean) / tau
        np.testing.assert_allclose(found[i], places.T @ places, rtol=1e-9)


def test_tests_are_drawn_from_the_density_that_is_said(vague):
    """Many draws at one chain state: their shares below each value, against the integral."""
    chains = vague.chains()
    for array in (chains.h, chains.latent, *chains.x, *chains.log_likelihood):
        array[:] = array[:1]
    sampler = sampler_of(vague)
    through = Lines.through(sampler.joint, chains, sampler.tuning, 0)
    profile = Profile.along(through, sampler.tuning)
    profile.coefficients[..., 1:4] += (0.4, -0.5, 0.2)  # skewed and heavy-tailed
    here = through.here
    drawn, told = profile.draw(here, np.random.default_rng(5))
    np.testing.assert_allclose(profile.log_density(drawn, here), told, rtol=1e-6, atol=1e-9)
    centre, sd, _ = through.gaussian(here)
    grid = centre + sd * np.linspace(-5.0, 5.0, CHAINS)[:, None]
    density = np.exp(profile.log_density(grid, here))
    for j in range(len(vague.tests)):
        steps = np.diff(grid[:, j]) * 0.5 * (density[1:, j] + density[:-1, j])
        shares = np.append(0.0, np.cumsum(steps))
        assert shares[-1] == pytest.approx(1.0, abs=1e-3)
        below = partial(np.interp, xp=grid[:, j], fp=shares)
        assert kstest(drawn[:, j], below).pvalue > 1e-3


def test_scatter_and_level_have_their_priors_in_a_move(vague):
    chains = vague.chains()
    joint = Joint(vague.linear.layout, vague.tests)
    h, level = chains.h.copy(), np.linspace(-3.0, 3.0, CHAINS)
    h[:, 0] = np.linspace(-4.0, 1.0, CHAINS)
    expected = joint.layout.log_prior(h).sum(axis=1) + norm.logpdf(level)
    found = joint.log_prior_of_quantity(0, chains.h, h[:, 0], level)
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-12)
    assert np.all(joint.log_prior_of_quantity(0, chains.h, np.full(CHAINS, 16.0), level) == -np.inf)
