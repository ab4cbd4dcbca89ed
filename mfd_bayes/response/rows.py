"""What a table of a response says: peaks with their bands, and limits that may be passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

UNITS = {
    "drift ratio": "1",
    "drift": "in",
    "acceleration": "in/s^2",
    "base shear": "kip",
    "residual drift": "in",
    "damper travel": "in",
    "damper force": "kip",
    "damper energy": "kip*in",
}
"""Internal unit of each quantity that rows tell of."""

PROBABILITIES = (0.5, 0.9, 0.95)
"""Of the equal-tailed bands."""


@dataclass(frozen=True)
class Row:
    """A peak and its bands.

    Attributes
    ----------
    quantity : str
    ground, place : str
    unit : str
        Internal, or "1" of a ratio.
    median, mean : float
    bands : tuple of (lower, upper)
        For `PROBABILITIES`.
    bare, plain : float
        The same without dampers, and with plain friction of the median slip force; NaN where it
        has no meaning.
    """

    quantity: str
    ground: str
    place: str
    unit: str
    median: float
    mean: float
    bands: tuple[tuple[float, float], ...]
    bare: float = np.nan
    plain: float = np.nan


@dataclass(frozen=True)
class Passing:
    """Probability that a limit is passed somewhere in the building.

    `error` is the Monte Carlo standard error of the probability.
    """

    quantity: str
    ground: str
    limit: float
    unit: str
    probability: float
    error: float
