"""Four real tests under every noise: where it decides a parameter, the run must say so.

    python -m benchmarks.noises.run FOLDER > benchmarks/noises/noises.txt

calibrates the tests of the 2022 session at 25, 35, 70 and 80 lbf, 0.5 Hz, under each noise, each
with its check by second fits under other noises. Slip forces, stiffness of the build-up and gap:
their 95 % intervals must overlap between noises, or the run must note that they do not. What is
read off the loop must lie inside the interval, or there is a note. A second fit must agree with the
calibration under its noise: no median off by half an interval or more without the same verdict.
Exit status 1: a limit was missed. Posteriors are kept in FOLDER, so that a second call goes on; the
records come from --data (MFD_BAYES_DATA, ../shared/data). It takes about half an hour.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import itertools
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.brfd_campaign import HEADER, TEST
from benchmarks.common.data import add_data_option
from benchmarks.common.machine import platform_line
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.noise_sensitivity import Bounds, moves, quantiles_of
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.result import calibrate_test, load_result
from mfd_bayes.evaluation.properties import is_missed, properties_of
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.loops import measured_cycles

TENSIONS = (25, 35, 70, 80)
EVERY = ",".join(sorted(NOISES, key=lambda name: (name != "ou", name != "staged", name)))
QUANTITIES = ("Fc_fwd", "Fc_bwd", "k3", "gap")
SHARE = 1 / 3
"""Largest cost of the check of all tests under the default noise, as a share of their sampling."""

OFF = 0.5
"""Most intervals by which the median of a second fit may be off its own calibration's."""


@dataclass(frozen=True)
class Fit:
    """A test under a noise: quantiles of its quantities, what it notes, and processor time, s."""

    own: dict[str, Bounds]
    others: list[dict[str, Any]]
    readings: dict[str, tuple[float, bool]]
    seconds: float

    def notes(self, name: str) -> list[str]:
        """Noises under which its check says that a quantity moves."""
        return [
            fit["noise"]
            for fit in self.others
            if name in fit["quantities"] and moves(self.own[name], fit["quantities"][name])
        ]


def lay_out(data: Path, folder: Path) -> Path:
    """Copy the four records and write their campaign file; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    text = HEADER
    for tension in TENSIONS:
        name = f"2022_{tension}lb_0.50Hz_1.0in.csv"
        shutil.copyfile(data / "brfd" / name, folder / name)
        text += TEST.format(id=f"{tension}lb", file=name, tension=tension, role="calibrate")
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def calibrated(
    campaign: Path, folder: Path, noises: Sequence[str], *, stored_only: bool
) -> Iterator[tuple[str, str, Fit]]:
    """Test, noise and fit of every test under every noise; what is stored is not sampled again."""
    for noise in noises:
        plan = plan_campaign(campaign, Options(noise=noise))
        for task in plan.tasks:
            file = f"{task.id}_{noise}.nc"
            if not (folder / file).is_file():
                if stored_only:
                    continue
                print(task.id, noise, file=sys.stderr, flush=True)
                began = time.process_time()
                calibrate_test(replace(task, file=file), folder, lambda _: None)
                (folder / f"{file}.seconds").write_text(f"{time.process_time() - began:.2f}")
            whole = float((folder / f"{file}.seconds").read_text())
            test = load_result(task.id, folder / file, plan.priors)
            stored, posterior = test.stored, test.posterior
            values, facts = stored.values(), stored.facts
            replicas = replicate(posterior, values, np.random.default_rng(0))
            drawn = properties_of(posterior.trace, replicas.observed)
            own_values = measured_cycles(posterior.trace).of_test()
            readings = {
                name: (own_values[name], is_missed(drawn[name], own_values[name], name))
                for name in ("slip_fwd", "slip_bwd", "build_up_slope", "gap")
            }
            own = quantiles_of(posterior, values)
            whole -= sum(fit["seconds"] for fit in facts["other_noises"])
            yield task.id, noise, Fit(own, facts["other_noises"], readings, whole)


def apart(one: Bounds, other: Bounds) -> bool:
    """Whether two intervals do not overlap."""
    return one[0] > other[2] or other[0] > one[2]


Fits = dict[str, dict[str, Fit]]


def table_of_intervals(fits: Fits) -> int:
    """Print each interval beside those under other noises; the number apart without a note.

    Another noise's interval is that of its calibration, where there is one, else of the second fit.
    """
    silent = 0
    print(f"{'test':5} {'quantity':8} {'noise':9} {'median [95 %]':24} under other noises")
    for test, name in itertools.product(fits, QUANTITIES):
        for noise, fit in fits[test].items():
            told, own, words = fit.notes(name), fit.own[name], []
            seen = {o["noise"]: o["quantities"][name] for o in fit.others if o["quantities"]}
            seen |= {o: other.own[name] for o, other in fits[test].items() if o != noise}
            for other, bounds in seen.items():
                far = apart(own, bounds)
                silent += far and not told
                what = (
                    "noted" if other in told else "apart, SILENT" if far and not told else "as it"
                )
                words.append(f"{other} {shown(bounds)} {'apart, ' * (far and bool(told))}{what}")
            print(f"{test:5} {name:8} {noise:9} {shown(own):24} {'; '.join(words)}")
    return silent


def shown(bounds: Bounds) -> str:
    """Median and interval."""
    return f"{bounds[1]:.3g} [{bounds[0]:.3g}, {bounds[2]:.3g}]"


def table_of_readings(fits: Fits) -> int:
    """Print what is read off beside each interval; the number outside without a note."""
    silent = 0
    print(f"\n{'test':5} {'quantity':8} {'read off':>9}  under each noise")
    for test, name in itertools.product(fits, QUANTITIES):
        words = []
        for noise, fit in fits[test].items():
            value, missed = fit.readings[name]
            low, _, high = fit.own[name]
            inside = low <= value <= high
            how = "inside" if inside else "noted" if missed else "in tolerance"
            if not inside and not missed and fit.notes(name):
                how = "noise noted"
            silent += how == "in tolerance"
            words.append(f"{noise} {how}")
        print(f"{test:5} {name:8} {value:9.3g}  {', '.join(words)}")
    return silent


def table_of_second_fits(fits: Fits) -> tuple[int, float]:
    """Print each second fit beside its own calibration; the number off, and the cost under ou."""
    wrong, cost = 0, {noise: [0.0, 0.0] for found in fits.values() for noise in found}
    print(f"\n{'test':5} {'noise':10} {'second':7} {'how':18} {'k':>5} {'seconds':>8}  off by")
    for test, noise, fit in ((t, n, fit) for t in fits for n, fit in fits[t].items()):
        cost[noise][1] += fit.seconds
        for other in fit.others:
            cost[noise][0] += other["seconds"]
            if other["error"]:
                print(f"{test:5} {noise:10} {other['noise']:7} {other['error']}")
                continue
            full = fits[test][other["noise"]].own if other["noise"] in fits[test] else None
            if full is None:
                print(f"{start(test, noise, other)}  not calibrated here")
                continue
            off = {
                name: abs(other["quantities"][name][1] - full[name][1])
                / (full[name][2] - full[name][0])
                for name in QUANTITIES
                if name in other["quantities"]
            }
            name = max(off, key=lambda n: off[n])
            bad = [
                n
                for n in off
                if off[n] > OFF
                and moves(fit.own[n], full[n]) != moves(fit.own[n], other["quantities"][n])
            ]
            wrong += len(bad)
            print(
                f"{start(test, noise, other)}  {off[name]:.2f} of the interval of {name}"
                f"{' OTHER VERDICT' if bad else ''}"
            )
    print()
    for noise, (check, sampling) in cost.items():
        print(
            f"the checks of {noise} take {check / sampling:.2f} of the sampling ({sampling:.0f} s)"
        )
    return wrong, cost["ou"][0] / cost["ou"][1]


def start(test: str, noise: str, other: dict[str, Any]) -> str:
    """First columns of a second fit's line."""
    k = float("nan") if other["k"] is None else other["k"]
    head = f"{test:5} {noise:10} {other['noise']:7} {other['how']:18}"
    return f"{head} {k:5.2f} {other['seconds']:8.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where records and posteriors are kept")
    parser.add_argument("--stored", action="store_true", help="only what the folder holds")
    parser.add_argument("--noises", default=EVERY, help="some of them, with commas between")
    add_data_option(parser)
    given = parser.parse_args()
    fits: Fits = {}
    campaign, noises = lay_out(given.data, given.folder), given.noises.split(",")
    found = calibrated(campaign, given.folder, noises, stored_only=given.stored)
    for test, noise, fit in found:
        fits.setdefault(test, {})[noise] = fit
    fits = {f"{tension}lb": fits[f"{tension}lb"] for tension in TENSIONS}
    print(f"four real tests under other noises, {platform_line()}")
    print("calibrated: " + "; ".join(f"{test} with {', '.join(of)}" for test, of in fits.items()))
    apart_silent = table_of_intervals(fits)
    read_silent = table_of_readings(fits)
    wrong, share = table_of_second_fits(fits)
    print(f"intervals apart without a note: {apart_silent} (none allowed)")
    print(f"readings outside, within their tolerance and without a note: {read_silent}")
    print(f"second fits with another verdict than the calibration: {wrong} (none allowed)")
    print(f"cost of the check under ou: {share:.2f} of the sampling (at most {SHARE:.2f})")
    sys.exit(int(apart_silent > 0 or wrong > 0 or share > SHARE))


if __name__ == "__main__":
    main()
