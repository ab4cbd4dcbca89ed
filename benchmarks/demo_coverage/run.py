"""How often the demo's 95 % intervals hold the true value, and its bands a test left out.

    python -m benchmarks.demo_coverage.run [SEEDS] > benchmarks/demo_coverage/demo_coverage.txt

runs `mfd-bayes demo --quick` with the seeds 1 to SEEDS (5): about ten minutes on two cores.
"""

import csv
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.common.machine import platform_line
from mfd_bayes.assessment import assess
from mfd_bayes.runs.opening import open_run


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    command = str(Path(sys.executable).parent / "mfd-bayes")
    inside: Counter[str] = Counter()
    known: Counter[str] = Counter()
    print(f"demo --quick, {platform_line()}")
    bands: list[tuple[float, float]] = []
    print(f"{'':32s}held-out test covered by")
    print(f"{'seed':>6}{'inside':>9}{'known':>8}{'share':>9}{'50 %':>10}{'95 %':>7}  verdict")
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            subprocess.run(
                [command, "demo", str(out), "--quick", "--seed", str(seed)],
                check=True,
                capture_output=True,
            )
            view = assess(open_run(out))
            with (out / "scores.csv").open() as file:
                scored = [row for row in csv.DictReader(file) if row["role"] != "calibrate"]
        middle, wide = (
            sum(float(row[f"coverage_{level}"]) for row in scored) / len(scored)
            for level in (50, 95)
        )
        bands.append((middle, wide))
        rows = [row for row in view.truth if row.informed]
        hits = sum(row.inside for row in rows)
        known.update(row.name for row in rows)
        inside.update(row.name for row in rows if row.inside)
        share = hits / len(rows)
        print(
            f"{seed:6d}{hits:9d}{len(rows):8d}{share:9.1%}{middle:10.1%}{wide:7.1%}  {view.verdict}"
        )
    total, hits = sum(known.values()), sum(inside.values())
    middle, wide = (sum(part) / seeds for part in zip(*bands, strict=True))
    print(f"{'all':>6}{hits:9d}{total:8d}{hits / total:9.1%}{middle:10.1%}{wide:7.1%}")
    print("\nby quantity")
    for name in sorted(known):
        print(f"{name:22s}{inside[name]:5d} of {known[name]}")


if __name__ == "__main__":
    main()
