"""How often do the demo's 95 % intervals hold the true value, and its bands a test left out?

    python -m benchmarks.population.demo > benchmarks/population/demo.txt

runs `mfd-bayes demo --quick` with --seeds seeds (5), of which --seed (1) is the first: ten minutes
on two cores (--quick: one seed).
One test left out says little of a band: its slip force lies at one place in its scatter, for all of
its samples. So the share of samples inside is given for the demo's own test, for `FURTHER` more
tests drawn from the same truth, and, beside each, for a band that knows the truth.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values
from mfd_bayes.evaluation.summary import assess

FURTHER, TRUE = 200, 2000
"""Number of further tests, and of tests that show the true distribution."""


def drawn(count, seed):
    """Forces of tests of the truth under the conditions of the demo's test left out, (count, n)."""
    rng, matrix, forces = np.random.default_rng(seed), Matrix(), []
    pressure, frequency = matrix.held_out
    for _ in range(count):
        values = draw_values(pressure / 1000.0, matrix.laws, rng)
        forces.append(draw_record(values, frequency, matrix.cycles[-1], rng)[2])
    return np.array(forces)


def demo(seed, true, extra):
    """Rows on the true values and the verdict; what is inside of three pairs of bands."""
    with tempfile.TemporaryDirectory() as folder:
        run_folder = Path(folder) / "out"
        common.command("demo", run_folder, "--quick", "--seed", seed)
        run = mb.open_run(run_folder)
        (trace,) = run.held_out.values()
        draws = run.predict(trace, "observation", draws=800, seed=seed).draws
        pairs = (draws, trace.force), (true, trace.force), (draws, extra)
        assessment = assess(run)
        return assessment.truth, assessment.verdict, [common.inside(*pair) for pair in pairs]


def line(seed, hits, total, shares):
    words = f"{seed:>6}{hits:9d}{total:8d}{hits / total:9.1%}"
    return "  ".join([words, *("".join(f"{share:8.1%}" for share in pair) for pair in shares)])


def main() -> None:
    parser = common.parser_of(__doc__ or "")
    parser.add_argument("--seeds", type=int, default=5)
    options = common.begin(parser)
    hits: Counter[str] = Counter()
    totals: Counter[str] = Counter()
    true, extra, all_shares = drawn(TRUE, 1001), drawn(FURTHER, 1002), []
    titles = ("its test left out", "truth's band", f"{FURTHER} more")
    print(f"{'':32s}" + "".join(f"{title:>18s}" for title in titles))
    print(f"{'seed':>6}{'inside':>9}{'known':>8}{'share':>9}" + "      50 %    95 %" * 3)
    seeds = 1 if options.quick else options.seeds
    for seed in range(options.seed, options.seed + seeds):
        rows, verdict, shares = demo(seed, true, extra)
        rows = [row for row in rows if row["informed"]]
        covered = [row["name"] for row in rows if row["inside"]]
        totals.update(row["name"] for row in rows)
        hits.update(covered)
        all_shares.append(shares)
        print(line(seed, len(covered), len(rows), shares), verdict, flush=True)
    print(line("all", hits.total(), totals.total(), np.mean(all_shares, axis=0)))
    print("\nby quantity")
    for name in sorted(totals):
        print(f"{name:22s}{hits[name]:5d} of {totals[name]}")


if __name__ == "__main__":
    main()
