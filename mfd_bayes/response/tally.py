"""What is kept of a history while it is computed: peaks, residuals, energies, and some samples."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORRECTION = 1.0 / 12.0
"""Of the trapezoidal rule with slopes: ∫ ≈ h (p₀ + p₁)/2 + h² (p₀' − p₁')/12."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """Largest sizes over a history, draws first.

    Attributes
    ----------
    drift : (n, S), in
    acceleration : (n, N), in/s²
        Absolute, of the floors.
    base_shear : (n,), kip
        Of inertia: −rᵀ M (ẍ + r a_g).
    force, travel : (n, m), kip, in
        Of the dampers.
    """

    drift: Array
    acceleration: Array
    base_shear: Array
    force: Array
    travel: Array

    @classmethod
    def zero(cls, draws: int, storeys: int, floors: int, dampers: int) -> Peaks:
        """Peaks before the first sample."""
        shapes = (storeys,), (floors,), (), (dampers,), (dampers,)
        return cls(*(np.zeros((draws, *shape)) for shape in shapes))

    def include(self, values: Peaks) -> None:
        """Take in the sizes at a sample."""
        for field in fields(self):
            own = getattr(self, field.name)
            np.maximum(own, np.abs(getattr(values, field.name)), out=own)

    def chosen(self, rows: NDArray[np.intp]) -> Peaks:
        """Those of some draws."""
        return Peaks(*(getattr(self, f.name)[rows] for f in fields(self)))

    def change_from(self, other: Peaks) -> Array:
        """Largest change from other peaks, over the largest peak of its kind, (n,)."""
        worst = np.zeros(len(self.drift))
        for field in fields(self):
            new, old = getattr(self, field.name), getattr(other, field.name)
            new, old = new.reshape(len(worst), -1), old.reshape(len(worst), -1)
            if not new.shape[1]:
                continue
            scale = np.maximum(new.max(axis=1), 1e-300)
            worst = np.maximum(worst, np.abs(new - old).max(axis=1) / scale)
        return worst


@dataclass(frozen=True, eq=False)
class Energies:
    """Energies up to now, (n,) each, kip in; `dampers` is (n, m)."""

    input: Array
    kinetic: Array
    strain: Array
    damping: Array
    dampers: Array
    yielding: Array
    brace: Array

    @property
    def lost(self) -> Array:
        """Input less all others, (n,): 0 but for errors of the integration."""
        stored = self.kinetic + self.strain + self.damping + self.yielding + self.brace
        return np.asarray(self.input - stored - self.dampers.sum(axis=1))

    def chosen(self, rows: NDArray[np.intp]) -> Energies:
        """Those of some draws."""
        return Energies(*(getattr(self, f.name)[rows] for f in fields(self)))


def work(
    before: Array, after: Array, slope_before: Array, slope_after: Array, step: float
) -> Array:
    """Integral of a power over a step, from its values and slopes at both ends."""
    trapezoid = 0.5 * step * (before + after)
    return np.asarray(trapezoid + CORRECTION * step**2 * (slope_before - slope_after))
