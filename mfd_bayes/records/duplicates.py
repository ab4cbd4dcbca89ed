"""One measurement in two files: whole, cut out of the other, or sampled anew."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.records.motion import Array
from mfd_bayes.records.trace import Trace

BIN = 1.0 / 32.0  # s; signals are compared as means over bins: the same at any sampling rate
SHORTEST, LONGEST = 64, 1 << 20  # fewest bins that must overlap, and most, nine hours, of a record
CORRELATION = 0.97  # least of two forces for a closer look
LARGER = 1.1  # most by which the rms of one force may exceed the other's
PLACES = 6  # most places, of those at which two forces are alike, that are looked at: cycles repeat
SAME, NEAR = 0.025, 0.25  # most difference of one measurement, in sds; before its lag is refined
NOISE = 1.2
"""Two forces are one measurement if they typically differ by less than so many sds of their noise:
tests that were repeated differ by 1.4 of them, and by what friction scatters."""
QUIET = 1e-3  # least noise that is expected of a force, as a share of its sd


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
        means = (0.5 * (v[1:] + v[:-1]) for v in (np.asarray(trace.force), trace.displacement))
        sums = (np.cumsum(mean * np.diff(time)) for mean in means)
        return cls(time, *(np.concatenate([[0.0], total]) for total in sums))

    @property
    def bins(self) -> int:
        """Number of whole bins."""
        return int(self.time[-1] / BIN)

    @cached_property
    def forces(self) -> Array:
        """Mean force in every whole bin, (bins,)."""
        return np.asarray(self.means(np.zeros(1), self.bins)[0][0])

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """Sums of the mean force, and of its square, over the bins before each, (bins + 1,)."""
        once, twice = (np.cumsum(values) for values in (self.forces, self.forces**2))
        return np.concatenate([[0.0], once]), np.concatenate([[0.0], twice])

    @cached_property
    def spectra(self) -> dict[int, NDArray[np.complex128]]:
        """Fourier transforms of the mean forces, by the length that they were padded to."""
        return {}

    def spectrum(self, size: int) -> NDArray[np.complex128]:
        """Fourier transform of the mean forces, padded to a length."""
        if size not in self.spectra:
            self.spectra[size] = np.fft.rfft(self.forces, size)
        return self.spectra[size]

    def means(self, first: Array, count: int) -> tuple[Array, Array]:
        """Mean force and displacement in `count` bins from each time `first` (n,), s, on."""
        edges = first[:, None] + BIN * np.arange(count + 1)
        parts = (np.interp(edges, self.time, values) for values in (self.force, self.displacement))
        force, displacement = (np.diff(part) / BIN for part in parts)
        return force, displacement


def find_twin(own: Signature, other: Signature) -> Twin | None:
    """Where a record is, in whole or in part, the same measurement as another; None if not."""
    if min(own.bins, other.bins) < SHORTEST or max(own.bins, other.bins) > LONGEST:
        return None
    near = [_refined(own, other, k * BIN, BIN / 4) for k in _coarse_lags(own, other)]
    lag, misfit = min(near, key=lambda pair: pair[1], default=(0.0, np.inf))
    if misfit > NEAR:
        return None
    for step in (BIN / 16, BIN / 64, BIN / 256):
        lag, misfit = _refined(own, other, lag, step)
    if misfit > SAME or not _of_same_noise(own, other, lag):
        return None
    return Twin(min(1.0, _overlap(own, other, np.array([lag]))[1] / own.bins), lag)


def _coarse_lags(own: Signature, other: Signature) -> list[int]:
    """Bins by which `one` begins after `other`, where both look alike, the likest first."""
    shifts = np.arange(1 - own.bins, other.bins)
    size = 1 << (own.bins + other.bins - 1).bit_length()
    products = np.fft.irfft(other.spectrum(size) * np.conj(own.spectrum(size)), size)[shifts]
    begin, end = np.maximum(0, -shifts), np.minimum(own.bins, other.bins - shifts)
    energies = [
        whole.sums[1][end + by] - whole.sums[1][begin + by]
        for whole, by in ((own, 0), (other, shifts))
    ]
    enough = end - begin > max(SHORTEST, 0.5 * min(own.bins, other.bins)) - 0.5
    norm = np.sqrt(np.maximum(energies[0] * energies[1], 0.0))
    safe = np.maximum(norm, 1e-9 * max(float(norm.max()), 1e-300))
    alike = np.where(enough, products / safe, -1.0)  # correlation of the forces in the overlap
    least, most = np.minimum(*energies), np.maximum(*energies)
    larger = np.sqrt(most / np.maximum(least, 1e-9 * max(float(most.max()), 1e-300)))
    padded = np.concatenate([[-1.0], alike, [-1.0]])
    peaks = (alike >= padded[:-2]) & (alike > padded[2:]) & (alike >= CORRELATION)
    best = sorted(np.flatnonzero(peaks).tolist(), key=lambda k: -alike[k])[:PLACES]
    return [int(shifts[k]) for k in best if larger[k] < LARGER]


def _refined(own: Signature, other: Signature, lag: float, step: float) -> tuple[float, float]:
    """The lag within two steps of a given one, s, at which two records differ least, and by what.

    By the rms difference of force, or of displacement if greater, over its sd.
    """
    lags = lag + step * np.arange(-2.0, 3.0)
    begin, count = _overlap(own, other, lags)
    if count < SHORTEST:
        return lag, np.inf
    pairs = zip(own.means(np.array([begin]), count), other.means(begin + lags, count), strict=True)
    misfits = [np.std(a - b, axis=1) / max(float(np.std(a)), 1e-300) for a, b in pairs]
    worst = np.maximum(*misfits)
    best = int(np.argmin(worst))
    return float(lags[best]), float(worst[best])


def _of_same_noise(own: Signature, other: Signature, lag: float) -> bool:
    """Whether two forces that are alike differ by less than independent noise would make them.

    The noise is read off the smallest third differences, which the loop's corners leave alone.
    """
    begin, count = _overlap(own, other, np.array([lag]))
    first, second = own.means(np.array([begin]), count), other.means(np.array([begin + lag]), count)
    forces = first[0][0], second[0][0]
    noise = max(_sd_of_small(np.diff(force, 3)) / np.sqrt(20.0) for force in forces)
    away = forces[0] - forces[1]
    typical = _sd_of_small(away - np.median(away), 0.5)
    return typical < NOISE * max(float(noise), QUIET * float(np.std(forces[0])))


def _sd_of_small(values: Array, share: float = 0.25) -> float:
    """Standard deviation of normal values of which a share is as small as that of these."""
    return float(np.quantile(np.abs(values), share) / special.ndtri(0.5 + 0.5 * share))


def _overlap(own: Signature, other: Signature, lags: Array) -> tuple[float, int]:
    """Begin of what is in both with each of the lags, in the time of `one`, s, and its bins."""
    begin = max(0.0, -float(lags.min()))
    end = min(own.time[-1], other.time[-1] - float(lags.max()))
    return begin, max(int((end - begin) / BIN), 0)
