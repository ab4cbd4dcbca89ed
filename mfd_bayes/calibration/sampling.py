"""Posterior draws of one test, by independent ensembles of walkers that run until they converge."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, autocorrelation_time, measure
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.modes import Mode, around_modes, find_modes, mode_shares, nearest_modes
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import Adaptive, Mixture, fit_mixture, joined
from mfd_bayes.calibration.quantities import interval_rows, intervals_of
from mfd_bayes.errors import FitError
from mfd_bayes.jobs.job import Progress
from mfd_bayes.records.numbers import whole_number
from mfd_bayes.store.cards import counted, grid

Array = NDArray[np.float64]

STORED = 3000
"""Largest number of steps stored for each walker; beyond it, every second one is dropped."""

ADAPTED, SIZE = 16, 2000.0
"""Most proposals of the warm-up; effective number of weighted draws from which it ends earlier."""

ROUND = 5
"""Draws of a proposal of the warm-up for each walker; twice as many each time it is repeated."""

BROAD = 0.3
"""Power of the density to which the first proposal is fitted, so that it reaches its tails."""

FITTED = 8000
"""Most draws to which a proposal is fitted."""

FIRST, LEAST_WAIT = 80, 20
"""Kept steps after which convergence is measured first, at most; and again, at least."""

SLOW = 40.0
"""Autocorrelation time, steps, above which the proposal is fitted again."""

LEAST = 32.0
"""Least autocorrelation time, steps, that is used for the length of a run: far tails are visited
more rarely than the estimate shows."""

NEVER = 1000.0
"""A proposal whose log density is this far below that of every walker is never accepted."""

SILENT = 5.0
"""Seconds after which R̂ and effective sample size are reported, even of a run that is too short."""

JUMPS = 0.85
"""Share of independence proposals among the steps; the others are differential evolution."""


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of a density; each ensemble is a chain.

    Attributes
    ----------
    q : (chain, draw, dim)
        A chain's draws are ordered by walker and, within a walker, by step, so that the
        autocorrelation of a chain is that of its walkers.
    log_prob : (chain, draw)
    walkers : int
    steps, thin, discarded : int
        Steps of each ensemble; the interval of steps between kept draws; steps of the warm-up,
        in which the proposal was fitted and no draw is kept.
    acceptance : (chain,)
    autocorrelation : (dim,)
        Integrated autocorrelation time, steps.
    watched : (ensemble, step, walker, m)
        Kept draws of all that must converge: coordinates, log density, derived quantities.
    """

    q: Array
    log_prob: Array
    walkers: int
    steps: int
    thin: int
    discarded: int
    acceptance: Array
    autocorrelation: Array
    watched: Array

    @property
    def slowest(self) -> float:
        """Largest autocorrelation time of a coordinate, steps."""
        return float(np.max(self.autocorrelation))

    @cached_property
    def convergence(self) -> Convergence:
        """Of all that is watched, in that order; to measure it takes as long as some ten steps."""
        return measure(self.watched)


@dataclass(frozen=True, eq=False)
class Draws:
    """Posterior draws of one test.

    Attributes
    ----------
    names : tuple of str
        Names of q's columns.
    q : (chain, draw, dim)
        Unconstrained coordinates.
    theta : (chain, draw, p)
        Parameters of the model in its own order, internal units.
    values : mapping of str to (chain, draw)
        All quantities by name, γ1 drawn from its prior.
    log_prob, log_prior, log_likelihood : (chain, draw)
    modes : tuple of Mode
        Where the walkers started, best first.
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
        """R̂ and effective sample sizes of every coordinate and derived quantity."""
        return self.chains.convergence

    @property
    def mode_values(self) -> list[dict[str, float]]:
        """Median of every quantity among the draws nearest to each mode; NaN without draws."""
        nearest = nearest_modes(self.modes, self.q)
        return [
            {
                name: float(np.median(values[nearest == k])) if np.any(nearest == k) else np.nan
                for name, values in self.values.items()
            }
            for k in range(len(self.modes))
        ]

    @property
    def mode_shares(self) -> Array:
        """Share of each chain's draws that is nearest to each mode, (chain, mode)."""
        return mode_shares(self.modes, self.q)

    def _repr_html_(self) -> str:
        chains, draws, _ = self.q.shape
        note = (
            f"worst R-hat {self.convergence.worst_r_hat:.3f}, smallest effective sample size "
            f"{self.convergence.worst_ess:.0f}, {self.wall_time:.1f} s"
        )
        title = f"Draws: {counted(chains, 'chain')} of {draws}"
        return grid(title, *interval_rows(intervals_of(self.values)), note)


def sample(
    posterior: Posterior,
    effort: str | Effort = "standard",
    seed: int | Sequence[int] = 0,
    *,
    report: Callable[[Progress], None] | None = None,
) -> Draws:
    """Posterior draws of one test, in four independent ensembles or more.

    Parameters
    ----------
    effort : {"standard", "quick", "thorough"} or Effort
    seed : int or sequence of int
        The same seed gives the same draws. A sequence of one number is that number.
    report : callable, optional
        Called with a `Progress` after every block of steps.

    Raises
    ------
    FitError
        When the prior has no mass at any start, or an argument is none of those above.
    """
    began = time.perf_counter()
    if not isinstance(posterior, Posterior):
        raise FitError(f"posterior must be a Posterior, got {type(posterior).__name__}")
    if report is not None and not callable(report):
        raise FitError(f"report must be a function of one argument, a Progress, got {report!r}")
    chosen, rng = find_effort(effort), generator_of(seed)
    modes = find_modes(posterior, rng, starts=chosen.starts)
    chains = sample_density(
        posterior.log_prob, modes, chosen, rng, derived=posterior.derived, report=report
    )
    flat, shape = chains.q.reshape(-1, posterior.dim), chains.q.shape[:2]
    values = posterior.values(flat)
    for name in posterior.model.keeps_prior:
        values[name] = posterior.priors[name].draw(rng, len(flat))
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


def generator_of(seed: int | Sequence[int]) -> np.random.Generator:
    """Random numbers of a seed, or a FitError where it is none.

    NumPy takes [1, 0] for [1]: here the number of zeros at the end of a sequence counts too.
    """
    several = isinstance(seed, Sequence) or (isinstance(seed, np.ndarray) and seed.ndim > 0)
    if not several or isinstance(seed, int | str | bytes):
        return np.random.default_rng(whole_number("seed", seed, 0, FitError))
    words = [whole_number("seed", one, 0, FitError) for one in seed]
    if not words:
        raise FitError("seed must be a whole number, 0 or more, or some of them, got none")
    zeros = len(words) - 1 - max((i for i, word in enumerate(words) if word), default=0)
    return np.random.default_rng(np.random.SeedSequence(words, spawn_key=(zeros,) if zeros else ()))


def sample_density(
    density: Callable[[Array, float], Array],
    modes: Sequence[Mode],
    effort: Effort,
    rng: np.random.Generator,
    *,
    derived: Callable[[Array], Array] | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Chains:
    """Draws of a density, from ensembles that start around its modes.

    In the warm-up a mixture of Student-t densities is fitted to weighted draws and, where these
    are few, to walkers. It is then frozen, and draws are kept: of independence proposals from the
    mixture (Tierney 1994) and of differential evolution (ter Braak 2006). If the chains mix
    slowly, the mixture is fitted again to the kept draws, which are then discarded: not in the
    second half of the effort's limit.

    Parameters
    ----------
    density : callable
        Log density of points (n, dim), (n,). What is surely below the number may be −inf instead.
    derived : callable, optional
        Other quantities that must converge too, (n, dim) -> (n, m).
    report : callable, optional
        Called with a `Progress` after every block of steps.
    """
    walk = _Walk(density, modes, effort, rng, derived)
    walk.warm_up()
    wait = min(FIRST, math.ceil(effort.length * LEAST))
    while True:
        walk.run(max(1, min(wait, effort.limit - walk.steps)))
        chains = walk.chains()
        if report is not None:
            report(walk.progress(chains))
        if walk.done(chains) >= 1.0 or walk.steps >= effort.limit:
            return chains
        if walk.is_slow(chains) and 2 * walk.steps <= effort.limit:
            walk.fit_again()
        longest = max(FIRST // 2, walk.fresh // 2)
        wait = max(LEAST_WAIT, walk.fresh // 4, math.ceil(min(1.1 * walk.left(chains), longest)))


class _Walk:
    """The walkers of all ensembles, which move together, their proposal and stored steps."""

    def __init__(
        self,
        density: Callable[[Array, float], Array],
        modes: Sequence[Mode],
        effort: Effort,
        rng: np.random.Generator,
        derived: Callable[[Array], Array] | None,
    ) -> None:
        self._density, self._effort, self._rng, self._derived = density, effort, rng, derived
        self._walkers = 2 * max(effort.walkers // 2, len(modes[0].q) + 3)
        self._total = effort.ensembles * self._walkers
        self._began = self._told = time.perf_counter()
        self.steps = self._fitted = 0
        self._round = ROUND
        self._lowest = max(mode.log_prob for mode in modes) - NEVER
        self._first = around_modes(modes, BROAD)

    def warm_up(self) -> None:
        """Fit the proposal, and place the walkers at weighted draws."""
        found = self._adapt(self._first)
        pick = self._rng.choice(len(found.q), self._total, p=found.weights)
        self._q, self._log_prob = found.q[pick], found.log_prob[pick]
        self._use(found.mixture())

    def fit_again(self) -> None:
        """Fit the proposal again, with the kept steps, if they are twice those of the last fit."""
        if len(self._stored) * self._stride < 2 * self._fitted:
            return
        self._fitted = len(self._stored) * self._stride
        draws = np.concatenate([q for q, _ in self._stored[len(self._stored) // 4 :]])
        if len(draws) > FITTED:
            draws = draws[self._rng.choice(len(draws), FITTED, replace=False)]
        walked = fit_mixture(draws, self._rng)
        self._round *= 2
        found = self._adapt(joined([walked, self._proposal], [0.8, 0.2]))
        self._use(joined([walked, found.mixture()], [0.3, 0.7]))

    def _adapt(self, first: Mixture) -> Adaptive:
        """Weighted draws from the first proposal and those that follow, until they are enough."""

        def bounded(q: Array) -> Array:
            log_prob = self._density(q, self._lowest)
            return np.where(log_prob < self._lowest, -np.inf, log_prob)

        found = Adaptive(bounded, first, self._rng, self._round * self._total)
        for _ in range(ADAPTED):
            self.steps += self._round
            if found.run().size >= SIZE:
                break
        return found

    def _use(self, proposal: Mixture) -> None:
        """Propose from a mixture, and drop the stored steps: all kept draws must be of one."""
        self._proposal, self._log_q = proposal, proposal.log_density(self._q)
        self.fresh, self._stride = 0, 1
        self._stored: list[tuple[Array, Array]] = []
        self._moved = np.zeros(self._total)

    def run(self, steps: int) -> None:
        """Continue for some steps, and store every stride-th of them."""
        for _ in range(steps):
            if self._rng.random() < JUMPS:
                fresh = self._proposal.draw(self._rng, self._total)
                self._move(np.arange(self._total), fresh, self._proposal.log_density(fresh))
            else:
                self._evolve()
            self.fresh += 1
            if self.fresh % self._stride == 0:
                self._stored.append((self._q.copy(), self._log_prob.copy()))
            if len(self._stored) >= STORED:
                self._stored, self._stride = self._stored[1::2], 2 * self._stride
        self.steps += steps

    def _move(self, rows: NDArray[np.intp], fresh: Array, log_q: Array | None) -> None:
        """Metropolis-Hastings of some walkers; symmetric proposals have no density `log_q`."""
        log_prob = self._density(fresh, float(self._log_prob.min()) - NEVER)
        gain = log_prob - self._log_prob[rows]
        if log_q is not None:
            gain += self._log_q[rows] - log_q
        taken = np.log(self._rng.random(len(rows))) < gain
        moved = rows[taken]
        self._q[moved], self._log_prob[moved] = fresh[taken], log_prob[taken]
        self._log_q[moved] = (
            self._proposal.log_density(fresh[taken]) if log_q is None else log_q[taken]
        )
        self._moved[moved] += 1.0

    def _evolve(self) -> None:
        """Differential evolution: each half of an ensemble moves by differences of the other half.

        One step in five moves by the full difference of two walkers, to jump between modes.
        """
        ensembles, half = self._effort.ensembles, self._walkers // 2
        order = np.argsort(self._rng.random((ensembles, self._walkers)), axis=1)
        order += self._walkers * np.arange(ensembles)[:, None]
        halves = order[:, :half], order[:, half:]
        scale = 1.0 if self._rng.random() < 0.2 else 2.38 / math.sqrt(2 * self._q.shape[1])
        for moving, still in (halves, halves[::-1]):
            first = self._rng.integers(half, size=moving.shape)
            other = (first + self._rng.integers(1, half, size=moving.shape)) % half
            away = self._q[np.take_along_axis(still, first, 1)]
            away -= self._q[np.take_along_axis(still, other, 1)]
            rows = moving.reshape(-1)
            stretch = scale * (1.0 + 1e-3 * self._rng.standard_normal((rows.size, 1)))
            self._move(rows, self._q[rows] + stretch * away.reshape(rows.size, -1), None)

    def done(self, chains: Chains) -> float:
        """Share of the targets that is reached: of the length first, which is known at once."""
        effort = self._effort
        asked = effort.length * max(chains.slowest, LEAST)
        length = self.fresh / asked if asked > 0.0 else math.inf
        if length < 1.0:
            return length
        return chains.convergence.share(effort.r_hat, effort.ess)

    def is_slow(self, chains: Chains) -> bool:
        """Whether the walkers mix slowly, or are far from the effort's effective sample size."""
        size = self._total * self.fresh / max(chains.slowest, 1.0)
        return size < 0.5 * self._effort.ess or chains.slowest > SLOW

    def left(self, chains: Chains) -> float:
        """Estimated number of steps still to be kept until the effort's targets are met."""
        done = self.done(chains)
        return self.fresh * (1.0 / done - 1.0) if done > 0.0 else math.inf

    def progress(self, chains: Chains) -> Progress:
        """Progress of the sampling; without R̂ and ESS while the run is too short, see `SILENT`."""
        lacking = []
        effort, left = self._effort, self.left(chains)
        share = self.steps / max(self.steps, min(self.steps + left, effort.limit))
        worst, now = (math.nan, math.nan), time.perf_counter()
        asked = effort.length * max(chains.slowest, LEAST)
        if self.fresh < asked:
            lacking.append(f"{self.fresh:.0f} of {math.ceil(asked)} kept steps")
        if self.fresh >= asked or now - self._told > SILENT:
            found, self._told = chains.convergence, now
            worst = found.worst_r_hat, found.worst_ess
            if not worst[0] <= effort.r_hat:
                lacking.append(f"R-hat {effort.r_hat:g}")
            if not worst[1] >= effort.ess:
                lacking.append(f"ESS {effort.ess:g}")
        seconds, missing = now - self._began, " and ".join(lacking)
        return Progress(self.steps, effort.limit, *worst, seconds, share, missing)

    def chains(self) -> Chains:
        """Thinned draws since the proposal was frozen."""
        ensembles, walkers = self._effort.ensembles, self._walkers
        q, log_prob = (
            np.swapaxes(np.reshape(part, (len(part), ensembles, walkers, -1)), 0, 1)
            for part in zip(*self._stored, strict=True)
        )
        thin = max(1, q.shape[1] * walkers // self._effort.kept)
        kept, heights = q[:, thin - 1 :: thin], log_prob[:, thin - 1 :: thin]
        watched = [kept, heights]
        if self._derived is not None:
            others = self._derived(kept.reshape(-1, kept.shape[-1]))
            watched.append(others.reshape(*kept.shape[:-1], -1))
        return Chains(
            q=np.swapaxes(kept, 1, 2).reshape(ensembles, -1, q.shape[-1]),
            log_prob=np.swapaxes(heights, 1, 2).reshape(ensembles, -1),
            walkers=walkers,
            steps=self.steps,
            thin=thin * self._stride,
            discarded=self.steps - self.fresh,
            acceptance=self._moved.reshape(ensembles, walkers).mean(axis=1) / self.fresh,
            autocorrelation=self._stride * autocorrelation_time(q),
            watched=np.concatenate(watched, axis=-1),
        )
