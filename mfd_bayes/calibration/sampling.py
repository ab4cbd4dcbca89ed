"""Draws from a density by emcee, in independent ensembles that run until they agree."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import emcee
import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, autocorrelation_time, measure
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.map_fit import Density, Mode, find_modes
from mfd_bayes.calibration.moves import Apart
from mfd_bayes.calibration.posterior import UNIDENTIFIABLE, Posterior
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Report = Callable[["Progress"], None]


STRIDE = 4
"""Steps of which one is stored: neighbours are so alike that the others are only memory."""


@dataclass(frozen=True)
class Progress:
    """Where a sampling stands: steps done, the limit, and the worst figures so far."""

    steps: int
    limit: int
    r_hat: float
    ess: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of a density, ensembles as chains.

    Attributes
    ----------
    q : (chain, draw, dim)
        A chain's draws are ordered by walker, and along a walker by step, so that the
        autocorrelation of a chain is that of its walkers.
    log_prob : (chain, draw)
    walkers : int
    steps, thin, discarded : int
        Steps of each ensemble, every which is kept, and how many at the start are not.
    acceptance : (chain,)
    autocorrelation : (dim,)
        Integrated autocorrelation time, steps.
    convergence : Convergence
    """

    q: Array
    log_prob: Array
    walkers: int
    steps: int
    thin: int
    discarded: int
    acceptance: Array
    autocorrelation: Array
    convergence: Convergence


@dataclass(frozen=True, eq=False)
class Draws:
    """Posterior draws of one test.

    Attributes
    ----------
    names : tuple of str
        What q's columns stand for.
    q : (chain, draw, dim)
        Unconstrained coordinates.
    theta : (chain, draw, p)
        Parameters of the model in its own order, internal units.
    values : mapping of str to (chain, draw)
        All quantities by name, γ1 drawn from its prior.
    log_prob, log_prior, log_likelihood : (chain, draw)
    chains : Chains
    modes : tuple of Mode
    wall_time : float, s
    """

    names: tuple[str, ...]
    q: Array
    theta: Array
    values: Mapping[str, Array]
    log_prob: Array
    log_prior: Array
    log_likelihood: Array
    chains: Chains
    modes: tuple[Mode, ...]
    wall_time: float

    @property
    def convergence(self) -> Convergence:
        """R̂ and effective sample sizes of every coordinate."""
        return self.chains.convergence


def sample(
    posterior: Posterior,
    effort: str | Effort = "standard",
    seed: int | Sequence[int] = 0,
    *,
    report: Report | None = None,
) -> Draws:
    """Posterior draws of one test, in four independent ensembles or more.

    Parameters
    ----------
    posterior : Posterior
    effort : {"quick", "standard", "thorough"} or Effort
    seed : int or sequence of int
        The same seed gives the same draws.
    report : callable, optional
        Called with a `Progress` after every block of steps.

    Raises
    ------
    FitError
        When the prior has no mass at any start, or the effort is unknown.
    """
    began = time.perf_counter()
    chosen = find_effort(effort)
    rng = np.random.default_rng(seed)
    modes = find_modes(posterior, rng)
    chains = sample_density(posterior.log_prob, modes, chosen, rng, report=report)
    flat = chains.q.reshape(-1, posterior.dim)
    shape = chains.q.shape[:2]
    values = posterior.values(flat)
    if UNIDENTIFIABLE in posterior.priors:
        values[UNIDENTIFIABLE] = posterior.priors[UNIDENTIFIABLE].draw(rng, len(flat))
    log_prior = posterior.log_prior(flat).reshape(shape)
    return Draws(
        names=posterior.names,
        q=chains.q,
        theta=posterior.theta(values).reshape(*shape, -1),
        values={name: value.reshape(shape) for name, value in values.items()},
        log_prob=chains.log_prob,
        log_prior=log_prior,
        log_likelihood=chains.log_prob - log_prior,
        chains=chains,
        modes=modes,
        wall_time=time.perf_counter() - began,
    )


def sample_density(
    density: Density,
    modes: Sequence[Mode],
    effort: Effort,
    rng: np.random.Generator,
    *,
    report: Report | None = None,
) -> Chains:
    """Draws of a log density (n, dim) -> (n,), from ensembles started around its modes."""
    began = time.perf_counter()
    sampler, state = _ensembles(density, modes, effort, rng)
    steps, wait = 0, effort.block
    while True:
        stored = max(1, wait // STRIDE)
        state = sampler.run_mcmc(state, stored, thin_by=STRIDE, skip_initial_state_check=True)
        steps += stored * STRIDE
        chains = _gather(sampler, steps, effort)
        found = chains.convergence
        if report is not None:
            seconds = time.perf_counter() - began
            report(Progress(steps, effort.limit, found.worst_r_hat, found.worst_ess, seconds))
        long_enough = steps - chains.discarded >= effort.length * np.max(chains.autocorrelation)
        if (long_enough and found.reached(effort.r_hat, effort.ess)) or steps >= effort.limit:
            return chains
        wait = min(effort.block, effort.limit - steps)


def _ensembles(
    density: Density, modes: Sequence[Mode], effort: Effort, rng: np.random.Generator
) -> tuple[emcee.EnsembleSampler, emcee.State]:
    """Sampler of all ensembles in lock-step, and where they start."""
    dim = len(modes[0].q)
    walkers = 2 * max(16, dim + 3)
    sampler = emcee.EnsembleSampler(
        effort.ensembles * walkers,
        dim,
        density,
        moves=[(Apart(move, effort.ensembles), weight) for move, weight in _moves(dim)],
        vectorize=True,
    )
    # emcee takes a RandomState's state and silently ignores anything else
    twister = np.random.RandomState(int(rng.integers(2**32)))
    begin = [_disperse(density, modes, walkers, rng) for _ in range(effort.ensembles)]
    return sampler, emcee.State(np.concatenate(begin), random_state=twister.get_state())


def _moves(dim: int) -> list[tuple[emcee.moves.RedBlueMove, float]]:
    """Differential evolution, now and then a full jump between walkers or a stretch.

    emcee 3.1.6's DESnookerMove does not sample the target and is not used.
    """
    usual = 2.38 / np.sqrt(2 * dim)
    return [
        (emcee.moves.DEMove(sigma=1e-3, gamma0=usual), 0.8),
        (emcee.moves.DEMove(sigma=1e-3, gamma0=1.0), 0.1),
        (emcee.moves.StretchMove(), 0.1),
    ]


def _disperse(
    density: Density, modes: Sequence[Mode], walkers: int, rng: np.random.Generator
) -> Array:
    """Walkers around the modes that hold mass, a little wider than Laplace's covariance."""
    evidence = np.array([mode.log_evidence for mode in modes])
    weights = np.exp(evidence - evidence.max())
    weights[weights < 1e-3] = 0.0
    weights /= weights.sum()
    begin = np.empty((walkers, len(modes[0].q)))
    factors = [np.linalg.cholesky(mode.covariance) for mode in modes]
    waiting = np.arange(walkers)
    shrink = 1.0
    while waiting.size:
        chosen = rng.choice(len(modes), size=waiting.size, p=weights)
        for i, k in zip(waiting, chosen, strict=True):
            begin[i] = modes[k].q + shrink * factors[k] @ rng.standard_normal(len(modes[k].q))
        values = density(begin[waiting])
        near = values > modes[0].log_prob - 5.0 * len(modes[0].q)
        waiting = waiting[~near]
        shrink *= 0.9
        if shrink < 1e-3:
            raise FitError("no density around the modes: the posterior cannot be sampled")
    return begin


def _gather(sampler: emcee.EnsembleSampler, steps: int, effort: Effort) -> Chains:
    """Draws of the second half of the steps, thinned, and what they say of convergence."""
    total = steps // STRIDE
    discarded = total // 2
    kept = total - discarded
    walkers = sampler.nwalkers // effort.ensembles
    dim = sampler.ndim
    apart = (kept, effort.ensembles, walkers)
    full = np.swapaxes(sampler.get_chain(discard=discarded).reshape(*apart, dim), 0, 1)
    log_prob = np.swapaxes(sampler.get_log_prob(discard=discarded).reshape(apart), 0, 1)
    thin = max(1, kept * walkers // effort.kept)
    chains, log_prob = full[:, ::thin], log_prob[:, ::thin]
    acceptance = np.reshape(sampler.acceptance_fraction, (effort.ensembles, walkers))
    return Chains(
        q=np.swapaxes(chains, 1, 2).reshape(effort.ensembles, -1, dim),
        log_prob=np.swapaxes(log_prob, 1, 2).reshape(effort.ensembles, -1),
        walkers=walkers,
        steps=steps,
        thin=thin * STRIDE,
        discarded=discarded * STRIDE,
        acceptance=acceptance.mean(axis=1),
        autocorrelation=STRIDE * autocorrelation_time(full),
        convergence=measure(chains),
    )
