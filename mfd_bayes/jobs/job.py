"""A job for another process: what it must offer, and the news of its progress and end."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol


class JobState(StrEnum):
    """Whether a test, or another piece of work, is waiting or has ended, and how."""

    WAITING = "waiting"
    RESTARTED = "begins again:"
    """Its process was lost, and another one starts it anew."""
    DONE = "done"
    KEPT = "kept"
    """An earlier session of the run has done it."""
    FAILED = "failed"
    NOTE = "note:"
    """No work, but a sentence that the user must see."""
    HELD_OUT = "held out"
    """A test that is predicted and never fitted."""


@dataclass(frozen=True)
class Workplace:
    """Where jobs are done."""

    jobs: int = 0
    """Number of processes of this machine; 0 for one per processor that this process may use."""
    scheduler: str = ""
    """Address of a dask.distributed scheduler whose workers do the jobs, as "tcp://host:8786"."""

    @property
    def processes(self) -> int:
        """Number of processes of this machine, by default as many as `taskset` allows."""
        if self.jobs:
            return self.jobs
        affinity = getattr(os, "sched_getaffinity", None)
        return len(affinity(0)) if affinity else os.cpu_count() or 1


@dataclass(frozen=True)
class Progress:
    """Progress of a sampling: steps done, the limit, and the worst diagnostics so far.

    R̂ and effective sample size are both NaN where they have not been measured.
    """

    steps: int
    limit: int
    r_hat: float
    ess: float
    seconds: float
    share: float = math.nan
    """Estimated fraction of the needed steps that is done; NaN where it is unknown."""
    missing: str = ""
    """The targets that are not reached yet, in words; none where it ends."""

    @property
    def measured(self) -> bool:
        """Whether R̂ and effective sample size are known."""
        return not (math.isnan(self.r_hat) and math.isnan(self.ess))

    @property
    def rate(self) -> float:
        """Steps per second."""
        return max(self.steps, 1) / max(self.seconds, 1e-9)


@dataclass(frozen=True)
class Step:
    """News of a piece of work: that it waits, what it is at, or that it has ended."""

    id: str
    stage: str
    """A `JobState`; in between what the work is at, such as "sampling"."""
    progress: Progress | None = None
    message: str = ""


Observe = Callable[[Step], None]
"""What is called with every piece of news."""


@dataclass(frozen=True)
class Outcome:
    """How a piece of work ended: `State.DONE`, or `State.FAILED` with an error."""

    id: str
    status: JobState
    seconds: float
    error: str = ""
    value: Any = None
    """What it computed, where it stores no files."""


class Job(Protocol):
    """Work for another process; it is pickled and sent there."""

    @property
    def id(self) -> str:
        """Name of the test, or of the other work."""

    @property
    def makes(self) -> tuple[str, ...]:
        """Files that it stores, relative to the run folder."""

    def needs(self, folder: Path) -> tuple[str, ...]:
        """Files that it reads, relative to the run folder."""

    def run(self, folder: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Do the work and store its files in a run folder."""
