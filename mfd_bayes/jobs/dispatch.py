"""Where the jobs of a run are done: in processes of this machine, or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from mfd_bayes.errors import FitError
from mfd_bayes.jobs.job import Job, Outcome, Step
from mfd_bayes.jobs.workers import run_in_processes


@dataclass(frozen=True)
class Workplace:
    """Where jobs are done."""

    jobs: int = 0
    """Number of processes of this machine; 0 for one per processor that this process may use."""
    scheduler: str = ""
    """Address of a dask.distributed scheduler whose workers do the jobs, as "tcp://host:8786"."""

    @property
    def processes(self) -> int:
        """Number of processes of this machine."""
        return self.jobs or processors()


def processors() -> int:
    """Number of processors that this process may use, as `taskset` or a job on a cluster sets."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_jobs(
    jobs: Sequence[Job], out: Path, workplace: Workplace, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which they end; the draws are the same on every machine.

    Raises
    ------
    MfdError
        When the result of a job cannot be written, or its processes or the cluster are lost.
    """
    if not workplace.scheduler:
        return run_in_processes(jobs, out, workplace.processes, observe)
    return _client().run_on_cluster(jobs, out, workplace.scheduler, observe)  # type: ignore[no-any-return]


def check_workers(workplace: Workplace) -> None:
    """Refuse a cluster that does not answer or has other versions, before anything is written.

    Raises
    ------
    FitError
    """
    if not workplace.scheduler:
        return
    if workplace.jobs:
        raise FitError("give either --jobs, for this machine, or --scheduler, for a cluster")
    _client().check_cluster(workplace.scheduler)


def _client() -> ModuleType:
    """Module that needs dask.distributed, an optional dependency."""
    try:
        from mfd_bayes.jobs.cluster import client
    except ModuleNotFoundError as error:
        raise FitError(
            f'--scheduler needs {error.name}: pip install "mfd_bayes[cluster]"'
        ) from error
    return client
