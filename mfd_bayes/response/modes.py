"""Natural periods and mode shapes of a linear structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a structure, the longest period first.

    Attributes
    ----------
    frequencies : (N,), rad/s
    shapes : (N, N)
        Columns φ with φᵀMφ = 1.
    """

    frequencies: Array
    shapes: Array

    @property
    def periods(self) -> Array:
        """Natural periods, (N,), s."""
        return np.asarray(2.0 * np.pi / self.frequencies)


def modes_of(mass: Array, stiffness: Array) -> Modes:
    """Modes of K φ = ω² M φ for symmetric positive definite matrices, (N, N)."""
    squares, shapes = linalg.eigh(stiffness, mass)
    return Modes(np.sqrt(squares), shapes)
