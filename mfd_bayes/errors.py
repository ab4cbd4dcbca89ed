"""The errors that a user can cause, each with one sentence that says what was expected.

Then what a caller gives, checked: numbers, of which none is cast in silence, and paths of files.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from contextlib import suppress
from math import inf, isfinite, nan
from numbers import Real
from operator import index
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


class MfdError(Exception):
    """Base of every error that this package raises on purpose."""


class RecordError(MfdError):
    """A test file cannot be used as it is."""


class CampaignError(MfdError):
    """A campaign file, or a setting, cannot be used as it is."""


class BuildingError(MfdError):
    """A building file, a ground motion, or what is asked of a building, cannot be used as it is."""


class UnitError(MfdError):
    """A unit is unknown, or does not measure what it is used for."""


class PriorError(MfdError):
    """A prior file, or a prior in it, cannot be used as it is."""


class FitError(MfdError):
    """A calibration cannot be started with these data, priors and model."""


class StoreError(MfdError):
    """A run folder, or a file in it, cannot be read or written."""


class ReportError(MfdError):
    """A report cannot be made in the form that was asked for."""


class NotThereError(MfdError, KeyError, IndexError):
    """There is nothing of this name or number; as with a dict or a list, it is a KeyError too."""

    __str__ = Exception.__str__  # a KeyError shows its sentence in quotes


def real_numbers(
    name: str, values: ArrayLike, error: type[MfdError] = RecordError
) -> NDArray[np.float64]:
    """Array of what is given, float64, not copied where it is one already.

    Masked values, complex numbers, text, true and false, and units, which would be lost, raise
    `error`.
    """
    import numpy as np

    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    _refuse_unit(name, values, error)
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise error(f"{name} holds masked values: fill them, or leave these samples out")
    try:
        array = np.asarray(values)
        if array.ndim == 0 and array.dtype.kind == "b":
            raise error(f"{name} must hold real numbers, got {values!r}")
        if array.dtype.kind in "biuf" or array.size == 0:
            return array.astype(np.float64)
        if array.dtype.kind == "O" and not any(isinstance(v, str | complex) for v in array.flat):
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise error(f"{name} must hold real numbers: {fault}") from fault
    raise error(f"{name} must hold real numbers, got values of type {array.dtype}")


def real_number(
    name: str,
    value: Any,
    error: type[MfdError],
    bounds: tuple[float, float] = (-inf, inf),
    *,
    exclusive: bool = False,
) -> float:
    """A finite number within bounds, and at neither of them where it must lie `exclusive`."""
    if type(value) is not float:
        _refuse_unit(name, value, error)
    is_real = isinstance(value, Real) and not isinstance(value, bool)
    if not is_real:
        import numpy as np

        is_array = isinstance(value, np.ndarray | np.generic)
        is_real = is_array and value.ndim == 0 and value.dtype.kind in "iuf"
    number = nan
    with suppress(OverflowError):
        number = float(value) if is_real else nan
    lower, upper = bounds
    if isfinite(number) and (lower < number < upper if exclusive else lower <= number <= upper):
        return number
    lower_words, upper_words = ("above", "below") if exclusive else ("of at least", "of at most")
    limits = [f"{lower_words} {lower:g}"] * (lower > -inf) + [f"{upper_words} {upper:g}"] * (
        upper < inf
    )
    expected = " ".join(["a finite number", " and ".join(limits)]).strip()
    raise error(f"{name} must be {expected}, got {value!r}")


def _refuse_unit(name: str, value: Any, error: type[MfdError]) -> None:
    """Refuse a quantity with a unit, such as one of pint, and a list of such."""
    for item in (value, *value) if isinstance(value, list | tuple) else (value,):
        if hasattr(item, "magnitude") and hasattr(item, "units"):
            raise error(f"{name} must be plain numbers without a unit, got one in {item.units}")


MOST_DRAWS = 100_000  # more would take the memory, and tell nothing new


def whole_number(
    name: str, value: Any, minimum: int, error: type[MfdError], maximum: int | None = None
) -> int:
    """A whole number that is not below the least one, nor above the most there may be."""
    try:
        number = index(value)
    except TypeError:
        number = minimum - 1
    if number < minimum or isinstance(value, bool):
        raise error(f"{name} must be a whole number, {minimum} or more, got {value!r}")
    if maximum is not None and number > maximum:
        raise error(f"{name} must be a whole number of at most {maximum}, got {value!r}")
    return number


def why_invalid(error: Exception) -> str:
    """Why a parser refused a text, briefly and without the interpreter's names."""
    text = str(error)
    if "set_int_max_str_digits" in text:
        return "it holds a number of thousands of digits"
    if "hex value" in text or "backslash" in text or "Unescaped '\\'" in text:
        text += "; in a path write / in place of \\, or single quotes about it"
    return text[:200]


_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def why_no_file(path: Path) -> str:
    """Why a path cannot be read as a file: "is a pipe, not a file"; "" where it may be one."""
    if "\0" in str(path):
        return "is no file: no name of one can hold the character NUL"
    mode = path.stat().st_mode
    return next((f"is {words}, not a file" for test, words in _KINDS if test(mode)), "")


def path_of(name: str, value: Any, error: type[MfdError]) -> Path:
    """Path that a caller gives as text or as a path."""
    if not isinstance(value, str | PathLike) or not isinstance(text := os.fspath(value), str):
        raise error(f"{name} must be a path, as text or pathlib.Path, got {value!r}")
    if "\0" in text:
        raise error(f"{name} must be a path without the character NUL, got {text!r}")
    return Path(text)


def file_inside(folder: Path, name: str) -> Path | None:
    """Path of a file that a text in a folder names, links followed; None where it lies outside."""
    path = (folder / name).resolve()
    is_inside = not Path(name).is_absolute() and path.is_relative_to(folder.resolve())
    return path if is_inside else None


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal; raises OSError where it cannot be read."""
    if reason := why_no_file(path):
        raise OSError(errno.EINVAL, reason, str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
