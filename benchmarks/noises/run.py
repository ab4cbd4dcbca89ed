"""Does a run say so where its noise decides a parameter? Four real tests under every noise.

    python -m benchmarks.noises.run > benchmarks/noises/noises.txt

takes half an hour (--quick: one test under two noises with little effort). Calibrates the tests of
the 2022 session at 25, 35, 70 and 80 lbf, 0.5 Hz, under each noise, each with its check by second
fits under other noises. Slip forces, stiffness of the build-up and gap: their 95 % intervals must
overlap between noises, or the run must note that they do not. Posteriors are kept in --out, so
that a second call goes on. Exit status 1: intervals are apart without a note, or the check takes
more than SHARE of the sampling. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import itertools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.result import Bounds, load_result, moves, quantiles_of
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign

TESTS = tuple(f"{tension}lb_0.50Hz_1.0in" for tension in (25, 35, 70, 80))
EVERY = sorted(NOISES, key=lambda name: (name != "ou", name != "staged", name))
QUANTITIES = ("Fc_fwd", "Fc_bwd", "k3", "gap")
SHARE = 1 / 3


@dataclass(frozen=True)
class Fit:
    """A test under a noise: quantiles, what its second fits say, and processor time, s."""

    own: dict[str, Bounds]
    others: list[dict[str, Any]]
    seconds: float


def fits_of(campaign: Path, noises: Sequence[str], effort: str) -> dict[str, dict[str, Fit]]:
    """Fit of every test under every noise; what is stored is not sampled again."""
    folder, fits = campaign.parent, {}
    for noise in noises:
        plan = plan_campaign(campaign, RunOptions(effort=effort), noise=noise)
        for task in plan.tasks:
            file = folder / f"{task.id}_{noise}.nc"
            clock = file.with_suffix(".seconds")
            if not file.is_file():
                print(task.id, noise, file=sys.stderr, flush=True)
                began = time.process_time()
                replace(task, file=file.name).run(folder, lambda _: None)
                clock.write_text(f"{time.process_time() - began:.2f}")
            test = load_result(task.id, file, plan.priors)
            second_fits = test.stored.facts["other_noises"]
            quantiles = quantiles_of(test.posterior, test.stored.values())
            seconds = float(clock.read_text()) - sum(o["seconds"] for o in second_fits)
            fits.setdefault(task.id, {})[noise] = Fit(quantiles, second_fits, seconds)
    return fits


def table_of_intervals(fits: dict[str, dict[str, Fit]]) -> int:
    """Print each interval beside those under other noises; the number apart without a note.

    Another noise's interval is that of its calibration, where there is one, else of the second fit.
    """
    silent = 0
    print(f"{'test':5} {'quantity':8} {'noise':9} {'median [95 %]':24} under other noises")
    for test, name in itertools.product(fits, QUANTITIES):
        for noise, fit in fits[test].items():
            interval, words = fit.own[name], []
            intervals = {o["noise"]: o["quantities"][name] for o in fit.others if o["quantities"]}
            noted = [rival for rival, bounds in intervals.items() if moves(interval, bounds)]
            intervals |= {o: rival.own[name] for o, rival in fits[test].items() if o != noise}
            for rival, bounds in intervals.items():
                word = "noted" if rival in noted else "as it"
                if interval[0] > bounds[2] or bounds[0] > interval[2]:
                    word = f"apart, {word if noted else 'SILENT'}"
                    silent += not noted
                words.append(f"{rival} {shown(bounds)} {word}")
            print(f"{test:5} {name:8} {noise:9} {shown(interval):24} {'; '.join(words)}")
    return silent


def shown(bounds: Bounds) -> str:
    """Median and interval."""
    return f"{bounds[1]:.3g} [{bounds[0]:.3g}, {bounds[2]:.3g}]"


def main() -> None:
    options = common.begin(common.parser_of(__doc__ or "", data=True, output="out_noises"))
    tests, noises, effort = TESTS, EVERY, "standard"
    if options.quick:
        tests, noises, effort = TESTS[:1], EVERY[:2], "quick"
    campaign = common.lay_out(options.data, options.out / effort, "2022-07", selection=tests)
    text = campaign.read_text(encoding="utf-8")
    campaign.write_text(text.replace("[columns]", "noise_check = true\n[columns]"), "utf-8")
    fits = fits_of(campaign, noises, effort)
    silent = table_of_intervals(fits)
    under_ou = [fit["ou"] for fit in fits.values()]
    check = sum(second_fit["seconds"] for fit in under_ou for second_fit in fit.others)
    share = check / sum(fit.seconds for fit in under_ou)
    print(f"intervals apart without a note: {silent} (none allowed)")
    print(f"cost of the check under ou: {share:.2f} of the sampling (at most {SHARE:.2f})")
    failed = [f"{silent} intervals are apart without a note"] if silent else []
    failed += [f"the check takes {share:.2f} of the sampling"] if share > SHARE else []
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
