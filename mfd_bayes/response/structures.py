"""The matrices of a building, of its storeys or from files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError, UnitError
from mfd_bayes.records.regular import why_no_file
from mfd_bayes.response.beside import file_beside
from mfd_bayes.response.measures import MASS
from mfd_bayes.response.schema import Content, Matrices
from mfd_bayes.units import convert

Array = NDArray[np.float64]

LARGEST = 500
"""Most degrees of freedom."""

LARGEST_FILE = 64 * 2**20
"""Largest text file of a matrix, bytes."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A structure without dampers; see `Building`. `dashpots` are (N, N), kip s/in."""

    mass: Array
    stiffness: Array
    dashpots: Array
    influence: Array
    drifts: Array
    heights: Array
    yields: Array
    storeys: Array


def skeleton_of(content: Content, path: Path) -> Skeleton:
    """Structure of a building file.

    Raises
    ------
    BuildingError
        When a file of a matrix cannot be used.
    """
    if content.matrices is not None:
        return _from_files(content.matrices, path)
    storeys = content.storey
    drifts = _drifts(len(storeys))
    stiffness = np.array([storey.stiffness for storey in storeys])
    dashpots = np.array([storey.dashpot for storey in storeys])
    return Skeleton(
        mass=np.diag([storey.inertia for storey in storeys]),
        stiffness=drifts.T @ np.diag(stiffness) @ drifts,
        dashpots=drifts.T @ np.diag(dashpots) @ drifts,
        influence=np.ones(len(storeys)),
        drifts=drifts,
        heights=np.array([storey.height or np.nan for storey in storeys]),
        yields=np.array([storey.yield_force or np.inf for storey in storeys]),
        storeys=stiffness,
    )


def _drifts(n: int) -> Array:
    """Drifts between neighbouring floors of displacements, (n, n)."""
    return np.eye(n) - np.eye(n, k=-1)


def _from_files(given: Matrices, path: Path) -> Skeleton:
    units = {"mass": MASS, "stiffness": "kip/in", "damping": "kip*s/in"}
    names = {"mass": given.mass, "stiffness": given.stiffness}
    if given.damping is not None:
        names["damping"] = given.damping
    found = {}
    for key, name in names.items():
        try:
            factor = convert(given.units.get(key, units[key]), units[key])  # type: ignore[call-overload]
        except UnitError as error:
            raise BuildingError(f"matrices.units.{key} in {path}: {error}") from error
        where = f"matrices.{key} in {path}"
        found[key] = factor * _matrix(file_beside(path.parent, name, where), where)
    n = len(found["mass"])
    if {m.shape for m in found.values()} != {(n, n)}:
        shapes = ", ".join(f"{key} {m.shape}" for key, m in found.items())
        raise BuildingError(f"matrices in {path} must be of one size, got {shapes}")
    for key, values in (("influence", given.influence), ("heights", given.heights)):
        if values is not None and len(values) != n:
            raise BuildingError(f"matrices.{key} in {path} must have {n} values, got {len(values)}")
    nothing = np.full(n, np.inf)
    return Skeleton(
        mass=found["mass"],
        stiffness=found["stiffness"],
        dashpots=found.get("damping", np.zeros((n, n))),
        influence=np.array(given.influence or np.ones(n)),
        drifts=_drifts(n),
        heights=np.array(given.heights or np.full(n, np.nan)),
        yields=nothing,
        storeys=np.zeros(n),
    )


def _matrix(path: Path, key: str) -> Array:
    """Square symmetric matrix of a CSV or .npy file."""
    try:
        if reason := why_no_file(path):
            raise BuildingError(f"{key}: {path} {reason}")
        if path.suffix == ".npy":
            matrix = _of_npy(path)
        elif path.stat().st_size > LARGEST_FILE:
            raise BuildingError(f"{key}: {path} is larger than {LARGEST_FILE >> 20} MB")
        else:
            matrix = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError, TypeError, EOFError) as error:
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


def _of_npy(path: Path) -> Array:
    """Array of a .npy file whose header says real numbers of a size that can be used."""
    with path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0}
        shape, _, kind = read.get(version, np.lib.format.read_array_header_2_0)(file)
        if kind.kind not in "biuf":
            raise ValueError(f"it holds {kind}, and no real numbers")
        if math.prod(shape) > LARGEST**2:
            raise ValueError(f"its shape is {shape}, and there are up to {LARGEST} rows")
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file), dtype=np.float64)
