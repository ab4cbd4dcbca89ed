"""The exact step of a linear structure between samples of its loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.response.balance import Pull
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
    brace : (m,), in/kip
        Travel that each device loses to its brace.
    """

    building: Building
    places: Array
    inverse: Array
    brace: Array

    @classmethod
    def of(cls, building: Building, places: Array) -> Frame:
        """Frame of a building with devices at these places, (m, N)."""
        brace = np.zeros(len(places))
        brace[: len(building.devices)] = [1.0 / device.brace for device in building.devices]
        return cls(building, places, np.asarray(linalg.inv(building.mass)), brace)

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
    carried : (2N + m, 2N)
        Rows of [x v] and of f at the start.
    shaken : (2, 2N)
        γ₀ and γ₁, of a_g at both ends.
    response : (m, 2N)
        Γ₁, of the force at the end.
    flexibility, mobility : (m, m), in/kip, in/(s kip)
        Loss of travel and of velocity of each device by the force of each at the end.
    brace : (m,), in/kip
        See `Frame`.
    pull : Pull
        Loss of travel, braces included.
    braced : bool
        Whether any brace gives.
    """

    size: float
    carried: Array
    shaken: Array
    response: Array
    flexibility: Array
    mobility: Array
    brace: Array
    pull: Pull
    braced: bool

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
        response = late[:, 1:].T
        flexibility = -response[:, :n] @ frame.places.T
        return cls(
            size,
            np.concatenate([found[: 2 * n, : 2 * n].T, early[:, 1:].T]),
            np.array([early[:, 0], late[:, 0]]),
            np.ascontiguousarray(response),
            flexibility,
            -response[:, n:] @ frame.places.T,
            frame.brace,
            Pull.of(flexibility + np.diag(frame.brace)),
            bool(frame.brace.any()),
        )

    def free(self, state: Array, pulled: Array, before: float, after: float) -> Array:
        """States (n, 2N) after the step without the devices' forces at its end.

        Parameters
        ----------
        state, pulled : (n, 2N), (n, m)
            States and forces at its start.
        before, after : float, in/s²
            Ground's acceleration at its start and end.
        """
        shaken = before * self.shaken[0] + after * self.shaken[1]
        return np.asarray(np.concatenate([state, pulled], axis=1) @ self.carried + shaken)


def halfway(x: Array, v: Array, step: float) -> tuple[Array, Array]:
    """Motion half-way between samples, (K, ...) of (K + 1, ...): cubic, from places and velocities.

    Returns
    -------
    place, velocity : (K, ...), in, in/s
    """
    place = 0.5 * (x[:-1] + x[1:]) + 0.125 * step * (v[:-1] - v[1:])
    velocity = 1.5 / step * (x[1:] - x[:-1]) - 0.25 * (v[:-1] + v[1:])
    return place, velocity
