"""How often do the demo's 95 % intervals hold the true value, and its bands a test left out?

    python -m benchmarks.demo_coverage.run > benchmarks/demo_coverage/demo_coverage.txt

runs `mfd-bayes demo --quick` with --seeds seeds (5): ten minutes on two cores (--quick: one seed).
One test left out says little of a band: its slip force lies at one place in its scatter, for all of
its samples. So the share of samples inside is given for the demo's own test, for `FURTHER` more
tests drawn from the same truth, and, beside each, for a band that knows the truth.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import csv
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values
from mfd_bayes.evaluation.summary import assess
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.runs.run import Run, open_run

Array = NDArray[np.float64]

FURTHER, TRUE = 200, 2000
"""Number of further tests, and of tests that show the true distribution."""

LEVELS = (50, 95)


@dataclass
class Seed:
    """What the demo of one seed came to."""

    view: CampaignView
    own: list[float]
    """Share of the samples of its own test inside the bands of `LEVELS`."""
    known: list[float]
    """The same of a band that knows the truth."""
    further: list[float]
    """Mean share of the samples of further tests."""


def drawn(count: int, seed: int) -> Array:
    """Forces of tests of the truth under the conditions of the demo's test left out, (count, n)."""
    rng, matrix = np.random.default_rng(seed), Matrix()
    pressure, frequency = matrix.held_out

    def force() -> Array:
        values = draw_values(pressure / 1000.0, matrix.laws, rng)
        return draw_record(values, frequency, matrix.cycles[-1], rng)[2]

    return np.array([force() for _ in range(count)])


def inside(draws: Array, forces: Array) -> list[float]:
    """Mean share of samples inside the bands of draws."""
    ends = [np.quantile(draws, [0.5 - level / 200, 0.5 + level / 200], axis=0) for level in LEVELS]
    return [float(np.mean((forces >= low) & (forces <= high))) for low, high in ends]


def own_of(out: Path) -> list[float]:
    """Share of the samples of the test left out that the run's bands hold."""
    with (out / "scores.csv").open() as file:
        scored = [row for row in csv.DictReader(file) if row["role"] != "calibrate"]
    return [float(np.mean([float(row[f"coverage_{n}"]) for row in scored])) for n in LEVELS]


def predicted(run: Run, seed: int) -> tuple[Array, Array]:
    """Draws of the band of the test left out, and its force."""
    (trace,) = run.held_out.values()
    return run.predict(trace, "observation", draws=800, seed=seed).draws, np.asarray(trace.force)


def demo(seed: int, true: Array, further: Array) -> Seed:
    """Run the demo with a seed and read it."""
    command = [sys.executable, "-m", "mfd_bayes"]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        words = [*command, "demo", str(out), "--quick", "--seed", str(seed)]
        subprocess.run(words, check=True, capture_output=True)
        run = open_run(out)
        draws, force = predicted(run, seed)
        known, more = inside(true, force), inside(draws, further)
        return Seed(assess(run), own_of(out), known, more)


def shares(values: list[float]) -> str:
    return "".join(f"{value:8.1%}" for value in values)


def main() -> None:
    parser = common.parser_of(__doc__ or "")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    seeds = 1 if options.quick else options.seeds
    common.heading((__doc__ or "").splitlines()[0])
    hits: Counter[str] = Counter()
    known: Counter[str] = Counter()
    true, further = drawn(TRUE, 1001), drawn(FURTHER, 1002)
    titles = ("its test left out", "truth's band", f"{FURTHER} more")
    print(f"{'':32s}" + "".join(f"{title:>18s}" for title in titles))
    print(f"{'seed':>6}{'inside':>9}{'known':>8}{'share':>9}" + "      50 %    95 %" * 3)
    found = []
    for seed in range(1, seeds + 1):
        one = demo(seed, true, further)
        found.append(one)
        rows = [row for row in one.view.truth if row["informed"]]
        known.update(row["name"] for row in rows)
        hits.update(row["name"] for row in rows if row["inside"])
        held = sum(row["inside"] for row in rows)
        line = f"{seed:6d}{held:9d}{len(rows):8d}{held / len(rows):9.1%}"
        columns = (one.own, one.known, one.further)
        print(line + "  ".join(["", *map(shares, columns)]), one.view.verdict, flush=True)
    total, held = sum(known.values()), sum(hits.values())
    means = [np.mean([getattr(s, n) for s in found], axis=0) for n in ("own", "known", "further")]
    line = f"{'all':>6}{held:9d}{total:8d}{held / total:9.1%}"
    print(line + "  ".join(["", *(shares(mean.tolist()) for mean in means)]))
    print("\nby quantity")
    for name in sorted(known):
        print(f"{name:22s}{hits[name]:5d} of {known[name]}")


if __name__ == "__main__":
    main()
