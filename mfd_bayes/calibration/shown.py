"""What a notebook shows of a posterior, of its draws and of a calibrated test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.quantities import units
from mfd_bayes.store.cards import card, counted, grid

Array = NDArray[np.float64]
Interval = tuple[float, float, float]
"""50, 2.5 and 97.5 % quantiles of the draws of a quantity."""

HEAD = ("quantity", "unit", "median", "2.5 %", "97.5 %")


class ShownPosterior:
    """A `Posterior` as notebooks show it."""

    def _repr_html_(self: Any) -> str:
        trace = self.trace
        facts = [
            ("model", self.model.name),
            ("noise", self.noise.name),
            ("record", f"{counted(trace.samples, 'sample')} over {np.ptp(trace.time):.4g} s"),
            ("sampled", f"{self.dim} quantities: {', '.join(self.names)}"),
        ]
        return card("Posterior of one test", facts)


class ShownDraws:
    """`Draws` as notebooks show them."""

    def _repr_html_(self: Any) -> str:
        chains, draws, _ = self.q.shape
        worst = self.convergence
        note = (
            f"worst R-hat {worst.worst_r_hat:.3f}, smallest effective sample size "
            f"{worst.worst_ess:.0f}, {self.wall_time:.1f} s"
        )
        title = f"Draws: {counted(chains, 'chain')} of {draws}"
        return grid(title, HEAD, interval_rows(intervals_of(self.values)), note)


def intervals_of(values: Mapping[str, Array]) -> dict[str, Interval]:
    """Median and equal-tailed 95 % interval of quantities, from draws of any shape."""
    return {name: _interval(drawn) for name, drawn in values.items()}


def interval_rows(intervals: Mapping[str, Interval]) -> Iterator[tuple[str, ...]]:
    """Name, unit, median and 95 % interval of quantities, as text."""
    known = units()
    for name, figures in intervals.items():
        yield name, known.get(name, ""), *(f"{figure:.4g}" for figure in figures)


def _interval(drawn: Array) -> Interval:
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(np.median(drawn)), float(low), float(high)
