"""Do the bounds of the data sheet hold the measured properties of tests left out?

    python -m benchmarks.design.run > benchmarks/design/design.txt
    python -m benchmarks.design.run --by test > benchmarks/design/by_test.txt

calibrates the 2022 session of the band brake as `benchmarks.heldout.run` does (--quick: three tests
with little effort, three minutes), leaves out each tension (or each test) in turn, infers the laws
from the others, and bounds the properties of each test left out, for its own motion and tension, as
the data sheet does. The share of the tests' measured values inside the bounds of a measurement
should be the stated probability, and so should that of their cycles. The range that chance allows
is that of tests of one tension that lie inside or not together. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from mfd_bayes.applications.comparison.crossvalidation import folds_of
from mfd_bayes.evaluation.bounds import design_rows
from mfd_bayes.evaluation.properties import measured_of
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.runs.run import Run

PROBABILITIES = (0.5, 0.8, 0.95)
BASIS = "observation"
PROPERTIES_SHOWN = (
    *("slip_fwd", "slip_bwd", "force_at_max_fwd", "force_at_max_bwd", "energy_per_cycle"),
    *("effective_stiffness", "effective_damping", "peak_fwd", "peak_bwd", "gap"),
)


def bounded(run: Run, effort: str, criterion: str) -> Iterator[dict]:
    """Measured value and bounds of every property of every test left out."""
    for fold in folds_of(run, criterion, effort):
        subset = common.without(run, fold.kept, effort, (run.manifest.seed, 2))
        for name in fold.left_out:
            measured = measured_of(run.manifest, name)
            values = measured.of_test()
            trace = replace(run.tests[name].trace, force=None)
            for probability in PROBABILITIES:
                rows = {(r["name"], r["basis"]): r for r in design_rows(subset, trace, probability)}
                for quantity in PROPERTIES_SHOWN:
                    row, item = rows[quantity, BASIS], PROPERTIES[quantity]
                    cycles = measured.values[item.key][measured.full_stroke]
                    inside = (row["lower"] <= cycles) & (cycles <= row["upper"])
                    yield {
                        "test": name,
                        "probability": probability,
                        "property": quantity,
                        "measured": values[quantity],
                        **{key: row[key] for key in ("lower", "upper")},
                        "cycles": cycles.size,
                        "cycles_inside": int(inside.sum()),
                    }
        print(f"without {fold.part}: done", file=sys.stderr, flush=True)


def show(table: pd.DataFrame) -> None:
    """Print the bounds of every test, and the shares inside."""
    table["inside"] = table["measured"].between(table["lower"], table["upper"])
    widest = table[table["probability"] == PROBABILITIES[-1]].drop(columns="probability")
    print(f"\n  bounds of 95 %\n{widest.to_string(index=False, float_format='%.3f')}")
    print("\n  share of tests inside the bounds (number that chance allows in 95 of 100 cases,")
    print("  where the tests of one tension, predicted together, lie inside or outside together),")
    print("  and cycles inside of all cycles")
    print(f"  {'property':20s} " + "  ".join(f"{100 * p:18g} %" for p in PROBABILITIES))
    for quantity in PROPERTIES_SHOWN:
        cells = []
        for probability in PROBABILITIES:
            rows = table[(table["probability"] == probability) & (table["property"] == quantity)]
            low, high = chance([name.split("_")[0] for name in rows["test"]], probability)
            of_cycles = f"{rows['cycles_inside'].sum()}/{rows['cycles'].sum()}"
            cells.append(f"{rows['inside'].sum():2d} of {len(rows):2d} ({low}-{high}) {of_cycles}")
        print(f"  {quantity:20s} " + "  ".join(f"{cell:>20s}" for cell in cells))


def chance(groups: list[str], probability: float) -> tuple[int, int]:
    """Numbers between which 95 of 100 cases lie, where tests of one group hit or miss together."""
    density = np.ones(1)
    for size in Counter(groups).values():
        density = np.convolve(density, [1 - probability, *[0] * (size - 1), probability])
    cumulative = np.cumsum(density)
    low, high = (int(np.searchsorted(cumulative, q - 1e-12)) for q in (0.025, 0.975))
    return low, high


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True, jobs=2, output="out_heldout")
    parser.add_argument("--by", choices=("level", "test"), default="level")
    options = common.begin(parser)
    run = common.calibrated(options, "2022-07")
    part = {"level": "tension", "test": "test"}[options.by]
    print(f"{len(run.tests)} tests, each {part} left out")
    show(pd.DataFrame(bounded(run, options.effort, options.by)))


if __name__ == "__main__":
    main()
