"""Tests compared with each other: duplicates, clocks, signs, and laws of what a loop shows."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import ClassVar

import numpy as np

from mfd_bayes.records.cycles import features_of
from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import asymmetry, channels_swapped, find_loops
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
    "build_up_slope": ("build-up", "kip/in"),
    "slip": ("slip force", "kip"),
}
# Of the logarithm of each quantity, and last of the actuation itself: sd between tests of one
# device, and mean and sd of its exponent over the actuation.
SCATTER, EXPONENT, BEND = np.array(
    [[0.08, 0.25, 0.15, 0.7], [0.0, 0.0, 0.5, 0.0], [0.3, 0.5, 0.7, 1e-3]]
)
FREEDOM = 8.0  # tests that `SCATTER` is worth
FALLING = 0.05  # probability that the slip force of a device falls with its actuation
FEWEST = 2  # fewest tests of a law
# log prior odds of a mistake: another unit or power of ten, any factor, another device, an exchange
UNIT, FACTOR, ANYTHING, EXCHANGED = -5.0, -9.0, -13.0, -5.0
INSIDE = 2.5  # and more for any factor between the levels of others: a law extrapolates less well
LEAST = 0.2  # least logarithm of a factor that is a mistake
ANY_FACTOR = np.array([s * a for a in np.arange(LEAST, np.log(3000.0), 0.1) for s in (1.0, -1.0)])
WITHIN = 2.5  # sds of the laws within which an exchange must bring both tests
CLEAR = 1.0  # log odds by which a mistake must be more probable than any in other tests
WAYS = {"displacement": np.array([1.0, -1.0, 0.0]), "force": np.array([0.0, 1.0, 1.0])}
UNITS = {"displacement": ("in", "mm", "cm", "m"), "force": ("kip", "lbf", "kN", "N", "MN", "kgf")}
"""Units that a column may be in instead of the one that it was read in."""


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others."""

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    trace: Trace  # every sample, without spikes
    steady: bool  # whether it has enough loops at full stroke to be compared
    features: dict[str, float]  # by name, as `features_of`
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
            features=features_of(trace),
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
    for earlier, test in combinations(tests, 2):
        if test.id in twins:
            continue
        if test.steady and earlier.steady:
            energies = [abs(t.features["energy_per_cycle"]) for t in (test, earlier)]
            if not min(energies) > 0.8 * max(energies):
                continue
        share = shared_part(test.trace, earlier.trace)
        if share is not None:
            twins.add(test.id)
            text = "same record as {other}"
            if share < 0.98:
                text = f"the same measurement as {{other}} in {share:.0%} of the longer record"
            yield test.id, Fault.of("duplicate", f"{text}: it would count twice", other=earlier.id)


def shared_part(trace_a: Trace, trace_b: Trace) -> float | None:
    """Share of the longer of two records that is one measurement in both; None if none is."""
    from scipy.optimize import minimize_scalar
    from scipy.signal import correlate, find_peaks

    ends = [float(trace.time[-1] - trace.time[0]) for trace in (trace_a, trace_b)]
    sizes = [int(end / BIN) for end in ends]
    if min(sizes) < SHORTEST or max(sizes) > LONGEST:
        return None
    integrals = [_integrals(trace) for trace in (trace_a, trace_b)]
    force_a, force_b = (_means(i, 0.0, n)[0] for i, n in zip(integrals, sizes, strict=True))
    # Of the forces in their overlap at every shift in bins: product, and energy of each.
    energies = (
        correlate(np.ones(force_b.size), force_a**2, method="fft"),
        correlate(force_b**2, np.ones(force_a.size), method="fft"),
    )
    energies = tuple(np.maximum(e, 1e-9 * e.max() + 1e-300) for e in energies)
    alike = correlate(force_b, force_a, method="fft") / np.sqrt(energies[0] * energies[1])
    shifts = np.arange(1 - force_a.size, force_b.size)
    overlap = np.minimum(force_a.size, force_b.size - shifts) - np.maximum(0, -shifts)
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

    best, smallest = 0.0, np.inf
    for peak in sorted(peaks, key=lambda k: -alike[k])[:6]:  # cycles repeat
        middle = BIN * float(shifts[peak])
        fit = minimize_scalar(
            misfit,
            bounds=(middle - BIN, middle + BIN),
            method="bounded",
            options={"xatol": BIN / 512},
        )
        if fit.fun < smallest:
            best, smallest = float(fit.x), float(fit.fun)
    if smallest > SAME:
        return None
    # Independent noise would make forces differ more than that; it is read off the smallest third
    # differences, which the loop's corners leave alone.
    forces = [means[0] for means in parts(best)]
    noise = max(float(np.quantile(np.abs(np.diff(f, 3)), 0.25)) for f in forces)
    difference = forces[0] - forces[1]
    typical = float(np.median(np.abs(difference - np.median(difference)))) / 0.6745
    if typical > NOISE * max(noise / 0.3186 / np.sqrt(20.0), QUIET * float(np.std(forces[0]))):
        return None
    return float(min(1.0, difference.size / max(sizes)))


def _integrals(trace: Trace) -> tuple[Array, Array]:
    """Time from 0, (T,), and the integrals of force and displacement over it, (2, T)."""
    values = np.array([np.asarray(trace.force), trace.displacement])
    steps = 0.5 * (values[:, 1:] + values[:, :-1]) * np.diff(trace.time)
    return trace.time - trace.time[0], np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))


def _means(integrals: tuple[Array, Array], start: float, count: int) -> Array:
    """Mean force and displacement in `count` bins from a time on, s, (2, count)."""
    edges = start + BIN * np.arange(count + 1)
    return np.diff([np.interp(edges, integrals[0], row) for row in integrals[1]], axis=1) / BIN


def _clocks(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose steps of time and cycles are those of another one, but in ms."""
    step = {test.id: float(np.median(np.diff(test.trace.time))) for test in tests}
    for test in tests:
        for reference in tests:
            if (
                0.0 < reference.cycle < test.cycle
                and abs(step[test.id] / step[reference.id] - 1000.0) < 1.0
                and 500.0 < test.cycle / reference.cycle < 2000.0
            ):
                fault = Fault.of(
                    "time unit",
                    f"its steps of {step[test.id]:.3g} s and its cycles of {test.cycle:.4g} s are "
                    "a thousand times those of {other}: is time in ms rather than in s?",
                    other=reference.id,
                )
                yield test.id, fault
                break


def _signs(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose signs are not those of the others: which of two, or both."""
    steady = [t for t in tests if t.steady and not t.swapped]
    for test in steady:
        peers = [t for t in steady if t is not test]
        directions = {t.trace.direction for t in peers}
        if len(peers) < (2 if test.work < 0.0 else 3) or len(directions) > 1:
            continue
        agrees = test.trace.direction in directions
        begins = "its motion begins in the direction opposite to that of all other tests"
        if test.work < 0.0:
            suspect = "force: its motion begins as those of the other tests"
            if not agrees:
                suspect = f"displacement: {begins}"
            swapped = f"the swapped sign is probably that of the {suspect}"
            yield test.id, Fault.of("force sign", swapped)
        elif not agrees:
            alike = [np.corrcoef(test.asymmetry, t.asymmetry)[0, 1] for t in peers]
            if np.nanmedian([0.0, 0.0] if np.isnan(alike).all() else alike) < 0.0:
                text = (
                    f"{begins}, and its two directions of motion seem exchanged: the signs of "
                    "force and displacement are probably both swapped"
                )
                yield test.id, Fault.of("both signs", text)


# --- mistakes that the laws of gap, build-up and slip force over the actuation show


@dataclass(frozen=True)
class Mistake:
    """What may be wrong with a test, or with two, and how it is put right in the laws' data.

    `logs` (3,) are added to the logarithms of its `QUANTITIES`, `level` to that of its actuation;
    where `left_out`, the test is taken out of the laws instead. Two tests exchange their levels.
    """

    tests: tuple[int, ...]
    name: str
    logs: Array = field(default_factory=lambda: np.zeros(3))
    level: float = 0.0
    log_prior: float = 0.0
    left_out: bool = False
    reason: str = ""


def _odd(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests that follow the laws of the others only if a mistake is put right.

    Each step puts right the mistake that makes the data of all laws most probable (its Bayes
    factor times its prior), until none is worth it, or two tests may be the wrong one.
    """
    steady = [t for t in tests if t.steady and t.work > 0.0]
    values = np.array([[t.features[name] for name in QUANTITIES] for t in steady])
    levels = np.array([t.level for t in steady])
    x, y = _logarithms(values.reshape(-1, 3), levels)
    wrong: set[int] = set()
    while len(steady) - len(wrong) > FEWEST:
        mistake = _likeliest(steady, x, y, wrong)
        if mistake is None:
            return
        wrong.update(mistake.tests)
        if len(mistake.tests) > 1:
            yield from _exchanged(*(steady[j] for j in mistake.tests))
            pair = list(mistake.tests)
            x[pair] = x[pair[::-1]]
            continue
        (j,) = mistake.tests
        law = np.delete(_sums(x, y), j, axis=0).sum(axis=0)
        yield steady[j].id, _explained(mistake, steady[j], x[j], y[j], law)
        x[j] += mistake.level
        y[j] = np.nan if mistake.left_out else y[j] + mistake.logs


def _logarithms(values: Array, levels: Array) -> tuple[Array, Array]:
    """Logarithms of actuations (J,) and of `QUANTITIES` (J, 3), NaN where one tells nothing.

    A test at 0 is not compared. Where the level is not known, slip forces are not; gap and build-up
    are, as at the mean level.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        y = np.log(np.where((values > 0.0) & (levels != 0.0)[:, None], values, np.nan))
        x = np.log(np.where(levels > 0.0, levels, np.nan))
    y[np.isnan(levels), 2] = np.nan
    mean = float(np.nanmean(x)) if np.any(levels > 0.0) else 0.0
    return np.where(np.isnan(x), mean, x) - mean, y


def _sums(x: Array, y: Array) -> Array:
    """Count and sums of x, y, x², xy, y² that a test adds to each law, (..., 4, 6); 0 for NaN.

    `x` (...) are logarithms of actuations, `y` (..., 3) those of `QUANTITIES`.
    """
    x, y = np.broadcast_arrays(x[..., None], y)
    compared = np.isfinite(y).any(axis=-1, keepdims=True)
    y = np.concatenate([y, np.where(compared, x[..., :1], np.nan)], axis=-1)
    x = np.broadcast_to(x[..., :1], y.shape)
    terms = np.stack(np.broadcast_arrays(1.0, x, y, x * x, x * y, y * y), axis=-1)
    return np.where(np.isfinite(y)[..., None], terms, 0.0)


def _law(sums: Array) -> tuple[Array, Array, Array, Array]:
    """Mean x, mean y, exponent, and its precision over that of one value, of each law (..., 4)."""
    n = np.maximum(sums[..., 0], 1.0)
    x, y = sums[..., 1] / n, sums[..., 2] / n
    precision = sums[..., 3] - n * x * x + (SCATTER / BEND) ** 2
    cross = sums[..., 4] - n * x * y + EXPONENT * (SCATTER / BEND) ** 2
    return x, y, cross / precision, precision


def _variance(sums: Array) -> Array:
    """Mean of the variance of a value about its law, and its degrees of freedom, (2, ..., 4)."""
    n = np.maximum(sums[..., 0], 1.0)
    _, y, exponent, precision = _law(sums)
    ridge = (SCATTER / BEND) ** 2
    squares = sums[..., 5] - n * y * y + EXPONENT**2 * ridge - exponent**2 * precision
    freedom = FREEDOM + n - 1.0
    return np.stack([(FREEDOM * SCATTER**2 + np.maximum(squares, 0.0)) / freedom, freedom])


def _log_evidence(sums: Array) -> Array:
    """Log of the probability of all values under their laws, (...), from sums (..., 4, 6).

    A law is a line with a flat prior on its level, a normal one on its exponent, and an inverse
    gamma one on its variance (Gelman et al., Bayesian Data Analysis, 3rd ed., section 14.2). The
    exponent of a slip force is positive but for the probability `FALLING`.
    """
    from scipy.special import gammaln, stdtr

    variance, freedom = _variance(sums)
    _, _, exponent, precision = _law(sums)
    slip = 2  # its place among the quantities
    rising = stdtr(freedom, exponent / np.sqrt(variance / precision))[..., slip]
    prior = stdtr(FREEDOM, (EXPONENT / BEND)[slip])
    sign = np.log(FALLING + (1.0 - FALLING) * rising / prior)
    n, start = np.maximum(sums[..., 0], 1.0), FREEDOM * SCATTER**2
    logs = (
        0.5 * np.log((SCATTER / BEND) ** 2 / precision / n)
        - 0.5 * (n - 1.0) * np.log(np.pi)
        + gammaln(0.5 * freedom)
        - gammaln(0.5 * FREEDOM)
        + 0.5 * FREEDOM * np.log(start)
        - 0.5 * freedom * np.log(freedom * variance)
    )
    return np.asarray(np.where(sums[..., 0] > 0.0, logs, 0.0).sum(axis=-1) + sign)


def _likeliest(
    tests: Sequence[Tested], x: Array, y: Array, wrong: Collection[int]
) -> Mistake | None:
    """The mistake that the data call for, of tests that are not known to be `wrong`.

    None where none is probable, or where a mistake in other tests explains the data about as well.
    """
    ranked = sorted(_scored(tests, x, y, wrong), key=lambda pair: -pair[0])
    if not ranked or ranked[0][0] < 0.0:
        return None
    score, best = ranked[0]
    rival = next((s for s, m in ranked if not {*m.tests} & {*best.tests}), -np.inf)
    return best if score - rival > CLEAR else None


def _scored(
    tests: Sequence[Tested], x: Array, y: Array, wrong: Collection[int]
) -> Iterator[tuple[float, Mistake]]:
    """Log odds and mistake: the likeliest one of each test, and the exchange of each two."""
    sums = _sums(x, y)
    total = sums.sum(axis=0)
    nothing = _log_evidence(total)
    candidates = [j for j in range(len(tests)) if j not in wrong and np.isfinite(y[j]).any()]
    for j in candidates:
        mistakes = _mistakes(j, tests)
        logs = y[j] + np.array([mistake.logs for mistake in mistakes])
        logs[[mistake.left_out for mistake in mistakes]] = np.nan
        levels = x[j] + np.array([mistake.level for mistake in mistakes])
        corrected = total - sums[j] + _sums(levels, logs)
        odds = _log_evidence(corrected) - nothing + [mistake.log_prior for mistake in mistakes]
        best = int(np.argmax(odds))
        levels = [t.level for i, t in enumerate(tests) if i != j and t.level > 0.0]
        in_range = bool(levels) and min(levels) <= tests[j].level <= max(levels)
        of_factor = in_range and mistakes[best].log_prior == FACTOR
        yield float(odds[best]) + INSIDE * of_factor, mistakes[best]
    for i in candidates:
        later = np.array([j for j in candidates if j > i], dtype=np.intp)
        moved = total - sums[i] - sums[later] + _sums(x[later], y[i]) + _sums(x[i], y[later])
        odds = _log_evidence(moved) - nothing
        odds += EXCHANGED - np.log(0.5 * len(candidates))
        distances = [_away(x[later], y[i], moved), _away(x[i], y[later], moved)]
        restored = np.nanmax(np.abs(distances), axis=(0, 2), initial=0.0) < WITHIN
        for j in np.flatnonzero(restored & (x[later] != x[i])).tolist():
            if tests[i].level > 0.0 and tests[later[j]].level > 0.0:
                yield float(odds[j]), Mistake((i, int(later[j])), "exchange")


def _away(x: Array, y: Array, law: Array) -> Array:
    """Distance of a test's values y (..., 3) from laws, in predictive sds, (..., 3)."""
    mean_x, mean_y, exponent, precision = _law(law)
    variance, _ = _variance(law)
    offset = np.asarray(x)[..., None] - mean_x
    sd = np.sqrt(variance * (1.0 + 1.0 / np.maximum(law[..., 0], 1.0) + offset**2 / precision))
    return np.asarray((y - (mean_y + exponent * offset)[..., :3]) / sd[..., :3])


def _mistakes(j: int, tests: Sequence[Tested]) -> list[Mistake]:
    """What may be wrong with test j by itself.

    A length that is too large by f makes the gap f times as wide and the build-up f times less
    steep; a force that is too large by f makes build-up and slip force f times as large; an
    actuation that is too large by f leaves the loop as it is.
    """
    test = tests[j]
    reason = (
        "neither a unit nor the actuation explains it; is it the record of another device, or of "
        "another session?"
    )
    mistakes = [Mistake((j,), "another device", log_prior=ANYTHING, left_out=True, reason=reason)]
    for role, way in WAYS.items():
        for unit in UNITS[role]:
            log = float(np.log(factor(test.units[role], role) / factor(unit, role)))
            if abs(log) > LEAST:
                reason = f"its {role} seems to be in {unit}, not in {test.units[role]}"
                mistakes.append(
                    Mistake((j,), f"unit of {role}", -log * way, 0.0, UNIT, reason=reason)
                )
        for log in ANY_FACTOR:
            size = f"{np.exp(abs(log)):.2g} times too {'large' if log > 0.0 else 'small'}"
            reason = f"its {role} seems to be {size}: check its unit and the sensor's factor"
            mistakes.append(Mistake((j,), role, -log * way, 0.0, FACTOR, reason=reason))
    if test.level > 0.0:
        number, _, unit = test.actuation.strip().partition(" ")
        for rival in {t.actuation.strip().partition(" ")[2] for t in tests} - {unit, ""}:
            if unit:
                log = float(np.log(actuation_factor(unit)[0] / actuation_factor(rival)[0]))
                reason = f"the actuation is probably {number} {rival}, not {test.actuation}"
                mistakes.append(
                    Mistake((j,), "actuation", level=-log, log_prior=UNIT, reason=reason)
                )
        for log in (np.log(10.0), -np.log(10.0)):
            mistakes.append(Mistake((j,), "actuation", level=-log, log_prior=UNIT))
        mistakes += [Mistake((j,), "actuation", level=-log, log_prior=FACTOR) for log in ANY_FACTOR]
    return mistakes


def _explained(mistake: Mistake, test: Tested, x: float, y: Array, law: Array) -> Fault:
    """A test's mistake, with the quantity that is farthest from the law of the others."""
    mean_x, mean_y, exponent, _ = _law(law)
    expected = mean_y + exponent * (x - mean_x)
    k = int(np.nanargmax(np.abs(_away(np.asarray(x), y, law))))
    words, unit = list(QUANTITIES.values())[k]
    reason = mistake.reason
    if mistake.name == "actuation":
        reason = reason or _of_actuation(test, -mistake.level)
    return Fault.of(
        mistake.name,
        f"its loop has a {words} of {{value}}, where the other tests suggest {{expected}}: {{why}}",
        value=(float(np.exp(y[k])), unit),
        expected=(float(np.exp(expected[k])), unit),
        why=reason,
    )


def _of_actuation(test: Tested, shift: float) -> str:
    """A wrong actuation, too large by the exponential of `shift`, and the one that it may be."""
    number, _, unit = test.actuation.strip().partition(" ")
    hint = ", by a factor of ten" if abs(abs(shift) - np.log(10.0)) < 1.0 else ""
    level, estimate = test.actuation, ""
    if number and unit:
        estimate = f" (its loop is that of about {float(number) / np.exp(shift):.2g} {unit})"
    return (
        f"the actuation{f', {level},' if level else ''} is probably wrong{hint}{estimate}, or the "
        "file is that of another test"
    )


def _exchanged(test_a: Tested, test_b: Tested) -> Iterator[tuple[str, Fault]]:
    """Two tests that follow the law of the others once their actuations are exchanged."""
    for test, partner in ((test_a, test_b), (test_b, test_a)):
        levels = f" ({test.actuation} and {partner.actuation})" if test.actuation else ""
        yield (
            test.id,
            Fault.of(
                "actuation",
                f"its actuation and that of {{other}}{levels} are probably exchanged, or their "
                "files are: exchanged, both loops follow the law of the other tests",
                other=partner.id,
            ),
        )
