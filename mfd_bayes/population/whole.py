"""Bands of whole histories: the probability holds for the whole curve, not for each sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def whole_band(draws: Array, probability: float) -> tuple[Array, Array]:
    """Lower and upper bound that hold whole curves with a probability, (T,) each, kip.

    The bounds are centre ± q · scale. Centre and scale are mean and sd of the draws at each
    sample; q is the quantile, over the draws, of the largest |F(t) − centre(t)| / scale(t).
    Where all draws agree (scale 0) the band has no width.

    Parameters
    ----------
    draws : (n, T), kip
    probability : float
    """
    centre, scale = draws.mean(axis=0), draws.std(axis=0)
    tiny = 1e-9 * max(float(np.max(np.abs(draws))), 1e-300)
    scale = np.where(scale > tiny, scale, 0.0)  # rounding is no spread
    deviation = np.abs(draws - centre) / np.where(scale > 0, scale, np.inf)
    reach = np.quantile(deviation.max(axis=1), probability, method="higher")
    tail = 0.5 * (1.0 - probability)
    lower, upper = np.quantile(draws, [tail, 1.0 - tail], axis=0)
    # never inside the band of single samples, also where the draws are very skew
    return np.minimum(centre - reach * scale, lower), np.maximum(centre + reach * scale, upper)


def holds_whole(draws: Array, observed: Array, probability: float = 0.95) -> bool:
    """Whether an observed curve (T,) is inside the band of whole curves of draws (n, T)."""
    lower, upper = whole_band(draws, probability)
    return bool(np.all((observed >= lower) & (observed <= upper)))
