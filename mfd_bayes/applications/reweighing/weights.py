"""Importance weights that take draws from one prior to another (Kong, 1992; PSIS).

The likelihood of a test is the same under both, so that its weights are the ratio of the priors of
its parameters x; both densities are of x itself, whatever coordinates either is sampled in. The
population's draws are joint ones of population and tests. Between these two everything is the same
but the priors of levels, scatter and effects, and of what each test has to itself: their ratio
weighs all of it at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import effective_size, psis, systematic
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.errors import PriorError
from mfd_bayes.population.conditioning import effective_draws
from mfd_bayes.population.design import Design
from mfd_bayes.population.law_scores import LARGEST_K

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST = 0.5  # share of the effective draws that a run aimed at, which weights must leave
FLOOR = 600.0  # log weights farther below the largest one are as far below


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of draws, or why there are none."""

    log: Array  # (n,), smoothed and normalised; empty where there are none
    pareto_k: float
    efficiency: float  # share of the draws' worth that is left
    reason: str = ""

    @classmethod
    def none(cls, reason: str) -> Weights:
        """No weights, for a reason."""
        return cls(np.empty(0), np.inf, 0.0, reason)

    @classmethod
    def of(cls, log_ratio: Array, min_share: float) -> Weights:
        """Of log ratios of the priors, (chain, draw); at least `min_share` must be left."""
        flat = log_ratio.ravel()
        if not np.any(np.isfinite(flat)):
            return cls.none("the other prior excludes every draw")
        size = effective_size(np.nan_to_num(log_ratio, neginf=flat[np.isfinite(flat)].min()))
        share = np.clip(size / flat.size, 1e-3, 1.0) if np.isfinite(size) else 1.0
        log, k = psis(np.maximum(flat, np.max(flat) - FLOOR), float(share))
        efficiency, reason = effective_draws(log) / flat.size, ""
        if k > LARGEST_K:
            reason = f"Pareto k {k:.2f}"
        elif efficiency < min(min_share, 1.0):
            reason = f"only {efficiency:.0%} of the draws' worth would be left"
        return cls(log, k, efficiency, reason)

    def pick(self, rng: np.random.Generator) -> Index:
        """Numbers of as many draws by their weights, increasing."""
        return systematic(self.log, self.log.size, rng)

    @property
    def words(self) -> str:
        """How the draws under the other prior are made."""
        if self.reason:
            return f"sampled ({self.reason})"
        k = f"Pareto k {self.pareto_k:.2f}, " if np.isfinite(self.pareto_k) else ""
        return f"weighted ({k}{self.efficiency:.0%} of the draws' worth)"


def check_same_parameters(posterior: Posterior, target: Posterior, file: str) -> None:
    """Refuse priors under which other parameters are sampled, or fixed at other values."""
    for name, prior in posterior.priors.items():
        target_prior, advice = target.priors[name], "calibrate the campaign with it"
        if prior.fixed != target_prior.fixed:
            verbs = ("fixes", "sampled") if target_prior.fixed else ("samples", "fixed")
            raise PriorError(f"{file} {verbs[0]} {name}, which the run {verbs[1]}: {advice}")
        if prior.fixed and prior.figures != target_prior.figures:
            raise PriorError(f"{file} fixes {name} at another value than the run: {advice}")


def weights_of_test(
    posterior: Posterior, target: Posterior, draws: Mapping[str, Array], min_share: float
) -> Weights:
    """Weights of a test's draws by name, (chain, draw) each, from its posterior to another.

    `min_share` is the share of the draws' worth that they must leave.
    """
    if posterior.first != target.first:
        return Weights.none("the first slip by the other priors is at another sample")
    log_ratio = np.zeros(draws["offset"].shape)
    for name in posterior.names:
        prior, target_prior = posterior.priors[name], target.priors[name]
        if _same(prior, target_prior):
            continue
        if target_prior.lower < prior.lower or target_prior.upper > prior.upper:
            return Weights.none(f"the other prior of {name} allows what the run's excludes")
        log_ratio += target_prior.log_density_of(draws[name]) - prior.log_density_of(draws[name])
    return Weights.of(log_ratio, min_share)


def _same(prior: Prior, target: Prior) -> bool:
    return prior.family == target.family and dict(prior.figures) == dict(target.figures)


def difference_of_layout(design: Design, target: Design) -> str:
    """Why draws of one design are none of another; "" where they are."""
    for name in design.coordinates.names:
        bounds = [
            (d.coordinates.priors[name].lower, d.coordinates.priors[name].upper)
            for d in (design, target)
        ]
        if bounds[0] != bounds[1]:
            return f"the prior of {name} has other bounds, and so its laws are of another scale"
    if not np.array_equal(design.common, target.common):
        return "other quantities are the same in all tests"
    layouts = [[(e.name, e.group, e.members) for e in d.effects] for d in (design, target)]
    if layouts[0] != layouts[1]:
        return "the groups of scatter are others"
    return ""
