"""Tests compared with each other: duplicates, clocks, signs, and laws of what a loop shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import ClassVar

import numpy as np
from scipy import special

from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import (
    LoopFeatures,
    asymmetry,
    channels_swapped,
    find_loops,
    loop_estimate,
)
from mfd_bayes.records.motion import Array
from mfd_bayes.records.record import Record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor, factor

STEADY = 3  # fewest loops at full stroke of a record that is compared
OTHERS, OTHERS_OF_NEGATIVE = 3, 2
"""Fewest other tests that all begin in the same direction for one that does not to be named, and
for saying which of two signs is swapped in one whose force does negative work."""
ENERGY = 0.2  # energies of a record and of a part of it differ by less than this share
WHOLE = 0.98  # a twin of at least this share of a record is the whole record
FAR_LEVEL, ALIKE = 4.0, 1.6
"""An actuation of more than `FAR_LEVEL` times the nearest one changes the slip force by `ALIKE`."""
UNLIKE, SPEED = 1.6, 3.0
"""Slip forces at like actuation, and at speeds within `SPEED`, differ by less than `UNLIKE`."""


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others."""

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    signature: Signature
    features: LoopFeatures | None  # None where the record has too few loops at full stroke
    asymmetry: Array  # (P,), kip; difference of the two directions along a stroke
    direction: int  # first direction of the motion, +1 or -1
    work: float  # kip*in, of the loops; negative where one sign is swapped
    level: float  # actuation, kip or ksi; NaN where it is not known
    actuation: str  # as the campaign gives it, "" for a column
    units: dict[str, str]  # of displacement and of force, in which the record was read
    step: float  # s; median step of time
    cycle: float  # s; median time of a full loop, 0 where there is none
    speed: float  # in/s; exceeded in a tenth of the samples
    swapped: bool  # whether displacement and force seem to be each other

    @classmethod
    def of(cls, name: str, record: Record, trace: Trace, actuation: str = "") -> Tested:
        """A test of its record, whose trace has every sample and a force."""
        trace = without_spikes(trace)
        loops = find_loops(trace)
        steady = bool(np.count_nonzero(loops.strong) >= STEADY)
        energy = np.empty(0) if loops.energy is None else loops.energy
        return cls(
            id=name,
            signature=Signature.of(trace),
            features=loop_estimate(trace) if steady else None,
            asymmetry=asymmetry(trace) if steady else np.full(1, np.nan),
            direction=trace.direction,
            work=float(energy.sum()),
            level=trace.reference_actuation,
            actuation=actuation,
            units={role: record.columns[role][1] for role in ("displacement", "force")},
            step=float(np.median(np.diff(trace.time))),
            cycle=float(np.median(loops.period)) if loops.period.size else 0.0,
            speed=float(np.quantile(np.abs(trace.velocity), 0.9)),
            swapped=channels_swapped(trace),
        )

    @property
    def plateau(self) -> float:
        """Slip force, kip; NaN where it cannot be read."""
        return self.features.plateau if self.features else float("nan")

    def same_level(self, other: Tested) -> bool:
        """Whether both have the same actuation, about."""
        return bool(abs(np.log(self.level / other.level)) < SAME_LEVEL)


def compare_tests(tests: Sequence[Tested]) -> list[tuple[str, Fault]]:
    """Faults by test: duplicates, then clocks, signs, units, actuations and other devices."""
    return [*_twins(tests), *_clocks(tests), *_signs(tests), *_odd(tests)]


def _clocks(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose steps of time and cycles are those of another one, but in ms."""
    for test in tests:
        for other in tests:
            if not 0.0 < other.cycle < test.cycle:
                continue
            steps, cycles = test.step / other.step, test.cycle / other.cycle
            if abs(steps - 1000.0) < 1.0 and 0.5 < cycles / 1000.0 < 2.0:
                fault = Fault.of(
                    "time unit",
                    f"its steps of {test.step:.3g} s and its cycles of {test.cycle:.4g} s are a "
                    "thousand times those of {other}: is time in ms rather than in s?",
                    other=other.id,
                )
                yield test.id, fault
                break


def _twins(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests that are the same measurement as one before."""
    twins = set()
    for other, test in combinations(tests, 2):
        if test.id in twins:
            continue
        if test.features is not None and other.features is not None:
            # Energies are about the same, but for the sign where one sign is swapped.
            energies = abs(test.features.energy), abs(other.features.energy)
            if not min(energies) > (1.0 - ENERGY) * max(energies):
                continue
        share = twin_share(test.signature, other.signature)
        if share is None:
            continue
        twins.add(test.id)
        share *= test.signature.bins / max(test.signature.bins, other.signature.bins)
        what = "same record as {other}"
        if share < WHOLE:
            what = f"the same measurement as {{other}} in {share:.0%} of the longer record"
        yield test.id, Fault.of("duplicate", f"{what}: it would count twice", other=other.id)


def _signs(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose signs are not those of the others: which of two, or both."""
    steady = [t for t in tests if t.features is not None and not t.swapped]
    for test in steady:
        others = [t for t in steady if t is not test]
        directions = {t.direction for t in others}
        fewest = OTHERS_OF_NEGATIVE if test.work < 0.0 else OTHERS
        if len(others) < fewest or len(directions) > 1:
            continue
        begins = "its motion begins in the direction opposite to that of all other tests"
        if test.work < 0.0:
            which = f"displacement: {begins}"
            if test.direction in directions:
                which = "force: its motion begins as those of the other tests"
            swapped = f"the swapped sign is probably that of the {which}"
            yield test.id, Fault.of("force sign", swapped)
        elif test.direction not in directions:
            alike = [np.corrcoef(test.asymmetry, t.asymmetry)[0, 1] for t in others]
            alike = [value for value in alike if np.isfinite(value)]
            if alike and float(np.median(alike)) < 0.0:  # the directions are exchanged
                both = (
                    f"{begins}, and its two directions of motion seem exchanged: the signs of "
                    "force and displacement are probably both swapped"
                )
                yield test.id, Fault.of("both signs", both)


def _odd(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose gap, build-up or slip force is not that of the others."""
    steady = [t for t in tests if t.features is not None and t.work > 0.0]
    values = [[getattr(t.features, name) for name in QUANTITIES] for t in steady]
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(np.array(values, dtype=np.float64).reshape(-1, len(QUANTITIES)))
    logs[~np.isfinite(logs)] = np.nan
    odd = find_odd(logs, np.array([t.level for t in steady]))
    rest = [t for i, t in enumerate(steady) if i not in odd]
    for j, deviation in odd.items():
        test, cause = steady[j], likely_cause(deviation, steady[j].units)
        if cause.name == "actuation":
            why = _of_actuation(test, cause, rest)
        elif cause.name == "another device":
            why = (
                "neither a unit nor the actuation explains it; is it the record of another "
                "device, or of another session?"
            )
        elif cause.read_in:
            why = f"its {cause.role} seems to be in {cause.unit}, not in {cause.read_in}"
        else:
            size = max(cause.factor, 1.0 / cause.factor)
            way = "large" if cause.factor > 1.0 else "small"
            why = (
                f"its {cause.name} seems to be {size:.2g} times too {way}: check its unit and the "
                "sensor's factor"
            )
        k = int(np.nanargmax(np.abs(deviation.values) / deviation.sds))
        name, unit = list(QUANTITIES.items())[k]
        value = float(getattr(test.features, name))
        yield (
            test.id,
            Fault.of(
                cause.name,
                f"its loop has a {_WORDS[name]} of {{value}}, where the other tests suggest "
                "{expected}: {why}",
                value=(value, unit),
                expected=(value / float(np.exp(deviation.values[k])), unit),
                why=why,
            ),
        )
    far = dict(_far_levels(rest))
    yield from far.items()
    yield from _unlike([t for t in rest if t.id not in far])


def _far_levels(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose actuation is far from that of all others, but whose slip force is not."""
    loaded = [t for t in tests if t.level > 0.0 and t.plateau > 0.0]
    for test in loaded:
        others = [t for t in loaded if t is not test]
        if len(others) < 2:
            continue
        away = np.log([test.level / t.level for t in others])
        force = np.log([test.plateau / t.plateau for t in others])
        near, like = int(np.argmin(np.abs(away))), int(np.argmin(np.abs(force)))
        spread = np.ptp([np.log(t.level) for t in others])
        if abs(away[near]) > max(np.log(FAR_LEVEL), spread) and abs(force[near]) < np.log(ALIKE):
            cause = Cause("actuation", factor=test.level / others[like].level)
            fault = Fault.of(
                "actuation",
                f"its actuation is {np.exp(abs(away[near])):.3g} times "
                f"{'that' if away[near] > 0 else 'less than that'} of the nearest test, {{near}}, "
                "but its slip force, {slip}, is about the same: {why}",
                near=others[near].id,
                slip=(test.plateau, "kip"),
                why=_of_actuation(test, cause, others),
            )
            yield test.id, fault


def _unlike(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose slip force is not that of their neighbours in actuation."""
    loaded = [t for t in tests if t.level > 0.0 and t.plateau > 0.0]
    away = {test.id: _from_neighbours(test, loaded) for test in loaded}
    for test in loaded:
        log_ratio, names = away[test.id]
        if abs(log_ratio) < np.log(UNLIKE):
            continue
        name = "force"
        why = (
            "its load cell or its actuation is probably wrong, or the file is that of another test"
        )
        same = [t for t in loaded if t is not test and t.same_level(test)]
        if len(same) == 1 and abs(away[same[0].id][0]) >= np.log(UNLIKE):  # which of the two is it?
            others = [t for t in loaded if not t.same_level(test)]
            own, its = (
                abs(_from_neighbours(t, [t, *others], ends=True)[0]) for t in (test, same[0])
            )
            if own < its:
                continue
            if own == its:
                name, why = "slip force", f"one of the two is wrong; {why}"
        fault = Fault.of(
            name,
            f"its slip force, {{slip}}, is {np.exp(log_ratio):.2g} times the one of about "
            "{expected} of its neighbours in actuation ({names}): {why}",
            slip=(test.plateau, "kip"),
            expected=(test.plateau / float(np.exp(log_ratio)), "kip"),
            names=", ".join(names),
            why=why,
        )
        yield test.id, fault


def _from_neighbours(
    test: Tested, tests: Sequence[Tested], *, ends: bool = False
) -> tuple[float, list[str]]:
    """Logarithm of the slip force over that of tests at like actuation and speed, and their names.

    Without a test at the same actuation, it is interpolated between the levels below and above;
    0 where it cannot be. With `ends`, beyond the other levels the slip force follows the root of
    the actuation.
    """
    others = [
        t for t in tests if t is not test and not abs(np.log(t.speed / test.speed)) > np.log(SPEED)
    ]
    near = [t for t in others if t.same_level(test)]
    if near:
        expected = float(np.median([np.log(t.plateau) for t in near]))
        return np.log(test.plateau) - expected, [t.id for t in near]
    below = max((t.level for t in others if t.level < test.level), default=None)
    above = min((t.level for t in others if t.level > test.level), default=None)
    levels = [level for level in (below, above) if level is not None]
    if len(levels) < 2 and not (ends and levels):
        return 0.0, []
    near = [t for t in others if t.level in levels]
    forces = [np.median([np.log(t.plateau) for t in near if t.level == at]) for at in levels]
    expected = float(np.interp(np.log(test.level), np.log(levels), forces))
    if len(levels) < 2:
        expected += 0.5 * float(np.log(test.level / levels[0]))
    return np.log(test.plateau) - expected, [t.id for t in near]


def _of_actuation(test: Tested, cause: Cause, others: Sequence[Tested]) -> str:
    """A wrong actuation, with the unit or the power of ten that would make it right."""
    number, _, unit = test.actuation.strip().partition(" ")
    away = np.log(cause.factor)
    for other in dict.fromkeys(t.actuation.strip().partition(" ")[2] for t in others):
        if other and unit and other != unit:
            wrong = actuation_factor(unit)[0] / actuation_factor(other)[0]
            if abs(np.log(wrong) - away) < 0.5 * abs(away):
                return f"the actuation is probably {number} {other}, not {test.actuation}"
    hint = ", by a factor of ten" if abs(abs(away) - np.log(10.0)) < 1.0 else ""
    given, about = test.actuation, ""
    if number and unit:
        about = f" (its loop is that of about {float(number) / cause.factor:.2g} {unit})"
    return (
        f"the actuation{f', {given},' if given else ''} is probably wrong{hint}{about}, or the "
        "file is that of another test"
    )


# One measurement in two files: whole, cut out of the other, or sampled anew.

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

    def energy(self, begin: Array, end: Array) -> Array:
        """Sum of the squared mean force over bins."""
        total = np.concatenate([[0.0], np.cumsum(self.forces**2)])
        return np.asarray(total[end] - total[begin])

    def means(self, first: Array, count: int) -> tuple[Array, Array]:
        """Mean force and displacement in `count` bins from each time `first` (n,), s, on."""
        edges = first[:, None] + BIN * np.arange(count + 1)
        parts = (np.interp(edges, self.time, values) for values in (self.force, self.displacement))
        force, displacement = (np.diff(part) / BIN for part in parts)
        return force, displacement


def twin_share(own: Signature, other: Signature) -> float | None:
    """Share of a record that is the same measurement as another, up to 1; None if none of it is."""
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
    return min(1.0, _overlap(own, other, np.array([lag]))[1] / own.bins)


def _coarse_lags(own: Signature, other: Signature) -> list[int]:
    """Bins by which `own` begins after `other`, where both look alike, the likest first."""
    shifts = np.arange(1 - own.bins, other.bins)
    size = 1 << (own.bins + other.bins - 1).bit_length()
    spectra = [np.fft.rfft(each.forces, size) for each in (own, other)]
    products = np.fft.irfft(spectra[1] * np.conj(spectra[0]), size)[shifts]
    begin, end = np.maximum(0, -shifts), np.minimum(own.bins, other.bins - shifts)
    energies = own.energy(begin, end), other.energy(begin + shifts, end + shifts)
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
    """Begin of what is in both with each of the lags, in the time of `own`, s, and its bins."""
    begin = max(0.0, -float(lags.min()))
    end = min(own.time[-1], other.time[-1] - float(lags.max()))
    return begin, max(int((end - begin) / BIN), 0)


# Tests whose gap, build-up or slip force does not follow the others, and the likely cause.

QUANTITIES = {"gap": "in", "slope": "kip/in", "plateau": "kip"}
_WORDS = {"gap": "gap", "slope": "build-up", "plateau": "slip force"}
FEWEST = 3  # fewest tests among which one can be odd
SCATTER = np.array([0.08, 0.25, 0.15])  # sd of each logarithm between tests of one device
FAR = 3.3  # a test is odd where a quantity is further away than this many sds of the others
SAME_LEVEL = 0.05  # actuations that differ by less than this share are one level
BEND = np.array([0.3, 0.5, 0.7])  # prior sd of the exponent of each quantity over the actuation
_MIDDLE = np.array([0.0, 0.0, 0.5])  # and its prior mean


@dataclass(frozen=True, eq=False)
class Deviation:
    """Logarithms of `QUANTITIES` over what the law of the other tests lets expect, (3,).

    NaN where unknown; with their standard deviations, and the exponents of the laws over the
    actuation.
    """

    values: Array
    sds: Array
    exponents: Array

    @property
    def distance(self) -> float:
        """Largest deviation in standard deviations."""
        return float(np.nanmax(np.abs(self.values) / self.sds, initial=0.0))


def find_odd(logs: Array, levels: Array) -> dict[int, Deviation]:
    """Odd tests by their number, the oddest first, each against the tests that are not odd.

    `logs` (J, 3) are logarithms of `QUANTITIES`, NaN where one is not known, `levels` (J,) the
    actuations. A test at 0 is not compared; where the level is not known, slip forces are not.
    """
    logs = logs.copy()
    logs[np.isnan(levels), 2] = np.nan
    logs[levels == 0.0] = np.nan
    place = np.log(np.where(levels > 0.0, levels, np.nan))
    left = list(range(len(levels)))
    for _ in range(len(levels) // 3):  # without the worst, others that are odd show
        if len(left) > FEWEST - 1:
            rest = {j: [i for i in left if i != j] for j in left}
            left.remove(min(left, key=lambda j: _disagreement(logs, place, rest[j])))
    every = set(range(len(levels)))
    odd = []
    for j in sorted(every - set(left)):  # against the trimmed tests, or all the others
        if any(_deviation(logs, place, j, some).distance > FAR for some in (left, every - {j})):
            odd.append(j)
    core = sorted(every - set(odd))
    odd = [j for j in odd if _deviation(logs, place, j, core).distance > FAR]
    core = sorted(every - set(odd))
    deviations = {j: _deviation(logs, place, j, core) for j in odd}
    deviations = {j: away for j, away in deviations.items() if not _shared(j, deviations, place)}
    return dict(sorted(deviations.items(), key=lambda item: -item[1].distance))


def _shared(j: int, deviations: dict[int, Deviation], place: Array) -> bool:
    """Whether another odd test at the same level deviates alike: the level, not the test, is odd.

    A deviation beyond twice `FAR` is no level's.
    """
    alike = (
        np.nanmax(np.abs(deviations[i].values - deviations[j].values) / SCATTER, initial=0.0) < FAR
        for i in deviations
        if i != j and abs(place[i] - place[j]) < SAME_LEVEL
    )
    return deviations[j].distance < 2.0 * FAR and any(alike)


def _deviation(logs: Array, place: Array, j: int, others: Iterable[int]) -> Deviation:
    """Deviation of test j from the law of others."""
    others = sorted(others)
    values, sds, exponents = np.full(3, np.nan), np.full(3, np.inf), _MIDDLE.copy()
    for k in range(3):
        finite = [i for i in others if np.isfinite(logs[i, k]) and np.isfinite(place[i])]
        if not finite:
            finite = [i for i in others if np.isfinite(logs[i, k])]
        if not np.isfinite(logs[j, k]) or len(finite) < FEWEST - 1:
            continue
        x, at = (np.nan_to_num(v) for v in (place[finite], place[j]))
        middle, value, slope, spread, far = _line(x, logs[finite, k], k)
        values[k] = logs[j, k] - value - slope * (float(at) - middle)
        few = 1.0 + 1.0 / (len(finite) - 1)
        sds[k] = few * np.sqrt(spread**2 + (far * (float(at) - middle)) ** 2)
        exponents[k] = slope
    return Deviation(values, sds, exponents)


def _line(x: Array, y: Array, k: int) -> tuple[float, float, float, float, float]:
    """Middle, value there, slope, scatter and error of the slope, of a line with a prior."""
    middle, value = float(x.mean()), float(y.mean())
    away, noise = x - middle, SCATTER[k] ** 2
    weight = float(away @ away) / noise + 1.0 / BEND[k] ** 2
    slope = (float(away @ (y - value)) / noise + _MIDDLE[k] / BEND[k] ** 2) / weight
    rest = y - value - slope * away
    spread = float(np.sqrt((rest @ rest + 2.0 * noise) / (y.size - 1 + 2.0)))
    return middle, value, slope, max(spread, float(SCATTER[k])), float(weight**-0.5)


def _disagreement(logs: Array, place: Array, tests: Sequence[int]) -> float:
    """Sum of squares of what is left of lines through tests, in units of the scatter."""
    total = 0.0
    for k in range(3):
        y, x = logs[list(tests), k], np.nan_to_num(place[list(tests)])
        finite = np.isfinite(y)
        if np.count_nonzero(finite) < 2:
            continue
        middle, value, slope, _, _ = _line(x[finite], y[finite], k)
        rest = y[finite] - value - slope * (x[finite] - middle)
        prior = ((slope - _MIDDLE[k]) / BEND[k]) ** 2
        total += float(np.sum((rest / SCATTER[k]) ** 2)) + prior
    return total


UNITS = {
    "displacement": ("in", "mm", "cm", "m"),
    "force": ("kip", "lbf", "kN", "N", "MN", "kgf"),
}
"""Units that a column may be in instead of the one that it was read in."""
WAYS = {"displacement": np.array([1.0, -1.0, 0.0]), "force": np.array([0.0, 1.0, 1.0])}
"""By how much the logarithms of gap, build-up and slip force grow with that of a wrong factor."""
FREE = 4.0  # penalty of a cause with a free factor: a unit that explains as much is the likelier
ANYTHING = 14.0  # penalty of another device, which explains every deviation


@dataclass(frozen=True)
class Cause:
    """What may be wrong with a test, and the factor by which it is too large.

    Of a wrong unit: whose role, the unit that it seems to be in, and the one it was read in.
    """

    name: str
    factor: float = 1.0
    role: str = ""
    unit: str = ""
    read_in: str = ""


def likely_cause(deviation: Deviation, units: dict[str, str]) -> Cause:
    """The cause that explains a deviation best.

    A length that is too large by f makes the gap f times as wide and the build-up f times less
    steep; a force that is too large by f makes build-up and slip force f times as large; an
    actuation that is too large by f leaves the loop as it is and moves the law's value.
    """
    finite = np.isfinite(deviation.values)
    values = np.where(finite, deviation.values, 0.0)
    weights = np.where(finite, 1.0 / deviation.sds**2, 0.0)
    causes = [(ANYTHING, Cause("another device"))]
    for role, way in (*WAYS.items(), ("actuation", -deviation.exponents)):
        size = float(way**2 @ weights)
        log = float((way * values) @ weights) / size if size > 0 else 0.0
        misfit = float((values - way * log) ** 2 @ weights)
        causes.append((misfit + FREE, Cause(role, float(np.exp(log)))))
        for unit in UNITS.get(role, ()):
            wrong = factor(units[role], role) / factor(unit, role)
            if abs(np.log(wrong)) > 0.2:
                misfit = float((values - way * np.log(wrong)) ** 2 @ weights)
                causes.append((misfit, Cause(f"unit of {role}", wrong, role, unit, units[role])))
    return min(causes, key=lambda pair: pair[0])[1]
