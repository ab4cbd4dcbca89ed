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
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import mfd_bayes

PROJECT = Path(__file__).parents[1]

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
actuation = "{tension} lbf"
role = "{role}"
"""
SI = """\
columns = { time = { name = "time_s" }, displacement = { name = "displacement_m" }, \
force = { name = "force_N" } }
"""


def heading(question: str, *libraries: str) -> None:
    """Print the question, the command, and on what it was measured."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    processor = next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    module = Path(sys.argv[0]).with_suffix("").relative_to(PROJECT).as_posix().replace("/", ".")
    words = " ".join(["python -m", module, *sys.argv[1:]])
    found = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", *libraries))
    print(f"{question}\n\n{words}\n{processor}, {os.cpu_count()} cores, load ", end="")
    print(f"{os.getloadavg()[0]:.1f}; Python {platform.python_version()}, {found}\n", flush=True)


def finish(failed: Sequence[str]) -> None:
    """Print what was missed, and exit with 1 where anything was."""
    print("\n" + ("\n".join(f"FAILED: {bar}" for bar in failed) or "all bars hold"))
    sys.exit(bool(failed))


def parser_of(docstring: str, *, data: bool = False) -> argparse.ArgumentParser:
    """Command line with --quick and --seed, and --data where real records are needed."""
    parser = argparse.ArgumentParser(description=docstring.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a trial that takes seconds")
    parser.add_argument("--seed", type=int, default=1)
    if data:
        words = "folder that holds brfd/ (MFD_BAYES_DATA, ../shared/data)"
        parser.add_argument("--data", type=Path, default=data_folder(), help=words)
    return parser


def data_folder() -> Path:
    """Folder that holds brfd/: that of MFD_BAYES_DATA, or ../shared/data beside the project."""
    return Path(os.environ.get("MFD_BAYES_DATA", PROJECT.parent / "shared" / "data"))


def lay_out(
    source: Path, folder: Path, session: str, model: str = "three_stage", **options: Any
) -> Path:
    """Copy the records of a session, or of one tension of 2023 ("36lb"), with a campaign file.

    Earthquakes are held out; `role` is what else is, a function of a line of the records' list.
    """
    role = options.get("role", lambda row: row["kind"] == "earthquake")
    folder.mkdir(parents=True, exist_ok=True)
    with (source / "brfd" / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    text = HEADER.format(session=session, model=model)
    for row in rows:
        of_2023 = session.endswith("lb") and row["session"] == "2023-04"
        if session not in (row["session"], f"{row['tension_lbf']}lb" if of_2023 else ""):
            continue
        file_name = row["file"]
        shutil.copyfile(source / "brfd" / file_name, folder / file_name)
        found = {"id": file_name.removesuffix(".csv").split("_", 1)[1], "file": file_name}
        found |= {"tension": row["tension_lbf"], "role": "validate" if role(row) else "calibrate"}
        text += TEST.format(**found) + (SI if file_name.endswith("_SI.csv") else "")
    campaign = folder / "campaign.toml"
    campaign.write_text(text, encoding="utf-8")
    return campaign


def ranks_table(
    ranks: Mapping[str, Sequence[int]], draws: int, failed: Mapping[str, float]
) -> None:
    """Print p-value, z of the mean rank and spread over that of uniform ranks, by quantity."""
    from tests.statistical.uniformity import Uniformity

    print(f"{'':28}{'p':>10}{'z':>8}{'spread':>9}")
    for name, values in ranks.items():
        middle, sd = draws / 2.0, np.sqrt(((draws + 1) ** 2 - 1) / 12.0)
        p = Uniformity(len(values), draws).p_value(values)
        z = (np.mean(values) - middle) / sd * np.sqrt(len(values))
        word = "  FAILED" if name in failed else ""
        print(f"{name:28}{p:10.2g}{z:8.2f}{np.std(values) / sd:9.2f}{word}")


# --- long series of simulations: each is stored once finished, so that a second run goes on


Task = tuple[Path, Callable[..., dict[str, Any]], tuple[Any, ...]]
"""File of the result, and the function and the arguments that it comes from."""


def fingerprint(settings: object, motion: bytes, study: str, rooms: Iterable[str]) -> str:
    """Short hash of the settings and of the code: the study's file and some rooms' files."""
    digest = hashlib.sha256(repr(settings).encode())
    digest.update(motion)
    package = Path(mfd_bayes.__file__).parent
    code = (path for room in rooms for path in sorted((package / room).glob("*.py")))
    for path in (Path(study), *code):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def run_series(tasks: list[Task], jobs: int, name: str) -> list[dict[str, Any]]:
    """Results of all tasks; those that an earlier run has stored are read."""
    left = [task for task in tasks if not task[0].is_file()]
    print(f"{len(tasks) - len(left)} of {len(tasks)} {name} found", file=sys.stderr)
    began = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for done, _ in enumerate(pool.imap_unordered(_run_and_store, left), 1):
            minutes = (time.perf_counter() - began) / 60.0
            print(f"{name}: {done} of {len(left)}, {minutes:.1f} min", file=sys.stderr)
    return [json.loads(path.read_text(encoding="utf-8")) for path, _, _ in tasks]


def _run_and_store(task: Task) -> None:
    path, run, arguments = task
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(run(*arguments)), encoding="utf-8")
    beside.replace(path)
