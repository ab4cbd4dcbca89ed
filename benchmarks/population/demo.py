"""How often do the demo's 95 % intervals hold the true value, and its bands a test left out?

    python -m benchmarks.population.demo > benchmarks/population/demo.txt

runs `mfd-bayes demo --quick` with --seeds seeds (5): ten minutes on two cores (--quick: one seed).
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


def demo(seed, true, further):
    """Rows on the true values and the verdict; what is inside of three pairs of bands."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        common.command("demo", out, "--quick", "--seed", seed)
        run = mb.open_run(out)
        (trace,) = run.held_out.values()
        draws = run.predict(trace, "observation", draws=800, seed=seed).draws
        pairs = (draws, trace.force), (true, trace.force), (draws, further)
        found = assess(run)
        return found.truth, found.verdict, [common.inside(*pair) for pair in pairs]


def line(seed, hits, known, shares):
    words = f"{seed:>6}{hits:9d}{known:8d}{hits / known:9.1%}"
    return "  ".join([words, *("".join(f"{share:8.1%}" for share in pair) for pair in shares)])


def main() -> None:
    parser = common.parser_of(__doc__ or "")
    parser.add_argument("--seeds", type=int, default=5)
    options = common.begin(parser)
    hits: Counter[str] = Counter()
    known: Counter[str] = Counter()
    true, further, every = drawn(TRUE, 1001), drawn(FURTHER, 1002), []
    titles = ("its test left out", "truth's band", f"{FURTHER} more")
    print(f"{'':32s}" + "".join(f"{title:>18s}" for title in titles))
    print(f"{'seed':>6}{'inside':>9}{'known':>8}{'share':>9}" + "      50 %    95 %" * 3)
    for seed in range(1, 1 + (1 if options.quick else options.seeds)):
        rows, verdict, shares = demo(seed, true, further)
        rows = [row for row in rows if row["informed"]]
        right = [row["name"] for row in rows if row["inside"]]
        known.update(row["name"] for row in rows)
        hits.update(right)
        every.append(shares)
        print(line(seed, len(right), len(rows), shares), verdict, flush=True)
    print(line("all", hits.total(), known.total(), np.mean(every, axis=0)))
    print("\nby quantity")
    for name in sorted(known):
        print(f"{name:22s}{hits[name]:5d} of {known[name]}")


if __name__ == "__main__":
    main()
