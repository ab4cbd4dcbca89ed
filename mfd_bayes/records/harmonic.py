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
    """A sine that begins at rest position.

    Attributes
    ----------
    amplitude : float, in
        Half the stroke.
    frequency : float, Hz
    cycles : float
        With at least 1.5, there is a full cycle between two turns of the same side.
    """

    amplitude: float
    frequency: float
    cycles: float

    def trace(self, actuation: ArrayLike) -> Trace:
        """The sampled motion at an actuation, ksi or kip."""
        count = round(SAMPLES * self.cycles) + 1
        turns = np.arange(count) / SAMPLES
        angle = 2.0 * np.pi * turns
        speed = 2.0 * np.pi * self.frequency * self.amplitude
        return Trace.from_arrays(
            turns / self.frequency,
            self.amplitude * np.sin(angle),
            actuation,
            velocity=speed * np.cos(angle),
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
    cycles = _cycles(parts[2], text)
    if not (amplitude > 0.0 and frequency > 0.0):
        raise UnitError(f"amplitude and frequency must be above zero, got {text!r}")
    return Harmonic(amplitude, frequency, cycles)


def _cycles(part: str, text: str) -> float:
    number, _, word = part.partition(" ")
    try:
        cycles = float(number)
    except ValueError:
        cycles = math.nan
    if word.strip() not in ("cycle", "cycles") or not math.isfinite(cycles):
        raise UnitError(f"{_FORM}, got {text!r}")
    if not 1.0 <= cycles <= MOST_CYCLES:
        raise UnitError(f"a harmonic motion has 1 to {MOST_CYCLES} cycles, got {text!r}")
    return cycles
