"""Tests compared with each other: duplicates, clocks, signs, and laws of what a loop shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import (
    LoopFeatures,
    asymmetry,
    channels_swapped,
    find_loops,
    loop_estimate,
)
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Array, Trace, without_spikes
from mfd_bayes.units import actuation_factor, factor

STEADY = 3  # fewest loops at full stroke of a record that is compared
BIN = 1.0 / 32.0  # s; two records are compared as means over bins: the same at any sampling rate
SHORTEST, LONGEST = 64, 1 << 20  # fewest bins that must overlap, and most, nine hours, of a record
CORRELATION, LARGER = 0.97, 1.1  # least of two forces, and most of the ratio of their rms
SAME, NOISE, QUIET = 0.025, 1.2, 1e-3
"""Two records are one measurement if they differ by less than the first share of their sd, and the
forces by less than so many sds of their noise (repeated tests differ by 1.4), which is at least the
last share of the sd of the force."""

SAME_MOTION = 0.1
"""Strokes, and times of a cycle, that differ by less than this share are the same."""

QUANTITIES = {
    "gap": ("gap", "in"),
    "slope": ("build-up", "kip/in"),
    "plateau": ("slip force", "kip"),
}
# Of the logarithm of each quantity: sd between tests of one device, and mean and sd of its exponent
# over the actuation.
SCATTER, EXPONENT, BEND = np.array([[0.08, 0.25, 0.15], [0.0, 0.0, 0.5], [0.3, 0.5, 0.7]])
FEWEST, FAR = 2, 3.3  # fewest tests of a law, and sds at which a test is odd
CLOSE, OUTSIDE = 2.0, 4.0  # sds at which a test loses weight in a law, and counts for none
UNITS = {
    "displacement": ("in", "mm", "cm", "m"),
    "force": ("kip", "lbf", "kN", "N", "MN", "kgf"),
}
"""Units that a column may be in instead of the one that it was read in."""
FREE, ANYTHING = 4.0, 14.0  # penalties of a cause with a free factor, and of another device
SAME_LEVEL = 0.05  # actuations that differ by less than this share are one level
UNLIKE = 1.6  # slip forces at one level differ by less than this factor
FAR_LEVEL = 4.0  # an actuation so many times the nearest one changes the slip force by `UNLIKE`


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others."""

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    trace: Trace  # every sample, without spikes
    steady: bool  # whether it has enough loops at full stroke to be compared
    features: LoopFeatures
    asymmetry: Array  # (P,), kip; difference of the two directions along a stroke
    work: float  # kip*in, of the loops; negative where one sign is swapped
    cycle: float  # s; median time of a full loop, 0 where there is none
    actuation: str  # as the campaign gives it, "" for a column
    units: dict[str, str]  # of displacement and of force, in which the record was read
    swapped: bool  # whether displacement and force seem to be each other

    @classmethod
    def of(cls, name: str, record: Record, trace: Trace, actuation: str = "") -> Tested:
        """A test of its record, whose trace has every sample and a force."""
        trace = without_spikes(trace)
        loops = find_loops(trace)
        return cls(
            id=name,
            trace=trace,
            steady=bool(np.count_nonzero(loops.strong) >= STEADY),
            features=loop_estimate(trace),
            asymmetry=asymmetry(trace),
            work=float(np.sum(np.asarray(loops.energy))),
            cycle=float(np.median(loops.period)) if loops.period.size else 0.0,
            actuation=actuation,
            units={role: record.columns[role][1] for role in ("displacement", "force")},
            swapped=channels_swapped(trace),
        )

    @property
    def level(self) -> float:
        """Actuation, kip or ksi; NaN where it is not known."""
        return self.trace.reference_actuation


def compare_tests(tests: Sequence[Tested], *, same_motion: bool = False) -> list[tuple[str, Fault]]:
    """Faults by test: duplicates, then clocks, signs, units, actuations and other devices.

    Gap, build-up and slip force are those of a friction damper whatever its motion. Of another
    device, whose loops may grow with it, only tests of the `same_motion` are compared.
    """
    groups = _of_same_motion(tests) if same_motion else [tests]
    odd = [fault for group in groups for fault in _odd(group)]
    return [*_duplicates(tests), *_clocks(tests), *_signs(tests), *odd]


def _of_same_motion(tests: Sequence[Tested]) -> list[list[Tested]]:
    """Tests in groups of about one stroke and one time of a cycle."""
    groups: dict[tuple[float, float], list[Tested]] = {}
    for test in tests:
        motion = float(np.ptp(test.trace.displacement)), test.cycle
        alike = (m for m in groups if np.allclose(m, motion, rtol=SAME_MOTION, atol=0.0))
        groups.setdefault(next(alike, motion), []).append(test)
    return [*groups.values()]


def _duplicates(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests that are the same measurement as one before: whole, cut out, or sampled anew."""
    twins = set()
    for other, test in combinations(tests, 2):
        if test.id in twins:
            continue
        if test.steady and other.steady:
            energies = abs(test.features.energy), abs(other.features.energy)
            if not min(energies) > 0.8 * max(energies):
                continue
        share = shared_part(test.trace, other.trace)
        if share is not None:
            twins.add(test.id)
            what = "same record as {other}"
            if share < 0.98:
                what = f"the same measurement as {{other}} in {share:.0%} of the longer record"
            yield test.id, Fault.of("duplicate", f"{what}: it would count twice", other=other.id)


def shared_part(own: Trace, other: Trace) -> float | None:
    """Share of the longer of two records that is one measurement in both; None if none is."""
    from scipy.optimize import minimize_scalar
    from scipy.signal import correlate, find_peaks

    ends = [float(trace.time[-1] - trace.time[0]) for trace in (own, other)]
    sizes = [int(end / BIN) for end in ends]
    if min(sizes) < SHORTEST or max(sizes) > LONGEST:
        return None
    integrals = [_integrals(trace) for trace in (own, other)]
    first, second = (_means(i, 0.0, n)[0] for i, n in zip(integrals, sizes, strict=True))
    # Of the forces in their overlap at every shift in bins: product, and energy of each.
    energies = (
        correlate(np.ones(second.size), first**2, method="fft"),
        correlate(second**2, np.ones(first.size), method="fft"),
    )
    energies = tuple(np.maximum(e, 1e-9 * e.max() + 1e-300) for e in energies)
    alike = correlate(second, first, method="fft") / np.sqrt(energies[0] * energies[1])
    shifts = np.arange(1 - first.size, second.size)
    overlap = np.minimum(first.size, second.size - shifts) - np.maximum(0, -shifts)
    alike[overlap < max(SHORTEST, 0.5 * min(sizes))] = -1.0
    alike[np.maximum(*energies) > LARGER**2 * np.minimum(*energies)] = -1.0
    peaks = find_peaks(np.pad(alike, 1, constant_values=-1.0), height=CORRELATION)[0] - 1

    def parts(lag: float) -> tuple[Array, Array]:
        begin = max(0.0, -lag)
        count = max(int((min(ends[0], ends[1] - lag) - begin) / BIN), 1)
        return _means(integrals[0], begin, count), _means(integrals[1], begin + lag, count)

    def misfit(lag: float) -> float:
        a, b = parts(lag)
        return float(np.max(np.std(a - b, axis=1) / np.maximum(np.std(a, axis=1), 1e-300)))

    best, least = 0.0, np.inf
    for peak in sorted(peaks, key=lambda k: -alike[k])[:6]:  # cycles repeat
        middle = BIN * float(shifts[peak])
        fit = minimize_scalar(
            misfit,
            bounds=(middle - BIN, middle + BIN),
            method="bounded",
            options={"xatol": BIN / 512},
        )
        if fit.fun < least:
            best, least = float(fit.x), float(fit.fun)
    if least > SAME:
        return None
    # Independent noise would make forces differ more than that; it is read off the smallest third
    # differences, which the loop's corners leave alone.
    forces = [part[0] for part in parts(best)]
    noise = max(float(np.quantile(np.abs(np.diff(f, 3)), 0.25)) for f in forces)
    away = forces[0] - forces[1]
    typical = float(np.median(np.abs(away - np.median(away)))) / 0.6745
    if typical > NOISE * max(noise / 0.3186 / np.sqrt(20.0), QUIET * float(np.std(forces[0]))):
        return None
    return float(min(1.0, away.size / max(sizes)))


def _integrals(trace: Trace) -> tuple[Array, Array]:
    """Time from 0, (T,), and the integrals of force and displacement over it, (2, T)."""
    values = np.array([np.asarray(trace.force), trace.displacement])
    steps = 0.5 * (values[:, 1:] + values[:, :-1]) * np.diff(trace.time)
    return trace.time - trace.time[0], np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))


def _means(integrals: tuple[Array, Array], first: float, count: int) -> Array:
    """Mean force and displacement in `count` bins from a time on, s, (2, count)."""
    edges = first + BIN * np.arange(count + 1)
    return np.diff([np.interp(edges, integrals[0], row) for row in integrals[1]], axis=1) / BIN


def _clocks(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose steps of time and cycles are those of another one, but in ms."""
    step = {test.id: float(np.median(np.diff(test.trace.time))) for test in tests}
    for test in tests:
        for other in tests:
            if (
                0.0 < other.cycle < test.cycle
                and abs(step[test.id] / step[other.id] - 1000.0) < 1.0
                and 500.0 < test.cycle / other.cycle < 2000.0
            ):
                fault = Fault.of(
                    "time unit",
                    f"its steps of {step[test.id]:.3g} s and its cycles of {test.cycle:.4g} s are "
                    "a thousand times those of {other}: is time in ms rather than in s?",
                    other=other.id,
                )
                yield test.id, fault
                break


def _signs(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose signs are not those of the others: which of two, or both."""
    steady = [t for t in tests if t.steady and not t.swapped]
    for test in steady:
        others = [t for t in steady if t is not test]
        directions = {t.trace.direction for t in others}
        if len(others) < (2 if test.work < 0.0 else 3) or len(directions) > 1:
            continue
        same = test.trace.direction in directions
        begins = "its motion begins in the direction opposite to that of all other tests"
        if test.work < 0.0:
            which = "force: its motion begins as those of the other tests"
            if not same:
                which = f"displacement: {begins}"
            swapped = f"the swapped sign is probably that of the {which}"
            yield test.id, Fault.of("force sign", swapped)
        elif not same:
            alike = [np.corrcoef(test.asymmetry, t.asymmetry)[0, 1] for t in others]
            if np.nanmedian([0.0, 0.0] if np.isnan(alike).all() else alike) < 0.0:
                both = (
                    f"{begins}, and its two directions of motion seem exchanged: the signs of "
                    "force and displacement are probably both swapped"
                )
                yield test.id, Fault.of("both signs", both)


# Tests whose gap, build-up or slip force does not follow the others, and the likely cause.


def _odd(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose gap, build-up or slip force is not that of the others."""
    steady = [t for t in tests if t.steady and t.work > 0.0]
    values = np.array([[getattr(t.features, name) for name in QUANTITIES] for t in steady])
    away, sds, exponents = deviations(values.reshape(-1, 3), np.array([t.level for t in steady]))
    far = np.nanmax(np.abs(away) / sds, axis=1, initial=0.0)
    odd = [int(j) for j in np.argsort(-far, kind="stable") if far[j] > FAR]
    rest = [t for j, t in enumerate(steady) if j not in odd]
    for j in odd:
        test = steady[j]
        name, why = _cause(test, away[j], sds[j], exponents[j], rest)
        k = int(np.nanargmax(np.abs(away[j]) / sds[j]))
        words, unit = list(QUANTITIES.values())[k]
        yield (
            test.id,
            Fault.of(
                name,
                f"its loop has a {words} of {{value}}, where the other tests suggest {{expected}}: "
                "{why}",
                value=(float(values[j, k]), unit),
                expected=(float(values[j, k] / np.exp(away[j, k])), unit),
                why=why,
            ),
        )
    yield from _unlike(rest)


def deviations(values: Array, levels: Array) -> tuple[Array, Array, Array]:
    """Deviations of J tests from the laws of the others, their sds and exponents, (J, 3) each.

    `values` (J, 3) are the `QUANTITIES`, NaN where one is not known, `levels` (J,) the actuations.
    A deviation is a logarithm, NaN where there is no law: a line over the logarithm of the level
    with a prior on its slope. Tests far from a robust line through all are left out of the laws.
    A test at 0 is not compared; where the level is not known, slip forces are not.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(np.where((values > 0.0) & (levels != 0.0)[:, None], values, np.nan))
        place = np.log(np.where(levels > 0.0, levels, np.nan))
    logs[np.isnan(levels), 2] = np.nan
    place = np.where(np.isnan(place), np.nanmean(place) if np.any(levels > 0.0) else 0.0, place)
    rest = np.column_stack([_rest(place, logs[:, k], k) for k in range(3)])
    sound = ~np.any(np.abs(rest) > OUTSIDE * SCATTER, axis=1)
    away, sds = np.full(values.shape, np.nan), np.full(values.shape, np.inf)
    exponents = np.tile(EXPONENT, (len(values), 1))
    for j, k in np.argwhere(np.isfinite(logs)):
        law = sound & np.isfinite(logs[:, k])
        law[j] = False
        if np.count_nonzero(law) >= FEWEST:
            x, y = place[law], logs[law, k]
            slope, information = _slope(x, y, np.ones(y.size), k)
            left = y - y.mean() - slope * (x - x.mean())
            spread = (left @ left + 2.0 * SCATTER[k] ** 2) / (y.size + 1.0)
            spread = max(spread, SCATTER[k] ** 2)
            at = place[j] - x.mean()
            away[j, k], exponents[j, k] = logs[j, k] - y.mean() - slope * at, slope
            sds[j, k] = np.sqrt(spread * (1.0 + 1.0 / y.size) + at**2 / information)
    return away, sds, exponents


def _rest(x: Array, y: Array, k: int) -> Array:
    """What a robust line leaves of a quantity k, (J,); the weights are Welsch's."""
    known = np.isfinite(y)
    rest = y - EXPONENT[k] * x
    rest = rest - np.nanmedian(rest) if known.any() else rest
    for _ in range(30 if np.count_nonzero(known) > FEWEST else 0):
        weights = np.exp(-0.5 * (rest[known] / (CLOSE * SCATTER[k])) ** 2)
        slope, _ = _slope(x[known], y[known], weights, k)
        rest = y - slope * x
        rest = rest - np.average(rest[known], weights=weights)
    return np.asarray(rest)


def _slope(x: Array, y: Array, weights: Array, k: int) -> tuple[float, float]:
    """Exponent of a quantity k over the actuation, with its prior, and its information."""
    x, y = x - np.average(x, weights=weights), y - np.average(y, weights=weights)
    scaled = weights * x / SCATTER[k] ** 2
    information = float(scaled @ x + BEND[k] ** -2)
    return float(scaled @ y + EXPONENT[k] / BEND[k] ** 2) / information, information


def _cause(
    test: Tested, away: Array, sds: Array, exponents: Array, others: Sequence[Tested]
) -> tuple[str, str]:
    """The cause that explains a deviation best, and a sentence on it.

    A length that is too large by f makes the gap f times as wide and the build-up f times less
    steep; a force that is too large by f makes build-up and slip force f times as large; an
    actuation that is too large by f leaves the loop as it is and moves the law's value.
    """
    values, weights = np.nan_to_num(away), np.where(np.isnan(away), 0.0, 1.0 / sds**2)
    ways = {
        "displacement": np.array([1.0, -1.0, 0.0]),
        "force": np.array([0.0, 1.0, 1.0]),
        "actuation": -exponents,
    }
    other = (
        "neither a unit nor the actuation explains it; is it the record of another device, or of "
        "another session?"
    )
    causes = [(ANYTHING, "another device", other)]
    for role, way in ways.items():
        size = float(way**2 @ weights)
        log = float((way * values) @ weights) / size if size > 0.0 else 0.0
        much, size_word = float(np.exp(abs(log))), "large" if log > 0.0 else "small"
        why = (
            f"its {role} seems to be {much:.2g} times too {size_word}: check its unit and the "
            "sensor's factor"
        )
        if role == "actuation":
            why = _of_actuation(test, log, others)
        causes.append((float((values - way * log) ** 2 @ weights) + FREE, role, why))
        for unit in UNITS.get(role, ()):
            log = float(np.log(factor(test.units[role], role) / factor(unit, role)))
            if abs(log) > 0.2:
                why = f"its {role} seems to be in {unit}, not in {test.units[role]}"
                misfit = float((values - way * log) ** 2 @ weights)
                causes.append((misfit, f"unit of {role}", why))
    return min(causes, key=lambda cause: cause[0])[1:]


def _of_actuation(test: Tested, away: float, others: Sequence[Tested]) -> str:
    """A wrong actuation, with the unit or the power of ten that would make it right."""
    number, _, unit = test.actuation.strip().partition(" ")
    for other in dict.fromkeys(t.actuation.strip().partition(" ")[2] for t in others):
        if other and unit and other != unit:
            wrong = float(np.log(actuation_factor(unit)[0] / actuation_factor(other)[0]))
            if abs(wrong - away) < 0.5 * abs(away):
                return f"the actuation is probably {number} {other}, not {test.actuation}"
    hint = ", by a factor of ten" if abs(abs(away) - np.log(10.0)) < 1.0 else ""
    given, about = test.actuation, ""
    if number and unit:
        about = f" (its loop is that of about {float(number) / np.exp(away):.2g} {unit})"
    return (
        f"the actuation{f', {given},' if given else ''} is probably wrong{hint}{about}, or the "
        "file is that of another test"
    )


def _unlike(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose slip force is that of a far actuation, or not that of others at their own."""
    loaded = [t for t in tests if t.level > 0.0 and t.features.plateau > 0.0]
    for test in loaded if len(loaded) > 2 else ():
        others = [t for t in loaded if t is not test]
        levels = np.log([test.level / t.level for t in others])
        forces = np.log([test.features.plateau / t.features.plateau for t in others])
        near, like = int(np.argmin(np.abs(levels))), int(np.argmin(np.abs(forces)))
        far = abs(levels[near]) > max(np.log(FAR_LEVEL), np.ptp(levels))
        if far and abs(forces[like]) < np.log(UNLIKE):
            much = f"{np.exp(abs(levels[near])):.3g} times"
            fault = Fault.of(
                "actuation",
                f"its actuation is {much} {'that' if levels[near] > 0 else 'less than that'} "
                "of the nearest test, {near}, but its slip force, {slip}, is about the same: "
                "{why}",
                near=others[near].id,
                slip=(test.features.plateau, "kip"),
                why=_of_actuation(test, float(levels[like]), others),
            )
            yield test.id, fault
            continue
        same = forces[np.abs(levels) < SAME_LEVEL]
        if same.size >= FEWEST and abs(ratio := float(np.median(same))) > np.log(UNLIKE):
            fault = Fault.of(
                "force",
                f"its slip force, {{slip}}, is {np.exp(ratio):.2g} times the one of about "
                "{expected} of the tests at its actuation: its load cell or its actuation is "
                "probably wrong, or the file is that of another test",
                slip=(test.features.plateau, "kip"),
                expected=(test.features.plateau / float(np.exp(ratio)), "kip"),
            )
            yield test.id, fault
