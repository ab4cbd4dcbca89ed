"""A synthetic campaign after the MFD paper's test matrix, whose true values are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.files import write_text

Array = NDArray[np.float64]

RATE = 100.0
AMPLITUDE = 1.0


_LAWS = {
    "K_c_fwd": 1.30,  # in²
    "K_c_bwd": 1.65,
    "alpha_sigma0": 15.0,  # in
    "sigma0_0": 15.0,  # kip/in
}
"""Friction is proportional to the pressure, σ0 affine in it (paper Eq. 5)."""

_RESIDUAL = {"Fc_fwd_0": 0.15, "Fc_bwd_0": 0.20}
"""Friction without pressure, kip, which is added where the matrix has tests at zero."""

_MEDIANS = {
    "sigma1": 0.02,  # kip·s/in
    "sigma2": 0.015,
    "static_excess_fwd": 0.18,
    "static_excess_bwd": 0.12,
    "k2": 0.6,  # kip/in
    "k3": 20.0,
    "d2": 0.09,  # in
    "d3": 0.07,
    "ell": 0.02,
    "v_s": 0.4,  # in/s
    "noise_sd": 0.03,  # kip
    "noise_time": 0.1,  # s
}
"""Medians over the tests; the value of each test is log-normal about them."""

_SCATTER = {
    **dict.fromkeys(("Fc_fwd", "Fc_bwd"), 0.05),
    **dict.fromkeys(("static_excess_fwd", "static_excess_bwd"), 0.15),
    **dict.fromkeys(("sigma0", "sigma1", "sigma2", "v_s"), 0.10),
    **dict.fromkeys(("k2", "k3", "d2", "d3", "ell"), 0.05),
    **dict.fromkeys(("noise_sd", "noise_time"), 0.10),
}
"""Standard deviation of the logarithm of quantities between tests."""

_OFFSET = 0.02
"""Standard deviation of the force offset between tests, kip."""

_HEADER = """\
# Synthetic: computed by the three-stage model from a stated truth, with stated noise.
# After the MFD paper's test matrix: 0.05 and 0.5 Hz, 0 to 1500 psi, 1 in, 100 Hz.
[campaign]
title = "Synthetic campaign after the MFD paper's test matrix"
priors = "mfd"
model = "three_stage"
noise = "ou"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }

[design]  # an example: with it the data sheet says which requirements of a standard are met
standard = "asce7-22"
T1 = "1.33 s"
mce = "1 in"
actuation = "1000 psi"
lambda_spec = { min = 0.9, max = 1.1 }
[design.target]
slip_fwd = "1.5 kip"
slip_bwd = "1.9 kip"
force_at_max_fwd = "1.5 kip"
force_at_max_bwd = "1.9 kip"
energy = { value = "6.6 kip*in", tolerance = "15 %" }

"""
_AFFINE = """\
[laws]  # friction is affine: some is left without pressure
Fc_fwd = "affine"
Fc_bwd = "affine"
Fs_fwd = "affine"
Fs_bwd = "affine"

"""


@dataclass(frozen=True)
class Matrix:
    """The tests: each pressure at each frequency, and one test that is predicted, not fitted.

    With a pressure of zero, there is friction without pressure too, and its laws are affine.
    """

    pressures: tuple[float, ...] = (0.0, 500.0, 800.0, 1200.0, 1500.0)  # psi
    frequencies: tuple[float, ...] = (0.05, 0.5)  # Hz
    cycles: tuple[int, ...] = (2, 6)  # of each frequency
    held_out: tuple[float, float] = (1000.0, 0.5)  # psi, Hz

    @property
    def laws(self) -> dict[str, float]:
        """True value of each constant of the laws, by name."""
        residual = _RESIDUAL if 0.0 in self.pressures else dict.fromkeys(_RESIDUAL, 0.0)
        return _LAWS | residual


def write_campaign(folder: Path, seed: int, matrix: Matrix = Matrix()) -> dict[str, Any]:
    """Write synthetic tests and their campaign file; returns the true values.

    They are in "population" the value of each constant of the laws and of the scatter, by name, in
    the coordinates of the population, and in "tests" those of each test's quantities.
    """
    rng = np.random.default_rng([seed, 1])
    planned = [
        (pressure, frequency, count, "calibrate")
        for frequency, count in zip(matrix.frequencies, matrix.cycles, strict=True)
        for pressure in matrix.pressures
    ]
    planned.append((*matrix.held_out, matrix.cycles[-1], "validate"))
    tests, entries = {}, []
    for pressure, frequency, count, role in planned:
        name = f"p{pressure:.0f}_f{frequency:g}"
        values = draw_values(pressure / 1000.0, matrix.laws, rng)
        rows = zip(*draw_record(values, frequency, count, rng), strict=True)
        lines = "".join(f"{t:.2f},{x:.6f},{f:.6f}\n" for t, x, f in rows)
        write_text(folder / f"{name}.csv", "time_s,displacement_in,force_kip\n" + lines)
        tests[name] = {key: float(value[0]) for key, value in values.items() if key != "gamma1"}
        entries.append(
            f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{pressure:.0f} psi"\n'
            f'role = "{role}"\n'
        )
    head = _HEADER + (_AFFINE if 0.0 in matrix.pressures else "")
    write_text(folder / "campaign.toml", head + "\n".join(entries))
    truth = {name: value for name, value in matrix.laws.items() if value}
    # the slip force and d2 of the population are combinations of the values drawn here
    combined = ("Fc_fwd", "Fc_bwd", "d2", "d3")
    truth |= {f"scatter_{name}": sd for name, sd in _SCATTER.items() if name not in combined}
    truth["scatter_d3"] = float(np.sqrt(2.0)) * _SCATTER["d3"]  # of d3/d2: both have this scatter
    truth["scatter_offset"] = _OFFSET
    for side in ("fwd", "bwd"):
        excess = f"static_excess_{side}"
        truth[f"K_s_{side}"] = truth[f"K_c_{side}"] * (1 + _MEDIANS[excess])
        for true in tests.values():
            true[f"Fs_{side}"] = true[f"Fc_{side}"] * (1 + true[excess])
    return {"population": truth, "tests": tests}


def draw_values(
    pressure: float, laws: Mapping[str, float], rng: np.random.Generator
) -> dict[str, Array]:
    """Quantities of one test at a pressure in ksi, (1,) each."""
    median = _MEDIANS | {
        "Fc_fwd": laws["K_c_fwd"] * pressure + laws["Fc_fwd_0"],
        "Fc_bwd": laws["K_c_bwd"] * pressure + laws["Fc_bwd_0"],
        "sigma0": laws["alpha_sigma0"] * pressure + laws["sigma0_0"],
    }
    values = {
        name: median[name] * np.exp(sd * rng.standard_normal(1)) for name, sd in _SCATTER.items()
    }
    values["offset"] = _OFFSET * rng.standard_normal(1)
    values["start"] = rng.uniform(0.1, 0.9, 1)
    values["gamma1"] = np.ones(1)
    return values


def draw_record(
    values: Mapping[str, Array], frequency: float, cycles: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time, displacement and force, with its noise, of a harmonic test, (n,) each.

    Its quantities are `values`, (1,) each.
    """
    time = np.arange(int(cycles / frequency * RATE) + 1) / RATE
    displacement = AMPLITUDE * np.sin(2 * np.pi * frequency * time)
    model = ThreeStage()
    trace = Trace.from_arrays(time, displacement)
    force = model.force(model.theta(values), trace, values["start"])[0]
    noise = find_noise("ou").draw(rng, time, values)[0]
    return time, displacement, force + values["offset"] + noise
