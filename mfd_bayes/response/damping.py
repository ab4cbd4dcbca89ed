"""Damping of a structure itself, without its dampers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.modes import Modes
from mfd_bayes.response.schema import Damping
from mfd_bayes.response.structures import Skeleton

Array = NDArray[np.float64]


def damping_matrix(asked: Damping, frame: Skeleton, modes: Modes, path: str) -> Array:
    """Damping matrix C, (N, N), kip s/in: of ratios, and of dashpots in addition.

    Rayleigh: C = a M + b K with the ratio ζ at two modes, a = 2ζ ω1 ω2/(ω1 + ω2) and
    b = 2ζ/(ω1 + ω2). Modal: C = M Φ diag(2 ζ ω) Φᵀ M, with the ratio in all modes.

    Raises
    ------
    BuildingError
        When a mode is asked for that is not there.
    """
    given = bool(np.any(frame.dashpots))
    stated = "ratio" in asked.model_fields_set or "kind" in asked.model_fields_set
    if asked.kind == "none" or (given and not stated):  # dashpots are the damping then
        return frame.dashpots
    ratio, omega = asked.ratio, modes.frequencies
    if asked.kind == "modal":
        towards = frame.mass @ modes.shapes
        return np.asarray(towards @ np.diag(2.0 * ratio * omega) @ towards.T + frame.dashpots)
    places = asked.modes if omega.size > 1 or "modes" in asked.model_fields_set else (1, 1)
    if max(places) > omega.size:
        raise BuildingError(
            f"building.damping.modes in {path}: the building has {omega.size} modes, got {places}"
        )
    first, second = (float(omega[place - 1]) for place in places)
    by_mass = 2.0 * ratio * first * second / (first + second)
    by_stiffness = 2.0 * ratio / (first + second)
    return np.asarray(by_mass * frame.mass + by_stiffness * frame.stiffness + frame.dashpots)
