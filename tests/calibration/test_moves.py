"""Every move goes through one harness; a move that is known to be wrong must fail it."""

from dataclasses import dataclass
from functools import cache

import emcee
import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.diagnostics import autocorrelation_time
from mfd_bayes.calibration.proposal import Mixture, learn
from mfd_bayes.calibration.sampling import JUMPS, Apart, Independent, evolution

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


MOVES = {
    "independent, badly placed": [(Independent(NARROW), 1.0)],
    "those of the sampler": those_of_the_sampler(),
}


@pytest.fixture(scope="module")
def sampled():
    """Chains and acceptance of the moves of a name, run once."""
    return cache(lambda name: run(MOVES[name]))


@pytest.mark.parametrize("name", MOVES)
def test_move_samples_a_correlated_gaussian(sampled, name):
    chains, acceptance = sampled(name)
    assert judge(chains).right, judge(chains)
    assert 0.1 < acceptance < 0.9


def test_harness_rejects_independent_proposals_without_their_density():
    chains, _ = run([(Forgetful(NARROW), 1.0)], steps=900)
    assert not judge(chains).right


def test_harness_rejects_exact_draws_that_are_slightly_too_wide():
    rng = np.random.default_rng(1)
    exact = MEAN + rng.normal(size=(ENSEMBLES, STEPS, WALKERS, DIM)) @ FACTOR.T
    assert judge(exact).right
    assert not judge(MEAN + 1.04 * (exact - MEAN)).right
    assert not judge(exact + 0.08 * SD).right
