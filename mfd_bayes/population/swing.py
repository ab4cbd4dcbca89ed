"""How a calibrated test follows its own changing actuation.

The law is not known before all tests are fitted, and a test need not follow it exactly: levels
deviate from it (`along`). So each test whose actuation changes has the shapes of a law to itself,
share and exponent, with the priors that laws have, and they are integrated out. What the population
shares is the slip force at the test's mean actuation alone, whatever the shape along the record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import Model
from mfd_bayes.population.laws import (
    COMPARE,
    LAWS,
    log_prior,
    prior_of,
    ratios_along,
    shapes_of,
    value_of,
)
from mfd_bayes.population.layout import Layout
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

STEADY = 0.02
"""Sd of an actuation, over its mean, below which slip forces may be taken in proportion to it."""


@dataclass(frozen=True, eq=False)
class Swing:
    """Factors of slip forces along a history, with K shapes of the test's own.

    Attributes
    ----------
    relative : (T,)
        Actuation over its mean.
    laws : mapping of str to str
        Of each quantity that follows the actuation: "compare", which has all shapes, or a law
        without free shapes.
    tied : mapping of str to str
        Parameters with the factors of another.
    """

    relative: Array
    laws: dict[str, str]
    tied: dict[str, str]

    @property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each of the K coordinates."""
        return tuple((name, s) for name, law in self.laws.items() for s in shapes_of(law))

    @property
    def units(self) -> tuple[Array, Array]:
        """Mean and sd of the coordinates under their priors, (K,) each."""
        found = [(prior_of(s).mean(), prior_of(s).std()) for _, s in self.shapes]
        mean, sd = np.reshape(found, (len(found), 2)).T
        return mean, sd

    def log_prior(self, q: Array) -> Array:
        """Log prior density of coordinates (n, K), (n,)."""
        total = np.zeros(len(q))
        for i, (_, shape) in enumerate(self.shapes):
            total += log_prior(shape, q[:, i])
        return total

    def scales(self, q: Array) -> dict[str, Array]:
        """Factors at coordinates (n, K), (n, T) each; see `Model.force`."""
        free = {pair: value_of(pair[1], q[:, i]) for i, pair in enumerate(self.shapes)}
        found = {}
        for name, law in self.laws.items():
            share, exponent = (
                free.get((name, shape), np.full(len(q), _fixed(law, shape)))
                for shape in ("share", "exponent")
            )
            found[name] = ratios_along(self.relative, share, exponent).T
        return found | {name: found[other] for name, other in self.tied.items() if other in found}


def _fixed(law: str, shape: str) -> float:
    """A shape that a law gives; NaN where it is free."""
    value = None if law == COMPARE else getattr(LAWS[law], shape)
    return np.nan if value is None else value


def swing_of(layout: Layout, model: Model, trace: Trace) -> Swing | None:
    """Swing of a test; None where its fit in proportion to the actuation is that of the laws."""
    mean = trace.reference_actuation
    if not trace.varying or not mean > 0 or np.std(trace.actuation) < STEADY * mean:
        return None
    declared = {name: law for name, law in layout.laws.items() if name in model.parameters}
    if all(declared.get(name, "proportional") == "proportional" for name in model.slip_forces):
        return None
    # over a wide swing an affine law is well off where the truth is a power of the actuation
    laws = {name: COMPARE if shapes_of(law) else law for name, law in declared.items()}
    tied = {name: other for name, other in model.tied_laws.items() if name in model.parameters}
    return Swing(np.asarray(trace.actuation) / mean, laws, tied)
