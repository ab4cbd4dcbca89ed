"""A first building file, to be changed by its user."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
from scipy.signal import lfilter

STEP, SAMPLES, PEAK = 0.02, 1000, 0.35
"""Of the artificial ground motion: s, number, g."""

_SOIL = 2.0 * np.pi * 2.5, 0.6
"""Frequency, rad/s, and damping of the soil."""


def example_building() -> str:
    """Text of a first building file."""
    return files("mfd_bayes.response").joinpath("example.toml").read_text(encoding="utf-8")


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
