"""Long series of simulations: each is stored once finished, so that a second run goes on."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import mfd_bayes

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
