r"""Ranks and coverage of bands given a first part, on 100 synthetic tests.

    python -m benchmarks.given.coverage > benchmarks/given/coverage.txt
    python -m benchmarks.given.coverage --level-sd 0.3 --out out_given_varying \
        > benchmarks/given/coverage_varying.txt
    python -m benchmarks.given.coverage --model backlash --out out_given_backlash \
        > benchmarks/given/coverage_backlash.txt

draws tests from a population with given values (`study`), predicts each from none, a quarter, half
and all of its record, and ranks the true force and quantities among the draws: ranks are uniform if
the part is taken in rightly. The negative control ranks each test among the draws of another. What
is done stays in out_given/, so that an interrupted run goes on; delete the folder when the code has
changed. Exit status 1: ranks are not uniform, or the control's are.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.common.machine import processor, versions
from benchmarks.common.uniformity import LEVEL, Uniformity, failures, rank_cells
from benchmarks.given.study import (
    DRAWS,
    LAWFUL,
    MEDIANS,
    SHARES,
    ask,
    draw_truth,
    make_study,
    ranks_of,
)

TESTS = 100


def one_test(study, index: int) -> dict:
    """Ranks of a test, and of the next test in its place, and what its bands are, by share."""
    truth, other = (draw_truth(study, np.random.default_rng([20, i])) for i in (index, index + 1))
    found = {}
    for share in SHARES:
        band = ask(study, truth, share, seed=index)
        rest = study.motion.time > share * study.motion.time[-1]
        rest |= share == 1.0
        inside = (band.lower <= truth.damper) & (truth.damper <= band.upper)
        told = band.given
        found[str(share)] = {
            "ranks": ranks_of(truth, band),
            "control": ranks_of(other, band),
            "coverage": float(np.mean(inside[rest])),
            "width": float(np.mean((band.upper - band.lower)[rest])),
            "method": told.method if told else "",
            "k": told.pareto_k if told else 0.0,
        }
    return found


def table(results: list[dict]) -> tuple[str, bool]:
    """Lines of the table, and whether all is as it should be."""
    uniform, lines, good = Uniformity(len(results), DRAWS), [], True
    for share in SHARES:
        those = [result[str(share)] for result in results]
        coverage = 100.0 * np.mean([t["coverage"] for t in those])
        width = np.mean([t["width"] for t in those])
        sampled = sum(t["method"] == "sampling" for t in those)
        lines.append(
            f"\ngiven {100 * share:.0f} %: 95 % bands of the rest hold {coverage:.1f} % of it, "
            f"width {width:.3f} kip; {sampled} of {len(those)} sampled"
        )
        lines.append(f"{'rank of':18}{'p':>10}{'z mean':>8}{'spread':>9}{'p, control':>12}")
        ranks = {name: [t["ranks"][name] for t in those] for name in those[0]["ranks"]}
        control = {name: [t["control"][name] for t in those] for name in ranks}
        for name in ranks:
            wrong = uniform.p_value(control[name])
            lines.append(f"{name:18}{rank_cells(ranks[name], uniform)}{wrong:12.2g}")
        failed, seen = failures(ranks, uniform), failures(control, uniform)
        good &= not failed and (share < 0.5 or bool(seen))
        lines.append(
            f"not uniform at {100 * LEVEL:g} % familywise: {', '.join(failed) or 'none'}; of the "
            f"control {len(seen)} of {len(ranks)}"
        )
    return "\n".join(lines), good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tests", type=int, default=TESTS)
    parser.add_argument("--first", type=int, default=0, help="number of the first test")
    parser.add_argument("--model", choices=MEDIANS, default="three_stage")
    parser.add_argument("--level-sd", type=float, default=LAWFUL, help="sd of levels off the laws")
    parser.add_argument("--out", type=Path, default=Path("out_given"))
    options = parser.parse_args()
    options.out.mkdir(exist_ok=True)
    study, results = make_study(options.model, options.level_sd), []
    for index in range(options.first, options.first + options.tests):
        path = options.out / f"{index}.json"
        if not path.is_file():
            path.write_text(json.dumps(one_test(study, index)))
        results.append(json.loads(path.read_text()))
    lines, good = table(results)
    print(f"Bands given a first part, {len(results)} synthetic tests, {DRAWS} draws each.")
    command = f"python -m benchmarks.given.coverage --tests {len(results)}"
    if options.first:
        command += f" --first {options.first}"
    if options.model != "three_stage":
        command += f" --model {options.model}"
    if options.level_sd > LAWFUL:
        command += f" --level-sd {options.level_sd:g}"
        print("The actuation doubles during a test, and levels of actuation deviate from the laws.")
    print(command)
    print(f"{processor()}, {versions('numpy', 'arviz')}")
    held = 100.0 * 0.95 * (DRAWS - 1) / (DRAWS + 1)
    print(f"Between the quantiles of {DRAWS} draws lie {held:.1f} % of what is drawn like them.")
    print(lines)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
