"""Ground motions: PEER's .AT2, plain columns with a step, and CSV with units."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from mfd_bayes.errors import BuildingError, MfdError, UnitError
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.readers import Table, read_table
from mfd_bayes.records.regular import path_of, why_no_file
from mfd_bayes.records.roles import header_unit
from mfd_bayes.response.ground_text import LONGEST_STEP, SAME_STEP, parse_step, read_text
from mfd_bayes.response.measures import acceleration_factor
from mfd_bayes.units import GRAVITY, factor

Array = NDArray[np.float64]

LARGEST = 64 * 2**20
"""Largest file, bytes."""

MOST = 200_000
"""Most samples of a ground motion."""

WEAKEST, STRONGEST = 1e-4, 5.0
"""Peaks of ground motions that are believed without being asked, g."""


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

    @property
    def words(self) -> str:
        """Name, peak in g and duration, in words."""
        peak, last = self.peak / GRAVITY, float(self.time[-1])
        return f"{self.name}: peak {peak:.3g} g, {last:.4g} s in steps of {self.step:.4g} s"

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


def read_ground(
    path: str | PathLike[str], *, step: float | None = None, unit: str = "", meant: bool = False
) -> Ground:
    """Ground motion of a file.

    Parameters
    ----------
    path : path
        With the suffix .csv: a table with a column of the time and one of the acceleration, with
        units in its header. Any other: PEER's .AT2, K-NET's files, or numbers alone.
    step : float, s, optional
        Where the file does not say it.
    unit : str, optional
        Of the acceleration, where the file does not say it; "g" by default, but for a CSV.
    meant : bool
        Whether to take any peak. Without it, and without a `unit`, one above 5 g or below
        0.0001 g is refused.

    Raises
    ------
    BuildingError
        When the file cannot be read, its step is not known, a value is of another type, the
        file says another step or unit than is given, or its peak cannot be that of the ground.
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
        found = (_of_table if path.suffix.lower() == ".csv" else _of_text)(path, step, unit)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except UnitError as error:
        raise BuildingError(f"{path}: {error}") from error
    if step is None and found.step > LONGEST_STEP:
        raise BuildingError(
            f"{path}: the file's step is {found.step:.6g} s, and steps are at most {LONGEST_STEP} "
            "s: give it as FILE:0.01s, or step=0.01 in Python"
        )
    peak = found.peak / GRAVITY
    if not (meant or unit or WEAKEST <= peak <= STRONGEST):
        raise BuildingError(
            f"{path}: its peak would be {peak:.3g} g, and ground motions have {WEAKEST:g} to "
            f"{STRONGEST:g} g: give the unit of its values as FILE:cm/s^2 (unit='cm/s^2' in "
            "Python), or a --scale"
        )
    return found


def _of_text(path: Path, step: float | None, unit: str) -> Ground:
    """Motion of PEER's format or of K-NET's, or of numbers alone in rows."""
    text = read_text(path)
    step = _agreed_step(path, text.step, step)
    if step is None:
        said = f" (it has {text.unread!r}, which cannot be read)" if text.unread else ""
        raise BuildingError(
            f"{path} does not say its step (NPTS= …, DT= … SEC){said}: give it as FILE:0.01s, or "
            "step=0.01 in Python"
        )
    by = acceleration_factor(unit or "g")
    if text.said:
        by = _agreed_factor(f"{path}: the header says {text.said!r}", text.unit, unit)
    return ground_of(_shown(path), step, text.values * by)


def _shown(path: Path) -> str:
    """Name of a file as text that can be written: bytes that are not UTF-8 become escapes."""
    return path.name.encode(errors="backslashreplace").decode()


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
    own = _unit_of(table, moves[0]) or unit
    if not own:
        raise BuildingError(f"{path}: the column {moves[0]!r} has no unit, such as acceleration_g")
    if times:
        by = factor(_unit_of(table, times[0]) or "s", "time")
        step = _step_of(path, by * columns[times[0]], _digit(columns[times[0]]) * by, step)
    if step is None:
        raise BuildingError(f"{path} needs a column of the time, such as 'time_s', or a step")
    by = _agreed_factor(f"{path}: the unit of the column {moves[0]!r} is {own!r}", own, unit)
    return ground_of(_shown(path), step, columns[moves[0]] * by)


def _unit_of(table: Table, name: str) -> str:
    """Unit of a column, by the row of units or by its name; "" where neither has one.

    Raises
    ------
    BuildingError
        When they contradict each other.
    """
    row, own = table.units.get(name, ""), header_unit(name) or ""
    if row and own and (a := _any_factor(row)) and (b := _any_factor(own)) and a != b:
        raise BuildingError(
            f"{table.path}: the column {name!r} is in {own!r} by its name and in {row!r} by the "
            "row of units: correct the file"
        )
    return row or own


def _any_factor(unit: str) -> float | None:
    """Factor of a unit of acceleration or of time, rounded; None for any other unit."""
    for read in (acceleration_factor, lambda text: factor(text, "time")):
        with suppress(UnitError):
            return float(f"{read(unit):.6g}")
    return None


def _step_of(path: Path, time: Array, digit: float, given: float | None) -> float:
    """Step of even times, s, whose last digit, of a size in s, is rounded; the given one if any.

    Times that are written more coarsely than their step are read only with a given step.
    """
    step = float(time[-1] - time[0]) / max(time.size - 1, 1)
    coarse = given is not None and digit > 1.01 * given
    off = float(np.max(np.abs(time - (time[0] + step * np.arange(time.size)))))
    change = np.diff(time) if time.size > 1 else np.zeros(1)
    even = np.ptp(change) <= 1e-3 * step or off <= 1.001 * min(
        digit, np.inf if coarse else step / 10
    )
    if not (step > 0.0 and even and (change.min() > 0.0 or (coarse and change.min() == 0.0))):
        raise BuildingError(f"{path}: the time of a ground motion must grow by one even step")
    if given is None or not coarse or abs(step - given) * time.size > digit:
        _agreed_step(path, step, given)
    return given or step


def _digit(values: Array) -> float:
    """Size of the last digit with which the largest values are written: "%.4f" or "%.5g"."""
    most = float(np.max(np.abs(values)))
    places = next((n for n in range(9) if np.allclose(values, np.round(values, n), 1e-12, 0)), 99)
    power = 10.0 ** np.floor(np.log10(np.maximum(np.abs(values), 1e-300)))
    lead = values / power
    digits = next((n for n in range(15) if np.allclose(lead, np.round(lead, n), 1e-12, 0)), 99)
    return float(max(10.0**-places, 10.0 ** (np.floor(np.log10(most or 1.0)) - digits)))


def parse_ground(text: str, *, of: str = "--ground") -> tuple[Path, float | None, str]:
    """File, step and unit of ``"Rinaldi.AT2:0.01s"`` or ``"a.txt:0.01s:cm/s^2"``.

    Step and unit are taken off the end; the path before them may have colons.

    Raises
    ------
    BuildingError
        When what follows the last colon is no step, no unit and no path.
    """
    name, step, unit = text, None, ""
    while ":" in name and not os.path.lexists(name):
        rest, tail = name.rsplit(":", 1)
        if step is None and (found := parse_step(tail)) is not None:
            step = found
        elif not unit and _any_unit(tail):
            unit = tail.strip()
        elif re.search(r"[/\\]", tail):  # "run 10:30/quake.txt", "C:\gm\quake.txt"
            break
        else:
            raise BuildingError(
                f"{of} {text!r}: expected FILE, FILE:0.01s or FILE:0.01s:g, got {tail!r}"
            )
        name = rest
    return Path(name), step, unit


def _any_unit(text: str) -> bool:
    """Whether a text is a unit of acceleration."""
    with suppress(UnitError):
        return acceleration_factor(text) > 0
    return False


STEP, SAMPLES, PEAK = 0.02, 1000, 0.35
"""Of the artificial ground motion: s, number, g."""

_SOIL = 2.0 * np.pi * 2.5, 0.6
"""Frequency, rad/s, and damping of the soil."""


def example_ground() -> str:
    """An artificial ground motion in PEER's layout: filtered noise that swells and fades.

    White noise through the soil's filter of Kanai and Tajimi, ω = 2π 2.5 Hz and ζ = 0.6, under an
    envelope. It is for trying out: no earthquake looks quite like it.
    """
    noise = np.random.default_rng(1940).standard_normal(SAMPLES)
    (omega, zeta), h = _SOIL, STEP
    decay = np.exp(-zeta * omega * h)
    turn = 2.0 * decay * np.cos(omega * h * np.sqrt(1.0 - zeta**2))
    shaken = lfilter([1.0, -1.0], [1.0, -turn, decay**2], noise)  # without a drift
    time = STEP * np.arange(SAMPLES)
    values = shaken * np.minimum(time / 3.0, 1.0) * np.exp(-np.maximum(time - 8.0, 0.0) / 3.0)
    values *= PEAK / np.max(np.abs(values))
    lines = [
        "Artificial ground motion, filtered noise, for trying out",
        "mfd-bayes init --building",
        "ACCELERATION TIME SERIES IN UNITS OF G",
        f"NPTS= {SAMPLES}, DT= {STEP:.4f} SEC",
    ]
    for row in values.reshape(-1, 5):
        lines.append("".join(f"{value:15.6E}" for value in row))
    return "\n".join(lines) + "\n"
