"""Posterior draws of one test, by independent ensembles of walkers that run until they converge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.modes import Mode, find_modes, mode_shares, nearest_modes
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.quantities import interval_rows, intervals_of
from mfd_bayes.errors import FitError
from mfd_bayes.jobs.job import Progress
from mfd_bayes.records.numbers import whole_number
from mfd_bayes.store.cards import counted, grid

if TYPE_CHECKING:
    from mfd_bayes.calibration.ensembles import Chains

Array = NDArray[np.float64]


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
    from mfd_bayes.calibration.ensembles import sample_density  # emcee takes long to import

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
