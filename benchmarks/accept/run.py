"""How often good devices are said to differ, and how often wrong ones are found and named.

    python -m benchmarks.accept.run good FOLDER     runs of benchmarks.accept.simulated
    python -m benchmarks.accept.run drift           five inspections, by the mixed model
    python -m benchmarks.accept.run real RUN36 RUN22    finished runs of the real sessions

`good` judges 2,000 good devices, and 200 of each fault, after three cycles each at limits of 15 %.
`real` leaves every record of the 36 lb session out of the run that it is compared with, unaltered
and with a planted fault; and compares the 30 lb records of 2023 with the run of 2022.
"""

import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import mfd_bayes as mb
from benchmarks.accept.simulated import CYCLES, production_test, set_scatter
from benchmarks.common import data_folder
from mfd_bayes.calibration.posterior import load_priors
from mfd_bayes.evaluation.acceptance import (
    Acceptance,
    Level,
    accept,
    birge_ratios,
    compare_record,
    complete_limits,
    expect,
    false_discovery,
    judge,
    trace_of,
)
from mfd_bayes.evaluation.laws import drift_row
from mfd_bayes.population.design import Setting, design_of
from mfd_bayes.population.inference import infer_population
from mfd_bayes.population.mixed_model import MixedModel
from mfd_bayes.records.record import Record

LIMITS = complete_limits({"all": 0.15})
GOOD, FAULTY = 2000, 200
SLIP = ("slip_fwd", "slip_bwd")
FAULTS: dict[str, tuple[dict[str, float], tuple[str, ...]]] = {
    **{
        f"slip {100 * (by - 1):+.0f} %": ({"Fc_fwd": by, "Fc_bwd": by}, SLIP)
        for by in (0.80, 0.85, 0.90, 1.10, 1.15, 1.20)
    },
    "slip +20 %, forward only": ({"Fc_fwd": 1.2}, ("slip_fwd",)),
    "slip -20 %, backward only": ({"Fc_bwd": 0.8}, ("slip_bwd",)),
    "gap x 1.5": ({"d2": 1.5, "d3": 1.5}, ("gap",)),
    "stiffness of the build-up x 0.7": ({"k3": 0.7, "sigma0": 0.7}, ("build_up_slope",)),
}
"""Factors of quantities, and which quantity of a device is rightly named."""


def table(rows: list[dict[str, Any]]) -> None:
    print(pd.DataFrame(rows).to_string(index=False), flush=True)


def share(count: int, of: int) -> str:
    return f"{100 * count / of:.1f} % ± {100 * np.sqrt(count / of * (1 - count / of) / of):.1f}"


def counted(what: str, judged: list[Acceptance], right: tuple[str, ...] = ()) -> dict[str, Any]:
    verdicts = Counter(device.verdict for device in judged)
    found = [device for device in judged if device.p_value < 0.05]
    row = {"devices": what, "number": len(judged), "differs": share(len(found), len(judged))}
    row |= {name: verdicts[name] for name in ("rejected", "cannot tell", "accepted")}
    if right:
        named = sum(device.named in right for device in found)
        row["named rightly"] = share(named, len(found)) if found else ""
    return row


def good(folder: Path) -> None:
    runs = [
        mb.open_run(path)
        for path in sorted(folder.glob("s*/out"))
        if (path / "report.html").exists()
    ]
    set_scatter(0.02)
    rng, pool = np.random.default_rng(7), []
    for run in runs:
        time_s, x, force = production_test(rng, {})
        path = run.folder.parent / "production.csv"
        columns = ("time_s", "displacement_in", "force_kip")
        pd.DataFrame(np.transpose([time_s, x, force]), columns=columns).to_csv(path, index=False)
        record = mb.read_record(path, actuation="1 ksi")
        expected = expect(
            run, trace_of(run, record), "", rate=record.rate, ratios=birge_ratios(run), draws=4000
        )
        pool.append((run, record, expected))

    def judged(number: int, fault: dict[str, float]) -> list[Acceptance]:
        devices = []
        for i in range(number):
            run, record, expected = pool[i % len(pool)]
            made = replace(record, force=production_test(rng, fault)[2])
            group = (compare_record(made, trace_of(run, made), expected),)
            level = Level.of(group, independent=True)
            devices.append(judge(f"{i}", group, level, level.p_value, LIMITS))
        return devices

    fine = judged(GOOD, {})
    print(
        f"{len(runs)} runs of 12 tests of a prototype, {CYCLES} cycles of each device; limits 15 %"
    )
    rows = [counted("good", fine)]
    rows += [counted(name, judged(FAULTY, f), right) for name, (f, right) in FAULTS.items()]
    table(rows)
    print("\nPower at a good device: a deviation that is found with 0.80")
    detectable = pd.DataFrame([device.rows["detectable"] for device in fine]).mean()
    print(detectable.dropna().round(1).to_string())
    batches = [fine[i : i + 20] for i in range(0, GOOD, 20)]
    any_found = sum(
        min(sorted(d.p_value for d in batch)[k] * 20 / (k + 1) for k in range(20)) < 0.05
        for batch in batches
    )
    print(f"\nBatches of 20 good devices with a false alarm: {share(any_found, len(batches))}")


def drift() -> None:
    """Inspections in five years of three tests each, whose slip force scatters by 2 %."""
    rng, rows = np.random.default_rng(8), []
    years = np.repeat(2020.0 + np.arange(5.0), 3)
    tested = [Setting(1.0, "", {"date": year}) for year in years]
    design = design_of(
        load_priors("mfd"), ("Fc_fwd",), tested, {"Fc_fwd": "proportional"}, {"Fc_fwd": ("date",)}
    )
    design, choice = replace(design, leveled=False), np.array([0])
    precision = np.full((years.size, 1, 1), (design.spread[0] / 0.005) ** 2)
    for rate, number in ((-0.02, 200), (0.02, 200), (0.0, 1000)):
        found, leaves = 0, []
        for _ in range(number):
            values = np.log1p(rate) * (years - 2020.0) + rng.normal(0.0, 0.02, years.size)
            mixed = MixedModel(design, (values / design.spread[0])[:, None], precision)
            h = mixed.sample(choice, rng, 1000)
            z = mixed.marginal(h, choice)[1].draw(rng)
            row = drift_row("Fc_fwd", "date", z[:, 1], years, 0.15)
            found += row.found
            leaves.append(row.leaves)
        true = abs(rate) * 14.0 > 0.15  # four years of tests, and ten after them
        rows.append(
            {
                "drift": f"{100 * rate:+.0f} % a year",
                "number": number,
                "found": share(found, number),
                "leaves 15 % in 14 years": "yes" if true else "no",
                "mean probability of that": round(float(np.mean(leaves)), 2),
            }
        )
    table(rows)


def changed(record: Record, kind: str, by: float) -> Record:
    """A record with a planted fault: the force of one or both directions, or a wider gap."""
    assert record.force is not None
    if kind == "slip":
        return replace(record, force=record.force * (1.0 + by))
    speed = np.gradient(record.displacement, record.time)
    return replace(record, force=record.force * np.where(speed > 0.0, 1.0 + by, 1.0))


def real(run36: Path, run22: Path) -> None:
    run, source, rows = mb.open_run(run36), data_folder() / "brfd", []
    files = {test.id: source / test.file for test in run.manifest.settings.test}
    for name in run.tests:
        kept = {other: test for other, test in run.tests.items() if other != name}
        inference = infer_population(
            kept, run.priors, run.manifest.settings.inference("quick", (1, 2))
        )
        other = replace(run, tests=kept)
        other.__dict__["population"] = inference.population
        record = mb.read_record(files[name], actuation="36 lbf")
        for kind, by in (
            ("slip", 0.0),
            *(("slip", sign * by) for by in (0.05, 0.10, 0.20) for sign in (-1, 1)),
            ("forward only", 0.20),
        ):
            began = time.process_time()
            (found,) = accept(other, changed(record, kind, by))
            rows.append(
                {
                    "record": name,
                    "planted": f"{kind} {100 * by:+.0f} %" if by else "nothing",
                    "p": f"{found.p_value:.3f}",
                    "verdict": found.verdict,
                    "named": found.named,
                    "s": round(time.process_time() - began, 1),
                }
            )
    table(rows)
    print("\nEach record by itself, and the eight of a row as one batch (Benjamini-Hochberg)")
    counts = []
    for planted, of in pd.DataFrame(rows).groupby("planted", sort=False):
        single = of["p"].astype(float).to_numpy()
        batch, beyond = false_discovery(single), (of["verdict"] == "rejected").to_numpy()
        counts.append(
            {
                "planted": planted,
                "differ": int((single < 0.05).sum()),
                "rejected": int(beyond.sum()),
                "differ, batch": int((batch < 0.05).sum()),
                "rejected, batch": int((beyond & (batch < 0.05)).sum()),
            }
        )
    table(counts)
    rows = []
    before = mb.open_run(run22)
    for path in sorted(source.glob("2023_30lb_*_1.0in.csv")):
        (found,) = accept(before, mb.read_record(path, actuation="30 lbf"), device=path.stem)
        effect = found.rows["effect"]
        rows.append(
            {
                "2023 against 2022": path.stem,
                "p": f"{found.p_value:.3f}",
                "verdict": found.verdict,
                "named": found.named,
                "slip fwd %": round(effect["slip_fwd"]),
                "slip bwd %": round(effect["slip_bwd"]),
                "energy %": round(effect["energy_per_cycle"]),
            }
        )
    table(rows)


def main() -> None:
    command, *words = sys.argv[1:] or [""]
    actions = {"good": good, "drift": drift, "real": real}
    if command not in actions:
        sys.exit(__doc__)
    actions[command](*map(Path, words))


if __name__ == "__main__":
    main()
