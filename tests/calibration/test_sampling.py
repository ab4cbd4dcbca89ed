"""Modes, proposals, moves and draws of densities that are known, each with a control that fails."""

import emcee
import numpy as np
import pytest
from scipy import optimize, stats

from mfd_bayes.calibration.diagnostics import autocorrelation_time
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import (
    Mixture,
    Proposal,
    fit_proposal,
    least_squares,
    maximize,
)
from mfd_bayes.calibration.sampling import (
    JUMPS,
    IndependenceMove,
    evolution,
    sample,
    sample_density,
)
from mfd_bayes.errors import FitError
from mfd_bayes.records.trace import Trace

DIM = 5
MEAN = np.array([0.0, 1.0, -2.0, 10.0, 0.5])
SD = np.array([1.0, 0.1, 3.0, 1.0, 20.0])
COVARIANCE = SD * SD[:, None] * (0.8 ** np.abs(np.subtract.outer(np.arange(DIM), np.arange(DIM))))
FACTOR = np.linalg.cholesky(COVARIANCE)
PRECISION = np.linalg.inv(COVARIANCE)
EFFORT = Effort(ess=800, limit=4000, ensembles=4, walkers=24)


def normal(q):
    """A correlated normal of very different widths, unnormalised."""
    return -0.5 * np.einsum("ni,ij,nj->n", q - MEAN, PRECISION, q - MEAN)


def bent(q):
    """The same normal, whose first coordinate bends the fourth; its moments are known."""
    return normal(np.column_stack([q[:, :3], q[:, 3] - 0.7 * (q[:, 0] ** 2 - 1.0), q[:, 4]]))


def draws_of(density, begin, seed=1, effort=EFFORT, **options):
    modes = [maximize(density, begin, SD)]
    return sample_density(density, modes, effort, np.random.default_rng(seed), **options)


def agrees(chains, mean, sd):
    """Whether means lie within 5 standard errors and standard deviations within 12 %."""
    q, ess = chains.q.reshape(-1, DIM), chains.convergence.ess_bulk[:DIM]
    close = np.abs(q.mean(axis=0) - mean) < 5.0 * sd / np.sqrt(ess)
    return bool(np.all(close) and np.all(np.abs(q.std(axis=0) / sd - 1.0) < 0.12))


def test_draws_have_the_moments_of_the_density():
    sd = np.where(np.arange(DIM) == 3, np.sqrt(1.0 + 0.49 * 2.0), SD)
    chains = draws_of(bent, MEAN + 0.3 * SD)
    assert chains.convergence.reached(EFFORT.r_hat, EFFORT.ess)
    assert agrees(chains, MEAN, sd)
    assert not agrees(chains, MEAN + 0.3 * sd, sd)
    assert not agrees(chains, MEAN, 1.2 * sd)
    # chains are ordered by walker, and counted
    np.testing.assert_allclose(chains.log_prob, bent(chains.q.reshape(-1, DIM)).reshape(4, -1))
    steps = chains.q.reshape(EFFORT.ensembles, EFFORT.walkers, -1, DIM)
    assert np.mean(steps[:, :, 1:] == steps[:, :, :-1]) > 0.1  # a walker that stays is its own
    assert chains.steps - chains.discarded >= steps.shape[2] * chains.thin
    assert np.all((chains.acceptance > 0.2) & (chains.acceptance < 1.0))


def test_the_seed_decides_and_what_is_reported_does_not():
    effort = Effort(ess=1e6, limit=150, length=1.0, ensembles=2, walkers=20)
    news = []
    base, again, reseeded = (
        draws_of(normal, MEAN, seed=seed, effort=effort, report=report).q
        for seed, report in ((3, None), (3, news.append), (4, None))
    )
    np.testing.assert_array_equal(base, again)
    assert not np.array_equal(base[:, :5], reseeded[:, :5])
    assert "ESS 1e+06" in news[-1].missing
    draws_of(normal, MEAN, report=news.append)
    assert news[-1].missing == ""


# --- moves: every move goes through one harness, which a wrong one must fail

ENSEMBLES, WALKERS = 4, 40


def exact(n, seed=20):
    return MEAN + np.random.default_rng(seed).normal(size=(n, DIM)) @ FACTOR.T


LEARNED = fit_proposal(
    exact(4000),
    3,
    np.random.default_rng(21),
    Mixture(np.ones(1), MEAN[None], 1.5 * FACTOR[None], np.full(1, 6.0)),
)
NARROW = Mixture(
    np.array([0.3, 0.7]),
    np.array([MEAN + 0.5 * SD, MEAN - 0.3 * SD]),
    np.linalg.cholesky(np.array([0.5 * COVARIANCE, 0.8 * COVARIANCE])),
    np.array([4.0, 6.0]),
)


class Forgetful(IndependenceMove):
    """The wrong way: proposals from a mixture, accepted as if they were symmetric."""

    def propose(self, model, state):
        proposal = self.source.draw(model.random, len(state.coords))
        log_prob, _ = model.compute_log_prob_fn(proposal)
        moved = np.log(model.random.rand(len(proposal))) < log_prob - state.log_prob
        state.coords[moved], state.log_prob[moved] = proposal[moved], log_prob[moved]
        return state, moved


def run(moves, steps):
    """Chains (ensemble, step, walker, dim) of moves that begin with exact draws."""
    total = ENSEMBLES * WALKERS
    sampler = emcee.EnsembleSampler(total, DIM, normal, moves=moves, vectorize=True)
    twister = np.random.RandomState(0).get_state()
    sampler.run_mcmc(emcee.State(exact(total, 100), random_state=twister), steps)
    return np.swapaxes(sampler.get_chain().reshape(steps, ENSEMBLES, WALKERS, DIM), 0, 1)


def sampled(chains):
    """Whether means, variances and the law of the first coordinate are the normal's."""
    late = chains[:, chains.shape[1] // 6 :]
    standard = np.linalg.solve(FACTOR, (late - MEAN).reshape(-1, DIM).T).T.reshape(late.shape)
    stride = int(3 * np.max(autocorrelation_time(standard)))
    mean, variance = standard.mean(axis=(0, 1, 2)), standard.var(axis=(0, 1, 2))
    law = stats.kstest(standard[:, ::stride, :, 0].ravel(), stats.norm.cdf)
    close = np.max(np.abs(mean)) < 0.05 and np.max(np.abs(variance - 1)) < 0.05
    return bool(close and law.pvalue > 0.001)


@pytest.mark.parametrize(
    ("moves", "steps", "expected"),
    [
        ([(IndependenceMove(NARROW, np.random.default_rng(1)), 1.0)], 1500, True),
        (
            [
                (IndependenceMove(LEARNED, np.random.default_rng(1)), JUMPS),
                *evolution(DIM, ENSEMBLES, 1.0 - JUMPS),
            ],
            800,
            True,
        ),
        ([(Forgetful(NARROW, np.random.default_rng(1)), 1.0)], 400, False),
    ],
    ids=["independent, badly placed", "those of the sampler", "without the proposal's density"],
)
def test_a_move_samples_a_correlated_normal(moves, steps, expected):
    assert sampled(run(moves, steps)) is expected


def test_the_harness_rejects_draws_that_are_slightly_too_wide_or_shifted():
    chains = exact(ENSEMBLES * 1000 * WALKERS).reshape(ENSEMBLES, 1000, WALKERS, DIM)
    assert sampled(chains)
    assert not sampled(MEAN + 1.04 * (chains - MEAN))
    assert not sampled(chains + 0.08 * SD)


# --- modes


def test_a_climb_ends_at_the_mode_with_its_covariance():
    mode = maximize(normal, MEAN + 2.0 * SD, SD)
    assert np.all(np.abs(mode.q - MEAN) < 0.01 * SD)
    np.testing.assert_allclose(mode.covariance, COVARIANCE, rtol=1e-4)
    mass = 0.5 * (DIM * np.log(2 * np.pi) + np.linalg.slogdet(COVARIANCE)[1])
    assert mode.log_evidence == pytest.approx(mass, abs=1e-3)


TIME = np.linspace(0.0, 3.0, 60)


def decay(points, _=None):
    """Misfit of a decaying oscillation, (n, 3) -> (n, 60)."""
    size, rate, pace = np.exp(points).T[:, :, None]
    data = 2.0 * np.exp(-0.7 * TIME) * np.cos(3.0 * TIME)
    return 5.0 * (size * np.exp(-rate * TIME) * np.cos(pace * TIME) - data)


def test_least_squares_ends_where_scipy_does_and_stays_where_there_is_no_number():
    begin = np.log([2.0, 0.7, 3.0]) + 0.25 * np.random.default_rng(5).standard_normal((6, 3))
    for reach in (8.0, 0.9):
        expected = [
            optimize.least_squares(
                lambda x: np.concatenate([decay(x[None])[0], x]),
                np.clip(point, 0.01 - reach, reach - 0.01),
                bounds=(-reach, reach),
            ).x
            for point in begin
        ]
        np.testing.assert_allclose(least_squares(decay, begin, reach), expected, atol=1e-3)

    def residual(points, _):
        return np.where(points < 1.0, np.nan, points - 0.5)

    with np.errstate(all="ignore"):
        minima = least_squares(residual, np.array([[0.0], [3.0]]), 8.0)
    assert minima[0, 0] == 0.0
    assert minima[1, 0] == pytest.approx(1.0, abs=0.05)


# --- proposals


def test_the_density_of_a_mixture_is_that_of_scipy():
    points = np.random.default_rng(0).normal(MEAN, 2.0 * SD, size=(50, DIM))
    terms = zip(NARROW.weights, NARROW.means, NARROW.factors, NARROW.dof, strict=True)
    expected = sum(w * stats.multivariate_t(m, f @ f.T, df=d).pdf(points) for w, m, f, d in terms)
    np.testing.assert_allclose(np.exp(NARROW.log_density(points)), expected, rtol=1e-8)
    mixture = Proposal((0.25, 0.75), (NARROW, NARROW))
    np.testing.assert_allclose(mixture.log_density(points), NARROW.log_density(points))


# --- what is given


def test_what_cannot_be_sampled_is_refused():
    wrong = {"ess": np.nan, "r_hat": "1", "limit": 0, "walkers": 1.5, "length": -1.0}
    for key, value in wrong.items():
        with pytest.raises(FitError, match=key):
            Effort(**{"ess": 100, "limit": 200, key: value})
    time = np.arange(100) / 25.0
    trace = Trace.from_arrays(time, np.sin(np.pi * time), 0.5, np.cos(np.pi * time))
    posterior = Posterior(trace, "mfd")
    for key, value in (
        *(("posterior", None), ("effort", "pink"), ("report", 5)),
        *(("seed", seed) for seed in ([], "12", b"ab", [[1]], True, -1)),
    ):
        with pytest.raises(FitError, match=key):
            sample(**{"posterior": posterior, "effort": "quick", key: value})
