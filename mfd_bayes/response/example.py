"""A first building file, to be changed by its user."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

STEP, SAMPLES, PEAK = 0.02, 1000, 0.35
"""Of the artificial ground motion: s, number, g."""

_SOIL = 2.0 * np.pi * 2.5, 0.6
"""Frequency, rad/s, and damping of the soil."""

EXAMPLE = """\
# A building with dampers, for: mfd-bayes respond OUT --building building.toml --ground …
# Every quantity has its unit. Change what is here; what is left out has a sensible default.

[building]
title = "Three storeys"
damping = { kind = "rayleigh", ratio = "2 %", modes = [1, 2] }   # or kind = "modal", or "none"

# The storeys from the lowest up: the floor above each, as weight or mass.
[[storey]]
weight = "30 kip"
height = "144 in"
stiffness = "40 kip/in"
# yield_force = "60 kip"        # elastic without it
# dashpot = "0.1 kip*s/in"

[[storey]]
weight = "30 kip"
height = "144 in"
stiffness = "40 kip/in"

[[storey]]
weight = "25 kip"
height = "144 in"
stiffness = "30 kip/in"

# Dampers: those of one place together. Actuation: a pressure or a force, as in the campaign.
[[damper]]
storey = 1                      # or between = [2, 0]: floors, 0 is the ground
count = 1
actuation = "1000 psi"          # or one of each: ["900 psi", "1100 psi"]
# actuation = { file = "pressure.csv", column = "pressure_psi", unit = "psi" }
geometry = 1.0                  # travel of the damper over the storey drift
brace = "rigid"                 # or a stiffness in series: "500 kip/in"

[[damper]]
storey = 2
actuation = "1000 psi"

[[damper]]
storey = 3
actuation = "1000 psi"

# How probable is it that these are passed?
[limits]
drift = "1 %"
acceleration = "0.5 g"
"""


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
