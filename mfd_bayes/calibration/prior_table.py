"""The priors of several quantities together: one array operation for all that are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import Line, Prior

Array = NDArray[np.float64]


class PriorTable:
    """Priors of k quantities, each with a coordinate of its own.

    Of few points, ten priors of one family take about as long as one.
    """

    def __init__(self, priors: Sequence[Prior]) -> None:
        rows: dict[tuple[object, ...], list[int]] = {}
        for row, prior in enumerate(priors):
            bounded = bool(np.isfinite(prior.lower)), bool(np.isfinite(prior.upper))
            rows.setdefault((prior.family, *bounded, *sorted(prior.figures)), []).append(row)
        self._size = len(priors)
        self._alike = [_Alike(those, [priors[row] for row in those]) for those in rows.values()]

    def values(self, q: Array) -> Array:
        """Quantities at coordinates (n, k), (k, n)."""
        found = np.empty((self._size, len(q)))
        for alike in self._alike:
            found[alike.rows] = alike.line.value(q.T[alike.rows])
        return found

    def log_density(self, q: Array) -> Array:
        """Log density of coordinates (n, k) with the Jacobian, (n,)."""
        found = np.empty((self._size, len(q)))
        for alike in self._alike:
            found[alike.rows] = alike.line.log_density(q.T[alike.rows], alike.family, alike.figures)
        total: Array = found.sum(axis=0)
        return total


class _Alike:
    """Priors of one family, whose bounds are of one kind, with their rows in the table."""

    def __init__(self, rows: list[int], priors: Sequence[Prior]) -> None:
        self.rows, self.family = rows, priors[0].family
        self.figures = {
            key: np.array([[prior.figures[key]] for prior in priors]) for key in priors[0].figures
        }
        lower, upper = ([[getattr(p, bound)] for p in priors] for bound in ("lower", "upper"))
        self.line = Line(np.array(lower), np.array(upper))
