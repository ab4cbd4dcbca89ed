"""Where the tests of a run are worked on: in processes of this machine, or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from types import ModuleType

from mfd_bayes.errors import FitError
from mfd_bayes.plan import Options
from mfd_bayes.task import Outcome, Step
from mfd_bayes.jobs.workers import Job, run_tasks


def run_jobs(
    jobs: Sequence[Job], out: Path, options: Options, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of tests as they come; which machine does them does not reach the draws.

    Raises
    ------
    MfdError
        When what comes of a test cannot be written, or its processes or the cluster are lost.
    """
    if not options.scheduler:
        return run_tasks(jobs, out, options.processes, observe)
    return _crew().run_on_cluster(jobs, out, options.scheduler, observe)  # type: ignore[no-any-return]


def check_workers(options: Options) -> None:
    """Refuse a cluster that is not there or not the same, before anything is written.

    Raises
    ------
    FitError
    """
    if not options.scheduler:
        return
    if options.jobs:
        raise FitError("give either --jobs, for this machine, or --scheduler, for a cluster")
    _crew().check_cluster(options.scheduler)


def _crew() -> ModuleType:
    """The module that needs dask.distributed, which not everybody has."""
    try:
        from mfd_bayes.jobs.cluster import crew
    except ModuleNotFoundError as error:
        raise FitError(
            f'--scheduler needs {error.name}: pip install "mfd_bayes[cluster]"'
        ) from error
    return crew
