"""Samples of a test as they come in, averaged over blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.population.given_part import block_size
from mfd_bayes.records.motion import HYSTERESIS
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ROWS = ("time", "displacement", "actuation", "force")


class Incoming:
    """The record so far: means over blocks of samples, and samples that wait for a block.

    Parameters
    ----------
    wanted : float, s
        Time between means, about.
    stroke : float, in
        Peak to peak of the motion as planned: smaller reversals than a share of it are noise.
    """

    def __init__(self, wanted: float, stroke: float) -> None:
        self._wanted, self._hysteresis = wanted, HYSTERESIS * stroke
        self._size = 0
        self._last = np.empty((len(ROWS), 0))
        self._waiting = np.empty((len(ROWS), 0))
        self._speeds = np.empty(0)
        self._means = np.empty((len(ROWS) + 1, 0))

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        rows = np.concatenate([self._last, self._waiting], axis=1)
        return float(rows[0, -1]) if rows.size else np.nan

    @property
    def count(self) -> int:
        """Number of means."""
        return int(self._means.shape[1])

    def take(
        self, time: ArrayLike, displacement: ArrayLike, actuation: ArrayLike, force: ArrayLike
    ) -> Index:
        """Numbers of the new means, after some more samples.

        Raises
        ------
        RecordError
            When shapes do not fit, a value is not finite, or time does not increase.
        """
        rows = _rows(time, displacement, actuation, force)
        times = np.concatenate([[self.time], rows[0]])
        if np.any(np.diff(times) <= 0):
            at = int(np.argmax(np.diff(times) <= 0))
            raise RecordError(
                f"time must increase; it does not at sample {at} of the update "
                f"(t = {rows[0, at]:g} s)"
            )
        self._waiting = np.concatenate([self._waiting, rows], axis=1)
        if not self._size:
            if self._waiting.shape[1] < 2:
                return np.empty(0, dtype=np.intp)
            own = float(np.median(np.diff(self._waiting[0])))
            self._size = block_size(own, self._wanted)
        return self._averaged()

    def _averaged(self) -> Index:
        """Means of the blocks that are complete; their numbers."""
        blocks = self._waiting.shape[1] // self._size
        if blocks == 0:
            return np.empty(0, dtype=np.intp)
        used = blocks * self._size
        around = np.concatenate([self._last, self._waiting], axis=1)
        speed = np.gradient(around[1], around[0])[self._last.shape[1] :][:used]
        rows = np.vstack([self._waiting[:, :used], speed])
        means = rows.reshape(len(rows), blocks, self._size).mean(axis=2)
        self._last, self._waiting = self._waiting[:, used - 1 : used], self._waiting[:, used:]
        first = self.count
        self._means = np.concatenate([self._means, means], axis=1)
        return np.arange(first, self.count)

    def trace(self) -> Trace:
        """The record so far."""
        return self._trace(self._means)

    def joined(self, after: Trace) -> tuple[Trace, Index]:
        """The record so far with a motion that follows it, and the numbers of all new samples.

        Samples that wait for a block come first among these; those of the motion are the last.
        """
        waiting = self._waiting
        speed = np.gradient(waiting[1], waiting[0]) if waiting.shape[1] > 1 else np.empty(0)
        rows = [self._means]
        if speed.size:
            rows.append(np.vstack([waiting, speed]))
        actuation = np.broadcast_to(np.asarray(after.actuation), after.time.shape)
        planned = np.where(np.isnan(actuation), self._means[2, -1], actuation)
        still = np.zeros(after.samples)
        rows.append(np.stack([after.time, after.displacement, planned, still, after.velocity]))
        together = np.concatenate(rows, axis=1)
        return self._trace(together), np.arange(self.count, together.shape[1])

    def _trace(self, rows: Array) -> Trace:
        time, displacement, actuation, force, velocity = rows
        level = actuation if np.ptp(actuation) > 0 else float(actuation[0])
        return Trace.from_arrays(
            time, displacement, level, force, velocity, hysteresis=self._hysteresis
        )


def _rows(
    time: ArrayLike, displacement: ArrayLike, actuation: ArrayLike, force: ArrayLike
) -> Array:
    """Samples that came in, (4, m), checked."""
    columns = [
        real_numbers(n, v)
        for n, v in zip(ROWS, (time, displacement, actuation, force), strict=True)
    ]
    size = columns[0].size
    for name, column in zip(ROWS, columns, strict=True):
        if column.shape != (size,) and not (name == "actuation" and column.ndim == 0):
            raise RecordError(
                f"{name} of an update must have shape ({size},) as time, got {column.shape}"
            )
        if not np.all(np.isfinite(column)):
            raise RecordError(f"{name} of an update must be finite")
        check_magnitude(name, column)
    if np.any(columns[2] < 0):
        raise RecordError("actuation of an update must not be negative")
    return np.stack([np.broadcast_to(column, (size,)) for column in columns])
