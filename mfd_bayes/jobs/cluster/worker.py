"""A test on a worker of a cluster: what the worker is asked to do, and what it hands back."""

from __future__ import annotations

import platform
import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import astuple
from importlib.metadata import version
from pathlib import Path
from typing import Any

from distributed import get_worker
from threadpoolctl import threadpool_info, threadpool_limits

from mfd_bayes.jobs.job import Job, State, Step
from mfd_bayes.store.files import write_bytes

_ENDED = (State.DONE, State.FAILED)
_SAME = ("mfd_bayes", "numpy", "scipy", "emcee", "distributed")


def work(
    job: Job, given: Mapping[str, bytes], expected: Mapping[str, str], topic: str
) -> dict[str, Any]:
    """Do a test in a folder of its own, and hand back the files that it made.

    Parameters
    ----------
    job : Job
    given : mapping of str to bytes
        Files of the run folder that it needs, by their names in it.
    expected : mapping of str to str
        Versions that this worker must have.
    topic : str
        Under which it says where it stands.

    Returns
    -------
    dict
        "refused": why it was not done, or ""; "status", "seconds", "error": as of an `Outcome`;
        "files": content by name; "steps": the last that there is to say.
    """
    worker, last = get_worker(), []
    found = differences(expected)
    refused = other_versions(worker.address, found) if found else _limit_threads()
    if refused:
        return {"refused": refused}
    key = worker.get_current_task()
    about = {"key": key, "attempt": uuid.uuid4().hex, "worker": worker.address}

    def tell(step: Step) -> None:
        if step.stage in _ENDED:  # comes with the files, so that nothing overtakes it
            last.append(_sent(step))
            return
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise _UnwantedError
        worker.log_event(topic, about | {"step": _sent(step)})

    with tempfile.TemporaryDirectory(prefix="mfd_bayes-") as home:
        out = Path(home)
        for name, content in given.items():
            write_bytes(out / name, content)
        try:
            outcome = job.run(out, tell)
        except _UnwantedError:
            return {"refused": "cancelled"}
        made = [name for name in job.makes if (out / name).is_file()]
        return {
            "refused": "",
            "status": str(outcome.status),
            "seconds": outcome.seconds,
            "error": outcome.error,
            "files": {name: (out / name).read_bytes() for name in made},
            "steps": last,
        }


class _UnwantedError(Exception):
    """Nobody waits for this test any longer."""


def versions() -> dict[str, str]:
    """What must be the same on both sides for the draws to be the same."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python} | {name: version(name) for name in _SAME}


def differences(expected: Mapping[str, str]) -> str:
    """The versions in which this process differs, in words; "" where it does not."""
    found = versions()
    return ", ".join(
        f"{name} {found.get(name, 'of no version')} and not {wanted}"
        for name, wanted in expected.items()
        if found.get(name) != wanted
    )


def other_versions(worker: str, found: str) -> str:
    """Why a worker with differences is not used."""
    return f"the worker {worker} has {found} as here: install the same versions there"


def _limit_threads() -> str:
    """Let numpy use one thread in this process from now on; why it cannot be done, or "".

    How many there are reaches the last bits of its sums. They are not set back: other tests may be
    at work in other threads of the process.
    """
    threadpool_limits(limits=1)
    many = [pool for pool in threadpool_info() if pool["num_threads"] != 1]
    if not many:
        return ""
    names = ", ".join(sorted(pool["filepath"] for pool in many))
    return (
        f"the worker {get_worker().address} computes with several threads, and {names} cannot be "
        "told not to: start it with OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1"
    )


def _sent(step: Step) -> list[Any]:
    """A step as plain values, which need no unpickling."""
    figures = [float(figure) for figure in astuple(step.progress)] if step.progress else None
    return [str(step.stage), step.message, figures]
