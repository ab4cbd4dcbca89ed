"""Checks of what is asked of a population: names, flags, settings, and numbers of draws."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError, NotThereError
from mfd_bayes.population.setting import Setting
from mfd_bayes.records.numbers import real_number, real_numbers

Array = NDArray[np.float64]


def check_text(name: str, value: Any) -> None:
    """Refuse what is no text.

    Raises
    ------
    FitError
        When it is none.
    """
    if not isinstance(value, str):
        raise FitError(f"{name} must be text, got {value!r}")


def check_flag(name: str, value: Any) -> None:
    """Refuse what is neither True nor False: the text "no" would count as True.

    Raises
    ------
    FitError
        When it is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise FitError(f"{name} must be True or False, got {value!r}")


def check_known(what: str, name: Any, known: Collection[str]) -> None:
    """Refuse a name that is not among those that are known.

    Raises
    ------
    NotThereError
        With all that are known.
    """
    if not isinstance(name, str) or name not in known:
        raise NotThereError(f"no {what} {name!r}: there are {', '.join(known) or 'none'}")


def check_actuations(actuation: ArrayLike) -> Array:
    """Actuations as numbers, ksi or kip.

    Raises
    ------
    FitError
        When one is no number, negative or not finite.
    """
    found = real_numbers("actuation", actuation, FitError)
    if not np.all((found >= 0.0) & (found < np.inf)):
        raise FitError(f"actuation must be finite numbers of at least 0, got {actuation!r}")
    return found


def check_setting(setting: Any, covariates: Collection[str]) -> None:
    """Refuse what is no setting, or lacks a covariate that a quantity follows.

    Raises
    ------
    FitError
        When it is none, or its actuation is no number, 0 or more.
    """
    if not isinstance(setting, Setting):
        raise FitError(f"setting must be a Setting, got {type(setting).__name__}")
    real_number("actuation of a setting", setting.actuation, FitError, (0.0, np.inf))
    lacking = [name for name in covariates if name not in setting.covariates]
    if lacking:
        raise FitError(
            f"the setting needs the covariate {lacking[0]!r}, which quantities of the run follow"
        )


def check_draws(index: Any, size: int) -> NDArray[np.intp]:
    """Numbers of draws, (n,), of as many as `size`.

    Raises
    ------
    FitError
        When they are no whole numbers, or there is no such draw.
    """
    found = np.asarray(index)
    whole = found.ndim == 1 and (found.dtype.kind in "iu" or not found.size)
    if not whole or np.any((found < 0) | (found >= size)):
        raise FitError(f"index must be whole numbers (n,) from 0 to {size - 1}, got {index!r}")
    return found.astype(np.intp, copy=False)


def check_generator(rng: Any) -> None:
    """Refuse what draws no random numbers.

    Raises
    ------
    FitError
        When it is no `numpy.random.Generator`.
    """
    if not isinstance(rng, np.random.Generator):
        raise FitError(
            f"rng must be a numpy.random.Generator, such as numpy.random.default_rng(1), got "
            f"{type(rng).__name__}"
        )
