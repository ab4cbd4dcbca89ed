"""Synthetic devices of four sizes, as files that a logger might write, with their truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import factor

RATE, CYCLES = 100.0, 4

_OF_FORCE = ("Fc_fwd", "Fc_bwd", "offset", "noise_sd")
_OF_LENGTH = ("d2", "d3", "ell", "v_s")
_STIFF = ("sigma0", "sigma1", "sigma2", "k2", "k3")
_MEDIANS = {  # kip, in, s
    "sigma0": 40.0, "sigma1": 0.02, "sigma2": 0.015, "static_excess_fwd": 0.15,
    "static_excess_bwd": 0.10, "k2": 0.6, "k3": 20.0, "d2": 0.09, "d3": 0.07, "ell": 0.02,
    "v_s": 0.4, "noise_sd": 0.03, "noise_time": 0.1,
}  # fmt: skip
_SCATTER = 0.05


@dataclass(frozen=True)
class Device:
    """A device, of the demo's shape but of any size."""

    name: str
    force: float  # of slip at the higher level
    force_unit: str
    length: float  # stroke from end to end
    length_unit: str
    named: bool = True  # whether the files have a row of names

    @property
    def by(self) -> tuple[float, float]:
        """Factors of force and length from the demo's device, some 1.5 kip and 2 in, to this."""
        kip = self.force * factor(self.force_unit, "force")
        inches = self.length * factor(self.length_unit, "displacement")
        return kip / 1.5, inches / 2.0


DEVICES = (
    Device("seal of 10 N", 10.0, "N", 1.0, "mm", named=False),
    Device("damper of 5 kN", 5.0, "kN", 20.0, "mm"),
    Device("brake of 400 lbf", 400.0, "lbf", 8.0, "in"),
    Device("isolator of 200 tf", 2.04e5, "kgf", 500.0, "mm"),
)


def write_device(folder: Path, device: Device, seed: int = 1) -> dict[str, dict[str, float]]:
    """Write a device's tests; returns the true values of each, internal units, by its file's stem.

    Two frequencies at each of two pressures, to which the slip force is proportional.
    """
    rng = np.random.default_rng([seed, len(device.name)])
    truth = {}
    for bar in (3, 6):
        for frequency in (0.25, 0.5):
            name = f"{bar}bar_{frequency:g}Hz"
            truth[name] = _write_test(folder / f"{name}.txt", device, (bar / 6, frequency), rng)
    return truth


def _write_test(
    path: Path, device: Device, condition: tuple[float, float], rng: np.random.Generator
) -> dict[str, float]:
    level, frequency = condition
    values = {k: m * np.exp(_SCATTER * rng.standard_normal(1)) for k, m in _MEDIANS.items()}
    for side, slip in (("fwd", 1.5), ("bwd", 1.8)):
        values[f"Fc_{side}"] = slip * level * np.exp(_SCATTER * rng.standard_normal(1))
    values["offset"] = 0.02 * rng.standard_normal(1)
    values |= {"start": rng.uniform(0.2, 0.8, 1), "gamma1": np.ones(1)}
    time = np.arange(int(CYCLES / frequency * RATE) + 1) / RATE
    motion = np.sin(2 * np.pi * frequency * time)
    model = ThreeStage()
    force = model.force(model.theta(values), Trace.from_arrays(time, motion), values["start"])[0]
    force = force + values["offset"] + find_noise("ou").draw(rng, time, values)[0]
    by_force, by_length = device.by
    travel = motion * by_length / factor(device.length_unit, "displacement")
    rows = np.column_stack([time, travel, force * by_force / factor(device.force_unit, "force")])
    head = f"time_s\ttravel_{device.length_unit}\tload_{device.force_unit}"
    heading = head if device.named else "Logger 7\nthree channels: clock, LVDT, load cell"
    np.savetxt(path, rows, "%.9g", "\t", header=heading, comments="")
    scales = dict.fromkeys(_OF_FORCE, by_force) | dict.fromkeys(_OF_LENGTH, by_length)
    scales |= dict.fromkeys(_STIFF, by_force / by_length)
    return {name: float(value[0]) * scales.get(name, 1.0) for name, value in values.items()}


def complete(campaign: Path, device: Device) -> None:
    """Write the units that are marked FIXME, and nothing else."""
    units = {"displacement": device.length_unit, "force": device.force_unit}
    lines = []
    for line in campaign.read_text(encoding="utf-8").splitlines():
        role = line.split(" = ")[0].removeprefix("columns.")
        if role in units and "FIXME" in line and "unit =" not in line.split("#")[0]:
            line = line.replace(" }", f', unit = "{units[role]}" }}', 1)
        lines.append(line)
    campaign.write_text("\n".join(lines) + "\n", encoding="utf-8")
