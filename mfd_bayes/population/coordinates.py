"""The coordinates in which tests are compared: unconstrained, in units of the prior.

In one test F_c trades off with F_s and ẋ_s, and d2 with d3: only their sums or products are known
well, and these are what differs between tests. So the coordinate of F_c,fwd (and bwd) is the
logarithm of the slip force at a speed common to all tests, F_c [1 + (F_s/F_c - 1) exp(-(v/ẋ_s)²)];
that of d2 is log(d2 + d3), the width of the gap, and that of d3 is log(d3/d2). All others are those
of their priors. These changes of variables have determinant 1. Prior units have mean 0 and standard
deviation 1 under the prior of a test by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import Prior

Array = NDArray[np.float64]

DRAWS = 4000  # prior draws by which the centre and the spread of the coordinates are found


@dataclass(frozen=True)
class Coordinates:
    """Coordinates x (n, D) of quantities, in prior units."""

    names: tuple[str, ...]  # quantities, D of them, in the order of the coordinates
    priors: Mapping[str, Prior]
    speed: float  # in/s, at which slip forces are compared
    by_name: bool = True  # whether d2 is a gap's, and so on: not those of a user's own model
    centre: Array = field(init=False)  # (D,), mean and sd of the coordinates under the priors
    spread: Array = field(init=False)

    def __post_init__(self) -> None:
        rng, priors = np.random.default_rng(0), [self.priors[name] for name in self.names]
        drawn = [prior.coordinate(prior.draw(rng, DRAWS)) for prior in priors]
        q = self._compared(np.stack(drawn, axis=1))
        object.__setattr__(self, "centre", q.mean(axis=0))
        object.__setattr__(self, "spread", q.std(axis=0))

    def _column(self, name: str) -> int | None:
        """Column of a quantity on the positive half line; None where there is none."""
        there = self.by_name and name in self.names and self.priors[name].on_half_line
        return self.names.index(name) if there else None

    def _shifts(self, own: Array) -> list[tuple[int, Array]]:
        """Column of F_c and log of the slip force at `speed` over F_c, (n,), by direction."""
        found, values = [], {}
        for side in ("fwd", "bwd"):
            excess, kinetic = f"static_excess_{side}", self._column(f"Fc_{side}")
            if kinetic is not None and {excess, "v_s"} <= set(self.names):
                for name in ("v_s", excess):
                    values[name] = self.priors[name].value(own[:, self.names.index(name)])
                stribeck = np.exp(-((self.speed / np.maximum(values["v_s"], 1e-12)) ** 2))
                found.append((kinetic, np.log1p(values[excess] * stribeck)))
        return found

    def _compared(self, own: Array) -> Array:
        """Compared coordinates, of those of the priors, (n, D)."""
        q, d2, d3 = own.copy(), self._column("d2"), self._column("d3")
        for kinetic, shift in self._shifts(own):
            q[:, kinetic] += shift
        if d2 is not None and d3 is not None:
            q[:, d2] = np.logaddexp(own[:, d2], own[:, d3])
            q[:, d3] = own[:, d3] - own[:, d2]
        return q

    def of_priors(self, x: Array) -> Array:
        """Coordinates of the priors, (n, D), of x (n, D)."""
        q = self.centre + self.spread * x
        own, d2, d3 = q.copy(), self._column("d2"), self._column("d3")
        for kinetic, shift in self._shifts(q):
            own[:, kinetic] -= shift
        if d2 is not None and d3 is not None:
            own[:, d2] = q[:, d2] - np.logaddexp(0.0, q[:, d3])
            own[:, d3] = own[:, d2] + q[:, d3]
        return own

    def values(self, x: Array) -> dict[str, Array]:
        """Quantities at x (n, D), by name, (n,) each, internal units."""
        q = self.of_priors(x)
        return {name: self.priors[name].value(q[:, k]) for k, name in enumerate(self.names)}

    def value(self, name: str, x: Array) -> Array:
        """A quantity whose coordinate is its prior's, such as the noise, at x (..., D), (...)."""
        k = self.names.index(name)
        return self.priors[name].value(self.centre[k] + self.spread[k] * x[..., k])

    def of(self, values: Mapping[str, Array]) -> Array:
        """Coordinates x (n, D) of quantities by name, (n,) each; of a missing one, its median."""
        n = max(np.size(value) for value in values.values())
        filled = {**{k: np.full(n, self.priors[k].typical) for k in self.names}, **values}
        q = [self.priors[name].coordinate(np.atleast_1d(filled[name])) for name in self.names]
        return np.asarray((self._compared(np.stack(q, axis=1)) - self.centre) / self.spread)

    def log_prior(self, x: Array, columns: NDArray[np.bool_]) -> Array:
        """Log density of some coordinates of x (n, D) under their priors, in prior units, (n,)."""
        q, total = self.of_priors(x), np.zeros(len(x))
        for k in np.flatnonzero(columns):
            total += self.priors[self.names[k]].log_density(q[:, k]) + np.log(self.spread[k])
        return total
