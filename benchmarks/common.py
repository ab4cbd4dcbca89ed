"""What the benchmarks share: the machine, the real records, long series, one thread, limits."""

from __future__ import annotations

import os

# Read when numpy and JAX are imported: a benchmark imports this module before them.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
os.environ.update(
    JAX_PLATFORMS="cpu",
    JAX_ENABLE_X64="1",
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import argparse
import csv
import hashlib
import json
import multiprocessing
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import mfd_bayes
from mfd_bayes.jobs.job import Step
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.population.inference import infer_population
from mfd_bayes.runs.run import Run, sequence_of
from tests.statistical.uniformity import LEVEL, Uniformity, failures

PROJECT = Path(__file__).parents[1]
SHORT = ("0.25Hz_0.5in", "0.25Hz_1.0in", "0.25Hz_1.5in", "ImperialValleyDBE")
FEW = {
    "36lb": [f"36lb_{name}" for name in SHORT],
    "2022-07": [f"{tension}lb_0.50Hz_1.0in" for tension in (20, 35, 80)],
}
"""Tests of sessions that a quick trial takes."""

HEADER = """\
[campaign]
title = "Banded rotary friction device, {session}"
priors = "brfd"
noise = "ou"
model = "{model}"

[columns]
time = {{ name = "time_s", unit = "s" }}
displacement = {{ name = "displacement_in", unit = "in" }}
force = {{ name = "force_kip", unit = "kip" }}

[laws]
Fc_fwd = "power"
Fc_bwd = "power"
Fs_fwd = "power"
Fs_bwd = "power"
"""
TEST = """
[[test]]
id = "{id}"
file = "{file}"
actuation = "{tension_lbf} lbf"
role = "{role}"
"""
SI = """\
columns = { time = { name = "time_s" }, displacement = { name = "displacement_m" }, \
force = { name = "force_N" } }
"""


def parser_of(
    docstring: str, *, data: bool = False, jobs: int = 0, output: str = ""
) -> argparse.ArgumentParser:
    """Command line with --quick and --seed, and what else a benchmark needs."""
    parser = argparse.ArgumentParser(description=docstring.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a trial that takes seconds")
    parser.add_argument("--seed", type=int, default=1)
    if data:
        words = "folder that holds brfd/ (MFD_BAYES_DATA, ../shared/data)"
        parser.add_argument("--data", type=Path, default=data_folder(), help=words)
    if jobs:
        parser.add_argument("--jobs", type=int, default=jobs)
    if output:
        words = "folder of what is finished: delete it when records or code have changed"
        parser.add_argument("--out", type=Path, default=PROJECT / output, help=words)
        parser.add_argument(
            "--effort", default="standard", help="of the calibrations; quick if --quick"
        )
    return parser


def begin(parser: argparse.ArgumentParser, *libraries: str) -> argparse.Namespace:
    """Read the command line; print the question, the command, and on what it is measured."""
    options = parser.parse_args()
    if options.quick and "effort" in options:
        options.effort = "quick"
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    processor = next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    module = Path(sys.argv[0]).with_suffix("").relative_to(PROJECT).as_posix().replace("/", ".")
    words = " ".join(["python -m", module, *sys.argv[1:]])
    versions = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", *libraries))
    print(f"{parser.description}\n\n{words}\n{processor}, {os.cpu_count()} cores, load ", end="")
    print(f"{os.getloadavg()[0]:.1f}; Python {platform.python_version()}, {versions}\n", flush=True)
    return options


def finish(failed: Sequence[str]) -> None:
    """Print what was missed, and exit with 1 where anything was."""
    print("\n" + ("\n".join(f"FAILED: {bar}" for bar in failed) or "all bars hold"))
    sys.exit(bool(failed))


def command(*words: object, may_fail: bool = False) -> str:
    """What a command of the package says, run in a process of its own; exits where it fails."""
    line = [sys.executable, "-m", "mfd_bayes", *map(str, words)]
    process = subprocess.run(line, capture_output=True, text=True, check=False)
    if process.returncode and not (may_fail and process.returncode == 1):
        sys.exit(f"{' '.join(line)}: {process.stdout}{process.stderr}")
    return process.stdout


def inside(draws: np.ndarray, truth: np.ndarray) -> list[float]:
    """Share of true values (…, T) inside the equal-tailed 50 and 95 % bands of draws (n, T)."""
    levels = [0.25, 0.75, 0.025, 0.975]
    low, high, lowest, highest = np.quantile(draws, levels, axis=0)
    return [
        float(np.mean((a <= truth) & (truth <= b))) for a, b in ((low, high), (lowest, highest))
    ]


def data_folder() -> Path:
    """Folder that holds brfd/: that of MFD_BAYES_DATA, or ../shared/data beside the project."""
    return Path(os.environ.get("MFD_BAYES_DATA", PROJECT.parent / "shared" / "data"))


def listed(source: Path) -> list[dict[str, str]]:
    """Lines of the list of the band brake's records, each with the `id` of its test."""
    with (source / "brfd" / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [{**row, "id": row["file"].removesuffix(".csv").split("_", 1)[1]} for row in rows]


def lay_out(
    source: Path,
    folder: Path,
    session: str,
    model: str = "three_stage",
    selection: Collection[str] = (),
) -> Path:
    """Copy the records of a session, or of one tension of 2023 ("36lb"), with a campaign file.

    Earthquakes are held out; `selection` are the ids of the tests that are wanted, all if empty.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = HEADER.format(session=session, model=model)
    for row in listed(source):
        of_2023 = session.endswith("lb") and row["session"] == "2023-04"
        if session not in (row["session"], f"{row['tension_lbf']}lb" if of_2023 else ""):
            continue
        if selection and row["id"] not in selection:
            continue
        shutil.copyfile(source / "brfd" / row["file"], folder / row["file"])
        role = "validate" if row["kind"] == "earthquake" else "calibrate"
        row["tension_lbf"] = row["tension_lbf"] or "30"  # of the semi-active tests, about
        text += TEST.format(**row, role=role) + (SI if row["id"].endswith("_SI") else "")
    campaign = folder / "campaign.toml"
    campaign.write_text(text, encoding="utf-8")
    return campaign


def calibrated(options: argparse.Namespace, session: str, model: str = "three_stage") -> Run:
    """Calibrated run of the records of a session, kept in --out; those of FEW if quick."""
    selection = FEW.get(session, ()) if options.quick else ()
    folder = options.out / f"{session}_{model}_{options.effort}"
    campaign_folder = options.out / f"campaign_{folder.name}"
    campaign = lay_out(options.data, campaign_folder, session, model, selection)
    request = RunOptions(
        effort=options.effort, seed=options.seed, jobs=options.jobs, resume=folder.exists()
    )

    def report(step: Step) -> None:
        print(step.id, step.stage, file=sys.stderr)

    return calibrate(plan_campaign(campaign, request), folder, report)


def without(run: Run, names: Collection[str], effort: str, seed: tuple[int, ...]) -> Run:
    """The run as if only some of its tests had been made."""
    settings, tests = run.manifest.settings, {name: run.tests[name] for name in names}
    inference = infer_population(tests, run.priors, settings.inference(effort, seed))
    reduced = replace(run, tests=tests, manifest=run.manifest.changed(peak_excess={}))
    reduced = reduced.with_population(inference.population)

    def pooled(name: str) -> dict[str, np.ndarray]:
        values = inference.values(list(tests).index(name))
        return {quantity: draws.reshape(-1) for quantity, draws in values.items()}

    vars(reduced)["_sequence"] = replace(sequence_of(reduced), pooled=pooled)
    return reduced


# --- ranks of true values among draws


def ranks_table(
    ranks: Mapping[str, Sequence[int]], draws: int, words: str, prefixes: tuple[str, ...] = ("",)
) -> dict[str, float]:
    """Print whether ranks are uniform, with those whose names begin with `prefixes`; which are not.

    By name: p-value, z of the mean rank, and the spread over that of uniform ranks.
    """
    tests = len(next(iter(ranks.values())))
    uniformity = Uniformity(tests, draws)
    failed = failures(ranks, uniformity)
    print(
        f"\n{words}: {'NOT uniform' if failed else 'uniform'}, {len(failed)} of {len(ranks)} "
        f"quantities fail\nfamilywise {LEVEL:.0%} over {len(ranks)} quantities by Bonferroni: "
        f"p below {LEVEL / len(ranks):.2g} fails\n{'':28}{'p':>10}{'z':>8}{'spread':>9}"
    )
    middle, sd = draws / 2.0, np.sqrt(((draws + 1) ** 2 - 1) / 12.0)
    for name in (name for name in ranks if name.startswith(prefixes)):
        p, values = uniformity.p_value(ranks[name]), np.array(ranks[name])
        z = (values.mean() - middle) / sd * np.sqrt(tests)
        word = "  FAILED" if name in failed else ""
        print(f"{name:28}{p:10.2g}{z:8.2f}{values.std() / sd:9.2f}{word}", flush=True)
    return failed


# --- long series of simulations: each is stored once finished, so that a second run goes on


def run_series(
    run: Callable[..., dict[str, Any]], tasks: list[tuple[Any, ...]], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Results of a function of all arguments; those that the same code has stored are read."""
    digest = hashlib.sha256()
    for folder in (Path(mfd_bayes.__file__).parent, PROJECT / "benchmarks", PROJECT / "tests"):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    folder = options.out / digest.hexdigest()[:12]
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{'_'.join(map(str, arguments))}.json" for arguments in tasks]
    pending = [(f, run, a) for f, a in zip(files, tasks, strict=True) if not f.is_file()]
    print(f"{len(tasks) - len(pending)} of {len(tasks)} found", file=sys.stderr)
    began = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for count, _ in enumerate(pool.imap_unordered(_run_and_store, pending), 1):
            minutes = (time.perf_counter() - began) / 60.0
            print(f"{count} of {len(pending)}, {minutes:.1f} min", file=sys.stderr)
    return [json.loads(file.read_text(encoding="utf-8")) for file in files]


def _run_and_store(task: tuple[Path, Callable[..., dict[str, Any]], tuple[Any, ...]]) -> None:
    path, run, arguments = task
    temporary = path.with_suffix(".part")
    temporary.write_text(json.dumps(run(*arguments)), encoding="utf-8")
    temporary.replace(path)
