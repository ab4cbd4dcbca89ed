"""Do predicted reductions of a band come true? Synthetic campaigns with and without the next test.

    python -m benchmarks.next_test.run > benchmarks/next_test/honest.txt

makes campaigns whose devices differ as the priors allow, asks for the next test, simulates the
recommended, the median and the worst candidate from the truth, infers the population again with
each, and compares: a minute a campaign (--quick: one). Campaigns that --store holds are not
computed again. Closed forms of the expected reduction are in tests/planning.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.next_test.campaigns import (
    BASE,
    CYCLES,
    FREQUENCY,
    Truth,
    advice_of,
    calibrated,
    width_of,
)
from mfd_bayes.planning.candidate import Candidate

WHICH = ("best", "median", "worst")


def campaign(seed: int) -> dict[str, Any]:
    """Predicted and realised reduction of three candidates of one campaign."""
    rng = np.random.default_rng([23, seed])
    truth = Truth.draw(rng)
    base = [truth.record(Candidate(p, FREQUENCY, 1.0, CYCLES), rng) for p in BASE]
    known = calibrated(base, seed)
    advice, before = advice_of(known, seed=seed), width_of(known)
    found = {}
    rows = advice[0], advice[len(advice) // 2], advice[len(advice) - 1]
    for which, row in zip(WHICH, rows, strict=True):
        again = calibrated([*base, truth.record(row.candidate, rng)], 1000 + seed)
        found[which] = {
            "actuation": row.candidate.actuation,
            "amplitude": row.candidate.amplitude,
            "predicted": row.reduction,
            "error": row.error,
            "realised": 1.0 - width_of(again) / before,
            "worst_r_hat": again.predictor.population.convergence.worst_r_hat,
        }
    return {"seed": seed, "scatter": truth.scatter, "width": before, "found": found}


def table(results: list[dict[str, Any]]) -> str:
    """All campaigns, the slope of realised on predicted, and what the recommended test won."""
    lines = [f"{'':8s}" + "".join(f"{which:>28s}" for which in WHICH)]
    lines.append("campaign" + f"{'psi    in predict. realised':>28s}" * 3)
    for result in results:
        cells = "".join(
            f"  {1000 * f['actuation']:6.0f} {f['amplitude']:4.2f}  {f['predicted']:5.3f}"
            f"   {f['realised']:6.3f}"
            for f in (result["found"][which] for which in WHICH)
        )
        lines.append(f"{result['seed']:8d}{cells}")
    x, y = (
        np.array([[r["found"][w][name] for w in WHICH] for r in results])
        for name in ("predicted", "realised")
    )
    pairs = zip(x.mean(axis=0), y.mean(axis=0), strict=True)
    means = "".join(f"{f'{a:5.3f}   {b:6.3f}':>28s}" for a, b in pairs)
    lines += [f"{'mean':8s}{means}", ""]
    slope, error = slope_of(x, y)
    lines.append(f"slope of realised on predicted reduction: {slope:.2f} ± {error:.2f}")
    lines.append(f"mean realised over mean predicted: {y.mean() / x.mean():.2f}")
    wins = int(np.sum(y[:, 0] > y[:, 1]))
    lines.append(f"the recommended test beat the median candidate in {wins} of {len(y)} campaigns")
    lines.append(f"campaigns: {len(results)}")
    return "\n".join(lines)


def slope_of(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope through all pairs with an intercept, and its error by resampling campaigns."""

    def slope(rows: np.ndarray) -> float:
        return float(np.polyfit(x[rows].ravel(), y[rows].ravel(), 1)[0])

    rng = np.random.default_rng(0)
    again = [slope(rng.integers(len(x), size=len(x))) for _ in range(500)]
    return slope(np.arange(len(x))), float(np.std(again))


def main() -> None:
    parser = common.parser_of(__doc__ or "")
    parser.add_argument("--store", type=Path, default=Path("out_next.jsonl"))
    parser.add_argument("--campaigns", type=int, default=40)
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    results = []
    if options.store.is_file() and not options.quick:
        results = [json.loads(line) for line in options.store.read_text().splitlines()]
    known = {result["seed"] for result in results}
    for seed in range(1, 1 + (1 if options.quick else options.campaigns)):
        if seed not in known:
            results.append(campaign(seed))
            if not options.quick:
                with options.store.open("a") as file:
                    file.write(json.dumps(results[-1]) + "\n")
    print(table(sorted(results, key=lambda result: result["seed"])))


if __name__ == "__main__":
    main()
