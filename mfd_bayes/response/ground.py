"""Ground motions: PEER's .AT2, plain columns with a step, and CSV with units."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError, MfdError, UnitError
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.regular import path_of, why_no_file
from mfd_bayes.records.roles import header_unit
from mfd_bayes.response.ground_text import read_text
from mfd_bayes.response.measures import acceleration_factor
from mfd_bayes.units import factor

Array = NDArray[np.float64]

LARGEST = 64 * 2**20
"""Largest file, bytes."""

MOST = 200_000
"""Most samples of a ground motion."""

SAME_STEP = 5e-3
"""Share by which a step that is given may differ from the file's, which is rounded there."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A ground motion.

    Attributes
    ----------
    name : str
    step : float, s
    acceleration : (T,), in/s²
        The first sample is at time 0. A copy of what is given, which cannot be changed.

    Raises
    ------
    BuildingError
        When the name is no text, the step is not positive, or values are missing, not finite or
        all zero.
    """

    name: str
    step: float
    acceleration: Array

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise BuildingError(f"name of a ground motion must be text, got {self.name!r}")
        step = _checked_step(self.name, self.step)
        object.__setattr__(self, "step", step)
        object.__setattr__(self, "acceleration", _checked_values(self.name, self.acceleration))

    @property
    def time(self) -> Array:
        """Times of the samples, (T,), s."""
        return np.asarray(self.step * np.arange(self.acceleration.size), dtype=np.float64)

    @property
    def peak(self) -> float:
        """Largest acceleration, in/s²."""
        return float(np.max(np.abs(self.acceleration)))

    def scaled(self, by: float) -> Ground:
        """The motion times a factor, which its name says.

        Raises
        ------
        BuildingError
            When the factor is no number, or zero.
        """
        by = real_number("factor", by, BuildingError)
        name = f"{self.name} × {by:.3g}"
        return replace(self, name=name, acceleration=by * self.acceleration)

    def with_peak(self, peak: float) -> Ground:
        """The motion scaled to a peak, in/s².

        Raises
        ------
        BuildingError
            When the peak is no number above zero.
        """
        peak = real_number("peak", peak, BuildingError, (0.0, np.inf), inside=True)
        return self.scaled(peak / self.peak)


def ground_of(name: str, step: float, acceleration: Sequence[float] | Array) -> Ground:
    """Checked ground motion of a step, s, and accelerations, in/s².

    Raises
    ------
    BuildingError
        As `Ground` does.
    """
    return Ground(name, step, acceleration)  # type: ignore[arg-type]


def _checked_step(name: str, step: Any) -> float:
    """Step of a ground motion, s."""
    what = f"{name}: the step of a ground motion"
    return real_number(what, step, BuildingError, (0.0, np.inf), inside=True)


def _checked_values(name: str, acceleration: Any) -> Array:
    """Accelerations of a ground motion as numbers of its own, (T,), in/s²."""
    values = np.array(real_numbers(f"{name}: acceleration", acceleration, BuildingError))
    if values.ndim != 1 or not 2 <= values.size <= MOST:
        raise BuildingError(f"{name}: expected 2 to {MOST} values, got {values.size}")
    if not np.all(np.isfinite(values)):
        row = int(np.argmax(~np.isfinite(values))) + 1
        raise BuildingError(f"{name}: value {row} of the ground motion is no finite number")
    if not np.any(values):
        raise BuildingError(f"{name}: the ground does not move: all values are 0")
    values.flags.writeable = False
    return values


def read_ground(path: str | PathLike[str], *, step: float | None = None, unit: str = "") -> Ground:
    """Ground motion of a file.

    Parameters
    ----------
    path : path
        With the suffix .csv: a table with a column of the time and one of the acceleration, with
        units in its header. Any other: PEER's .AT2, or numbers alone.
    step : float, s, optional
        Where the file does not say it.
    unit : str, optional
        Of the acceleration, where the file does not say it; "g" by default, but for a CSV.

    Raises
    ------
    BuildingError
        When the file cannot be read, its step is not known, a value is of another type, or the
        file says another step or unit than is given.
    """
    path = path_of("ground", path, BuildingError)
    if step is not None:
        step = _checked_step(path.name, step)
    if not isinstance(unit, str):
        raise BuildingError(f"unit must be text, such as 'g' or 'm/s^2', got {unit!r}")
    try:
        if reason := why_no_file(path):
            raise BuildingError(f"{path} {reason}")
        if path.stat().st_size > LARGEST:
            raise BuildingError(f"{path} is larger than {LARGEST >> 20} MB")
        if path.suffix.lower() == ".csv":
            return _of_table(path, step, unit)
        return _of_text(path, step, unit)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except UnitError as error:
        raise BuildingError(f"{path}: {error}") from error


def _of_text(path: Path, step: float | None, unit: str) -> Ground:
    """Motion of PEER's format, or of numbers alone in rows."""
    text = read_text(path)
    step = _agreed_step(path, text.step, step)
    if step is None:
        raise BuildingError(
            f"{path} does not say its step (NPTS= …, DT= … SEC): give it as FILE:0.01s, or "
            "step=0.01 in Python"
        )
    said = f"the header says 'UNITS OF {text.unit}'"
    by = _agreed_factor(f"{path}: {said}", _in_header(text.unit), unit) if text.unit else None
    return ground_of(path.name, step, text.values * (by or acceleration_factor(unit or "g")))


def _agreed_step(path: Path, own: float | None, given: float | None) -> float | None:
    """Step of a file, s, or the one that is given where the file does not say it."""
    if own is None or given is None or math.isclose(own, given, rel_tol=SAME_STEP):
        return given if own is None else own
    raise BuildingError(
        f"{path}: the file's step is {own:.6g} s, and {given:.6g} s was given: leave the step out, "
        "or correct the file"
    )


def _agreed_factor(where: str, own: str, given: str) -> float:
    """Factor of the unit that a file says to in/s²; `where` is the place at which it is said."""
    wanted = acceleration_factor(given) if given else None
    try:
        by = acceleration_factor(own)
    except UnitError as error:
        if wanted is not None:
            return wanted
        raise BuildingError(
            f"{where}, which is no acceleration such as 'g' or 'cm/s^2': give the unit as "
            "FILE:cm/s^2, or unit='cm/s^2' in Python"
        ) from error
    if wanted is None or math.isclose(by, wanted, rel_tol=1e-6):
        return by
    raise BuildingError(
        f"{where}, and {given!r} was given: leave the unit out, or correct the file"
    )


def _in_header(unit: str) -> str:
    """A header's unit, in capitals as a rule, as units are written here: "CM/S2", "GAL"."""
    lower = unit.lower()
    return "cm/s^2" if lower == "gal" else re.sub(r"(?<=[a-z])2$", "^2", lower)


def _of_table(path: Path, step: float | None, unit: str) -> Ground:
    """Motion of a CSV with names, such as time_s and acceleration_g."""
    try:
        table = read_table(path)
        names = {name: name.lower() for name in table.names}
        moves = [n for n, low in names.items() if low.startswith(("acc", "a_", "ag", "ground"))]
        if len(moves) != 1:
            raise BuildingError(
                f"{path} needs one column of the acceleration, such as 'acceleration_g'; it has "
                f"{', '.join(table.names[:20])}"
            )
        times = [name for name, low in names.items() if low.startswith(("time", "t_", "t["))]
        columns = table.columns([*moves, *times[:1]])
    except MfdError as error:
        raise BuildingError(str(error)) from error
    own = table.units.get(moves[0]) or header_unit(moves[0]) or unit
    if not own:
        raise BuildingError(f"{path}: the column {moves[0]!r} has no unit, such as acceleration_g")
    if times:
        time = columns[times[0]] * factor(header_unit(times[0]) or "s", "time")
        step = _agreed_step(path, _step_of(path, time), step)
    if step is None:
        raise BuildingError(f"{path} needs a column of the time, such as 'time_s', or a step")
    by = _agreed_factor(f"{path}: the unit of the column {moves[0]!r} is {own!r}", own, unit)
    return ground_of(path.name, step, columns[moves[0]] * by)


def _step_of(path: Path, time: Array) -> float:
    """Step of times, s, which must be even."""
    steps = np.diff(time)
    if time.size < 2 or not steps.min() > 0 or np.ptp(steps) > 1e-3 * steps.mean():
        raise BuildingError(f"{path}: the time of a ground motion must grow by one even step")
    return float((time[-1] - time[0]) / (time.size - 1))


def parse_ground(text: str, *, of: str = "--ground") -> tuple[Path, float | None, str]:
    """File, step and unit of ``"Rinaldi.AT2:0.01s"`` or ``"a.txt:0.01s:cm/s^2"``.

    Raises
    ------
    BuildingError
        When what follows the colons is no step and no unit.
    """
    name, *rest = text.split(":")
    if not rest or Path(text).exists():
        return Path(text), None, ""
    step, unit = None, ""
    for part in rest:
        match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(s|ms)\s*", part)
        try:
            if match:
                step = float(match[1]) * factor(match[2], "time")
            else:
                acceleration_factor(part)
                unit = part
        except (ValueError, UnitError) as error:
            raise BuildingError(
                f"{of} {text!r}: expected FILE, FILE:0.01s or FILE:0.01s:g, got {part!r}"
            ) from error
    return Path(name), step, unit


__all__ = ["Ground", "ground_of", "parse_ground", "read_ground"]
