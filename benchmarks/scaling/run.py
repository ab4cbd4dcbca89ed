"""How do time and memory of a calibration grow with samples, walkers, parameters and tests?

    python -m benchmarks.scaling.run > benchmarks/scaling/scaling.txt
    python -m benchmarks.scaling.run --tests 20 60 180 500 >> benchmarks/scaling/scaling.txt

The first takes two minutes (--quick: the smallest cases): the log posterior of synthetic records of
a slow sine, for all walkers of a step at once as the sampler does, each case in its own process;
the median seconds of a step and how far the peak memory of the process grows. The second takes an
hour and a half on two cores: synthetic campaigns at effort "quick" with two processes, two cycles
at 0.5 and 1 Hz, ten levels of pressure, at 50 Hz. `ratio` is the time until the last test is
stored, divided by half of the sum of the tests' own times (two processes: 1 is ideal). Then follow
the seconds and the peak memory of each stage in the main process, the sweeps of the population, the
peak memory of the largest worker, and the sizes of what was written.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import multiprocessing
import resource
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from mfd_bayes.calibration.posterior import Posterior, find_priors, load_priors
from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from mfd_bayes.jobs.job import Step
from mfd_bayes.pipeline.calibrate import calibrate_campaign
from mfd_bayes.pipeline.plan import Options
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import MANIFEST
from mfd_bayes.store.files import read_json

WORKERS = 2
STAGES = ("tests", "population", "report")
PRESSURES = tuple(float(round(500.0 + 1000.0 * k / 9)) for k in range(10))
MATRIX = Matrix(pressures=PRESSURES, frequencies=(0.5, 1.0), cycles=(2, 2), held_out=(900.0, 0.5))
WATCH = 0.05

SAMPLES = (100, 1000, 10_000, 100_000, 1_000_000)
WALKERS = (24, 48, 96, 192, 384, 768)
MODELS = ("lugre iid", "bouc_wen iid", "three_stage iid", "three_stage ou", "three_stage staged")
USUAL = (1000, 192, "three_stage ou")
REPEATS, LONG = 5, 30.0


def memory(pid: int | str = "self") -> float:
    """Resident memory of a process, MiB; 0 of one that has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((int(x.split()[1]) / 1024.0 for x in lines if x.startswith("VmRSS:")), 0.0)


# one step of the sampler


def make_trace(samples: int) -> Trace:
    """A record of ten cycles whose force is nearly a rectangle."""
    time_s = np.linspace(0.0, 200.0, samples)
    displacement = np.sin(2 * np.pi * 0.05 * time_s)
    force = 1.3 * np.sign(np.cos(2 * np.pi * 0.05 * time_s))
    force += 0.05 * np.random.default_rng(1).standard_normal(samples)
    return Trace.from_arrays(time_s, displacement, 1.0, force)


def study_step(case: tuple[int, int, str], line) -> None:
    """Send the seconds of a step, the growth of peak memory, MiB, and the dimensions."""
    samples, walkers, model = case
    path = find_priors("mfd")
    priors = load_priors(path.name, path.parent)
    posterior = Posterior(make_trace(samples), priors, model.split()[1], model.split()[0])
    rng = np.random.default_rng(2)
    points = posterior.coordinates(posterior.draw_prior(rng, walkers))
    before = memory()
    seconds: list[float] = []
    while len(seconds) < REPEATS and sum(seconds) < LONG:
        began = time.perf_counter()
        posterior.log_prob(points)
        seconds.append(time.perf_counter() - began)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    line.send((median(seconds), peak - before, posterior.dim))


def density(quick: bool) -> None:
    """Print the table of one step."""
    print(f"{'samples':>9s}{'walkers':>9s}{'model, noise':>22s}{'parameters':>12s}", end="")
    print(f"{'ms a step':>12s}{'us a walker':>13s}{'MiB':>8s}")
    cases = [(n, *USUAL[1:]) for n in (SAMPLES[:2] if quick else SAMPLES)]
    if not quick:
        cases += [(USUAL[0], n, USUAL[2]) for n in WALKERS]
        cases += [(*USUAL[:2], model) for model in MODELS]
    for case in cases:
        seconds, grown, dim = apart(study_step, case)
        samples, walkers, model = case
        print(f"{samples:9d}{walkers:9d}{model:>22s}{dim:12d}", end="")
        print(f"{1e3 * seconds:12.2f}{1e6 * seconds / walkers:13.2f}{grown:8.0f}", flush=True)


# a campaign


@dataclass
class Watched:
    """Seconds and peak memory, MiB, of each stage, and of the greatest worker."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    peaks: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    worker: float = 0.0
    stage: str = "tests"
    sweeps: int = 0

    def follow(self) -> None:
        """Measure memory at intervals, in a thread."""
        while True:
            began = time.perf_counter()
            self.peaks[self.stage] = max(self.peaks[self.stage], memory())
            if self.stage == "tests":
                ours = [p.pid for p in multiprocessing.active_children() if p.pid]
                self.worker = max([self.worker, *map(memory, ours)])
            time.sleep(WATCH)
            self.seconds[self.stage] += time.perf_counter() - began

    def observe(self, step: Step) -> None:
        """Take note of the stage."""
        if step.id in STAGES:
            self.stage = step.id
            if step.progress:
                self.sweeps = step.progress.steps


def lay_out(folder: Path, tests: int) -> Path:
    """Write a campaign of so many tests, in series that have a truth of their own."""
    entries, header = [], ""
    for number in range(-(-tests // (len(PRESSURES) * len(MATRIX.frequencies)))):
        write_campaign(folder / f"series_{number}", number, MATRIX)
        text = (folder / f"series_{number}" / "campaign.toml").read_text(encoding="utf-8")
        header, *found = text.split("[[test]]\n")
        for entry in found[:-1]:  # the last one is held out
            entry = entry.replace('id = "', f'id = "s{number}_')
            entries.append(entry.replace('file = "', f'file = "series_{number}/'))
    path = folder / "campaign.toml"
    header = header.replace('"ou"', '"ou"\nrate = "50 Hz"')
    path.write_text(header + "".join(f"[[test]]\n{entry}" for entry in entries[:tests]))
    return path


def study_campaign(case: tuple[int, Path], line) -> None:
    """Calibrate so many tests in a folder; send times, memory and sizes of the files."""
    tests, home = case
    watched = Watched()
    path = lay_out(home / "campaign", tests)
    threading.Thread(target=watched.follow, daemon=True).start()
    options = Options(effort="quick", seed=1, jobs=WORKERS)
    view = calibrate_campaign(path, home / "out", options, watched.observe)
    own = [t["seconds"] for t in read_json(home / "out" / MANIFEST)["tests"].values()]
    stored = sum(file.stat().st_size for file in (home / "out").rglob("*.nc"))
    pages = sum(file.stat().st_size for file in (home / "out").rglob("*.html"))
    written = stored / tests / 2**20, pages / 2**20
    line.send((watched, sum(own), written, [c.status for c in view.checks].count("fail")))


def campaign(tests: int) -> None:
    """Print time and memory of a campaign of so many tests."""
    with tempfile.TemporaryDirectory() as home:
        watched, own, written, failed = apart(study_campaign, (tests, Path(home)))
    ratio = watched.seconds["tests"] / (own / WORKERS)
    print(f"{tests:6d}{own / tests:9.1f}{ratio:9.3f}", end="")
    for stage in STAGES:
        print(f"{watched.seconds[stage]:9.0f}{watched.peaks[stage]:7.0f}", end="")
    print(f"{watched.sweeps:8d}{watched.worker:8.0f}", end="")
    print(f"{written[0]:10.2f}{written[1]:8.1f}{failed:7d}", flush=True)


def apart(study, case):
    """What a study in a process of its own sends."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=study, args=(case, theirs))
    process.start()
    theirs.close()
    try:
        return ours.recv()
    finally:
        process.join()


def main() -> None:
    parser = common.parser_of(__doc__ or "")
    parser.add_argument("--tests", type=int, nargs="+", help="campaigns of so many tests instead")
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    if not options.tests:
        density(options.quick)
        return
    print(" tests  s each    ratio" + "".join(f"{stage:>12s} MiB" for stage in STAGES), end="")
    print("  sweeps  worker  MiB/test    page failed")
    for tests in options.tests:
        campaign(tests)


if __name__ == "__main__":
    main()
