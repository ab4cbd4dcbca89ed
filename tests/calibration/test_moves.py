"""Every move goes through one harness; a move that is known to be wrong must fail it."""

from dataclasses import dataclass
from functools import cache

import emcee
import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.diagnostics import autocorrelation_time
from mfd_bayes.calibration.ensembles import JUMPS, Apart, Independent, evolution
from mfd_bayes.calibration.proposal import Mixture, learn

DIM, ENSEMBLES, WALKERS, STEPS = 5, 4, 40, 3000
MEAN = np.array([0.0, 1.0, -2.0, 10.0, 0.5])
SD = np.array([1.0, 0.1, 3.0, 1.0, 20.0])
COVARIANCE = SD * SD[:, None] * (0.8 ** np.abs(np.subtract.outer(np.arange(DIM), np.arange(DIM))))
FACTOR = np.linalg.cholesky(COVARIANCE)
PRECISION = np.linalg.inv(COVARIANCE)


def log_density(q):
    off = q - MEAN
    return -0.5 * np.einsum("ni,ij,nj->n", off, PRECISION, off)


def apart(move):
    """Red–blue moves applied within each ensemble; other moves unchanged."""
    return Apart(move, ENSEMBLES) if hasattr(move, "get_proposal") else move


def exact(n, seed=20):
    return MEAN + np.random.default_rng(seed).normal(size=(n, DIM)) @ FACTOR.T


ANCHORS = Mixture(np.ones(1), MEAN[None], 1.5 * FACTOR[None], np.full(1, 6.0))
LEARNED = learn(exact(4000), 3, np.random.default_rng(21), ANCHORS)
NARROW = Mixture(
    np.array([0.3, 0.7]),
    np.array([MEAN + 0.5 * SD, MEAN - 0.3 * SD]),
    np.linalg.cholesky(np.array([0.5 * COVARIANCE, 0.8 * COVARIANCE])),
    np.array([4.0, 6.0]),
)


def those_of_the_sampler():
    return [(Independent(LEARNED), JUMPS), *evolution(DIM, ENSEMBLES, 1.0 - JUMPS)]


class Forgetful(Independent):
    """The wrong way: proposals from a mixture, accepted as if they were symmetric."""

    def propose(self, model, state):
        proposal = self.source.draw(model.random, len(state.coords))
        log_prob, _ = model.compute_log_prob_fn(proposal)
        moved = np.log(model.random.rand(len(proposal))) < log_prob - state.log_prob
        state.coords[moved], state.log_prob[moved] = proposal[moved], log_prob[moved]
        return state, moved


def run(moves, *, seed=0, steps=STEPS, begin=None):
    """Chains (ensemble, step, walker, dim) from exact draws of the target, and acceptance."""
    rng = np.random.default_rng(100)
    total = ENSEMBLES * WALKERS
    if begin is None:
        begin = MEAN + rng.normal(size=(total, DIM)) @ FACTOR.T
    weighted = [(apart(move), weight) for move, weight in moves]
    sampler = emcee.EnsembleSampler(total, DIM, log_density, moves=weighted, vectorize=True)
    state = emcee.State(begin, random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps)
    chain = sampler.get_chain().reshape(steps, ENSEMBLES, WALKERS, DIM)
    return np.swapaxes(chain, 0, 1), np.mean(sampler.acceptance_fraction)


@dataclass(frozen=True)
class Verdict:
    """Errors of the draws' means and variances, and the p-value of a KS test."""

    mean_error: float
    variance_ratio: np.ndarray
    p_value: float

    @property
    def right(self):
        spread = np.max(np.abs(self.variance_ratio - 1))
        return bool(self.mean_error < 0.05 and spread < 0.05 and self.p_value > 0.001)


def judge(chains):
    late = chains[:, chains.shape[1] // 6 :]
    standard = np.linalg.solve(FACTOR, (late - MEAN).reshape(-1, DIM).T).T.reshape(late.shape)
    apart = int(3 * np.max(autocorrelation_time(standard)))
    thinned = standard[:, ::apart, :, 0].ravel()
    return Verdict(
        mean_error=float(np.max(np.abs(standard.mean(axis=(0, 1, 2))))),
        variance_ratio=standard.var(axis=(0, 1, 2)),
        p_value=float(stats.kstest(thinned, stats.norm.cdf).pvalue),
    )


class Snooker(emcee.moves.DESnookerMove):
    """emcee's snooker move, which needs its complement in three parts."""

    def get_proposal(self, s, c, random):
        return super().get_proposal(s, np.array_split(c[0], 3), random)


MOVES = {
    "differential evolution": [(emcee.moves.DEMove(sigma=1e-3), 1.0)],
    "full jumps now and then": [
        (emcee.moves.DEMove(sigma=1e-3), 0.7),
        (emcee.moves.DEMove(sigma=1e-3, gamma0=1.0), 0.3),
    ],
    "stretch": [(emcee.moves.StretchMove(), 1.0)],
    "independent, learned from draws": [(Independent(LEARNED), 1.0)],
    "independent, badly placed": [(Independent(NARROW), 1.0)],
    "those of the sampler": those_of_the_sampler(),
}


EMCEES = ("differential evolution", "full jumps now and then", "stretch")
"""Moves of emcee alone: what it releases changes seldom, so these cases are slow tests."""


@pytest.fixture(scope="module")
def sampled():
    """Chains and acceptance of the moves of a name, run once."""
    return cache(lambda name: run(MOVES[name]))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in EMCEES else ()) for name in MOVES],
)
def test_move_samples_a_correlated_gaussian(sampled, name):
    chains, acceptance = sampled(name)
    assert judge(chains).right, judge(chains)
    assert 0.1 < acceptance < 0.9


@pytest.mark.slow
def test_harness_rejects_a_move_that_does_not_sample_the_target():
    chains, _ = run([(Snooker(), 1.0)], steps=900)
    verdict = judge(chains)
    assert not verdict.right
    assert np.all(verdict.variance_ratio < 0.9)


def test_harness_rejects_independent_proposals_without_their_density():
    chains, _ = run([(Forgetful(NARROW), 1.0)], steps=900)
    assert not judge(chains).right


def test_harness_rejects_exact_draws_that_are_slightly_too_wide():
    rng = np.random.default_rng(1)
    exact = MEAN + rng.normal(size=(ENSEMBLES, STEPS, WALKERS, DIM)) @ FACTOR.T
    assert judge(exact).right
    assert not judge(MEAN + 1.04 * (exact - MEAN)).right
    assert not judge(exact + 0.08 * SD).right


def test_move_finds_the_target_from_afar():
    begin = MEAN + SD * (6 + np.random.default_rng(2).normal(size=(ENSEMBLES * WALKERS, DIM)))
    chains, _ = run(those_of_the_sampler(), begin=begin)
    assert judge(chains).right


def test_ensembles_are_independent(sampled):
    chains, _ = sampled("those of the sampler")
    means = chains[:, 500:].mean(axis=2)  # of each ensemble at each step
    thinned = means[:, :: int(3 * np.max(autocorrelation_time(chains)))]
    n = thinned.shape[1]
    pairs = np.triu_indices(ENSEMBLES, 1)

    def worst(series):
        return max(np.max(np.abs(np.corrcoef(series[..., k])[pairs])) for k in range(DIM))

    assert n > 30
    assert worst(thinned) * np.sqrt(n) < 4
    # the control: mixing in a part of a neighbour's mean is detected
    mixed = thinned + 0.5 * np.roll(thinned, 1, axis=0)
    assert worst(mixed) * np.sqrt(n) > 4


def test_an_ensemble_is_deaf_to_where_the_others_are():
    # moving three ensembles far away, and flat, does not change the first one's proposals
    class Recorder:
        def __init__(self):
            self.move = emcee.moves.DEMove(sigma=1e-3)
            self.heard = []

        def setup(self, coords):
            self.move.setup(coords)

        def get_proposal(self, s, c, random):
            self.heard.append((s.copy(), np.concatenate(c)))
            return self.move.get_proposal(s, c, random)

    recorder = Recorder()
    homes = np.repeat(1e3 * np.arange(ENSEMBLES), WALKERS)[:, None] * SD
    begin = MEAN + homes + np.random.default_rng(3).normal(size=(ENSEMBLES * WALKERS, DIM)) * SD
    run([(recorder, 1.0)], steps=1, begin=begin)
    assert len(recorder.heard) == 2 * ENSEMBLES
    for moving, still in recorder.heard:
        assert len(moving) == len(still) == WALKERS // 2
        assert len(np.unique(np.concatenate([moving, still]), axis=0)) == WALKERS
        both = np.concatenate([moving, still])
        home = np.round((both - MEAN)[:, 0] / SD[0] / 1e3)
        assert len(set(home.tolist())) == 1


def test_a_learned_proposal_is_accepted_most_of_the_time():
    move = Independent(LEARNED)
    run([(move, 1.0)], steps=50)
    assert move.acceptance > 0.6
    move.forget()
    assert move.acceptance == 0.0


def test_every_walker_is_proposed_once_a_step_and_log_prob_goes_with_it():
    begin = MEAN + np.random.default_rng(4).normal(size=(ENSEMBLES * WALKERS, DIM)) @ FACTOR.T
    counted = []

    def density(q):
        counted.append(len(q))
        return log_density(q)

    sampler = emcee.EnsembleSampler(
        len(begin),
        DIM,
        density,
        moves=Apart(emcee.moves.StretchMove(), ENSEMBLES),
        vectorize=True,
    )
    sampler.run_mcmc(begin, 20)
    assert counted[1:] == [len(begin) // 2] * 40
    chain, log_prob = sampler.get_chain(), sampler.get_log_prob()
    for q, stored in zip(chain, log_prob, strict=True):
        np.testing.assert_allclose(stored, log_density(q), rtol=1e-12)


def test_same_seed_same_draws():
    first, again, other = (
        run(those_of_the_sampler(), seed=seed, steps=50)[0] for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.any(first[:, -1] == other[:, -1])
