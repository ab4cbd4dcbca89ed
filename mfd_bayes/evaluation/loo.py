"""Leave-one-cycle-out cross-validation of a calibrated test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import measure_draws, psis
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.evaluation.cycles import Cycles, cycle_log_likelihood, find_cycles
from mfd_bayes.evaluation.evidence import log_evidence

Array = NDArray[np.float64]

LARGEST_K = 0.7
"""Pareto k above which the importance weights of a cycle cannot be trusted."""

_FIGURES = ("elpd", "lppd", "psis_k", "k")


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Leave-one-cycle-out figures, one for each cycle.

    As in Vehtari, Gelman and Gabry (2017), but whole cycles are left out, since neighbouring
    samples of a record depend on each other. Where PSIS weights cannot be trusted because a
    cycle is too informative, p(y_c | y_-c) = p(y)/p(y_-c) is computed from both evidences.

    Attributes
    ----------
    elpd : (C,)
        Expected log predictive density, log p(y_c | y_-c).
    lppd : (C,)
        The same under the posterior with the cycle included.
    psis_k : (C,)
        Pareto k of PSIS with the posterior's draws.
    k : (C,)
        Pareto k of the weights behind `elpd`, from PSIS or from the evidences.
    test : (C,) int, optional
        Number of each cycle's test, where there are several.
    """

    elpd: Array
    lppd: Array
    psis_k: Array
    k: Array
    test: NDArray[np.intp] | None = None

    @property
    def cycles(self) -> int:
        """Number of cycles C."""
        return self.elpd.size

    @property
    def total(self) -> float:
        """Expected log predictive density of all cycles."""
        return float(self.elpd.sum())

    @property
    def error(self) -> float:
        """Standard error of the total."""
        return standard_error(self.elpd, self.test)

    @property
    def p_loo(self) -> float:
        """Effective number of parameters."""
        return float(np.sum(self.lppd - self.elpd))

    @property
    def bad(self) -> NDArray[np.bool_]:
        """Whether the figures of a cycle cannot be trusted, (C,)."""
        return ~(self.k <= LARGEST_K)

    @property
    def redone(self) -> NDArray[np.bool_]:
        """Whether PSIS failed for a cycle, (C,)."""
        return ~(self.psis_k <= LARGEST_K)

    def part(self, chosen: NDArray[np.bool_]) -> CrossValidation:
        """Figures of the chosen cycles; `chosen` is (C,)."""
        kept = {name: getattr(self, name)[chosen] for name in _FIGURES}
        return CrossValidation(**kept, test=None if self.test is None else self.test[chosen])


def cross_validate(
    posterior: Posterior,
    values: Mapping[str, Array],
    chains: int,
    walkers: int,
    rng: np.random.Generator,
) -> CrossValidation:
    """Leave-one-cycle-out figures of a calibrated test.

    Parameters
    ----------
    values : mapping of str to (chain · draw,)
        Posterior draws of all quantities, in their stored order.
    chains, walkers : int
        Number of chains, and of walkers in each.

    Raises
    ------
    FitError
        When the record has too few cycles.
    """
    cycles = find_cycles(posterior.trace, posterior.first)
    given = cycle_log_likelihood(posterior, values, cycles)[0]
    found = []
    for column in given.T:
        ess = measure_draws(column.reshape(chains, -1), walkers).ess_bulk[0]
        found.append(leave_out(column, float(np.clip(ess / column.size, 1e-3, 1.0))))
    elpd, lppd, psis_k = np.transpose(found)
    plain = CrossValidation(elpd, lppd, psis_k, psis_k)
    if not np.any(plain.redone):
        return plain
    k = psis_k.copy()
    draws = posterior.coordinates(values)
    whole, whole_k = log_evidence(posterior.log_prob, draws, np.zeros(len(draws)), rng)
    for cycle in np.flatnonzero(plain.redone).tolist():
        rest = without_cycle(posterior, cycles, cycle)
        evidence, rest_k = log_evidence(rest, draws, -given[:, cycle], rng)
        if max(whole_k, rest_k) < k[cycle]:
            elpd[cycle], k[cycle] = whole - evidence, max(whole_k, rest_k)
    return CrossValidation(elpd, lppd, psis_k, k)


def without_cycle(posterior: Posterior, cycles: Cycles, cycle: int) -> Callable[[Array], Array]:
    """Log posterior density of q without one cycle, p(θ) p(y_-c | θ), (n, dim) -> (n,)."""

    def density(q: Array) -> Array:
        found = posterior.log_prior(q)
        inside = np.isfinite(found)
        with np.errstate(over="ignore", invalid="ignore"):
            given, whole = cycle_log_likelihood(posterior, posterior.values(q[inside]), cycles)
            found[inside] += whole - given[:, cycle]
        return np.where(np.isnan(found), -np.inf, found)

    return density


def leave_out(log_likelihood: Array, efficiency: float = 1.0) -> tuple[float, float, float]:
    """Elpd, lppd and Pareto k of one cycle, from its log density under each draw, (n,).

    The posterior without the cycle is the full one divided by p(y_c | y_-c, θ): the draws are
    weighted by the inverse of that.
    """
    log_weights, k = psis(-log_likelihood, efficiency)
    elpd = np.logaddexp.reduce(log_weights + log_likelihood)
    lppd = np.logaddexp.reduce(log_likelihood) - np.log(log_likelihood.size)
    return float(elpd), float(lppd), k


def join(parts: Iterable[CrossValidation]) -> CrossValidation:
    """Figures of several tests, joined over all their cycles."""
    several = list(parts)
    joined = {n: np.concatenate([getattr(p, n) for p in several]) for n in _FIGURES}
    test = np.repeat(np.arange(len(several)), [p.cycles for p in several])
    return CrossValidation(**joined, test=test)


def standard_error(figures: Array, test: NDArray[np.intp] | None = None) -> float:
    """Standard error of a sum over cycles; NaN for fewer than two.

    The cycles of one test resemble each other, so that tests count, not cycles: with J tests and
    the sum s_j of the cycles of test j, less the mean over all cycles, it is
    √(J/(J − 1) Σ s_j²), but never less than if all cycles were independent, √(C var). Of one test
    only the latter is known.

    Parameters
    ----------
    figures : (C,)
    test : (C,) int, optional
        Number of each cycle's test; one test if not given.
    """
    if figures.size < 2:
        return float("nan")
    alone = np.sqrt(figures.size * np.var(figures, ddof=1))
    tests = np.empty(0) if test is None else np.unique(test)
    if tests.size < 2:
        return float(alone)
    away = figures - figures.mean()
    sums = np.array([away[test == one].sum() for one in tests])
    return float(max(alone, np.sqrt(tests.size / (tests.size - 1) * np.sum(sums**2))))


def difference(one: CrossValidation, other: CrossValidation) -> tuple[float, float]:
    """Elpd of one minus that of the other, and its standard error, paired over cycles."""
    apart = one.elpd - other.elpd
    return float(apart.sum()), standard_error(apart, one.test)
