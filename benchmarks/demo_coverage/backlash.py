"""How often intervals hold the true value in the demo's campaign with a backlash truth.

    python -m benchmarks.demo_coverage.backlash [SEEDS] > benchmarks/demo_coverage/backlash.txt

The demo's tests and laws, but the force is that of friction behind a spring with a gap, and the
campaign is calibrated with the same model (`model = "backlash"`, effort quick): four minutes a
seed on two cores.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.machine import platform_line
from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.campaign.synthetic import AMPLITUDE, RATE, Matrix
from mfd_bayes.evaluation.summary import assess
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Truth

Array = NDArray[np.float64]

MEDIANS = {
    "k_fwd": 40.0,  # kip/in
    "k_bwd": 40.0,
    "gap": 0.15,  # in
    "ell": 0.02,
    "k_0": 0.3,  # kip/in
    "n": 3.0,
    "sigma2": 0.015,  # kip·s/in
    "static_excess_fwd": 0.18,
    "static_excess_bwd": 0.12,
    "v_s": 0.4,  # in/s
    "noise_sd": 0.03,  # kip
    "noise_time": 0.1,  # s
}
SCATTER = {
    **dict.fromkeys(("Fc_fwd", "Fc_bwd", "gap", "k_fwd", "k_bwd"), 0.05),
    **dict.fromkeys(("static_excess_fwd", "static_excess_bwd"), 0.15),
    **dict.fromkeys(("sigma2", "v_s", "noise_sd", "noise_time"), 0.10),
}
"""Standard deviation of the logarithm between tests, as in the demo; others are the same in all."""

OFFSET = 0.02  # kip

HEAD = """\
[campaign]
title = "Synthetic campaign with a backlash truth"
priors = "mfd"
model = "backlash"
noise = "ou"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }

[laws]
Fc_fwd = "affine"
Fc_bwd = "affine"
Fs_fwd = "affine"
Fs_bwd = "affine"

"""


def draw_values(
    pressure: float, laws: Mapping[str, float], rng: np.random.Generator
) -> dict[str, Array]:
    """Quantities of one test at a pressure in ksi, (1,) each."""
    medians = MEDIANS | {
        f"Fc_{side}": laws[f"K_c_{side}"] * pressure + laws[f"Fc_{side}_0"]
        for side in ("fwd", "bwd")
    }
    values = {
        name: median * np.exp(SCATTER.get(name, 0.0) * rng.standard_normal(1))
        for name, median in medians.items()
    }
    return values | {
        "offset": OFFSET * rng.standard_normal(1),
        "start": rng.uniform(0.25, 0.75, 1),  # in the gap
    }


def write(
    path: Path, values: Mapping[str, Array], frequency: float, cycles: int, rng: np.random.Generator
) -> None:
    """Write a harmonic test."""
    time = np.arange(int(cycles / frequency * RATE) + 1) / RATE
    displacement = AMPLITUDE * np.sin(2 * np.pi * frequency * time)
    model = BacklashLuGre()
    trace = Trace.from_arrays(time, displacement)
    force = model.force(model.theta(values), trace, values["start"])[0] + values["offset"]
    force = force + find_noise("ou").draw(rng, time, values)[0]
    rows = zip(time, displacement, force, strict=True)
    lines = "".join(f"{t:.2f},{x:.6f},{f:.6f}\n" for t, x, f in rows)
    path.write_text("time_s,displacement_in,force_kip\n" + lines, encoding="utf-8")


def write_campaign(folder: Path, seed: int) -> Truth:
    """Write the tests and their campaign file; the true values."""
    rng, matrix = np.random.default_rng([seed, 1]), Matrix()
    folder.mkdir()
    tests, text = {}, HEAD
    for frequency, cycles in zip(matrix.frequencies, matrix.cycles, strict=True):
        for pressure in matrix.pressures:
            name = f"p{pressure:.0f}_f{frequency:g}"
            values = draw_values(pressure / 1000.0, matrix.laws, rng)
            write(folder / f"{name}.csv", values, frequency, cycles, rng)
            tests[name] = {key: float(value[0]) for key, value in values.items()}
            text += f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\n'
            text += f'actuation = "{pressure:.0f} psi"\n\n'
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    names = ("K_c_fwd", "K_c_bwd", "Fc_fwd_0", "Fc_bwd_0")
    laws = {name: matrix.laws[name] for name in names}
    return Truth(population=laws | {"scatter_offset": OFFSET}, tests=tests)


def one(seed: int) -> CampaignView:
    """Calibrate the campaign of a seed and compare it with the truth."""
    with tempfile.TemporaryDirectory() as place:
        truth = write_campaign(Path(place) / "campaign", seed)
        chosen = Options(effort="quick", seed=seed, jobs=2)
        plan = plan_campaign(Path(place) / "campaign" / "campaign.toml", chosen)
        plan = replace(plan, manifest=plan.manifest.changed(truth=truth))
        return assess(calibrate(plan, Path(place) / "out", lambda _: None))


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    hits: Counter[str] = Counter()
    known: Counter[str] = Counter()
    print(f"backlash truth, quick, {platform_line()}")
    print(f"{'seed':>6}{'inside':>9}{'known':>8}{'share':>9}")
    for seed in range(1, seeds + 1):
        view = one(seed)
        rows = [row for row in view.truth if row.informed]
        known.update(row.name for row in rows)
        hits.update(row.name for row in rows if row.inside)
        held = sum(row.inside for row in rows)
        print(f"{seed:6d}{held:9d}{len(rows):8d}{held / len(rows):9.1%} {view.verdict}", flush=True)
    total, held = sum(known.values()), sum(hits.values())
    print(f"{'all':>6}{held:9d}{total:8d}{held / total:9.1%}")
    print("\nby quantity")
    for name in sorted(known):
        print(f"{name:22s}{hits[name]:5d} of {known[name]}")


if __name__ == "__main__":
    main()
