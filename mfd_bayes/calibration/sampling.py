"""Posterior draws of one test, by independent ensembles of walkers that run until they converge.

emcee takes long to import: other files import this one where a test is sampled.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import emcee
import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import (
    Convergence,
    autocorrelation_time,
    interval_rows,
    intervals_of,
    measure,
    measure_draws,
)
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import units
from mfd_bayes.calibration.proposal import (
    Density,
    Evidence,
    Mixture,
    Mode,
    Proposal,
    Rows,
    climb,
    find_modes,
    fit_proposal,
    laplace_mixture,
    log_evidence,
)
from mfd_bayes.errors import FitError, whole_number
from mfd_bayes.jobs.job import Progress
from mfd_bayes.messages import counted
from mfd_bayes.store.cards import grid

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

STORED = 3000  # steps stored for each walker; beyond it, every second one is dropped
ROUND = 20  # steps after which the proposal is learned again during the warm-up
ROUNDS = 12  # largest number of such rounds at full power; fewer where they no longer help
INVERSE_TEMPERATURES = (0.3, 0.35, 0.5, 0.65, 0.8)  # powers of the density in the first rounds
BROAD = 0.5  # the proposal learned at this power stays part of all later ones
FIRST = 80  # largest number of kept steps after which convergence is measured first
SLOW = 40.0  # autocorrelation time, steps, above which the proposal is learned again
LEAST = 16.0  # least autocorrelation time that is used: far tails are visited more rarely
PARTS = 6  # largest number of Student-t components of a learned proposal, besides the wide one
REQUIRED = 200  # correlated draws per dimension that each component needs
JUMPS = 0.7  # share of independence proposals; the other steps are differential evolution


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of a density; each ensemble is a chain.

    A chain's draws are ordered by walker and, within a walker, by step, so that the
    autocorrelation of a chain is that of its walkers.
    """

    q: Array  # (chain, draw, dim)
    log_prob: Array  # (chain, draw)
    walkers: int
    steps: int  # of each ensemble
    thin: int  # steps between kept draws
    discarded: int  # steps of the warm-up, in which the proposal was fitted
    acceptance: Array  # (chain,)
    autocorrelation: Array  # (dim,), integrated autocorrelation time, steps
    watched: Array  # (ensemble, step, walker, m): coordinates, log density, derived quantities

    @property
    def slowest(self) -> float:
        """Largest autocorrelation time of a coordinate, steps."""
        return float(np.max(self.autocorrelation))

    @cached_property
    def convergence(self) -> Convergence:
        """Of all that is watched, in that order; to measure it takes as long as some ten steps."""
        return measure(self.watched)


def sample_density(
    density: Density,
    modes: Sequence[Mode],
    effort: Effort,
    rng: np.random.Generator,
    *,
    derived: Callable[[Array], Array] | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Chains:
    """Draws of a density, from ensembles started around its modes.

    In the warm-up, walkers sample a power of the density, raised in rounds to 1, and a mixture
    of Student-t densities is learned from their positions. The mixture is then frozen, and
    draws are kept: from independence proposals of the mixture and differential evolution. If
    the chains mix slowly, or are far from the effort's target, the mixture is learned again
    from the kept draws, which are then discarded: not in the second half of the effort's limit.
    `derived` gives other quantities that must converge too, (n, dim) -> (n, m).
    """
    began = time.perf_counter()
    walk = _Walk(density, modes, effort, rng)
    walk.warm_up()
    wait = min(FIRST, math.ceil(effort.length * LEAST))
    while True:
        walk.run(max(1, min(wait, effort.limit - walk.steps)))
        chains = walk.chains(derived)
        required = max(effort.length * max(chains.slowest, LEAST), 1e-9)
        fraction, r_hat, ess = walk.kept / required, math.nan, math.nan
        missing = f"{walk.kept} of {required:.0f} kept steps"
        if long_enough := fraction >= 1.0:  # only now is the convergence worth measuring
            fraction = chains.convergence.share(effort.r_hat, effort.ess)
            r_hat, ess = chains.convergence.worst_r_hat, chains.convergence.worst_ess
            lacking = [] if r_hat <= effort.r_hat else [f"R-hat {effort.r_hat:g}"]
            lacking += [] if ess >= effort.ess else [f"ESS {effort.ess:g}"]
            missing = " and ".join(lacking)
        remaining = walk.kept * (1.0 / fraction - 1.0) if fraction > 0.0 else math.inf
        if report is not None:
            share = walk.steps / max(walk.steps, min(walk.steps + remaining, effort.limit))
            seconds = time.perf_counter() - began
            report(Progress(walk.steps, effort.limit, r_hat, ess, seconds, share, missing))
        reached = long_enough and chains.convergence.reached(effort.r_hat, effort.ess)
        if reached or walk.steps >= effort.limit:
            return chains
        size = chains.walkers * effort.ensembles * walk.kept / max(chains.slowest, 1.0)
        slow = size < 0.5 * effort.ess or chains.slowest > SLOW
        if slow and 2 * walk.steps <= effort.limit and walk.learn_again():
            remaining = math.inf
        longest = max(FIRST // 2, walk.kept // 2)
        wait = max(ROUND, walk.kept // 4, math.ceil(min(1.1 * remaining, longest)))


class _Walk:
    """The walkers of all ensembles, which move together, their proposal and stored steps."""

    def __init__(
        self, density: Density, modes: Sequence[Mode], effort: Effort, rng: np.random.Generator
    ) -> None:
        dim = len(modes[0].q)
        self._effort, self._rng = effort, rng
        self._walkers = 2 * max(effort.walkers // 2, dim + 3)
        self._power = INVERSE_TEMPERATURES[0]

        def powered(q: Array) -> Array:
            return self._power * density(q)

        self._anchors: Mixture | Proposal = laplace_mixture(modes, self._power)
        self._independent = IndependenceMove(self._anchors, rng)
        self._sampler = emcee.EnsembleSampler(
            effort.ensembles * self._walkers,
            dim,
            powered,
            moves=[(self._independent, JUMPS), *evolution(dim, effort.ensembles, 1.0 - JUMPS)],
            vectorize=True,
        )
        # emcee takes a RandomState's state and silently ignores anything else
        twister = np.random.RandomState(int(rng.integers(2**32))).get_state()
        begin = initial_walkers(powered, self._anchors, self._sampler.nwalkers, rng)
        self._state = emcee.State(begin, random_state=twister)
        self.steps = self._learned = 0
        self._freeze()

    def warm_up(self) -> None:
        """Learn the proposal in rounds, until another one would cost more than it saves.

        A round costs its steps; a better acceptance rate shortens what is kept in proportion.
        """
        max_steps = self._effort.limit // 4
        for power in INVERSE_TEMPERATURES:
            if self.steps >= max_steps:
                break
            self._raise(power)
            self.run(ROUND)
            self._learn(0.75)
            if power == BROAD:
                self._anchors = Proposal((0.3, 0.7), (self._anchors, self._independent.source))
        self._raise(1.0)
        gain, best = 1.0 + ROUND / max(self._effort.length * LEAST, 1.0), 0.0
        for _ in range(ROUNDS):
            self._independent.proposed = self._independent.accepted = 0
            self.run(ROUND)
            accepted = self._independent.accepted / max(self._independent.proposed, 1)
            self._learn(0.5)
            if accepted < gain * best or self.steps >= max_steps:
                break
            best = accepted
        self._freeze()

    def _raise(self, power: float) -> None:
        """Continue at a new power of the density, without the steps stored before."""
        state = emcee.State(self._state, copy=True)
        if state.log_prob is not None:  # None before the first step
            state.log_prob *= power / self._power
        self._state, self._power = state, power
        self._freeze()

    def learn_again(self) -> bool:
        """Learn the proposal from the kept steps and keep anew, if there are enough of them."""
        enough = len(self._coords) * self._stride >= 4 * self._learned
        if enough:
            self._learn(0.75)
            self._freeze()
        return enough

    def _learn(self, share: float) -> None:
        """Learn the proposal from the last share of the stored steps."""
        late = self._coords[-math.ceil(share * len(self._coords)) :]
        self._learned = len(late) * self._stride
        draws = np.concatenate(late)
        components = int(np.clip(len(draws) // (REQUIRED * draws.shape[1]), 1, PARTS))
        self._independent.source = fit_proposal(draws, components, self._rng, self._anchors)

    def _freeze(self) -> None:
        """Drop the stored steps: all kept draws must come from one proposal."""
        self.kept, self._stride = 0, 1
        self._coords: list[Array] = []
        self._log_prob: list[Array] = []
        self._moved = np.zeros(self._sampler.nwalkers)

    def run(self, steps: int) -> None:
        """Continue for some steps, and store every stride-th of them."""
        for state in self._sampler.sample(
            self._state, iterations=steps, store=False, skip_initial_state_check=True
        ):
            self._moved += np.any(state.coords != self._state.coords, axis=1)
            self._state = emcee.State(state, copy=True)
            self.kept += 1
            if self.kept % self._stride == 0:
                self._coords.append(self._state.coords)
                self._log_prob.append(self._state.log_prob)
            if len(self._coords) >= STORED:
                self._coords, self._log_prob = self._coords[1::2], self._log_prob[1::2]
                self._stride *= 2
        self.steps += steps

    def chains(self, derived: Callable[[Array], Array] | None) -> Chains:
        """Thinned draws since the proposal was frozen."""
        ensembles, walkers = self._effort.ensembles, self._walkers
        shape = (len(self._coords), ensembles, walkers)
        full = np.swapaxes(np.reshape(self._coords, (*shape, -1)), 0, 1)
        log_prob = np.swapaxes(np.reshape(self._log_prob, shape), 0, 1)
        thin = max(1, len(self._coords) * walkers // self._effort.kept)
        thinned, thinned_log_prob = full[:, thin - 1 :: thin], log_prob[:, thin - 1 :: thin]
        watched = [thinned, thinned_log_prob[..., None]]
        if derived is not None:
            extra = derived(thinned.reshape(-1, thinned.shape[-1]))
            watched.append(extra.reshape(*thinned.shape[:-1], -1))
        return Chains(
            q=np.swapaxes(thinned, 1, 2).reshape(ensembles, -1, full.shape[-1]),
            log_prob=np.swapaxes(thinned_log_prob, 1, 2).reshape(ensembles, -1),
            walkers=walkers,
            steps=self.steps,
            thin=thin * self._stride,
            discarded=self.steps - self.kept,
            acceptance=np.reshape(self._moved, (ensembles, walkers)).mean(axis=1) / self.kept,
            autocorrelation=self._stride * autocorrelation_time(full),
            watched=np.concatenate(watched, axis=-1),
        )


# --- moves of the walkers -------------------------------------------------------------------------


def accept(
    model: emcee.model.Model, state: emcee.State, index: Rows, proposal: Array, factor: Array
) -> Rows:
    """Walkers of those at `index` that move to their proposals, by Metropolis and Hastings."""
    log_prob = np.asarray(model.compute_log_prob_fn(proposal)[0])
    gain = log_prob - state.log_prob[index] + factor
    accepted = np.log(model.random.rand(index.size)) < gain
    moved: Rows = index[accepted]
    state.coords[moved], state.log_prob[moved] = proposal[accepted], log_prob[accepted]
    return moved


class WithinEnsembles(emcee.moves.Move):  # type: ignore[misc]  # emcee is not typed
    """A red–blue move of emcee, applied within each of several independent ensembles.

    Each half of an ensemble moves by the other half of the same ensemble alone; the density is
    evaluated for all ensembles in one batch.
    """

    def __init__(self, move: emcee.moves.RedBlueMove, ensembles: int) -> None:
        self.move, self.ensembles = move, ensembles

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """New state, and which walkers moved, (ensembles · walkers,)."""
        self.move.setup(state.coords)
        total = len(state.coords)
        walkers = total // self.ensembles
        order = np.argsort(model.random.rand(self.ensembles, walkers), axis=1)
        order += walkers * np.arange(self.ensembles)[:, None]
        halves = order[:, : walkers // 2], order[:, walkers // 2 :]
        accepted = np.zeros(total, dtype=bool)
        for moving, resting in (halves, halves[::-1]):
            pairs = [
                self.move.get_proposal(state.coords[m], [state.coords[s]], model.random)
                for m, s in zip(moving, resting, strict=True)
            ]
            proposal, factor = (np.concatenate(arrays) for arrays in zip(*pairs, strict=True))
            accepted[accept(model, state, moving.reshape(-1), proposal, factor)] = True
        return state, accepted


class IndependenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee is not typed
    """Metropolis–Hastings with proposals that do not depend on a walker's position.

    Walkers are independent here, so that all move in one batch. The target stays invariant
    as long as the proposal is unchanged; draws from which it was learned must be discarded.
    """

    def __init__(self, proposal: Mixture | Proposal, rng: np.random.Generator) -> None:
        self.source, self._rng = proposal, rng
        self.proposed = self.accepted = 0

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """New state, and which walkers moved, (walkers,)."""
        total = len(state.coords)
        proposal, accepted = self.source.draw(self._rng, total), np.zeros(total, dtype=bool)
        factor = self.source.log_density(state.coords) - self.source.log_density(proposal)
        accepted[accept(model, state, np.arange(total), proposal, factor)] = True
        self.proposed += total
        self.accepted += int(accepted.sum())
        return state, accepted


def evolution(dim: int, ensembles: int, weight: float) -> list[tuple[emcee.moves.Move, float]]:
    """Differential evolution moves within each ensemble, with their weights.

    One step in five moves by the full difference of two walkers, so that it can jump between
    modes. emcee 3.1.6's DESnookerMove does not sample the target and is not used.
    """
    gamma = 2.38 / np.sqrt(2 * dim)
    return [
        (WithinEnsembles(emcee.moves.DEMove(sigma=1e-3, gamma0=gamma), ensembles), 0.8 * weight),
        (WithinEnsembles(emcee.moves.DEMove(sigma=1e-3, gamma0=1.0), ensembles), 0.2 * weight),
    ]


def initial_walkers(
    density: Density, anchors: Mixture | Proposal, walkers: int, rng: np.random.Generator
) -> Array:
    """Starting points (walkers, dim): draws around the modes, chosen by importance weights."""
    draws = anchors.draw(rng, 4 * walkers)
    ratio = density(draws) - anchors.log_density(draws)
    top = np.sort(ratio)[-max(10, len(ratio) // 100)]
    if not np.isfinite(top):
        raise FitError("no density around the modes: the posterior cannot be sampled")
    weights = np.exp(np.minimum(ratio - top, 0.0))
    return draws[rng.choice(len(draws), size=walkers, p=weights / weights.sum())]


# --- draws of one test ----------------------------------------------------------------------------


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
    posterior : Posterior
        That was sampled.
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
    posterior: Posterior

    @property
    def convergence(self) -> Convergence:
        """R̂ and effective sample sizes of every coordinate and derived quantity."""
        return self.chains.convergence

    def log_evidence(self, seed: int | Sequence[int] = 0) -> Evidence:
        """Log of likelihood times prior, integrated, by bridge sampling from these draws.

        It compares models of the same record, and depends on their priors.
        """
        rng, walkers = generator_of(seed), self.chains.walkers
        return log_evidence(self.posterior.log_prob, self.q, self.log_prob, walkers, rng)

    def summary(self) -> pd.DataFrame:
        """A row for each quantity that varies, in internal units.

        Columns: unit, mean, sd, q2.5, q50, q97.5, r_hat, ess_bulk and ess_tail.
        """
        import pandas as pd

        unit_of, rows = units(self.posterior.model), {}
        for name, draws in self.values.items():
            if np.ptp(draws) > 0.0:
                low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975]).tolist()
                row = {"unit": unit_of.get(name, ""), "mean": draws.mean(), "sd": draws.std()}
                row |= {"q2.5": low, "q50": middle, "q97.5": high}
                rows[name] = row | measure_draws(draws, self.chains.walkers).figures()
        return pd.DataFrame.from_dict(rows, orient="index")

    def to_inference_data(self, seed: int = 0) -> Any:
        """What ArviZ's functions take: InferenceData, or a DataTree from ArviZ 1 on.

        Its groups are posterior, sample_stats (lp), prior, log_prior, log_likelihood, observed_data
        and constant_data. Both densities sum to the joint ones, as `psense` needs them; of the log
        likelihood, `force` is that of each cycle given all others, by which
        `az.loo(data, var_name="force")` leaves out whole cycles. A record of fewer than three has
        the sum alone. The prior has as many draws as a chain, by `seed`.
        """
        from mfd_bayes.calibration.cycles import density_groups
        from mfd_bayes.store.netcdf import arviz_data, draws_group, trace_groups

        unit_of, n = units(self.posterior.model), self.q.shape[1]
        of_prior = self.posterior.sample_prior(n, seed)
        return arviz_data(
            {
                "posterior": draws_group(self.values, unit_of),
                "sample_stats": draws_group({"lp": self.log_prob}),
                "prior": draws_group({k: v[None] for k, v in of_prior.items()}, unit_of),
                **density_groups(self.posterior, self.values, self.log_likelihood),
                **trace_groups(self.posterior.trace),
            }
        )

    def __repr__(self) -> str:
        return self._title

    @property
    def _title(self) -> str:
        """How many draws of what, and whether they have converged."""
        chains, draws, _ = self.q.shape
        return (
            f"Draws: {counted(chains, 'chain')} of {draws}, {len(self.names)} quantities of "
            f"{self.posterior.model.name}; worst R-hat {self.convergence.worst_r_hat:.3f}, "
            f"smallest ESS {self.convergence.worst_ess:.0f}, {self.wall_time:.1f} s"
        )

    def _repr_html_(self) -> str:
        return grid(self._title, *interval_rows(intervals_of(self.values)))


def sample(
    posterior: Posterior,
    effort: str | Effort = "standard",
    seed: int | Sequence[int] = 0,
    *,
    report: Callable[[Progress], None] | None = None,
    begin: Array | None = None,
) -> Draws:
    """Posterior draws of one test, in four independent ensembles or more.

    Parameters
    ----------
    effort : {"standard", "quick", "thorough"} or Effort
    seed : int or sequence of int
        The same seed gives the same draws. A sequence of one number is that number.
    report : callable, optional
        Called with a `Progress` after every block of steps.
    begin : (m, dim), optional
        Points near which the modes are, such as draws under another prior; they are looked for
        from the prior when left out.

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
    settings, rng = find_effort(effort), generator_of(seed)
    if begin is None:
        modes = find_modes(posterior, rng, starts=settings.starts)
    else:
        sd = posterior.coordinates(posterior.sample_prior(2000, rng)).std(axis=0)
        modes = climb(posterior, begin, sd)
    chains = sample_density(
        posterior.log_prob, modes, settings, rng, derived=posterior.derived, report=report
    )
    flat, shape = chains.q.reshape(-1, posterior.dim), chains.q.shape[:2]
    values = posterior.values(flat)
    for name in posterior.model.nonidentifiable:
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
        posterior=posterior,
    )


def generator_of(seed: int | Sequence[int]) -> np.random.Generator:
    """NumPy's random numbers of a seed, or a FitError where it is none."""
    several = np.ndim(seed) and not isinstance(seed, str | bytes)
    words = list(seed) if several else [seed]  # type: ignore[arg-type]
    if not words:
        raise FitError("seed must be a whole number, 0 or more, or some of them, got none")
    return np.random.default_rng([whole_number("seed", word, 0, FitError) for word in words])
