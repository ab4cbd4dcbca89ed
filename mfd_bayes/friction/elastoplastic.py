"""Elastic, perfectly plastic forces: storeys that yield, and friction that is almost rigid."""

from __future__ import annotations

from typing import Self

import numpy as np

from mfd_bayes.friction.model import Columns, Model, State
from mfd_bayes.friction.quantity import Array


class _ElastoPlastic(Model):
    """Springs of stiffness k that slip at ±F_y: dF = k dx while |F| < F_y."""

    name = "elastoplastic"

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Force of each spring after a way."""
        c = state.constants
        force = state.memory["spring"] + c["stiffness"] * (displacement - state.displacement)
        return {"spring": np.minimum(np.maximum(force, -c["strength"]), c["strength"])}

    def total(self, state: State) -> Array:
        """Force beside that of the linear structure, (n,), kip."""
        elastic = state.constants["elastic"] * state.displacement
        return np.asarray(state.memory["spring"] - elastic)


class ElastoPlastic(State):
    """A state of such springs."""

    @classmethod
    def at_rest(cls, stiffness: Array, strength: Array, elastic: Array | None = None) -> Self:
        """Springs without force at displacement 0.

        Parameters
        ----------
        stiffness, strength : (n,), kip/in, kip
        elastic : (n,), kip/in, optional
            Stiffness whose elastic force is subtracted: that of a storey which the linear structure
            has already, so that the force here is 0 until it yields.
        """
        zero = np.zeros(stiffness.size)
        constants = {"stiffness": stiffness, "strength": strength}
        constants["elastic"] = zero if elastic is None else elastic
        return cls(_ElastoPlastic(), constants, {"spring": zero}, zero, zero, {})
