"""Elastic, perfectly plastic forces: storeys that yield, and friction that is almost rigid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.banks.bank import Array, Scales, with_state


@dataclass(frozen=True, eq=False)
class PlasticBank:
    """Springs of stiffness k that slip at ±F_y: dF = k dx while |F| < F_y.

    Attributes
    ----------
    stiffness, strength : (n,), kip/in, kip
    elastic : (n,), kip/in
        Stiffness whose elastic force is subtracted: that of a storey which the linear structure
        has already, so that the force here is 0 until it yields.
    spring, displacement : (n,), kip, in
        Force of the spring, and displacement at the last sample.
    """

    stiffness: Array
    strength: Array
    elastic: Array
    spring: Array
    displacement: Array

    @classmethod
    def at_rest(
        cls, stiffness: Array, strength: Array, elastic: Array | None = None
    ) -> PlasticBank:
        """Springs without force at displacement 0."""
        zero = np.zeros(stiffness.size)
        return cls(stiffness, strength, zero if elastic is None else elastic, zero, zero)

    @property
    def force(self) -> Array:
        """Force beside that of the linear structure, (n,), kip."""
        return np.asarray(self.spring - self.elastic * self.displacement)

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> PlasticBank:
        """State at the next sample; see `Bank.step`."""
        spring = self.spring + self.stiffness * (displacement - self.displacement)
        np.clip(spring, -self.strength, self.strength, out=spring)
        return replace(self, spring=spring, displacement=displacement)

    def chosen(self, rows: NDArray[np.intp]) -> PlasticBank:
        """The bank of some of its springs."""
        columns = (self.stiffness, self.strength, self.elastic, self.spring, self.displacement)
        return PlasticBank(*(column[rows] for column in columns))

    def replaced(self, rows: NDArray[np.intp], part: PlasticBank) -> PlasticBank:
        """The bank with the state of some of its springs replaced; see `Bank.replaced`."""
        return with_state(self, ("spring", "displacement"), rows, part)
