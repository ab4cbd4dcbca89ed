"""A building: masses, stiffness, damping, and where its dampers are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.regular import path_of
from mfd_bayes.response.content import read_content
from mfd_bayes.response.damping import damping_matrix
from mfd_bayes.response.modes import Modes, modes_of
from mfd_bayes.response.schema import Content, Damper, History, Limits
from mfd_bayes.response.structures import LARGEST, Skeleton, skeleton_of
from mfd_bayes.units import parse_actuation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Device:
    """One damper in a building.

    Attributes
    ----------
    name : str
        Its place: "storey 1", "storey 1, no. 2".
    upper, lower : int
        Floors that it joins, from 1; 0 is the ground.
    actuation : float, ksi or kip
        NaN where it is a history.
    unit : {"ksi", "kip"}
    geometry : float
        Travel of the damper over the drift between the two floors.
    brace : float, kip/in
        Stiffness in series; infinite for a rigid one.
    history : History, optional
    """

    name: str
    upper: int
    lower: int
    actuation: float
    unit: str
    geometry: float = 1.0
    brace: float = np.inf
    history: History | None = None


@dataclass(frozen=True, eq=False)
class Building:
    """A building with dampers, in kip, in and s.

    Attributes
    ----------
    title : str
    mass, damping, stiffness : (N, N), kip s²/in, kip s/in, kip/in
    influence : (N,)
        Motion of each degree of freedom when the ground moves by 1.
    drifts : (S, N)
        Storey drifts of displacements.
    heights : (S,), in
        NaN where not known.
    yields : (S,), kip
        Yield force of each storey, infinite where it stays elastic; `storeys` (S,), kip/in, are
        the stiffnesses that yield then.
    storeys : (S,), kip/in
    devices : tuple of Device
    limits : Limits
    """

    title: str
    mass: Array
    damping: Array
    stiffness: Array
    influence: Array
    drifts: Array
    heights: Array
    yields: Array
    storeys: Array
    devices: tuple[Device, ...]
    limits: Limits
    folder: Path = Path()

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "stiffness"):
            matrix = real_numbers(f"{name} of a building", getattr(self, name), BuildingError)
            if matrix.ndim != 2 or len(matrix) != matrix.shape[1] or len(matrix) > LARGEST:
                raise BuildingError(
                    f"{name} of a building must be a square matrix of up to {LARGEST} rows, got "
                    f"the shape {matrix.shape}"
                )
            object.__setattr__(self, name, matrix)

    @property
    def freedoms(self) -> int:
        """Number of degrees of freedom N."""
        return len(self.mass)

    @property
    def modes(self) -> Modes:
        """Periods and shapes of the elastic building without dampers."""
        return modes_of(self.mass, self.stiffness)

    @property
    def travels(self) -> Array:
        """Travel of each damper, with that of its brace, of displacements, (m, N)."""
        rows = np.zeros((len(self.devices), self.freedoms + 1))
        for row, device in zip(rows, self.devices, strict=True):
            row[device.upper] += device.geometry
            row[device.lower] -= device.geometry
        return rows[:, 1:]

    @property
    def floors(self) -> tuple[str, ...]:
        """Names of the storeys."""
        return tuple(f"storey {i + 1}" for i in range(len(self.drifts)))

    def at_level(self, actuation: float) -> Building:
        """The building with all dampers at one constant actuation, ksi or kip.

        Raises
        ------
        BuildingError
            When it is no number, 0 or more.
        """
        actuation = real_number("actuation", actuation, BuildingError, (0.0, np.inf))
        level = [replace(d, actuation=actuation, history=None) for d in self.devices]
        return replace(self, devices=tuple(level))

    def bare(self) -> Building:
        """The building without its dampers."""
        return replace(self, devices=())


def read_building(path: str | PathLike[str]) -> Building:
    """Building of a TOML file.

    Raises
    ------
    BuildingError
        When the file, or a file that it names, cannot be read, or a value cannot be used; the
        key is named.
    """
    path = path_of("building", path, BuildingError)
    return building_of(read_content(path), path)


def building_of(content: Content, path: Path) -> Building:
    """Building of a checked content; `path` is its file, beside which others are looked for."""
    frame = skeleton_of(content, path)
    check_frame(frame, path)
    modes = modes_of(frame.mass, frame.stiffness)
    damping = damping_matrix(content.building.damping, frame, modes, str(path))
    devices = tuple(
        device
        for number, damper in enumerate(content.damper, start=1)
        for device in _devices(damper, number, len(frame.mass), path)
    )
    units = {device.unit for device in devices}
    if len(units) > 1:
        raise BuildingError(f"damper in {path}: actuation must be a pressure of all, or a force")
    shares = [name for name in ("drift", "residual") if getattr(content.limits, name) is not None]
    if shares and not np.all(np.isfinite(frame.heights)):
        raise BuildingError(f"limits.{shares[0]} in {path} needs the height of every storey")
    return Building(
        content.building.title,
        frame.mass,
        damping,
        frame.stiffness,
        frame.influence,
        frame.drifts,
        frame.heights,
        frame.yields,
        frame.storeys,
        devices,
        content.limits,
        path.parent,
    )


def check_frame(frame: Skeleton, path: Path) -> None:
    """Refuse a mass or a stiffness with which nothing can be computed."""
    for name, matrix in (("mass", frame.mass), ("stiffness", frame.stiffness)):
        values = np.linalg.eigvalsh(matrix)
        if values[0] <= 1e-14 * values[-1]:
            raise BuildingError(
                f"the {name} matrix of {path} must be symmetric and positive definite; its "
                f"smallest eigenvalue is {values[0]:.3g}"
            )


def _devices(damper: Damper, number: int, floors: int, path: Path) -> list[Device]:
    """The devices of one [[damper]], each by itself."""
    upper, lower = damper.between or (damper.storey or 0, (damper.storey or 1) - 1)
    key = "between" if damper.between else "storey"
    if max(upper, lower) > floors or upper == lower:
        raise BuildingError(
            f"damper {number}.{key} in {path}: expected floors of 0, the ground, to {floors}, two "
            f"different ones, got {damper.between or damper.storey}"
        )
    place = f"storey {upper}" if lower == upper - 1 else f"floors {lower} to {upper}"
    brace = np.inf if damper.brace is None else damper.brace
    found = []
    for i in range(damper.count):
        given = damper.actuation
        name = place if damper.count == 1 else f"{place}, no. {i + 1}"
        level, unit, history = np.nan, "ksi", None
        if isinstance(given, History):
            history = given
            unit = parse_actuation(f"1 {given.unit}")[1]
        else:
            level, unit = parse_actuation(given[i] if isinstance(given, tuple) else given)
        found.append(Device(name, upper, lower, level, unit, damper.geometry, brace, history))
    return found
