"""Does a run say so where its noise decides a parameter? Four real tests under every noise.

    python -m benchmarks.noises.run FOLDER > benchmarks/noises/noises.txt

takes half an hour (--quick: one test under two noises with little effort). Calibrates the tests of
the 2022 session at 25, 35, 70 and 80 lbf, 0.5 Hz, under each noise, each with its check by second
fits under other noises. Slip forces, stiffness of the build-up and gap: their 95 % intervals must
overlap between noises, or the run must note that they do not. Posteriors are kept in FOLDER, so
that a second call goes on. Exit status 1: intervals are apart without a note, or the check takes
more than SHARE of the sampling. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import itertools
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.posterior import NOISES
from mfd_bayes.calibration.result import Bounds, load_result, moves, quantiles_of
from mfd_bayes.pipeline.plan import Options, plan_campaign

TENSIONS = ("25", "35", "70", "80")
EVERY = sorted(NOISES, key=lambda name: (name != "ou", name != "staged", name))
QUANTITIES = ("Fc_fwd", "Fc_bwd", "k3", "gap")
SHARE = 1 / 3


@dataclass(frozen=True)
class Fit:
    """A test under a noise: quantiles, what its second fits say, and processor time, s."""

    own: dict[str, Bounds]
    others: list[dict[str, Any]]
    seconds: float

    def notes(self, name: str) -> list[str]:
        """Noises under which its check says that a quantity moves."""
        return [
            fit["noise"]
            for fit in self.others
            if name in fit["quantities"] and moves(self.own[name], fit["quantities"][name])
        ]


def calibrated(
    campaign: Path, folder: Path, noises: Sequence[str], effort: str
) -> Iterator[tuple[str, str, Fit]]:
    """Test, noise and fit of every test under every noise; what is stored is not sampled again."""
    for noise in noises:
        plan = plan_campaign(campaign, Options(noise=noise, effort=effort))
        for task in plan.tasks:
            file = f"{task.id}_{noise}.nc"
            if not (folder / file).is_file():
                print(task.id, noise, file=sys.stderr, flush=True)
                began = time.process_time()
                replace(task, file=file).run(folder, lambda _: None)
                (folder / f"{file}.seconds").write_text(f"{time.process_time() - began:.2f}")
            test = load_result(task.id, folder / file, plan.priors)
            others = test.stored.facts["other_noises"]
            whole = float((folder / f"{file}.seconds").read_text())
            own = quantiles_of(test.posterior, test.stored.values())
            yield task.id, noise, Fit(own, others, whole - sum(o["seconds"] for o in others))


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


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("folder", type=Path, help="where records and posteriors are kept")
    options = parser.parse_args()
    chosen = TENSIONS[:1] if options.quick else TENSIONS
    campaign = common.lay_out(options.data, options.folder, "2022-07")
    head, *tests = campaign.read_text(encoding="utf-8").split("\n[[test]]")
    wanted = [f'"{t}lb_0.50Hz_1.0in"' for t in chosen]
    tests = [test for test in tests if any(name in test for name in wanted)]
    campaign.write_text("\n[[test]]".join([head, *tests]), encoding="utf-8")
    common.heading((__doc__ or "").splitlines()[0])
    fits: Fits = {}
    effort = "quick" if options.quick else "standard"
    found = calibrated(campaign, options.folder, EVERY[:2] if options.quick else EVERY, effort)
    for test, noise, fit in found:
        fits.setdefault(test, {})[noise] = fit
    silent = table_of_intervals(fits)
    under_ou = [found["ou"] for found in fits.values()]
    check = sum(other["seconds"] for fit in under_ou for other in fit.others)
    share = check / sum(fit.seconds for fit in under_ou)
    print(f"intervals apart without a note: {silent} (none allowed)")
    print(f"cost of the check under ou: {share:.2f} of the sampling (at most {SHARE:.2f})")
    failed = [f"{silent} intervals are apart without a note"] if silent else []
    failed += [f"the check takes {share:.2f} of the sampling"] if share > SHARE else []
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
