"""Which uncertainty matters: shares of the variance of a peak, from the draws that there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.result import Response

Array = NDArray[np.float64]

ORDERS = 24
"""Orders in which sources are added; the share of each is its mean gain (LMG)."""

FEWEST = 30
"""Fewest draws, of those that did not run away, of which there are shares."""

REST = "interactions and the rest"


@dataclass(frozen=True)
class Shares:
    """Shares of the sources in the variance of a peak, within one ground motion."""

    quantity: str
    ground: str
    shares: Mapping[str, float]


def influence(
    response: Response, quantity: str = "drift", ground: int = 0, seed: int = 0
) -> dict[str, float]:
    """Shares of the sources in the variance of the largest of a quantity; their sum is 1.

    They are those within one ground motion, by its number from 0. Empty where there are fewer than
    `FEWEST` draws, or all are equal.

    The peak is regressed on the dampers' values (linear and quadratic, as means over the dampers
    and of each storey by itself), and the explained variance is divided by the mean gain over
    orders of adding the sources (Lindeman, Merenda and Gold, 1980). What no source explains stays
    as "interactions and the rest". Explained shares are adjusted for the number of columns.

    Parameters
    ----------
    quantity : {"drift", "acceleration", "base_shear", "travel"}
    """
    good = response.usable(ground)
    values = response.measure(quantity)[good, ground][:, None]
    if len(values) < FEWEST or np.ptp(values) <= 0.0:
        return {}
    within = values - values.mean()
    about = {name: _columns(column[good]) for name, column in response.dampers.about.items()}
    about = {name: columns for name, columns in about.items() if columns.shape[1]}
    gains = dict.fromkeys(about, 0.0)
    rng = np.random.default_rng(seed)
    for _ in range(ORDERS):
        used: list[str] = []
        before = 0.0
        for name in rng.permutation(list(about)).tolist():
            used.append(name)
            after = max(before, _explained([about[n] for n in used], within))
            gains[name] += (after - before) / ORDERS
            before = after
    return {**gains, REST: max(0.0, 1.0 - sum(gains.values()))}


def _columns(values: Array) -> Array:
    """Standardised mean over the dampers, and its square; constant columns are left out."""
    mean = values.mean(axis=1)
    columns = np.stack([mean, (mean - mean.mean()) ** 2, *values.T[:6]], axis=1)
    spread = columns.std(axis=0)
    return np.asarray(
        ((columns - columns.mean(axis=0)) / np.maximum(spread, 1e-300))[:, spread > 0]
    )


def _explained(columns: Sequence[Array], targets: Array) -> float:
    """Adjusted share of the variance of targets (n, 1) that a regression explains."""
    design = np.concatenate(columns, axis=1)
    n, total = len(design), float(np.sum(targets**2))
    fit, _, rank, _ = np.linalg.lstsq(design, targets, rcond=1e-8)
    left = float(np.sum((targets - design @ fit) ** 2))
    freedom = n - 1 - int(rank)
    if freedom <= 0 or total <= 0:
        return 0.0
    return max(0.0, 1.0 - left / total * (n - 1) / freedom)
