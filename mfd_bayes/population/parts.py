"""What the shared coordinates of drawn tests are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Parts:
    """What the shared coordinates of n drawn tests are made of, in prior units, (n, d) each.

    Attributes
    ----------
    level
        Of the medians over tests at the reference actuation.
    law
        Laws, dependences, and effects of the level and the session.
    scatter
        From test to test.
    """

    level: Array
    law: Array
    scatter: Array

    @property
    def total(self) -> Array:
        """Their sum, the coordinates less their centre, (n, d)."""
        return self.level + self.law + self.scatter


@dataclass(frozen=True, eq=False)
class Expected:
    """What n draws of the hyperparameters say of a test, in prior units.

    Attributes
    ----------
    level, law : (n, d)
        As in `Parts`, without the effects of a level or session that no test was made in.
    open : tuple of (str, int, (n,))
        Those effects, "level" or "session", or "beyond" for a motion outside those of the tests;
        the quantity, and its sd.
    scatter : (n, d)
        Sd from test to test.
    together : (n, d, d)
        Cholesky factor of the correlation of the scatter between quantities.
    """

    level: Array
    law: Array
    open: tuple[tuple[str, int, Array], ...]
    scatter: Array
    together: Array

    def parts(
        self,
        rng_of: Callable[[str, int], np.random.Generator],
        *,
        scattered: bool = True,
        leveled: bool = True,
    ) -> Parts:
        """What tests are made of; see `Population.draw_parts`.

        Parameters
        ----------
        rng_of : callable
            Generator for an open effect, by its name and the number of its quantity, and for the
            scatter, by "scatter" and 0.
        """
        law, n = self.law.copy(), len(self.law)
        for name, k, sd in self.open:
            if scattered or name != "session":
                drawn = rng_of(name, k).standard_normal(n)
                if leveled or name != "level":
                    law[:, k] += sd * drawn
        scatter = np.zeros_like(law)
        if scattered:
            drawn = rng_of("scatter", 0).standard_normal(law.shape)
            scatter = self.scatter * np.einsum("nij,nj->ni", self.together, drawn)
        return Parts(self.level, law, scatter)
