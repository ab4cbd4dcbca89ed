"""Every move of a sweep leaves a linear-Gaussian joint posterior invariant; broken ones do not."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from mfd_bayes.population.chains import Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.design import Layout
from mfd_bayes.population.moves import glide as gliding
from mfd_bayes.population.moves import leaps as leaping
from mfd_bayes.population.moves import one_test, shared
from mfd_bayes.population.moves.glide import glide
from mfd_bayes.population.moves.hyperparameters import draw_latent, evolve_hyperparameters
from mfd_bayes.population.moves.leaps import leap
from mfd_bayes.population.moves.lines import Lines, transport
from mfd_bayes.population.surrogate import surrogates_of
from mfd_bayes.population.sweep import COMPANION, Sampler
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
        # Gaussians that are near the likelihoods, not the likelihoods themselves
        self.tests = [
            replace(t, mean=t.mean + 0.3 * np.sqrt(np.diag(t.covariance)), covariance=c)
            for t in linear.likelihoods()
            for c in [1.3 * t.covariance]
        ]

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
        ensemble = np.repeat(np.arange(CHAINS // 32), 32)
        weight = np.ones((CHAINS, len(x), d))
        return Chains(h, latent, x, likelihoods, layout.draw_choice(CHAINS), weight, ensemble)


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


@pytest.fixture(scope="module")
def device(make_linear):
    """A quantity whose scatter prior prefers none, and one that differs between tests."""
    found = Case(make_linear((0.5, 0.5, 0.9, 0.9), ("Fc_fwd", "k3"), noise=20.0, seed=3))
    assert found.linear.layout.sparse == (False, True)
    return found


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


def shift(
    case: Case, move, times: int = 30, sampler: Sampler | None = None, chains: Chains | None = None
) -> float:
    """Largest change of a moment by a move, in standard errors."""
    chains = chains or case.chains()
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
    joint = sampler.joint
    density = joint.log_blocks(joint.given(chains), chains.h)
    for _ in range(2):
        evolve_hyperparameters(joint, chains, sampler.rng, density)
    expected = joint.log_blocks(joint.given(chains), chains.h)
    np.testing.assert_allclose(density, expected, rtol=1e-9)
    latent(sampler, chains)


def leaps(sampler: Sampler, chains: Chains) -> None:
    """Leaps of effects and shapes with levels integrated out, some taken, then of the levels."""
    joint = sampler.joint
    density = joint.log_blocks(joint.given(chains), chains.h)
    accepted = leap(joint, chains, sampler.rng, density)
    expected = joint.log_blocks(joint.given(chains), chains.h)
    np.testing.assert_allclose(density, expected, rtol=1e-9)
    assert all(0.02 < np.mean(yes) < 1.0 for _, yes in accepted)
    latent(sampler, chains)


def with_surrogates(case: Case, squared) -> Sampler:
    """A sampler whose tests have surrogates, which are exact here."""
    given = [squared(test) for test in case.linear.likelihoods()]
    rng = np.random.default_rng(5)
    tests = surrogates_of(given, [case.exact.x[:256, j] for j in range(len(given))], rng)
    return Sampler(Joint(case.linear.layout, tests), np.random.default_rng(4), COMPANION)


def glides(sampler: Sampler, chains: Chains) -> None:
    """A trajectory of levels and tests, most of them taken."""
    accepted = glide(sampler.joint, chains, sampler.rng)
    assert 0.5 < np.mean(accepted[0][1]) < 1.0


def together(move, sampler: Sampler, chains: Chains, k: int = 0):
    """One move of a quantity's scatter and level with its tests; returns its acceptance."""
    return move(sampler.joint, chains, sampler.rng, sampler.tuning, k)[0][1]


def along_lines(move):
    """Update of each quantity's scatter and level in turn, with the tests' values of it."""

    def kernel(sampler: Sampler, chains: Chains) -> None:
        for k in range(sampler.joint.d):
            assert np.any(together(move, sampler, chains, k))

    return kernel


def move_all(move, sampler: Sampler, chains: Chains, slopes) -> None:
    """Move of all tests at once, some of which must be taken."""
    accepted = move(sampler.joint, chains, sampler.rng, slopes)
    assert len(accepted) == 2
    assert all(np.mean(yes) > 0.02 for _, yes in accepted)


MOVES = {
    "hyper": hyper,
    "leap": leaps,
    "latent": latent,
    "near": of_one_test(one_test.step_near),
    "evolution": of_one_test(one_test.evolve_tests),
    "transport": along_lines(transport),
    "shift": lambda sampler, chains: move_all(shared.shift, sampler, chains, sampler.slopes),
    "rescale": lambda sampler, chains: move_all(shared.rescale, sampler, chains, sampler.slopes),
    "together": lambda sampler, chains: sampler.move_together(chains),
    "sweep": lambda sampler, chains: sampler.sweep(chains),
}


FULL = {"together": 10, "sweep": 10}
"""Times of those kernels that move everything far at once."""


@pytest.mark.parametrize("name", [name for name in MOVES if name not in ("shift", "rescale")])
def test_a_move_leaves_the_posterior_as_it_is(case, name):
    assert shift(case, MOVES[name], FULL.get(name, 30)) < FAR


@pytest.mark.parametrize("name", ["hyper", "near", "transport", "sweep"])
def test_a_move_keeps_quantities_that_are_known_together(pair, name):
    assert shift(pair, MOVES[name], FULL.get(name, 20)) < FAR


@pytest.mark.parametrize("name", ["near", "transport", "sweep"])
def test_a_move_keeps_tests_that_tell_little(vague, name):
    assert shift(vague, MOVES[name], FULL.get(name, 20)) < FAR


@pytest.mark.parametrize(
    "name", ["hyper", "latent", "near", "transport", "shift", "rescale", "sweep"]
)
def test_a_move_keeps_a_quantity_that_is_one_for_the_device(device, name):
    assert shift(device, MOVES[name], FULL.get(name, 30)) < FAR


@pytest.mark.parametrize("name", ["shift", "rescale"])
def test_a_move_of_all_tests_with_a_wrong_ratio_does_not(device, name, monkeypatch):
    """A shift that forgets the other quantities' scatter, a rescale with the Jacobian again."""
    accept = shared._accept

    def wrong(joint, chains, rng, proposed):
        ratio = proposed.log_ratio.copy()
        if name == "shift":
            ratio[:] = 0.0
        else:
            ratio += (proposed.h - chains.h).sum(axis=1) * len(joint.tests)
        return accept(joint, chains, rng, replace(proposed, log_ratio=ratio))

    monkeypatch.setattr(shared, "_accept", wrong)
    assert shift(device, MOVES[name], 150 if name == "shift" else 50) > 1.5 * FAR


@pytest.mark.parametrize("which", ["case", "pair", "vague", "device"])
@pytest.mark.parametrize("move", [glides, MOVES["sweep"]])
def test_trajectories_leave_the_posterior_as_it_is(request, squared, which, move):
    found = request.getfixturevalue(which)
    sampler = with_surrogates(found, squared)
    taken = found.chains()
    sampler.take_over(taken)
    assert shift(found, move, 10, sampler, taken) < FAR


def test_trajectories_whose_energy_is_forgotten_do_not(case, squared, monkeypatch):
    monkeypatch.setattr(gliding, "SIZE", 1.2)
    monkeypatch.setattr(gliding._Momentum, "energy", property(lambda self: np.zeros(CHAINS)))
    sampler, taken = with_surrogates(case, squared), case.chains()
    sampler.take_over(taken)

    def move(sampler, chains):
        glide(sampler.joint, chains, sampler.rng)

    assert shift(case, move, 15, sampler, taken) > 1.5 * FAR


@pytest.mark.parametrize("move", ["shift", "rescale"])
def test_without_a_quantity_of_the_device_nothing_moves_with_all_tests(case, move):
    sampler, chains = sampler_of(case), case.chains()
    before = features(chains)
    given = sampler.joint, chains, sampler.rng, sampler.slopes
    assert getattr(shared, move)(*given) == []
    np.testing.assert_array_equal(features(chains), before)


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


def broken_scatter(case: Case) -> Sampler:
    """Scatter that is a quarter of its true value."""

    class Wrong(Layout):
        def scatter(self, h):
            return 0.25 * super().scatter(h)

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
    ],
)
def test_a_broken_move_does_not(case, name, wrong):
    assert shift(case, MOVES[name], 50, sampler=wrong(case)) > 1.5 * FAR


def test_proposals_near_a_gaussian_whose_density_is_forgotten_do_not(case, monkeypatch):
    square = one_test.GaussianConditional.square
    monkeypatch.setattr(
        one_test.GaussianConditional, "square", lambda self, away: 0.0 * square(self, away)
    )
    assert shift(case, MOVES["near"], 40) > 1.5 * FAR


def test_leaps_whose_density_is_forgotten_do_not(case, monkeypatch):
    log = leaping._Leaps.log
    monkeypatch.setattr(leaping._Leaps, "log", lambda self, at: 0.0 * log(self, at))
    assert shift(case, MOVES["leap"], 20) > 1.5 * FAR


def test_a_chain_that_is_alone_far_away_comes_back_by_leaps_alone(case):
    """Effects as large as the law's whole range, and a law that says the opposite."""
    first, odd = slice(0, CHAINS, 32), case.chains()
    odd.h[first, -2:] = np.log(2.0), -1.5
    without = deepcopy(odd)
    sampler = sampler_of(case)
    for _ in range(15):
        hyper(sampler, without)
        leaps(sampler, odd)
    usual = case.chains().h[:, -1]
    lost = [np.abs(c.h[first, -1] - usual.mean()) > 3.0 * usual.std() for c in (without, odd)]
    assert np.mean(lost[0]) > 0.3
    assert np.mean(lost[1]) < 0.05


def test_transport_that_forgets_how_it_spreads_the_tests_does_not(vague, monkeypatch):
    gaussian = Lines.gaussian

    def narrow(lines, at):
        centre, sd = gaussian(lines, at)
        return centre, np.ones_like(sd)

    assert shift(vague, MOVES["transport"], 20) < FAR
    monkeypatch.setattr(Lines, "gaussian", narrow)  # preserves distances: no Jacobian, still exact
    assert shift(vague, MOVES["transport"], 20) < FAR
    monkeypatch.setattr(Lines, "accept", forgetful(Lines.accept))
    assert shift(vague, MOVES["transport"], 30) > 1.5 * FAR


def forgetful(accept):
    """Acceptance that ignores the population's density of the tests."""

    def wrong(lines, new, t, log_ratio, log_uniform):
        lost = lines.log_population(t, new)
        lost = lost - lines.log_population(lines.chains.values(lines.k), lines.here)
        return accept(lines, new, t, log_ratio - lost.sum(axis=1), log_uniform)

    return wrong


def test_proposals_near_a_gaussian_likelihood_are_all_taken(case):
    tests = [test.approximated() for test in case.tests]
    sampler, chains = sampler_of(case, tests), case.chains()
    for j, test in enumerate(tests):
        chains.log_density[j] = test.log_likelihood(chains.x[j])
    MOVES["near"](sampler, chains)
    assert all(np.mean(sampler.accepted[f"near {j}"]) == 1.0 for j in range(len(tests)))


def test_stored_likelihoods_are_those_of_the_coordinates(case):
    chains = case.chains()
    sampler = sampler_of(case)
    for _ in range(3):
        sampler.sweep(chains)
    for test, x, density in zip(case.tests, chains.x, chains.log_density, strict=True):
        np.testing.assert_allclose(density, test.log_likelihood(x), rtol=1e-9, atol=1e-9)


def test_chains_never_leave_the_support_of_a_test(case):
    """The likelihood is zero on one side, where its Gaussian approximation is not."""
    edge = case.tests[0].mean[0]

    def bounded(test: TestLikelihood) -> TestLikelihood:
        def log_likelihood(x):
            return np.where(x[:, 0] > edge, test.log_likelihood(x), -np.inf)

        return replace(test, log_likelihood=log_likelihood)

    tests = [bounded(case.tests[0]), *case.tests[1:]]
    sampler, chains = sampler_of(case, tests), case.chains()
    assert np.any(chains.x[0] <= edge)
    sampler.take_over(chains)
    for _ in range(4):
        sampler.sweep(chains)
    assert np.all(chains.x[0] > edge)
    assert all(np.all(np.isfinite(density)) for density in chains.log_density)


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


def test_scatter_and_level_have_their_priors_in_a_move(vague):
    chains = vague.chains()
    joint = Joint(vague.linear.layout, vague.tests)
    h, level = chains.h.copy(), np.linspace(-3.0, 3.0, CHAINS)
    h[:, 0] = np.linspace(-4.0, 1.0, CHAINS)
    expected = joint.layout.log_prior(h).sum(axis=1) + norm.logpdf(level)
    found = joint.log_prior_of_quantity(0, chains.h, h[:, 0], level)
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-12)
    assert np.all(joint.log_prior_of_quantity(0, chains.h, np.full(CHAINS, 16.0), level) == -np.inf)
