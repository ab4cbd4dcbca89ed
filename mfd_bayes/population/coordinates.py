"""The coordinates in which the tests' shared quantities scatter from test to test.

In one test F_c trades off with F_s and ẋ_s, and d2 with d3: only their sums or products are known
well, and these are what differs between tests. Scatter of each by itself would count it twice. So
the coordinate of F_c,fwd (and bwd) is the logarithm of the slip force at a speed v_ref common
to all tests, F_c [1 + (F_s/F_c − 1) exp(−(v_ref/ẋ_s)²)]; that of d2 is log(d2 + d3), the width
of the gap, and that of d3 is log(d3/d2). All others are those of their priors. These changes of
variables have determinant 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.prior_table import PriorTable
from mfd_bayes.calibration.priors import Prior

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coordinates:
    """Shared coordinates of quantities.

    Attributes
    ----------
    names : tuple of str
        Quantities, d of them, in the order of the coordinates.
    priors : mapping of str to Prior
    speed : float, in/s
        v_ref.
    """

    names: tuple[str, ...]
    priors: Mapping[str, Prior]
    speed: float

    @cached_property
    def _table(self) -> PriorTable:
        """Priors of the quantities."""
        return PriorTable([self.priors[name] for name in self.names])

    def _slips(self) -> list[tuple[int, int]]:
        """Columns of F_c and its excess, in the directions that have both."""
        found = []
        if "v_s" in self.names:
            for side in ("fwd", "bwd"):
                kinetic, excess = f"Fc_{side}", f"static_excess_{side}"
                if excess in self.names and self._positive(kinetic):
                    found.append((self.names.index(kinetic), self.names.index(excess)))
        return found

    def _gap(self) -> tuple[int, int] | None:
        """Columns of d2 and d3, where both are shared."""
        if self._positive("d2") and self._positive("d3"):
            return self.names.index("d2"), self.names.index("d3")
        return None

    def _positive(self, name: str) -> bool:
        return name in self.names and self.priors[name].on_half_line

    def _shift(self, own: Array, excess: int) -> Array:
        """Logarithm of the slip force at v_ref over F_c, (n,)."""
        v_s = self.priors["v_s"].value(own[:, self.names.index("v_s")])
        stribeck = np.exp(-((self.speed / np.maximum(v_s, 1e-12)) ** 2))
        share = self.priors[self.names[excess]].value(own[:, excess])
        return np.asarray(np.log1p(share * stribeck))

    def from_own(self, own: Array) -> Array:
        """Shared coordinates from those of the priors, (n, d)."""
        q = own.copy()
        for kinetic, excess in self._slips():
            q[:, kinetic] += self._shift(own, excess)
        gap = self._gap()
        if gap:
            d2, d3 = gap
            q[:, d2] = np.logaddexp(own[:, d2], own[:, d3])
            q[:, d3] = own[:, d3] - own[:, d2]
        return q

    def to_own(self, q: Array) -> Array:
        """Coordinates of the priors from the shared ones, (n, d)."""
        own = q.copy()
        for kinetic, excess in self._slips():
            own[:, kinetic] -= self._shift(q, excess)
        gap = self._gap()
        if gap:
            d2, d3 = gap
            own[:, d2] = q[:, d2] - np.logaddexp(0.0, q[:, d3])
            own[:, d3] = own[:, d2] + q[:, d3]
        return own

    def values(self, q: Array) -> dict[str, Array]:
        """Quantities at shared coordinates (n, d), by name, (n,) each, internal units."""
        return dict(zip(self.names, self._table.values(self.to_own(q)), strict=True))

    def of(self, values: Mapping[str, Array]) -> Array:
        """Shared coordinates of quantities by name, (n, d)."""
        own = [self.priors[name].coordinate(values[name]) for name in self.names]
        return self.from_own(np.stack(own, axis=1))

    def log_prior(self, q: Array) -> Array:
        """Log density of shared coordinates under the priors of a test by itself, (n,)."""
        return self._table.log_density(self.to_own(q))
