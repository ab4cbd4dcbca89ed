"""What the draws of a prediction are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.parts import Parts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drawn:
    """Ingredients of the n draws of a prediction.

    Attributes
    ----------
    parts : Parts
        Of the quantities that tests share.
    unknown : mapping of str to (n,)
        Quantities that tests do not share, such as the start in the gap.
    scales : mapping of str to (n, T)
        Factors of the quantities with a law along a history of actuation; empty for a constant.
    noise : (n, T), kip, or None
        With the load cell's offset; None where only the damper's force is predicted.
    discrepancy : (n, K), kip, or None
        Coefficients of what the model leaves over in every cycle.
    levels : (n, S), or None
        Levels of the noise of the S strokes, over its standard deviation; None where nothing is
        known of them.
    """

    parts: Parts
    unknown: Mapping[str, Array]
    scales: Mapping[str, Array]
    noise: Array | None = None
    discrepancy: Array | None = None
    levels: Array | None = None

    def first(self, n: int) -> Drawn:
        """The first n draws."""
        parts = Parts(self.parts.level[:n], self.parts.law[:n], self.parts.scatter[:n])
        return Drawn(
            parts,
            {name: column[:n] for name, column in self.unknown.items()},
            {name: factors[:n] for name, factors in self.scales.items()},
            None if self.noise is None else self.noise[:n],
            None if self.discrepancy is None else self.discrepancy[:n],
            None if self.levels is None else self.levels[:n],
        )

    def untangled(self) -> Drawn:
        """The same draws, where the part of laws and effects does not follow that of the levels.

        Tests know the sum of the two well, and neither of them: what one of them has too much, the
        other has too little. By itself either would be more uncertain than both. So what a
        straight line on the level says of laws and effects is counted to the level.
        """
        parts = self.parts
        away = parts.level - parts.level.mean(axis=0)
        products = np.sum(away * (parts.law - parts.law.mean(axis=0)), axis=0)
        follows = products / np.maximum(np.sum(away**2, axis=0), 1e-300) * away
        return replace(self, parts=Parts(parts.level + follows, parts.law - follows, parts.scatter))
