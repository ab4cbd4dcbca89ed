"""Whether a result follows the data or the prior: its sensitivity to power scaling.

Prior or likelihood is raised to a power below and above 1, by importance weights of the draws. The
sensitivity is how fast a quantity's distribution moves then: the cumulative Jensen-Shannon distance
over log2 of the power (Kallioinen, Paananen, Bürkner and Vehtari, Stat. Comput. 34, 57, 2024). It
is computed by ArviZ.

A quantity of which prior and data know about as much follows both, and they need not disagree:
they do where their powers move its mean too, in opposite directions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import array_stats, psis

Array = NDArray[np.float64]
Name = TypeVar("Name")

ALPHAS = (0.8, 1.25)  # powers; their logarithms are of one size
THRESHOLD = 0.05  # sensitivity from which a quantity is said to follow what was scaled
# change of a mean between these powers, over its sd, from which prior and data disagree: it is
# 0.22 of two normal densities of one width whose means lie a usual distance apart
PULL = 0.3


class Follows(StrEnum):
    """What a quantity follows."""

    DATA = "follows the data"
    PRIOR = "follows the prior"
    BOTH = "follows both"
    DISAGREE = "prior and data disagree"
    NEITHER = "hardly follows either"


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivities of a quantity to the power of the prior and of the likelihood.

    `pulls` are the changes of its mean from the lower to the upper power of each, over its sd.
    `pareto_k` is the largest of the weights of these powers: above 0.7 none can be trusted.
    """

    prior: float
    data: float
    pulls: tuple[float, float]
    pareto_k: float

    @property
    def verdict(self) -> Follows:
        """What the quantity follows."""
        if self.prior < THRESHOLD:
            return Follows.DATA if self.data >= THRESHOLD else Follows.NEITHER
        if self.data < THRESHOLD:
            return Follows.PRIOR
        opposed = self.pulls[0] * self.pulls[1] < 0.0 and min(map(abs, self.pulls)) >= PULL
        return Follows.DISAGREE if opposed else Follows.BOTH


def power_scaling(
    draws: Mapping[Name, Array], log_prior: Array, log_likelihood: Array
) -> dict[Name, Sensitivity]:
    """Sensitivities of quantities that vary, from draws and joint log densities, (chain, draw)."""
    names = [name for name, values in draws.items() if np.ptp(values) > 0.0]
    if not names:
        return {}
    values = np.stack([np.asarray(draws[name], np.float64) for name in names])
    columns = values.reshape(len(names), -1)
    sensitivities: list[Array] = []
    pulls: list[Array] = []
    shapes: list[float] = []
    for density in (log_prior, log_likelihood):
        logs, k = zip(*(psis((power - 1.0) * density.ravel()) for power in ALPHAS), strict=True)
        weights = np.exp(logs)
        low_mean, high_mean = (columns @ w for w in weights)
        pulls.append((high_mean - low_mean) / columns.std(axis=1))
        shapes += k
        lower, upper = (np.broadcast_to(w.reshape(density.shape), values.shape) for w in weights)
        sensitivities.append(array_stats().power_scale_sense(values, lower, upper, *ALPHAS))
    return {
        name: Sensitivity(float(prior), float(data), (float(a), float(b)), max(shapes))
        for name, prior, data, a, b in zip(names, *sensitivities, *pulls, strict=True)
    }
