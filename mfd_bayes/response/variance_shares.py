"""Which uncertainty matters: shares of the variance of a peak, from the draws that there are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mfd_bayes.response.result import Response

ORDERS = 24  # orders in which sources are added; the share of each is its mean gain
FEWEST = 30  # fewest draws, of those that did not run away, of which there are shares
PLACES = 6  # dampers whose own values are columns of the regression, beside the mean over all
REST = "interactions and the rest"


@dataclass(frozen=True)
class Shares:
    """Shares of the sources in the variance of a peak, within one ground motion."""

    quantity: str
    ground: str
    shares: Mapping[str, float]


def variance_shares(
    response: Response, quantity: str = "drift", ground: int = 0, seed: int = 0
) -> dict[str, float]:
    """Shares of the sources in the variance of the largest of a quantity; their sum is 1.

    They are those within one ground motion, by its number from 0. Empty where there are fewer than
    `FEWEST` draws, or all are equal.

    The peak is regressed on the dampers' values (linear and quadratic, as means over the dampers
    and of each by itself), and the explained variance, adjusted for the number of columns, is
    divided by the mean gain over orders of adding the sources (Lindeman, Merenda and Gold, 1980).
    What no source explains stays as "interactions and the rest".

    Parameters
    ----------
    quantity : {"drift", "acceleration", "base_shear", "travel"}
    """
    good = response.usable(ground)
    values = response.measure(quantity)[good, ground]
    if len(values) < FEWEST or np.ptp(values) <= 0.0:
        return {}
    columns = {}
    for name, about in response.dampers.about.items():
        mean = about[good].mean(axis=1)
        column = np.column_stack([mean, (mean - mean.mean()) ** 2, about[good][:, :PLACES]])
        spread = column.std(axis=0)
        if np.any(spread > 0):
            columns[name] = ((column - column.mean(axis=0))[:, spread > 0]) / spread[spread > 0]
    within = values - values.mean()

    def explained(names: list[str]) -> float:
        design = np.concatenate([columns[name] for name in names], axis=1)
        fit, _, rank, _ = np.linalg.lstsq(design, within, rcond=1e-8)
        freedom = len(within) - 1 - int(rank)
        if freedom <= 0:
            return 0.0
        left = np.sum((within - design @ fit) ** 2) / np.sum(within**2)
        return max(0.0, 1.0 - float(left) * (len(within) - 1) / freedom)

    gains, rng = dict.fromkeys(columns, 0.0), np.random.default_rng(seed)
    for _ in range(ORDERS):
        order, before = rng.permutation(list(columns)).tolist(), 0.0
        for k, name in enumerate(order, start=1):
            after = max(before, explained(order[:k]))
            gains[name] += (after - before) / ORDERS
            before = after
    return {**gains, REST: max(0.0, 1.0 - sum(gains.values()))}
