"""How do time and memory of a calibration grow with the number of tests?

    python -m benchmarks.scaling.run > benchmarks/scaling/scaling.txt

takes an hour and a half on two cores (--quick: 2 tests): synthetic campaigns at effort "quick" with
two processes, two cycles at 0.5 and 1 Hz, ten levels of pressure, at 50 Hz. `ratio` is the time
until the last test is stored, divided by half of the sum of the tests' own times (two processes: 1
is ideal). Then follow the seconds and the peak memory of each stage in the main process, the sweeps
of the population, the peak memory of the largest worker, and the sizes of what was written.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import multiprocessing
import tempfile
import threading
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from mfd_bayes.pipeline.calibrate import calibrate_plan
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.runs.folder import MANIFEST
from mfd_bayes.store.files import read_json

WORKERS = 2
STAGES = ("tests", "population", "report")
PRESSURES = tuple(float(round(500.0 + 1000.0 * k / 9)) for k in range(10))
MATRIX = Matrix(pressures=PRESSURES, frequencies=(0.5, 1.0), cycles=(2, 2), held_out=(900.0, 0.5))
WATCH = 0.05


def memory(pid):
    """Resident memory of a process, MiB; 0 of one that has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((int(x.split()[1]) / 1024.0 for x in lines if x.startswith("VmRSS:")), 0.0)


class Watched:
    """Seconds and peak memory, MiB, of each stage, and of the greatest worker."""

    def __init__(self):
        self.seconds, self.peaks = defaultdict(float), defaultdict(float)
        self.worker, self.stage, self.sweeps = 0.0, STAGES[0], 0

    def follow(self):
        """Measure memory at intervals, in a thread."""
        while True:
            began = time.perf_counter()
            self.peaks[self.stage] = max(self.peaks[self.stage], memory("self"))
            if self.stage == "tests":
                ours = [p.pid for p in multiprocessing.active_children() if p.pid]
                self.worker = max([self.worker, *map(memory, ours)])
            time.sleep(WATCH)
            self.seconds[self.stage] += time.perf_counter() - began

    def observe(self, step):
        """Take note of the stage."""
        if step.id in STAGES:
            self.stage = step.id
            if step.progress:
                self.sweeps = step.progress.steps


def lay_out(folder, tests):
    """Write a campaign of so many tests, in series that have a truth of their own."""
    entries, header = [], ""
    for number in range(-(-tests // (len(PRESSURES) * len(MATRIX.frequencies)))):
        write_campaign(folder / f"series_{number}", number, MATRIX)
        text = (folder / f"series_{number}" / "campaign.toml").read_text(encoding="utf-8")
        header, *sections = text.split("[[test]]\n")
        for entry in sections[:-1]:  # the last one is held out
            entry = entry.replace('id = "', f'id = "s{number}_')
            entries.append(entry.replace('file = "', f'file = "series_{number}/'))
    path = folder / "campaign.toml"
    header = header.replace('"ou"', '"ou"\nrate = "50 Hz"')
    path.write_text(header + "".join(f"[[test]]\n{entry}" for entry in entries[:tests]))
    return path


def campaign(tests):
    """Calibrate so many tests; a line of times, memory and sizes of the files."""
    watched = Watched()
    with tempfile.TemporaryDirectory() as folder:
        path, output = lay_out(Path(folder) / "campaign", tests), Path(folder) / "out"
        threading.Thread(target=watched.follow, daemon=True).start()
        plan = plan_campaign(path, RunOptions(effort="quick", seed=1, jobs=WORKERS))
        view = calibrate_plan(plan, output, watched.observe)
        sampling = sum(test["seconds"] for test in read_json(output / MANIFEST)["tests"].values())
        stored = sum(file.stat().st_size for file in output.rglob("*.nc")) / tests / 2**20
        pages = sum(file.stat().st_size for file in output.rglob("*.html")) / 2**20
    line = (
        f"{tests:6d}{sampling / tests:9.1f}{watched.seconds['tests'] / (sampling / WORKERS):9.3f}"
    )
    for stage in STAGES:
        line += f"{watched.seconds[stage]:9.0f}{watched.peaks[stage]:7.0f}"
    failed = [check.status for check in view.checks].count("fail")
    return line + f"{watched.sweeps:8d}{watched.worker:8.0f}{stored:10.2f}{pages:8.1f}{failed:7d}"


def main():
    parser = common.parser_of(__doc__)
    parser.add_argument("--tests", type=int, nargs="+", default=[20, 60, 180, 500])
    options = common.begin(parser)
    print(" tests  s each    ratio" + "".join(f"{stage:>12s} MiB" for stage in STAGES), end="")
    print("  sweeps  worker  MiB/test    page failed")
    for tests in [2] if options.quick else options.tests:
        # in a process of its own, whose memory is counted
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            print(pool.submit(campaign, tests).result(), flush=True)


if __name__ == "__main__":
    main()
