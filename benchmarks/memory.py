"""The memory that a calibration takes, by stage, and what of it grows with the number of tests.

    python benchmarks/memory.py [TESTS …] > benchmarks/memory.txt

calibrates synthetic campaigns of so many small tests each (15 60), with a model and a noise that
take little time, at effort "quick", and watches
the resident memory of the process that gathers them, not of those that sample: its peak while the
tests come in, while the population is inferred, and while the report is made. Some 10 minutes on
two cores.
"""

import multiprocessing
import platform
import sys
import tempfile
import threading
import time
from pathlib import Path

from mfd_bayes.demo import Truth, write_campaign
from mfd_bayes.pipeline import Options, Step, calibrate_campaign

STAGES = ("tests", "population", "report")
FREQUENCIES = (0.25, 0.5, 1.0)
WATCH = 0.02


def lay_out(folder: Path, tests: int) -> Path:
    """Write a campaign of so many tests of one cycle, at 5 levels of pressure or more."""
    levels = max(5, tests // 9)
    repeats = -(-tests // (levels * len(FREQUENCIES)))
    pressures = tuple(500.0 + 1000.0 * k / (levels - 1) for k in range(levels))
    entries, header = [], ""
    for number in range(repeats):
        truth = Truth(
            pressures=pressures, frequencies=FREQUENCIES, cycles=(1, 1, 1), held_out=(900.0, 0.5)
        )
        write_campaign(folder / f"series_{number}", number, truth)
        text = (folder / f"series_{number}" / "campaign.toml").read_text(encoding="utf-8")
        header, *found = text.split("[[test]]\n")
        for entry in found[:-1]:  # the last one is held out
            entry = entry.replace('id = "', f'id = "s{number}_')
            entries.append(entry.replace('file = "', f'file = "series_{number}/'))
    path = folder / "campaign.toml"
    header = header.replace('"three_stage"', '"lugre"').replace('"ou"', '"iid"\nrate = "25 Hz"')
    path.write_text(header + "".join(f"[[test]]\n{entry}" for entry in entries[:tests]))
    return path


def resident() -> float:
    """Resident memory of this process, MiB."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise RuntimeError("this system does not tell resident memory in /proc/self/status")


def study(tests: int, line) -> None:
    """Calibrate so many tests, and send the peak of each stage, MiB, and its seconds."""
    peaks, seconds, at = dict.fromkeys(STAGES, 0.0), dict.fromkeys(STAGES, 0.0), ["tests"]

    def watch() -> None:
        while True:
            peaks[at[0]] = max(peaks[at[0]], resident())
            seconds[at[0]] += WATCH
            time.sleep(WATCH)

    def observe(step: Step) -> None:
        if step.id in STAGES:
            at[0] = step.id

    with tempfile.TemporaryDirectory() as home:
        path = lay_out(Path(home) / "campaign", tests)
        threading.Thread(target=watch, daemon=True).start()
        calibrate_campaign(path, Path(home) / "out", Options("quick", seed=1), observe)
        stored = sum(file.stat().st_size for file in Path(home).rglob("posterior.nc"))
    line.send((peaks, seconds, stored / tests / 2**20))


def main() -> None:
    print(f"{platform.platform()}, Python {platform.python_version()}")
    print(f"\n{'tests':>5s}" + "".join(f"{stage:>14s}" for stage in STAGES), end="")
    print("   peak, MiB (seconds); posterior.nc, MiB a test", flush=True)
    context = multiprocessing.get_context("spawn")
    for tests in [int(word) for word in sys.argv[1:]] or [15, 60]:
        ours, theirs = context.Pipe()
        process = context.Process(target=study, args=(tests, theirs))
        process.start()
        peaks, seconds, size = ours.recv()
        process.join()
        cells = (f"{peaks[s]:.0f} ({seconds[s]:.0f})" for s in STAGES)
        print(
            f"{tests:5d}" + "".join(f"{cell:>14s}" for cell in cells) + f"   {size:.2f}", flush=True
        )


if __name__ == "__main__":
    main()
