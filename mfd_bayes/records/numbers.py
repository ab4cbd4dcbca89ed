"""Real numbers out of what a caller gives: nothing is cast in silence."""

from __future__ import annotations

from operator import index
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import MfdError, RecordError

Array = NDArray[np.float64]


def real_numbers(name: str, values: ArrayLike, error: type[MfdError] = RecordError) -> Array:
    """Array of what is given, float64, not copied where it is one already.

    Raises
    ------
    MfdError
        Of the kind `error`, when it holds masked values, complex numbers, text or no numbers.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise error(f"{name} holds masked values: fill them, or leave these samples out")
    try:
        found = np.asarray(values)
        if found.dtype.kind in "biuf" or found.size == 0:
            return found.astype(np.float64)
        if found.dtype.kind == "O" and not any(isinstance(v, str | complex) for v in found.flat):
            return found.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise error(f"{name} must hold real numbers: {fault}") from fault
    raise error(f"{name} must hold real numbers, got values of type {found.dtype}")


def whole_number(name: str, value: Any, least: int, error: type[MfdError]) -> int:
    """A whole number that is not below the least one.

    Raises
    ------
    MfdError
        Of the kind `error`, when it is none.
    """
    try:
        found = index(value)
    except TypeError:
        found = least - 1
    if found < least or isinstance(value, bool):
        raise error(f"{name} must be a whole number, {least} or more, got {value!r}")
    return found


def why_invalid(error: Exception) -> str:
    """Why a parser refused a text, briefly and without the interpreter's names."""
    text = str(error)
    if "set_int_max_str_digits" in text:
        return "it holds a number of thousands of digits"
    return text[:200]
