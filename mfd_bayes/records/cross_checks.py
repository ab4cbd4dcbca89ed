"""Tests compared with each other: duplicates, signs, units, and laws of what a loop shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.duplicates import Signature, find_twin
from mfd_bayes.records.loop_features import LoopFeatures, asymmetry, loop_estimate
from mfd_bayes.records.loops import channels_swapped, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.outliers import QUANTITIES, SAME_LEVEL, Cause, find_odd, likely_cause
from mfd_bayes.records.record import Record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor

STEADY = 3  # fewest loops at full stroke of a record that is compared
OTHERS, OTHERS_OF_NEGATIVE = 3, 2
"""Fewest other tests that all begin in the same direction for one that does not to be named, and
for saying which of two signs is swapped in one whose force does negative work."""
ENERGY = 0.2  # energies of a record and of a part of it differ by less than this share
WHOLE = 0.98  # a twin of at least this share of a record is the whole record
FAR, ALIKE = 4.0, 1.6
"""An actuation of more than `FAR` times the nearest one changes the slip force by `ALIKE`."""
UNLIKE, SPEED = 1.6, 3.0
"""Slip forces at like actuation, and at speeds within `SPEED`, differ by less than `UNLIKE`."""

_LOOP_HAS = {
    "gap": ("a gap of {value}", "in"),
    "slope": ("a build-up of {value}", "kip/in"),
    "plateau": ("a slip force of {value}", "kip"),
}


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others.

    Attributes
    ----------
    signature : Signature
    features : LoopFeatures or None
        None where the record has too few loops at full stroke.
    asymmetry : (P,), kip
        Difference of the two directions along a stroke.
    direction : int
        First direction of the motion, +1 or -1.
    work : float, kip*in
        Energy of the loops; negative where one sign is swapped.
    level : float, kip or ksi
        Actuation, NaN where it is not known.
    actuation : str
        As the campaign gives it, "" for a column.
    units : mapping of str to str
        Unit of displacement and of force that the record was read in.
    step, cycle : float, s
        Median step of time, and median time of a full loop; 0 where there is none.
    speed : float, in/s
        Exceeded in a tenth of the samples.
    swapped : bool
        Whether displacement and force seem to be each other.
    """

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    signature: Signature
    features: LoopFeatures | None
    asymmetry: Array
    direction: int
    work: float
    level: float
    actuation: str
    units: dict[str, str]
    step: float = 0.0
    cycle: float = 0.0
    speed: float = float("nan")
    swapped: bool = False

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
        twin = find_twin(test.signature, other.signature)
        if twin is None:
            continue
        twins.add(test.id)
        share = twin.share * test.signature.bins / max(test.signature.bins, other.signature.bins)
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
        has, unit = _LOOP_HAS[QUANTITIES[k]]
        value = float(getattr(test.features, QUANTITIES[k]))
        yield (
            test.id,
            Fault.of(
                cause.name,
                f"its loop has {has}, where the other tests suggest {{expected}}: {{why}}",
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
        if abs(away[near]) > max(np.log(FAR), spread) and abs(force[near]) < np.log(ALIKE):
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
