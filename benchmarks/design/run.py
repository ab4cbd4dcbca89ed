"""Do bounding properties of design hold the energies and slip forces of tests left out?

    python -m benchmarks.design.run > benchmarks/design/design.txt

calibrates the 2022 session of the band brake (half an hour on two cores; --quick: three tests with
little effort, three minutes), leaves out each tension in turn, infers the laws from the others, and
bounds the properties of each test left out, for its own motion and tension, as `mfd-bayes predict
--design` does. The share of the tests' own values inside the bounds of "this device tested again"
should be the stated probability: energies and peak forces as measured, slip forces as the test's
own calibration has them. The range that chance allows is that of tests of one tension that lie
inside or not together. The calibrated run stays in --out: delete it when records or code have
changed. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from mfd_bayes.evaluation.crossvalidate import Fold, folds_of
from mfd_bayes.evaluation.properties import design_rows, measured_of, measured_properties
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.population.inference import infer_population
from mfd_bayes.runs.run import Run

SMALLEST = ("20lb_0.50Hz_1.0in", "35lb_0.50Hz_1.0in", "80lb_0.50Hz_1.0in")
PROBABILITIES = (0.5, 0.8, 0.95)
BASIS = {
    "slip_fwd": "new_test",
    "slip_bwd": "new_test",
    "energy_per_cycle": "new_test",
    "peak_fwd": "observation",
    "peak_bwd": "observation",
}
"""What each property is compared with: measured peaks have noise, energies hardly any."""


def own_values(run: Run, name: str) -> dict[str, float]:
    """Measured properties of a test, by name."""
    measured = measured_properties(measured_of(run.manifest, name))
    return {key: value for key, value in measured.items() if key in BASIS}


def without(run: Run, fold: Fold, effort: str) -> Run:
    """The run as if the tests of a part had never been made."""
    kept = {name: run.tests[name] for name in fold.kept}
    settings = run.manifest.settings.inference(effort, (run.manifest.seed, 2))
    inference = infer_population(kept, run.priors, settings)
    others = replace(run, tests=kept)
    vars(others)["population"] = inference.population  # instead of the one that is stored
    return others


def bounded(run: Run, effort: str) -> Iterator[tuple[str, float, float, dict]]:
    """Test, probability, own value and bounds of every property of every test left out."""
    for fold in folds_of(run, "level", effort):
        others = without(run, fold, effort)
        for name in fold.left_out:
            own = own_values(run, name)
            trace = replace(run.tests[name].trace, force=None)
            for probability in PROBABILITIES:
                rows = {(r["name"], r["basis"]): r for r in design_rows(others, trace, probability)}
                for what, basis in BASIS.items():
                    yield name, probability, own[what], rows[what, basis]
        print(f"without {fold.part}: done", file=sys.stderr, flush=True)


def show(found: list[tuple[str, float, float, dict]]) -> None:
    """Print the bounds of every test, and the shares inside."""
    print(f"\n  {'test':24s} {'property':18s} {'own':>7s}  bounds of 95 %     λ min  λ max  inside")
    for name, probability, own, row in found:
        if probability == PROBABILITIES[-1]:
            inside = row["lower"] <= own <= row["upper"]
            print(
                f"  {name:24s} {row['name']:18s} {own:7.3f}  "
                f"{row['lower']:7.3f} to {row['upper']:7.3f}  "
                f"{row['lambda_min']:5.2f}  {row['lambda_max']:5.2f}  {'yes' if inside else 'NO'}"
            )
    print("\n  share of tests inside the bounds (number that chance allows in 95 of 100 cases,")
    print("  where the tests of one tension, predicted together, lie inside or outside together)")
    print(f"  {'property':18s} " + "  ".join(f"{100 * p:12g} %" for p in PROBABILITIES))
    for what in BASIS:
        cells = []
        for probability in PROBABILITIES:
            those = [row for row in found if row[1] == probability and row[3]["name"] == what]
            hits = [r["lower"] <= own <= r["upper"] for _, _, own, r in those]
            low, high = chance([name.split("_")[0] for name, *_ in those], probability)
            cells.append(f"{sum(hits):2d} of {len(hits):2d} ({low} to {high})")
        print(f"  {what:18s} " + "  ".join(f"{cell:>14s}" for cell in cells))


def chance(groups: list[str], probability: float) -> tuple[int, int]:
    """Numbers between which 95 of 100 cases lie, where tests of one group hit or miss together."""
    density = np.ones(1)
    for size in Counter(groups).values():
        density = np.convolve(density, [1 - probability, *[0] * (size - 1), probability])
    below = np.cumsum(density)
    low, high = (int(np.searchsorted(below, q - 1e-12)) for q in (0.025, 0.975))
    return low, high


def finished(options: argparse.Namespace) -> Run:
    """Calibrated run of the session, or of three of its tests."""
    out = options.out / ("quick" if options.quick else "standard")
    campaign = common.lay_out(options.data, options.out / f"campaign_{out.name}", "2022-07")
    if options.quick:
        head, *tests = campaign.read_text(encoding="utf-8").split("\n[[test]]")
        kept = [test for test in tests if any(f'"{known}"' in test for known in SMALLEST)]
        campaign.write_text("\n[[test]]".join([head, *kept]), encoding="utf-8")
    chosen = Options(effort=out.name, seed=options.seed, jobs=options.jobs, resume=out.exists())
    return calibrate(plan_campaign(campaign, chosen), out, lambda _: None)


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("--out", type=Path, default=common.PROJECT / "out_design")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    run = finished(options)
    print(f"{len(run.tests)} tests, each tension left out")
    show(list(bounded(run, "quick" if options.quick else "standard")))


if __name__ == "__main__":
    main()
