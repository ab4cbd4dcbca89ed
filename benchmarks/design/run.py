"""Do bounding properties of design hold the energies and slip forces of tests left out?

    python -m benchmarks.design.run > benchmarks/design/design.txt

calibrates the 2022 session of the band brake as `benchmarks.heldout.run` does (--quick: three tests
with little effort, three minutes), leaves out each tension in turn, infers the laws from the
others, and bounds the properties of each test left out, for its own motion and tension, as
`mfd-bayes predict --design` does. The share of the tests' own values inside the bounds of "this
device tested again" should be the stated probability: energies and peak forces as measured, slip
forces as the test's own calibration has them. The range that chance allows is that of tests of one
tension that lie inside or not together. Real records come from --data.
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
from mfd_bayes.runs.run import Run

PROBABILITIES = (0.5, 0.8, 0.95)
BASIS = {
    "slip_fwd": "new_test",
    "slip_bwd": "new_test",
    "energy_per_cycle": "new_test",
    "peak_fwd": "observation",
    "peak_bwd": "observation",
    "gap": "observation",
}
"""What each property is compared with: measured peaks have noise, energies hardly any."""


def bounded(run: Run, effort: str) -> Iterator[dict]:
    """Own value and bounds of every property of every test left out."""
    for fold in folds_of(run, "level", effort):
        subset = common.without(run, fold.kept, effort, (run.manifest.seed, 2))
        for name in fold.left_out:
            values = measured_of(run.manifest, name).of_test()
            trace = replace(run.tests[name].trace, force=None)
            for probability in PROBABILITIES:
                rows = {(r["name"], r["basis"]): r for r in design_rows(subset, trace, probability)}
                for quantity, basis in BASIS.items():
                    line = {"test": name, "probability": probability, "property": quantity}
                    bounds = ("lower", "upper", "lower_ratio", "upper_ratio")
                    yield (
                        line
                        | {"own": values[quantity]}
                        | {k: rows[quantity, basis][k] for k in bounds}
                    )
        print(f"without {fold.part}: done", file=sys.stderr, flush=True)


def show(table: pd.DataFrame) -> None:
    """Print the bounds of every test, and the shares inside."""
    table["inside"] = (table["lower"] <= table["own"]) & (table["own"] <= table["upper"])
    widest = table[table["probability"] == PROBABILITIES[-1]].drop(columns="probability")
    print(f"\n  bounds of 95 %\n{widest.to_string(index=False, float_format='%.3f')}")
    print("\n  share of tests inside the bounds (number that chance allows in 95 of 100 cases,")
    print("  where the tests of one tension, predicted together, lie inside or outside together)")
    print(f"  {'property':18s} " + "  ".join(f"{100 * p:12g} %" for p in PROBABILITIES))
    for quantity in BASIS:
        cells = []
        for probability in PROBABILITIES:
            rows = table[(table["probability"] == probability) & (table["property"] == quantity)]
            low, high = chance([name.split("_")[0] for name in rows["test"]], probability)
            cells.append(f"{rows['inside'].sum():2d} of {len(rows):2d} ({low} to {high})")
        print(f"  {quantity:18s} " + "  ".join(f"{cell:>14s}" for cell in cells))


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
    options = common.begin(parser)
    run = common.calibrated(options, "2022-07")
    print(f"{len(run.tests)} tests, each tension left out")
    show(pd.DataFrame(bounded(run, "quick" if options.quick else options.effort)))


if __name__ == "__main__":
    main()
