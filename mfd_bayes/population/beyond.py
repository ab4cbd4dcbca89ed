"""What is unknown of a motion that lies outside those of the calibrated tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.layout import Layout
from mfd_bayes.population.setting import Setting

Array = NDArray[np.float64]

STROKE = 0.2
"""Sd of what a quantity that differs between tests may change by for each e-fold (a factor of 2.7)
of stroke outside the tests: twice that of a dependence within them. Slip forces of the band brake
change by 0.15 to 0.2 for an e-fold of stroke."""

RATE = 0.1
"""The same for speed and frequency, as a dependence within the tests. The friction models know the
speed, and the gap does not change with it."""

_STAY = ("offset", "noise_")


def unknown_beyond(layout: Layout, setting: Setting, n: int) -> list[tuple[str, int, Array]]:
    """Open effects of n draws as in `Expected`: none where the motion is like that of a test.

    With the stroke, quantities may change that differ between tests, but for offset and noise;
    with the speed those that follow the actuation. What is the same in all tests, such as a
    stiffness, stays so.
    """
    stroke, rate = folds_beyond(setting, layout.settings)
    if not stroke and not rate:
        return []
    same = layout.common or layout.sparse or (False,) * len(layout.names)
    found = []
    for k, name in enumerate(layout.names):
        if not same[k] and not name.startswith(_STAY):
            sd = np.hypot(STROKE * stroke, RATE * rate * (name in layout.laws))
            found.append(("beyond", k, np.full(n, sd / layout.spread[k])))
    return found


def folds_beyond(setting: Setting, tested: Sequence[Setting]) -> tuple[float, float]:
    """E-folds by which the stroke, and speed or frequency, lie outside those of the tests.

    Of speed and frequency the one that lies farther outside counts. Below those of the tests they
    do not: every test passes through all speeds down to rest.
    """
    known = [_logarithms(one) for one in tested if _moves(one)]
    if not known or not _moves(setting):
        return 0.0, 0.0
    asked, low, high = _logarithms(setting), np.min(known, axis=0), np.max(known, axis=0)
    stroke, speed, frequency = np.maximum(asked - high, 0.0)
    return float(max(stroke, low[0] - asked[0])), float(max(speed, frequency))


def _moves(setting: Setting) -> bool:
    return min(setting.covariates.get(name, 0.0) for name in ("amplitude", "velocity")) > 0.0


def _logarithms(setting: Setting) -> Array:
    """Logarithms of stroke, speed and frequency, (3,)."""
    stroke, speed = (np.log(setting.covariates[name]) for name in ("amplitude", "velocity"))
    return np.array([stroke, speed, speed - stroke])
