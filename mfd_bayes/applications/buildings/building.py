"""A building, read from its file and checked."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)
from scipy import linalg

from mfd_bayes.applications.buildings.ground import parse_acceleration
from mfd_bayes.errors import (
    BuildingError,
    MfdError,
    UnitError,
    file_inside,
    path_of,
    real_number,
    why_no_file,
)
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.table import header_unit
from mfd_bayes.store.files import TomlError, faults_text, read_toml
from mfd_bayes.units import (
    GRAVITY,
    actuation_factor,
    convert,
    factor,
    parse_actuation,
    parse_quantity,
)

Array = NDArray[np.float64]

# --- the keys of a building file, and which values each may have


def _quantity(kind: str) -> Callable[[str], float]:
    return lambda text: parse_quantity(text, kind)


def _mass(text: str) -> float:
    try:
        return parse_quantity(text, "mass")
    except UnitError as error:
        raise UnitError(
            f"expected a mass such as '45 Mg' or '0.26 kip*s^2/in', got {text!r}"
        ) from error


def _share(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return parse_quantity(text, "dimensionless")


def _read(parse: Callable[[str], object], *, only_text: bool = True) -> BeforeValidator:
    """Validator of a text with a number and a unit; other values are refused, or left alone."""

    def validate(value: object) -> object:
        if not isinstance(value, str):
            if only_text:
                raise ValueError(f"give a number and a unit in quotes, got {value!r}")
            return value
        try:
            return parse(value)
        except UnitError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(validate)


def _checked_actuation(text: str) -> str:
    parse_actuation(text)
    return text


_ABOVE = Field(gt=0.0, le=1e12)
Mass = Annotated[float, _ABOVE, _read(_mass)]
Length = Annotated[float, _ABOVE, _read(_quantity("displacement"))]
Stiffness = Annotated[float, _ABOVE, _read(_quantity("stiffness"))]
Force = Annotated[float, _ABOVE, _read(_quantity("force"))]
Dashpot = Annotated[float, Field(ge=0.0, le=1e12), _read(_quantity("damping"))]
Acceleration = Annotated[float, _ABOVE, _read(parse_acceleration)]
Share = Annotated[float, _ABOVE, _read(_share, only_text=False)]
Ratio = Annotated[float, Field(ge=0.0, lt=1.0), _read(_share, only_text=False)]
Actuation = Annotated[str, _read(_checked_actuation, only_text=False)]
Positive = Annotated[int, Field(ge=1)]
Floor = Annotated[int, Field(ge=0)]


class BuildingTable(BaseModel):
    """A table of a building file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Damping(BuildingTable):
    """Damping of the structure itself."""

    kind: Literal["rayleigh", "modal", "none"] = "rayleigh"
    ratio: Ratio = 0.02
    modes: tuple[Positive, Positive] = (1, 2)


class Storey(BuildingTable):
    """A storey and the floor above it; the first is the lowest."""

    mass: Mass | None = None
    weight: Force | None = None
    height: Length | None = None
    stiffness: Stiffness
    yield_force: Force | None = None
    dashpot: Dashpot = 0.0

    @model_validator(mode="after")
    def _one_mass(self) -> Storey:
        if (self.mass is None) == (self.weight is None):
            raise ValueError("give either mass or weight of the floor")
        return self

    @property
    def inertia(self) -> float:
        """Mass of the floor, kip s²/in."""
        return self.mass if self.mass is not None else (self.weight or 0.0) / GRAVITY


class Matrices(BuildingTable):
    """A structure by its matrices, from CSV or .npy files beside the building file."""

    mass: str
    stiffness: str
    damping: str | None = None
    units: dict[Literal["mass", "stiffness", "damping"], str] = {}
    influence: tuple[float, ...] | None = None
    heights: tuple[Length, ...] | None = None


class History(BuildingTable):
    """An actuation that changes in time, from a file with a column of the time."""

    file: str
    column: str
    unit: str


def _kind(value: object) -> str:
    return ":table" if isinstance(value, dict) else ":list" if isinstance(value, list) else ":text"


class Damper(BuildingTable):
    """One damper, or several at one place."""

    storey: Positive | None = None
    between: tuple[Floor, Floor] | None = None
    count: Annotated[int, Field(ge=1, le=100)] = 1
    actuation: Annotated[
        Annotated[Actuation, Tag(":text")]
        | Annotated[tuple[Actuation, ...], Tag(":list")]
        | Annotated[History, Tag(":table")],
        Discriminator(_kind),
    ]
    geometry: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    brace: Annotated[Stiffness | None, BeforeValidator(lambda v: None if v == "rigid" else v)] = (
        None
    )

    @model_validator(mode="after")
    def _one_place(self) -> Damper:
        if (self.storey is None) == (self.between is None):
            raise ValueError("give either storey, or between = [upper, lower] of two floors")
        if isinstance(self.actuation, tuple) and len(self.actuation) != self.count:
            raise ValueError(
                f"actuation must have one value, or one for each of the {self.count} dampers"
            )
        return self


class ResponseLimits(BuildingTable):
    """Limits whose probability of being passed is computed."""

    drift: Share | None = None
    acceleration: Acceleration | None = None
    base_shear: Force | None = None
    travel: Length | None = None
    residual: Share | None = None


class About(BuildingTable):
    """What the building is."""

    title: Annotated[str, Field(max_length=200)] = "Building"
    damping: Damping = Damping()


class Content(BuildingTable):
    """A whole building file."""

    building: About = About()
    storey: tuple[Storey, ...] = ()
    matrices: Matrices | None = None
    damper: tuple[Damper, ...] = ()
    limits: ResponseLimits = ResponseLimits()

    @model_validator(mode="after")
    def _one_structure(self) -> Content:
        if bool(self.storey) == (self.matrices is not None):
            raise ValueError("give either [[storey]] tables or [matrices]")
        return self


KEYS: dict[str, Collection[str]] = {
    "": Content.model_fields,
    "building": About.model_fields,
    "damping": Damping.model_fields,
    "storey": Storey.model_fields,
    "matrices": Matrices.model_fields,
    "units": ("mass", "stiffness", "damping"),
    "damper": Damper.model_fields,
    "actuation": History.model_fields,
    "limits": ResponseLimits.model_fields,
}
"""Keys that each table may have; "" is the file itself."""


def read_content(path: Path) -> Content:
    """Content of a building file; unknown, missing and wrong keys are named."""
    try:
        raw = read_toml(path)
        return Content.model_validate(raw)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise BuildingError(f"{path} {error}") from error
    except ValidationError as error:
        raise BuildingError(
            faults_text(path, raw, error, lambda tables: KEYS[("", *tables)[-1]])
        ) from None


LARGEST = 500  # most degrees of freedom
LARGEST_FILE = 64 * 2**20  # largest text file of a matrix, bytes


# --- the building


@dataclass(frozen=True, eq=False)
class Device:
    """One damper in a building, between an upper and a lower floor: from 1; 0 is the ground."""

    name: str  # its place: "storey 1", "storey 1, no. 2"
    upper: int
    lower: int
    actuation: float  # ksi or kip; NaN where it is a history
    unit: str  # "ksi" or "kip"
    geometry: float = 1.0  # travel of the damper over the drift between the two floors
    brace: float = np.inf  # stiffness in series, kip/in; infinite for a rigid one
    history: tuple[Array, Array] | None = None  # time, s, and actuation, (T,) each

    @property
    def level(self) -> float:
        """Actuation, ksi or kip; the mean of a history."""
        return self.actuation if self.history is None else float(np.mean(self.history[1]))


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a structure, the longest period first."""

    frequencies: Array  # (N,), rad/s
    shapes: Array  # (N, N), columns φ with φᵀMφ = 1

    @property
    def periods(self) -> Array:
        """Natural periods, (N,), s."""
        return 2.0 * np.pi / self.frequencies


@dataclass(frozen=True, eq=False)
class Building:
    """A building of N degrees of freedom and S storeys with dampers, in kip, in and s."""

    title: str
    mass: Array  # (N, N), kip s²/in
    damping: Array  # (N, N), kip s/in
    stiffness: Array  # (N, N), kip/in
    influence: Array  # (N,), motion of each degree of freedom when the ground moves by 1
    drifts: Array  # (S, N), storey drifts of displacements
    heights: Array  # (S,), in; NaN where not known
    yields: Array  # (S,), kip; infinite where a storey stays elastic
    storeys: Array  # (S,), kip/in, stiffness of the storeys that yield
    devices: tuple[Device, ...]
    limits: ResponseLimits

    @property
    def freedoms(self) -> int:
        """Number of degrees of freedom N."""
        return len(self.mass)

    @property
    def modes(self) -> Modes:
        """Periods and shapes of the elastic building without dampers, K φ = ω² M φ."""
        squares, shapes = linalg.eigh(self.stiffness, self.mass)
        return Modes(np.sqrt(squares), shapes)

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

    @property
    def actuations(self) -> tuple[Array | None, list[Array]]:
        """Times, (T,) s, and the actuation of each damper then, (T,).

        Where all are constant there are no times, and T is 1.
        """
        grids = [device.history[0] for device in self.devices if device.history is not None]
        times = np.unique(np.concatenate(grids)) if grids else None
        levels = [
            np.full(1 if times is None else times.size, device.actuation)
            if device.history is None
            else np.interp(device.history[0] if times is None else times, *device.history)
            for device in self.devices
        ]
        return times, levels

    def at_level(self, actuation: float) -> Building:
        """The building with all dampers at one constant actuation, ksi or kip."""
        actuation = real_number("actuation", actuation, BuildingError, (0.0, np.inf))
        level = [replace(d, actuation=actuation, history=None) for d in self.devices]
        return replace(self, devices=tuple(level))

    def bare(self) -> Building:
        """The building without its dampers."""
        return replace(self, devices=())


def read_building(path: str | PathLike[str]) -> Building:
    """Building of a TOML file."""
    path = path_of("building", path, BuildingError)
    return building_of(read_content(path), path)


def building_of(content: Content, path: Path) -> Building:
    """Building of a checked content; `path` is its file, beside which others are looked for."""
    matrices = content.matrices
    if matrices is not None:
        mass, stiffness, dashpots = _matrices(matrices, path)
        size = len(mass)
        for key, values in (("influence", matrices.influence), ("heights", matrices.heights)):
            if values is not None and len(values) != size:
                raise BuildingError(
                    f"matrices.{key} in {path} must have {size} values, got {len(values)}"
                )
        drifts = np.eye(size) - np.eye(size, k=-1)
        influence = np.array(matrices.influence or np.ones(size))
        heights = np.array(matrices.heights or np.full(size, np.nan))
        storeys, yields = np.zeros(size), np.full(size, np.inf)
    else:
        size, entries = len(content.storey), content.storey
        drifts = np.eye(size) - np.eye(size, k=-1)
        storeys = np.array([storey.stiffness for storey in entries])
        yields = np.array([storey.yield_force or np.inf for storey in entries])
        heights = np.array([storey.height or np.nan for storey in entries])
        mass, influence = np.diag([storey.inertia for storey in entries]), np.ones(size)
        stiffness = drifts.T @ np.diag(storeys) @ drifts
        dashpots = drifts.T @ np.diag([storey.dashpot for storey in entries]) @ drifts
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        squares = np.linalg.eigvalsh(matrix)
        if squares[0] <= 1e-14 * squares[-1]:
            raise BuildingError(
                f"the {name} matrix of {path} must be symmetric and positive definite; its "
                f"smallest eigenvalue is {squares[0]:.3g}"
            )
    devices = tuple(
        device
        for number, damper in enumerate(content.damper, start=1)
        for device in _devices(damper, number, size, path)
    )
    if len({device.unit for device in devices}) > 1:
        raise BuildingError(f"damper in {path}: actuation must be a pressure of all, or a force")
    shares = [name for name in ("drift", "residual") if getattr(content.limits, name) is not None]
    if shares and not np.all(np.isfinite(heights)):
        raise BuildingError(f"limits.{shares[0]} in {path} needs the height of every storey")
    title, limits = content.building.title, content.limits
    structure = mass, dashpots, stiffness, influence, drifts, heights, yields, storeys
    undamped = Building(title, *structure, devices, limits)
    return replace(undamped, damping=damping_matrix(content.building.damping, undamped, str(path)))


def damping_matrix(damping: Damping, building: Building, path: str) -> Array:
    """Damping matrix C, (N, N), kip s/in: of ratios, and of a building's dashpots in addition.

    Rayleigh: C = a M + b K with the ratio ζ at two modes, a = 2ζ ω1 ω2/(ω1 + ω2) and
    b = 2ζ/(ω1 + ω2). Modal: C = M Φ diag(2 ζ ω) Φᵀ M, with the ratio in all modes.
    """
    dashpots, modes, fields = building.damping, building.modes, damping.model_fields_set
    if damping.kind == "none" or (np.any(dashpots) and not fields & {"ratio", "kind"}):
        return dashpots  # they are the damping then
    ratio, omega = damping.ratio, modes.frequencies
    if damping.kind == "modal":
        towards = building.mass @ modes.shapes
        return towards @ np.diag(2.0 * ratio * omega) @ towards.T + dashpots
    places = damping.modes if omega.size > 1 or "modes" in fields else (1, 1)
    if max(places) > omega.size:
        raise BuildingError(
            f"building.damping.modes in {path}: the building has {omega.size} modes, got {places}"
        )
    omega_1, omega_2 = (float(omega[number - 1]) for number in places)
    by_mass = 2.0 * ratio * omega_1 * omega_2 / (omega_1 + omega_2)
    by_stiffness = 2.0 * ratio / (omega_1 + omega_2)
    return by_mass * building.mass + by_stiffness * building.stiffness + dashpots


def _devices(damper: Damper, number: int, floors: int, path: Path) -> Iterator[Device]:
    """The devices of one [[damper]], each by itself."""
    upper, lower = damper.between or (damper.storey or 0, (damper.storey or 1) - 1)
    key = "between" if damper.between else "storey"
    if max(upper, lower) > floors or upper == lower:
        raise BuildingError(
            f"damper {number}.{key} in {path}: expected floors of 0, the ground, to {floors}, two "
            f"different ones, got {damper.between or damper.storey}"
        )
    location = f"storey {upper}" if lower == upper - 1 else f"floors {lower} to {upper}"
    brace, actuation = np.inf if damper.brace is None else damper.brace, damper.actuation
    history = _history(actuation, location, path) if isinstance(actuation, History) else None
    for i in range(damper.count):
        name = location if damper.count == 1 else f"{location}, no. {i + 1}"
        if isinstance(actuation, History):
            level, unit = np.nan, parse_actuation(f"1 {actuation.unit}")[1]
        else:
            level, unit = parse_actuation(
                actuation[i] if isinstance(actuation, tuple) else actuation
            )
        yield Device(name, upper, lower, level, unit, damper.geometry, brace, history)


def _history(history: History, location: str, path: Path) -> tuple[Array, Array]:
    """Times, s, and actuations, ksi or kip, of a damper's file."""
    label = f"the actuation of {location}"
    file = _file_beside(path.parent, history.file, label)
    try:
        table = read_table(file)
        times = [name for name in table.names if name.lower().startswith(("time", "t_", "t["))]
        if not times:
            raise BuildingError(f"actuation.file {file} needs a column of the time, 'time_s'")
        columns = table.columns([times[0], history.column])
        time = columns[times[0]] * factor(header_unit(times[0]) or "s", "time")
        level = columns[history.column] * actuation_factor(history.unit)[0]
    except MfdError as error:
        raise BuildingError(f"{label}: {error}") from error
    if time.size < 2 or not np.all(np.diff(time) > 0) or np.any(level < 0):
        raise BuildingError(f"{label}: {file} must have growing times and no value below 0")
    return time, level


def _matrices(entry: Matrices, path: Path) -> tuple[Array, Array, Array]:
    """Mass, stiffness and dashpots, (N, N) each, of files."""
    matrices: dict[str, Array] = {}
    for key, unit in (("mass", "kip*s^2/in"), ("stiffness", "kip/in"), ("damping", "kip*s/in")):
        name, label = getattr(entry, key), f"matrices.{key} in {path}"
        if name is None:
            continue
        try:
            scale = convert(entry.units.get(key, unit), unit)  # type: ignore[call-overload]
        except UnitError as error:
            raise BuildingError(f"matrices.units.{key} in {path}: {error}") from error
        matrices[key] = scale * _matrix(_file_beside(path.parent, name, label), label)
    if len({matrix.shape for matrix in matrices.values()}) > 1:
        shapes = ", ".join(f"{key} {m.shape}" for key, m in matrices.items())
        raise BuildingError(f"matrices in {path} must be of one size, got {shapes}")
    return (
        matrices["mass"],
        matrices["stiffness"],
        matrices.get("damping", np.zeros_like(matrices["mass"])),
    )


def _matrix(path: Path, key: str) -> Array:
    """Square symmetric matrix of a CSV or .npy file."""
    try:
        if reason := why_no_file(path):
            raise BuildingError(f"{key}: {path} {reason}")
        if path.suffix == ".npy":
            matrix = np.asarray(np.load(path, mmap_mode="r"))  # no shape larger than the file
            if matrix.dtype.kind not in "biuf":
                raise ValueError(f"it holds {matrix.dtype}, and no real numbers")
        elif path.stat().st_size > LARGEST_FILE:
            raise BuildingError(f"{key}: {path} is larger than {LARGEST_FILE >> 20} MB")
        else:
            matrix = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError, TypeError, EOFError, OverflowError) as error:
        raise BuildingError(f"{key}: cannot read {path} as numbers: {error}") from error
    square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] and 0 < len(matrix) <= LARGEST
    if not square or not np.all(np.isfinite(matrix)):
        raise BuildingError(
            f"{key}: {path} must hold a square matrix of finite numbers, up to {LARGEST} rows, got "
            f"the shape {matrix.shape}"
        )
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-9 * np.abs(matrix).max()):
        raise BuildingError(f"{key}: the matrix in {path} must be symmetric")
    return np.asarray(0.5 * (matrix + matrix.T))


def _file_beside(folder: Path, name: str, key: str) -> Path:
    """Path of a file in a building file's folder; `key` is the place at which it is named."""
    try:
        path = file_inside(folder, name)
    except (OSError, RuntimeError, ValueError) as error:
        raise BuildingError(f"{key}: the file {name!r} cannot be found: {error}") from error
    if path is None:
        raise BuildingError(
            f"{key}: the file {name!r} lies outside the folder of the building file"
        )
    return folder / name


def example_building() -> str:
    """Text of a first building file, to be changed by its user."""
    return files("mfd_bayes.applications.buildings").joinpath("example.toml").read_text("utf-8")
