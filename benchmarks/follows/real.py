"""Earthquakes cut in two: the second part predicted with and without the end of the first.

    python -m benchmarks.follows.real --out OUT > benchmarks/follows/real.txt

calibrates three harmonic tests of the 36 lb session of the band brake and the first part of each
of its earthquakes, with both models that have a gap, into OUT/MODEL (a finished run is used
again). The second parts have the role "validate" and say `after`. Each is predicted with an unknown
start, after the first part, and, as a control that must be worse, with the place at its end
mirrored: 0.2 of the gap is 0.8 then. CRPS and width are of bands of kind "observation". The start
is as the model takes it: that of three_stage counts along the first direction of the motion.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from benchmarks.common.data import add_data_option
from benchmarks.common.machine import print_bars, processor, versions
from mfd_bayes.evaluation.scores import score
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.population.bands import Band, Forecast
from mfd_bayes.population.starts import Ending

HEAD = """\
[campaign]
title = "36 lb, earthquakes cut in two"
priors = "brfd"
model = "{model}"
rate = "32 Hz"

[columns]
time = {{ name = "time_s" }}
displacement = {{ name = "displacement_in" }}
force = {{ name = "force_kip" }}
"""
TEST = """
[[test]]
id = "{id}"
file = "2023_36lb_{file}.csv"
actuation = "36 lbf"
{more}
"""
MODELS = ("three_stage", "backlash")
HARMONIC = ("0.50Hz_0.5in", "0.25Hz_1.0in", "1.00Hz_1.0in")
CUTS = {"KocaeliDBE": (9.3, 26.7), "ImperialValleyDBE": (7.0, 28.0)}
"""Where each earthquake is cut, and where it ends, s."""

DRAWS = 800
LESS = 0.85
"""Largest CRPS with the end of the first part, over that with an unknown start."""


def lay_out(source: Path, folder: Path, model: str) -> Path:
    """Copy the records and write their campaign file; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (*HARMONIC, *CUTS):
        shutil.copyfile(source / f"2023_36lb_{name}.csv", folder / f"2023_36lb_{name}.csv")
    text = HEAD.format(model=model)
    text += "".join(TEST.format(id=name, file=name, more="") for name in HARMONIC)
    for name, (cut, end) in CUTS.items():
        text += TEST.format(id=f"{name}_1", file=name, more=f'fit = "0 s to {cut} s"')
        more = f'fit = "{cut} s to {end} s"\nrole = "validate"\nafter = "{name}_1"'
        text += TEST.format(id=f"{name}_2", file=name, more=more)
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def bands_of(run: mb.Run, name: str) -> dict[str, Band]:
    """Bands of a second part: with an unknown start, with the end of the first, and mirrored."""
    trace = run.held_out[name]
    before = run.sequence.before(name, trace, Forecast(draws=DRAWS))
    if before is None:
        raise SystemExit(f"{name} follows none")
    mirrored = replace(before, place=1.0 - before.place)
    starts: dict[str, str | Ending] = {"unknown": "", "after": before, "mirrored": mirrored}
    return {
        how: run.predict(trace, "observation", draws=DRAWS, after=after)
        for how, after in starts.items()
    }


def print_table(run: mb.Run) -> list[str]:
    """Print a line for each second part and start; what does not hold."""
    print(
        f"{'record':22}{'start':>10}{'2.5 to 97.5 %':>16}{'CRPS':>8}{'RRSE':>8}{'95 %':>7}"
        f"{'width':>8}"
    )
    failed = []
    for name in run.held_out:
        found = {}
        for how, band in bands_of(run, name).items():
            found[how] = s = score(band.draws, np.asarray(run.held_out[name].force))
            low, high = np.quantile(band.values["start"], [0.025, 0.975])
            print(
                f"{name:22}{how:>10}{low:9.2f} to {high:.2f}{s.crps:8.3f}{s.rrse:8.2f}"
                f"{100.0 * s.coverage[2]:7.1f}{s.width:8.2f}"
            )
        if found["after"].crps > LESS * found["unknown"].crps:
            failed.append(f"{name}: the end of the first part does not help")
        if found["mirrored"].crps < found["unknown"].crps:
            failed.append(f"{name}: the control helps too")
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    add_data_option(parser)
    options = parser.parse_args()
    print(f"{processor()}, {versions('numpy', 'arviz')}, effort quick, seed 1, draws {DRAWS}")
    failed = []
    for model in MODELS:
        campaign = lay_out(options.data / "brfd", options.out / f"{model}_campaign", model)
        out = options.out / model
        plan = plan_campaign(campaign, Options(effort="quick", resume=out.exists(), jobs=1))
        run = calibrate(plan, out, lambda s: print(s.id, s.stage, file=sys.stderr))
        print(f"\nModel {model}, {len(run.tests)} calibrated tests.")
        failed += [f"{model}, {bar}" for bar in print_table(run)]
    print_bars(failed)
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
