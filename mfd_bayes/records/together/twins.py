"""One measurement in two files: whole, cut out of the other, or sampled anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.records.motion import Array
from mfd_bayes.records.trace import Trace

BIN = 1.0 / 32.0
"""Signals are compared as means over bins of this length, s: the same at any sampling rate."""

LIKE = 0.97
"""Least correlation of two forces for a closer look."""

PLACES = 6
"""Most places, of those at which two forces are alike, that are looked at: cycles repeat."""

SAME = 0.025
"""Two forces are one measurement if they differ by less than this share of their sd."""

NEAR = 0.25
"""The same, before the lag is known to a small part of a bin."""

SHORTEST = 64
"""Fewest bins in which two records must overlap."""


@dataclass(frozen=True, eq=False)
class Twin:
    """How much of a record is also in another: `share` of its length, up to 1."""

    share: float
    lag: float  # s; by how much its time is behind the other's


@dataclass(frozen=True, eq=False)
class Signature:
    """Integrals of force and displacement over time, from which means over any bins follow."""

    time: Array
    force: Array
    displacement: Array

    @classmethod
    def of(cls, trace: Trace) -> Signature:
        """Signature of a trace with a force."""
        time = trace.time - trace.time[0]
        return cls(
            time, _integral(time, np.asarray(trace.force)), _integral(time, trace.displacement)
        )

    @property
    def bins(self) -> int:
        """Number of whole bins."""
        return int(self.time[-1] / BIN)

    def means(self, first: float, count: int) -> tuple[Array, Array]:
        """Mean force and displacement in `count` bins from the time `first`, s, on."""
        edges = first + BIN * np.arange(count + 1)
        parts = (np.interp(edges, self.time, values) for values in (self.force, self.displacement))
        force, displacement = (np.diff(part) / BIN for part in parts)
        return force, displacement


def find_twin(one: Signature, other: Signature) -> Twin | None:
    """Where a record is, in whole or in part, the same measurement as another; None if not."""
    if min(one.bins, other.bins) < SHORTEST:
        return None
    lags = [_refined(one, other, k * BIN, BIN / 4) for k in _coarse_lags(one, other)]
    lag = min(lags, key=lambda t: _misfit(one, other, t), default=None)
    if lag is None or _misfit(one, other, lag) > NEAR:
        return None
    for step in (BIN / 16, BIN / 64, BIN / 256):
        lag = _refined(one, other, lag, step)
    if _misfit(one, other, lag) > SAME:
        return None
    return Twin(min(1.0, _overlap(one, other, lag)[1] / one.bins), lag)


def _refined(one: Signature, other: Signature, lag: float, step: float) -> float:
    """The lag within two steps of a given one, s, at which two records differ least."""
    return min((lag + k * step for k in range(-2, 3)), key=lambda t: _misfit(one, other, t))


def _integral(time: Array, values: Array) -> Array:
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _coarse_lags(one: Signature, other: Signature) -> list[int]:
    """Bins by which `one` begins after `other`, where both look alike, the likest first."""
    alike = _correlation(one.means(0.0, one.bins)[0], other.means(0.0, other.bins)[0])
    peaks = (alike >= np.roll(alike, 1)) & (alike > np.roll(alike, -1)) & (alike >= LIKE)
    best = sorted(np.flatnonzero(peaks).tolist(), key=lambda k: -alike[k])[:PLACES]
    return [k if k < other.bins else k - alike.size for k in best]


def _correlation(a: Array, b: Array) -> Array:
    """Correlation of b, shifted by k bins, with a, over their overlap; -1 where that is short."""
    size = a.size + b.size
    spectra = {}
    for name, values in {"a": a, "aa": a**2, "1a": a**0, "b": b, "bb": b**2, "1b": b**0}.items():
        spectra[name] = np.fft.rfft(values, size)

    def product(of_b: str, of_a: str) -> Array:
        return np.fft.irfft(spectra[of_b] * np.conj(spectra[of_a]), size)

    count = product("1b", "1a")
    norm = np.sqrt(np.maximum(product("1b", "aa"), 0.0) * np.maximum(product("bb", "1a"), 0.0))
    enough = count > max(SHORTEST, 0.5 * min(a.size, b.size)) - 0.5
    safe = np.maximum(norm, 1e-9 * max(float(norm.max()), 1e-300))
    return np.where(enough, product("b", "a") / safe, -1.0)


def _overlap(one: Signature, other: Signature, lag: float) -> tuple[float, int]:
    """Begin of the overlap in the time of `one`, s, and its number of bins."""
    begin = max(0.0, -lag)
    end = min(one.time[-1], other.time[-1] - lag)
    return begin, max(int((end - begin) / BIN), 0)


def _misfit(one: Signature, other: Signature, lag: float) -> float:
    """Rms difference of force, and of displacement, over their sd, where both records are known."""
    begin, count = _overlap(one, other, lag)
    if count < SHORTEST:
        return np.inf
    pairs = zip(one.means(begin, count), other.means(begin + lag, count), strict=True)
    return max(float(np.std(a - b)) / max(float(np.std(a)), 1e-300) for a, b in pairs)
