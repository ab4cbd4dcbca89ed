"""A fault of a record, and runs of samples."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Trace

Samples = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of a record that would spoil its fit.

    `samples`, (K,), are those at which it was found; empty for the whole record.
    """

    name: str  # one of `NAMES`
    sentence: str  # the finding, with figures and units, and its possible cause
    samples: Samples = field(default_factory=lambda: np.empty(0, dtype=np.intp))


def rate_of(trace: Trace) -> float:
    """Samples per second, Hz."""
    return (trace.samples - 1) / float(trace.time[-1] - trace.time[0])


def runs(flags: NDArray[np.bool_]) -> tuple[Samples, Samples]:
    """Sample before each run of flags, and the length of the run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return (edges[::2] - 1).astype(np.intp), (edges[1::2] - edges[::2]).astype(np.intp)


def spread(starts: Samples, lengths: Samples) -> Samples:
    """All samples of runs, with the one before each."""
    pieces = [np.arange(a, a + n + 1) for a, n in zip(starts, lengths, strict=True)]
    return np.concatenate(pieces or [np.empty(0)]).astype(np.intp)


def count(number: int, thing: str) -> str:
    """Number and noun: "3 steps"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
