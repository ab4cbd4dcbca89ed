"""A piece of work that is done elsewhere: what it must offer, and the news of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True)
class Step:
    """News of a test: where its sampling stands, or that it began or ended.

    Attributes
    ----------
    id : str
    stage : str
        "waiting" before it begins, and at its end "done", "failed", or "kept" where an earlier
        session did it; what it is at in between.
    progress : Progress or None
    message : str
    """

    id: str
    stage: str
    progress: Progress | None = None
    message: str = ""


@dataclass(frozen=True)
class Outcome:
    """How a test's calibration ended: status "done", or "failed" with an error."""

    id: str
    status: str
    seconds: float
    error: str = ""


@dataclass(frozen=True)
class Progress:
    """Where a sampling stands: steps done, the limit, and the worst figures so far.

    `share` is that of the steps it will take, about; NaN where that is not known.
    """

    steps: int
    limit: int
    r_hat: float
    ess: float
    seconds: float
    share: float = math.nan


class Job(Protocol):
    """Work for a process, which must be small enough to send."""

    @property
    def id(self) -> str:
        """What it is called."""

    @property
    def makes(self) -> tuple[str, ...]:
        """Files of a run folder that it stores, by their names in it."""

    def needs(self, out: Path) -> tuple[str, ...]:
        """Files of a run folder that it reads, by their names in it."""

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Do it, and store what comes of it in a run folder."""
