"""What is unknown of a motion that lies outside those of the calibrated tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.layout import Layout
from mfd_bayes.population.setting import Setting

Array = NDArray[np.float64]

SLOPE = 0.2
"""Sd of what a quantity that differs between tests may change by for each e-fold (a factor of 2.7)
outside the tests: twice that of a dependence within them. Slip forces of the band brake change by
0.15 to 0.2 for an e-fold of stroke."""

_STAY = ("offset", "noise_")


def unknown_beyond(layout: Layout, setting: Setting, n: int) -> list[tuple[str, int, Array]]:
    """Open effects of n draws as in `Expected`: none where the motion is like that of a test.

    The quantities are those that differ between tests, but for offset and noise. What is the same
    in all tests, such as a stiffness, stays so.
    """
    folds = folds_beyond(setting, layout.settings)
    if not folds:
        return []
    sparse = layout.sparse or (False,) * len(layout.names)
    return [
        ("beyond", k, np.full(n, SLOPE * folds / layout.spread[k]))
        for k, name in enumerate(layout.names)
        if not sparse[k] and not name.startswith(_STAY)
    ]


def folds_beyond(setting: Setting, tested: Sequence[Setting]) -> float:
    """E-folds by which a motion lies outside the tests' strokes, speeds and frequencies.

    Stroke and speed count as two directions. The frequency, which follows from both, counts where
    it lies farther outside. Speeds and frequencies below those of the tests do not count: every
    test passes through all speeds down to rest.
    """
    known = [_logarithms(one) for one in tested if _moves(one)]
    if not known or not _moves(setting):
        return 0.0
    asked, low, high = _logarithms(setting), np.min(known, axis=0), np.max(known, axis=0)
    stroke, speed, frequency = np.maximum(asked - high, 0.0)
    stroke = max(stroke, low[0] - asked[0])
    return float(max(np.hypot(stroke, speed), frequency))


def _moves(setting: Setting) -> bool:
    return min(setting.covariates.get(name, 0.0) for name in ("amplitude", "velocity")) > 0.0


def _logarithms(setting: Setting) -> Array:
    """Logarithms of stroke, speed and frequency, (3,)."""
    stroke, speed = (np.log(setting.covariates[name]) for name in ("amplitude", "velocity"))
    return np.array([stroke, speed, speed - stroke])
