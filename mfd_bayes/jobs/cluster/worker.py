"""The worker's side of a cluster: it does a job and returns the files."""

from __future__ import annotations

import platform
import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from distributed import get_worker
from scipy import linalg  # noqa: F401  # loads scipy's BLAS, for `_limit_threads` to find it
from threadpoolctl import threadpool_info, threadpool_limits

from mfd_bayes.jobs.job import Job, State, Step
from mfd_bayes.store.files import write_bytes

_ENDED = (State.DONE, State.FAILED)
_SAME = ("mfd_bayes", "numpy", "scipy", "emcee", "distributed")


def work(
    job: Job, given: Mapping[str, bytes], expected: Mapping[str, str], topic: str
) -> dict[str, Any]:
    """Do a job in a temporary folder, and return the files that it made.

    Parameters
    ----------
    job : Job
    given : mapping of str to bytes
        Files that the job needs, by their paths in the run folder.
    expected : mapping of str to str
        Versions that this worker must have.
    topic : str
        Dask's name for the messages of progress.

    Returns
    -------
    dict
        "refused": why the job was not done, or ""; "status", "seconds", "error": as of an
        `Outcome`; "files": content by name; "steps": the last steps.
    """
    news = _News(get_worker(), topic)
    found = differences(expected)
    refused = other_versions(news.worker.address, found) if found else _limit_threads()
    if refused:
        return {"refused": refused}
    with tempfile.TemporaryDirectory(prefix="mfd_bayes-") as folder:
        out = Path(folder)
        for name, content in given.items():
            write_bytes(out / name, content)
        try:
            outcome = job.run(out, news.send)
        except _CancelledError:
            return {"refused": "cancelled"}
        made = [name for name in job.makes if (out / name).is_file()]
        return {
            "refused": "",
            "status": str(outcome.status),
            "seconds": outcome.seconds,
            "error": outcome.error,
            "files": {name: (out / name).read_bytes() for name in made},
            "steps": news.last,
        }


class _CancelledError(Exception):
    """The client has cancelled this job."""


@dataclass
class _News:
    """Messages of progress from one attempt at a job, and the last steps, which are not sent."""

    worker: Any
    topic: str
    last: list[list[Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.key = self.worker.get_current_task()
        self.attempt = uuid.uuid4().hex

    def send(self, step: Step) -> None:
        if step.stage in _ENDED:  # returned with the files, so that it comes after all messages
            self.last.append(_plain(step))
            return
        task = self.worker.state.tasks.get(self.key)
        if task is None or task.state == "cancelled":
            raise _CancelledError
        about = {"key": self.key, "attempt": self.attempt, "worker": self.worker.address}
        self.worker.log_event(self.topic, about | {"step": _plain(step)})


def versions() -> dict[str, str]:
    """Versions that must be the same on both sides for the draws to be the same."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python} | {name: version(name) for name in _SAME}


def differences(expected: Mapping[str, str]) -> str:
    """Versions of this process that are not the expected ones, in words; "" where all are."""
    found = versions()
    return ", ".join(
        f"{name} {found.get(name, 'of no version')} and not {wanted}"
        for name, wanted in expected.items()
        if found.get(name) != wanted
    )


def other_versions(worker: str, found: str) -> str:
    """Sentence that refuses a worker with other versions."""
    return f"the worker {worker} has {found} as here: install the same versions there"


def _limit_threads() -> str:
    """Let numpy use one thread in this process from now on; "", or why that is not possible.

    The number of threads changes the last bits of numpy's sums. It is not set back: other jobs may
    run in other threads of this process. It holds for the libraries that are loaded by now: numpy
    and scipy each have a BLAS, and both are loaded with this module.
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


def _plain(step: Step) -> list[Any]:
    """A step as plain values, which need not be unpickled."""
    figures = None
    if step.progress:
        *numbers, missing = astuple(step.progress)
        figures = [*map(float, numbers), missing]
    return [str(step.stage), step.message, figures]
