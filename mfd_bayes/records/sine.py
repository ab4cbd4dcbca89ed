"""Harmonic motions from a text, without a file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import DAMPER, Axes, parse_quantity, split_quantity

SAMPLES = 400
"""Samples of a cycle."""

MOST_CYCLES = 100


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
    timed: bool = True

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
        if not self.timed:
            return Trace.from_arrays(None, self.amplitude * x, actuation)
        return Trace.from_arrays(
            np.arange(x.size) / (SAMPLES * self.frequency),
            self.amplitude * x,
            actuation,
            velocity=2.0 * np.pi * self.frequency * self.amplitude * v,
        )


def parse_sine(text: str, axes: Axes = DAMPER) -> Harmonic:
    """Harmonic motion of ``"1 in, 0.5 Hz, 3 cycles"``: amplitude, frequency, number of cycles.

    Without a frequency where time does not matter; the amplitude is one of the model's motion,
    ``"2 %, 3 cycles"``.

    Raises
    ------
    UnitError
        When it has not these three parts, or one is not above zero or too large.
    """
    parts, form = [part.strip() for part in text.split(",")], _form(axes)
    if len(parts) != (3 if axes.timed else 2):
        raise UnitError(f"{form}, got {text!r}")
    if axes.motion == DAMPER.motion:
        amplitude = parse_quantity(parts[0], "displacement", of="the amplitude")
    else:
        value, unit = split_quantity(parts[0], of="the amplitude", example=f"1 {axes.motion.unit}")
        amplitude = value * axes.factor(unit, "displacement", of="the amplitude")
    frequency = parse_quantity(parts[1], "rate", of="the frequency") if axes.timed else 1.0
    number, _, word = parts[-1].partition(" ")
    try:
        cycles = float(number)
    except ValueError:
        cycles = math.nan
    if word.strip() not in ("cycle", "cycles") or not math.isfinite(cycles):
        raise UnitError(f"{form}, got {text!r}")
    if not 1.0 <= cycles <= MOST_CYCLES:
        raise UnitError(f"a harmonic motion has 1 to {MOST_CYCLES} cycles, got {text!r}")
    if not (amplitude > 0.0 and frequency > 0.0):
        raise UnitError(f"amplitude and frequency must be above zero, got {text!r}")
    return Harmonic(amplitude, frequency, cycles, axes.timed)


def _form(axes: Axes) -> str:
    unit = axes.motion.unit
    amplitude = f"1 {unit}" if unit != "1" else "2 %"
    if axes == DAMPER:
        return "a harmonic motion reads '1 in, 0.5 Hz, 3 cycles'"
    parts = (amplitude, "0.5 Hz", "3 cycles") if axes.timed else (amplitude, "3 cycles")
    return f"a harmonic motion of {axes.motion.name} reads '{', '.join(parts)}'"
