"""Starting points of the walkers: around the modes, spread like the density."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.map_fit import Density, Mode
from mfd_bayes.calibration.mixture import Mixture, Proposal
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]


def around_modes(modes: Sequence[Mode], power: float) -> Mixture:
    """Laplace's approximation to a power of the density, at every mode that may matter.

    Laplace's masses are rough, so each mode's weight is the cube root of its mass. Modes whose
    log mass is more than 20 below the best are left out.
    """
    evidence = np.array([mode.log_evidence for mode in modes])
    weights = np.exp(np.maximum(evidence - evidence.max(), -300.0) / 3.0)
    kept = evidence > evidence.max() - 20.0
    return Mixture.of(
        weights[kept] / weights[kept].sum(),
        np.array([mode.q for mode in modes])[kept],
        np.array([mode.covariance / power for mode in modes])[kept],
        np.full(int(kept.sum()), 6.0),
    )


def disperse(
    density: Density, anchors: Proposal, walkers: int, random: np.random.RandomState
) -> Array:
    """Starting points (walkers, dim): draws around the modes, chosen by importance weights.

    Raises
    ------
    FitError
        When the density is zero at all draws.
    """
    draws = anchors.draw(random, 4 * walkers)
    ratio = density(draws) - anchors.log_density(draws)
    top = np.sort(ratio)[-max(10, len(ratio) // 100)]
    if not np.isfinite(top):
        raise FitError("no density around the modes: the posterior cannot be sampled")
    weights = np.exp(np.minimum(ratio - top, 0.0))
    near = np.flatnonzero(weights)
    chosen = random.choice(near, size=walkers, p=weights[near] / weights[near].sum())
    begin: Array = draws[chosen]
    return begin
