"""Samples of a test as they come in: averaged over blocks, and without the sensor's reversals."""

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

AHEAD = 2
"""Samples at rest before the first, so that any record has three."""


class Incoming:
    """The record so far: means over blocks of samples, and samples that wait for a block.

    The displacement follows the measured one as if through a small play, so that reversals within
    it are none. All means before the first motion are one, with the mean force: a device at rest.

    Parameters
    ----------
    wanted : float, s
        Time between means, about; an attribute too.
    stroke : float, in
        Peak to peak of the motion as planned: reversals below a share of it are noise.
    """

    def __init__(self, wanted: float, stroke: float) -> None:
        self.wanted, self._play = wanted, 0.5 * HYSTERESIS * stroke
        self._size = self._resting = 0
        self._first_time = self._last_time = np.nan
        self._waiting = np.empty((len(ROWS), 0))
        self._means = np.empty((len(ROWS), 0))

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return self._last_time

    @property
    def window(self) -> tuple[float, float]:
        """Times of the first and the last sample, s."""
        return self._first_time, self._last_time

    @property
    def count(self) -> int:
        """Number of means, with those ahead."""
        return int(self._means.shape[1])

    @property
    def direction(self) -> int:
        """+1 or -1, that of the first motion; 0 while the device is at rest."""
        return _direction(self._means[1])

    def take(
        self, time: ArrayLike, displacement: ArrayLike, actuation: ArrayLike, force: ArrayLike
    ) -> Index:
        """Numbers of the new means, after some more samples; that at rest counts as new once more.

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
        if np.isnan(self._last_time) and rows.size:
            self._first_time = float(rows[0, 0])
        self._last_time = float(times[-1])
        self._waiting = np.concatenate([self._waiting, rows], axis=1)
        if not self._size and self._waiting.shape[1] > 1:
            own = float(np.median(np.diff(self._waiting[0])))
            self._size = block_size(own, self.wanted)
        blocks = self._waiting.shape[1] // self._size if self._size else 0
        if blocks == 0:
            return np.empty(0, dtype=np.intp)
        used = blocks * self._size
        means = self._waiting[:, :used].reshape(len(ROWS), blocks, self._size).mean(axis=2)
        self._waiting = self._waiting[:, used:]
        return self._added(means)

    def _added(self, means: Array) -> Index:
        """Numbers of means that are added, of which those at rest are joined."""
        first = self.count if self.count else AHEAD
        if not self.count:
            ahead = np.repeat(means[:, :1], AHEAD, axis=1)
            ahead[0] += self.wanted * np.arange(-AHEAD, 0)
            self._means = ahead
        means[1] = self._followed(means[1])
        resting = 0 if self.direction else int(np.argmax([*(means[1] != self._means[1, -1]), True]))
        if resting:
            first = AHEAD
            self._join_rest(means[:, :resting])
        self._means = np.concatenate([self._means, means[:, resting:]], axis=1)
        return np.arange(first, self.count)

    def _join_rest(self, means: Array) -> None:
        """Join means at rest to the one that there is."""
        known, new = self._resting, means.shape[1]
        rest = means[:, -1:].copy()
        before = self._means[3, AHEAD] if known else 0.0
        rest[3] = (known * before + means[3].sum()) / (known + new)
        self._resting = known + new
        self._means = np.concatenate([self._means[:, :AHEAD], rest], axis=1)

    def _followed(self, displacement: Array) -> Array:
        """Displacement without reversals within the play, (m,), in."""
        here = float(self._means[1, -1])
        found = np.empty(displacement.size)
        for i, x in enumerate(displacement.tolist()):
            here = min(max(here, x - self._play), x + self._play)
            found[i] = here
        return found

    def trace(self) -> Trace:
        """The record so far."""
        return _trace(self._means)

    def joined(self, after: Trace) -> tuple[Trace, Index]:
        """The record so far with a motion that follows it, and the numbers of all new samples.

        Samples that wait for a block come first among these; those of the motion are the last.
        """
        actuation = np.broadcast_to(np.asarray(after.actuation), after.time.shape)
        planned = np.where(np.isnan(actuation), self._means[2, -1], actuation)
        nothing = np.zeros(after.samples)
        future = np.stack([after.time, after.displacement, planned, nothing])
        new = np.concatenate([self._waiting, future], axis=1)
        new[1] = self._followed(new[1])
        together = np.concatenate([self._means, new], axis=1)
        return _trace(together), np.arange(self.count, together.shape[1])


def _direction(displacement: Array) -> int:
    """+1 or -1, that of the first motion; 0 without one."""
    moved = np.flatnonzero(np.diff(displacement))
    if not moved.size:
        return 0
    return 1 if displacement[moved[0] + 1] > displacement[moved[0]] else -1


def _trace(rows: Array) -> Trace:
    time, displacement, actuation, force = rows
    level = actuation if np.ptp(actuation) > 0 else float(actuation[0])
    # backward difference of second order: samples that are still to come do not change it, and it
    # is not half a step late, which made slip forces a standard deviation too small
    step = np.diff(time, prepend=time[0] - 1.0)
    speed = np.diff(displacement, prepend=displacement[0]) / step
    speed[1:] += np.diff(speed) * step[1:] / (step[1:] + step[:-1])
    return Trace.from_arrays(time, displacement, level, force, speed, hysteresis=0.0)


def _rows(
    time: ArrayLike, displacement: ArrayLike, actuation: ArrayLike, force: ArrayLike
) -> Array:
    """Samples that came in, (4, m), checked."""
    given = time, displacement, actuation, force
    columns = [real_numbers(name, column) for name, column in zip(ROWS, given, strict=True)]
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
