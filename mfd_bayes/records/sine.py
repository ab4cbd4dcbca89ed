"""Harmonic motions from a text, without a file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import parse_quantity

SAMPLES = 400
"""Samples of a cycle."""

MOST_CYCLES = 100

_FORM = "a harmonic motion reads '1 in, 0.5 Hz, 3 cycles'"


@dataclass(frozen=True)
class Harmonic:
    """Full cycles from turn to turn, with half a cycle from rest to the first turn and back.

    A sine that begins at full speed would be a jump out of rest, and its viscous force a peak
    that no machine makes.

    Attributes
    ----------
    amplitude : float, in
        Half the stroke.
    frequency : float, Hz
    cycles : float
        Of full stroke.
    """

    amplitude: float
    frequency: float
    cycles: float

    def trace(self, actuation: ArrayLike) -> Trace:
        """The sampled motion at an actuation, ksi or kip; back at rest after whole half cycles."""
        step = 2.0 * np.pi / SAMPLES
        angle, half = step * np.arange(round(SAMPLES * self.cycles) + 1), SAMPLES // 2
        into = step * np.arange(half)
        x = np.concatenate([0.5 * (1.0 - np.cos(into)), np.cos(angle)])
        v = np.concatenate([0.5 * np.sin(into), -np.sin(angle)])
        if (2.0 * self.cycles).is_integer():  # it ends at a turn
            out = step * np.arange(1, half + 1)
            last = 0.5 * round(np.cos(angle[-1]))
            x = np.concatenate([x, last * (1.0 + np.cos(out))])
            v = np.concatenate([v, -last * np.sin(out)])
        return Trace.from_arrays(
            np.arange(x.size) / (SAMPLES * self.frequency),
            self.amplitude * x,
            actuation,
            velocity=2.0 * np.pi * self.frequency * self.amplitude * v,
        )


def parse_sine(text: str) -> Harmonic:
    """Harmonic motion of ``"1 in, 0.5 Hz, 3 cycles"``: amplitude, frequency, number of cycles.

    Raises
    ------
    UnitError
        When it has not these three parts, or one is not above zero or too large.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise UnitError(f"{_FORM}, got {text!r}")
    amplitude = parse_quantity(parts[0], "displacement", of="the amplitude")
    frequency = parse_quantity(parts[1], "rate", of="the frequency")
    number, _, word = parts[2].partition(" ")
    try:
        cycles = float(number)
    except ValueError:
        cycles = math.nan
    if word.strip() not in ("cycle", "cycles") or not math.isfinite(cycles):
        raise UnitError(f"{_FORM}, got {text!r}")
    if not 1.0 <= cycles <= MOST_CYCLES:
        raise UnitError(f"a harmonic motion has 1 to {MOST_CYCLES} cycles, got {text!r}")
    if not (amplitude > 0.0 and frequency > 0.0):
        raise UnitError(f"amplitude and frequency must be above zero, got {text!r}")
    return Harmonic(amplitude, frequency, cycles)
