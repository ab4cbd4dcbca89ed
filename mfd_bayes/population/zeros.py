"""Tests at zero actuation, and which laws learn from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.population.laws import COMPARE, LAWS
from mfd_bayes.population.setting import Setting

NOTHING = 1e-3
"""Actuation below this share of the largest is zero: what a gauge shows with nothing applied."""


def with_zeros(settings: Sequence[Setting]) -> tuple[Setting, ...]:
    """The settings with an actuation of zero where it is next to nothing.

    Raises
    ------
    FitError
        When an actuation is negative or unknown, or all are zero.
    """
    found = [setting.actuation for setting in settings]
    if not min(found) >= 0 or not max(found) > 0 or np.any(np.isnan(found)):
        raise FitError(
            "the laws need an actuation above zero in at least one calibrated test, and none that "
            "is negative"
        )
    least = NOTHING * max(found)
    return tuple(replace(s, actuation=0.0) if s.actuation < least else s for s in settings)


def weights_of(law: str, settings: Sequence[Setting]) -> dict[str, float]:
    """Weights of the laws before they are compared.

    With tests at zero actuation, only laws that have a value there are compared: the others are
    limits of them.
    """
    if law != COMPARE:
        return {law: 1.0}
    zero = any(setting.actuation == 0 for setting in settings)
    compared = [name for name in LAWS if LAWS[name].intercept or not zero]
    return dict.fromkeys(compared, 1.0 / len(compared))


def informs_of(
    settings: Sequence[Setting],
    names: tuple[str, ...],
    weights: Mapping[str, Mapping[str, float]],
) -> NDArray[np.bool_]:
    """Whether each test informs level, scatter and law of each quantity, (J, d).

    A law without an intercept says nothing of a test at zero actuation: the quantity takes a value
    of its own there, which informs nothing (`apart`).
    """
    found = np.ones((len(settings), len(names)), dtype=np.bool_)
    zero = [setting.actuation == 0 for setting in settings]
    for name, laws in weights.items():
        if any(weight > 0 and not LAWS[law].intercept for law, weight in laws.items()):
            found[zero, names.index(name)] = False
    return found
