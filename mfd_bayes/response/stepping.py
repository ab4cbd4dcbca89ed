"""The exact step of a linear structure between samples of its loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.response.building import Building

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """A building in the form that is stepped: M ẍ + C ẋ + K x = −M r a_g − Bᵀ f.

    Attributes
    ----------
    building : Building
    places : (m, N)
        Travels B of the devices, with that of their braces, of displacements.
    inverse : (N, N)
        M⁻¹.
    """

    building: Building
    places: Array
    inverse: Array

    @classmethod
    def of(cls, building: Building, places: Array) -> Frame:
        """Frame of a building with devices at these places, (m, N)."""
        return cls(building, places, np.asarray(linalg.inv(building.mass)))

    def acceleration(self, x: Array, v: Array, force: Array, ground: Array | float) -> Array:
        """Relative acceleration, (…, N), in/s², of motions (…, N) and forces (…, m)."""
        pull = x @ self.building.stiffness + v @ self.building.damping + force @ self.places
        return np.asarray(-pull @ self.inverse - ground * self.building.influence)


@dataclass(frozen=True, eq=False)
class Step:
    """State after a step h in which all loads are linear in time: exact for a linear structure.

        [x v]₁ = [x v]₀ Φᵀ + a_g₀ γ₀ + a_g₁ γ₁ + f₀ Γ₀ + f₁ Γ₁

    From the exponential of the augmented matrix (Van Loan, 1978).

    Attributes
    ----------
    size : float, s
    carried : (2N + 2 + m, 2N)
        Rows of [x v], a_g at both ends and f at the start.
    response : (m, 2N)
        Γ₁, of the force at the end.
    flexibility, mobility : (m, m), in/kip, in/(s kip)
        Loss of travel and of velocity of each device by the force of each at the end.
    """

    size: float
    carried: Array
    response: Array
    flexibility: Array
    mobility: Array

    @classmethod
    def of(cls, frame: Frame, size: float) -> Step:
        """The step of a frame over `size` seconds."""
        b, n, m = frame.building, frame.building.freedoms, len(frame.places)
        flow = np.zeros((2 * n, 2 * n))
        flow[:n, n:] = np.eye(n)
        flow[n:, :n] = -frame.inverse @ b.stiffness
        flow[n:, n:] = -frame.inverse @ b.damping
        loads = np.zeros((2 * n, 1 + m))
        loads[n:, 0] = -b.influence
        loads[n:, 1:] = -frame.inverse @ frame.places.T
        whole = np.zeros((2 * n + 2 * (1 + m),) * 2)
        whole[: 2 * n, : 2 * n] = flow * size
        whole[: 2 * n, 2 * n : 2 * n + 1 + m] = loads * size
        whole[2 * n : 2 * n + 1 + m, 2 * n + 1 + m :] = np.eye(1 + m)
        found = linalg.expm(whole)
        constant = found[: 2 * n, 2 * n : 2 * n + 1 + m]
        late = found[: 2 * n, 2 * n + 1 + m :]
        early = constant - late
        carried = np.concatenate(
            [found[: 2 * n, : 2 * n].T, early[:, :1].T, late[:, :1].T, early[:, 1:].T]
        )
        response = late[:, 1:].T
        return cls(
            size,
            np.ascontiguousarray(carried),
            np.ascontiguousarray(response),
            -response[:, :n] @ frame.places.T,
            -response[:, n:] @ frame.places.T,
        )
