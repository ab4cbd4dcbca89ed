"""Tests compared with each other: duplicates, signs, units, and laws of what a loop shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np

from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.duplicates import Signature, find_twin
from mfd_bayes.records.loop_features import Readings, asymmetry, read_off
from mfd_bayes.records.loops import channels_swapped, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.outliers import (
    QUANTITIES,
    SAME_LEVEL,
    Cause,
    find_odd,
    likely_cause,
)
from mfd_bayes.records.record import Record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor

STEADY = 3
"""Fewest loops at full stroke of a record whose readings are compared."""


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others.

    Attributes
    ----------
    signature : Signature
    readings : Readings or None
        None where the record has too few loops at full stroke.
    lopsided : (P,), kip
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
    readings: Readings | None
    lopsided: Array
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
        units = {role: record.columns[role][1] for role in ("displacement", "force")}
        return cls(
            id=name,
            signature=Signature.of(trace),
            readings=read_off(trace) if steady else None,
            lopsided=asymmetry(trace) if steady else np.full(1, np.nan),
            direction=trace.direction,
            work=float(energy.sum()),
            level=trace.reference_actuation,
            actuation=actuation,
            units=units,
            step=float(np.median(np.diff(trace.time))),
            cycle=float(np.median(loops.period)) if loops.period.size else 0.0,
            speed=float(np.quantile(np.abs(trace.velocity), 0.9)),
            swapped=channels_swapped(trace),
        )


OTHERS, OTHERS_OF_NEGATIVE = 3, 2
"""Fewest other tests that all begin in the same direction for one that does not to be named, and
for saying which of two signs is swapped in one whose force does negative work."""

LIKE = 0.2
"""Energies of a record and of a part of it differ by less than this share."""

WHOLE = 0.98
"""A twin of at least this share of a record is the whole record."""

FAR, ALIKE = 4.0, 1.6
"""An actuation of more than `FAR` times the nearest one changes the slip force by `ALIKE`."""

UNLIKE = 1.6
"""Slip forces at like actuation, and speeds within `SPEED`, differ by less than this factor."""

SPEED = 3.0

_SAID = {"gap": "a gap of {:.3g} in", "slope": "a build-up of {:.3g} kip/in"}
_SAID |= {"plateau": "a slip force of {:.3g} kip"}


def compare_tests(tests: Sequence[Tested]) -> list[tuple[str, Fault]]:
    """Faults by test: duplicates, then clocks, signs, units, actuations and other devices."""
    return [*_twins(tests), *_clocks(tests), *_signs(tests), *_odd(tests)]


def _clocks(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose steps of time and cycles are those of another one, but in ms."""
    for one in tests:
        for other in tests:
            if not 0.0 < other.cycle < one.cycle:
                continue
            steps, cycles = one.step / other.step, one.cycle / other.cycle
            if abs(steps - 1000.0) < 1.0 and 0.5 < cycles / 1000.0 < 2.0:
                yield (
                    one.id,
                    Fault(
                        "time unit",
                        f"its steps of {one.step:.3g} s and its cycles of {one.cycle:.4g} s are a "
                        f"thousand times those of {other.id}: is time in ms rather than in s?",
                    ),
                )
                break


def _twins(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests that are the same measurement as one before."""
    named = set()
    for other, one in combinations(tests, 2):
        if one.id in named:
            continue
        if one.readings is not None and other.readings is not None:
            # Energies are about the same, but for the sign where one sign is swapped.
            energies = abs(one.readings.energy), abs(other.readings.energy)
            if not min(energies) > (1.0 - LIKE) * max(energies):
                continue
        twin = find_twin(one.signature, other.signature)
        if twin is None:
            continue
        named.add(one.id)
        part = twin.share * one.signature.bins / max(one.signature.bins, other.signature.bins)
        what = f"same record as {other.id}"
        if part < WHOLE:
            what = f"the same measurement as {other.id} in {part:.0%} of the longer record"
        yield one.id, Fault("duplicate", f"{what}: it would count twice")


def _signs(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose signs are not those of the others: which of two, or both."""
    steady = [t for t in tests if t.readings is not None and not t.swapped]
    for one in steady:
        others = [t for t in steady if t is not one]
        ways = {t.direction for t in others}
        if len(others) < (OTHERS_OF_NEGATIVE if one.work < 0.0 else OTHERS) or len(ways) > 1:
            continue
        begins = "its motion begins in the direction opposite to that of all other tests"
        if one.work < 0.0:
            which = f"displacement: {begins}"
            if one.direction in ways:
                which = "force: its motion begins as those of the other tests"
            yield one.id, Fault("force sign", f"the swapped sign is probably that of the {which}")
        elif one.direction not in ways:
            alike = [np.corrcoef(one.lopsided, t.lopsided)[0, 1] for t in others]
            known = [value for value in alike if np.isfinite(value)]
            if known and float(np.median(known)) < 0.0:  # the directions are exchanged
                both = (
                    f"{begins}, and its two directions of motion seem exchanged: the signs of "
                    "force and displacement are probably both swapped"
                )
                yield one.id, Fault("both signs", both)


def _odd(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose gap, build-up or slip force is not that of the others."""
    steady = [t for t in tests if t.readings is not None and t.work > 0.0]
    readings = [[getattr(t.readings, name) for name in QUANTITIES] for t in steady]
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(np.array(readings, dtype=np.float64).reshape(-1, len(QUANTITIES)))
    logs[~np.isfinite(logs)] = np.nan
    found = find_odd(logs, np.array([t.level for t in steady]))
    for j, away in found.items():
        others = [t for i, t in enumerate(steady) if i not in found]
        cause = likely_cause(away, steady[j].units)
        k = int(np.nanargmax(np.abs(away.values) / away.sds))
        value = getattr(steady[j].readings, QUANTITIES[k])
        said, expected = _SAID[QUANTITIES[k]].format(value), value / np.exp(away.values[k])
        why = cause.words
        if cause.name == "actuation":
            why = _of_actuation(steady[j], cause, others)
        elif cause.name == "another device":
            why = "neither a unit nor the actuation explains it; is it the record of another "
            why += "device, or of another session?"
        elif not why:
            size = cause.factor if cause.factor > 1.0 else 1.0 / cause.factor
            way = "large" if cause.factor > 1.0 else "small"
            why = f"its {cause.name} seems to be {size:.2g} times too {way}: check its unit and "
            why += "the sensor's factor"
        shown = f"its loop has {said}, where the other tests suggest {expected:.3g}"
        yield steady[j].id, Fault(cause.name, f"{shown}: {why}")
    rest = [t for i, t in enumerate(steady) if i not in found]
    far = list(_far_levels(rest))
    yield from far
    yield from _unlike([t for t in rest if t.id not in {name for name, _ in far}])


def _far_levels(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose actuation is far from that of all others, but whose slip force is not."""
    known = [t for t in tests if t.level > 0.0 and t.readings and t.readings.plateau > 0.0]
    for one in known:
        others = [t for t in known if t is not one]
        if len(others) < 2:
            continue
        away = np.log([one.level / t.level for t in others])
        force = np.log([_plateau(one) / _plateau(t) for t in others])
        near, like = int(np.argmin(np.abs(away))), int(np.argmin(np.abs(force)))
        apart = np.ptp([np.log(t.level) for t in others])
        if abs(away[near]) > max(np.log(FAR), apart) and abs(force[near]) < np.log(ALIKE):
            cause = Cause("actuation", "", 0.0, one.level / others[like].level)
            yield (
                one.id,
                Fault(
                    "actuation",
                    f"its actuation is {np.exp(abs(away[near])):.3g} times "
                    f"{'that' if away[near] > 0 else 'less than that'} of the nearest test, "
                    f"{others[near].id}, but its slip force, {_plateau(one):.3g} kip, is about the "
                    f"same: {_of_actuation(one, cause, others)}",
                ),
            )


def _unlike(tests: Sequence[Tested]) -> Iterator[tuple[str, Fault]]:
    """Tests whose slip force is not that of their neighbours in actuation."""
    known = [t for t in tests if t.level > 0.0 and _plateau(t) > 0.0]
    away = {one.id: _from_neighbours(one, known) for one in known}
    for one in known:
        same = [t for t in known if t is not one and _same_level(t, one)]
        factor, names = away[one.id]
        if abs(factor) < np.log(UNLIKE):
            continue
        which = (
            "its load cell or its actuation is probably wrong, or the file is that of another test"
        )
        if len(same) == 1 and abs(away[same[0].id][0]) >= np.log(UNLIKE):  # which of the two is it?
            others = [t for t in known if not _same_level(t, one)]
            sizes = [abs(_from_neighbours(t, [t, *others], ends=True)[0]) for t in (one, same[0])]
            if sizes[0] < sizes[1]:
                continue
            if sizes[0] == sizes[1]:
                which = f"one of the two is wrong; {which}"
        sentence = (
            f"its slip force, {_plateau(one):.3g} kip, is {np.exp(factor):.2g} times the one of "
            f"about {_plateau(one) / np.exp(factor):.3g} kip of its neighbours in actuation "
            f"({', '.join(names)}): {which}"
        )
        yield one.id, Fault("slip force" if which.startswith("one") else "force", sentence)


def _same_level(one: Tested, other: Tested) -> bool:
    return bool(abs(np.log(one.level / other.level)) < SAME_LEVEL)


def _from_neighbours(
    one: Tested, tests: Sequence[Tested], *, ends: bool = False
) -> tuple[float, list[str]]:
    """Logarithm of the slip force over that of tests at like actuation and speed, and their names.

    Without a test at the same actuation, it is interpolated between the levels below and above;
    0 where it cannot be. With `ends`, beyond the other levels the slip force follows the root of
    the actuation.
    """
    others = [
        t for t in tests if t is not one and not abs(np.log(t.speed / one.speed)) > np.log(SPEED)
    ]
    near = [t for t in others if _same_level(t, one)]
    if near:
        expected = float(np.median([np.log(_plateau(t)) for t in near]))
        return np.log(_plateau(one)) - expected, [t.id for t in near]
    below = max((t.level for t in others if t.level < one.level), default=None)
    above = min((t.level for t in others if t.level > one.level), default=None)
    levels = [level for level in (below, above) if level is not None]
    near = [t for t in others if t.level in levels]
    if len(levels) < 2 and not (ends and levels):
        return 0.0, []
    forces = [np.median([np.log(_plateau(t)) for t in near if t.level == at]) for at in levels]
    expected = float(np.interp(np.log(one.level), np.log(levels), forces))
    if len(levels) < 2:
        expected += 0.5 * float(np.log(one.level / levels[0]))
    return np.log(_plateau(one)) - expected, [t.id for t in near]


def _plateau(test: Tested) -> float:
    return test.readings.plateau if test.readings else float("nan")


def _of_actuation(test: Tested, cause: Cause, others: Sequence[Tested]) -> str:
    """A wrong actuation, with the unit or the power of ten that would make it right."""
    number, _, unit = test.actuation.strip().partition(" ")
    away = np.log(cause.factor)
    for known in dict.fromkeys(t.actuation.strip().partition(" ")[2] for t in others):
        if known and unit and known != unit:
            wrong = actuation_factor(unit)[0] / actuation_factor(known)[0]
            if abs(np.log(wrong) - away) < 0.5 * abs(away):
                return f"the actuation is probably {number} {known}, not {test.actuation}"
    hint = ", by a factor of ten" if abs(abs(away) - np.log(10.0)) < 1.0 else ""
    shown, about = test.actuation, ""
    if number and unit:
        about = f" (its loop is that of about {float(number) / cause.factor:.2g} {unit})"
    return (
        f"the actuation{f', {shown},' if shown else ''} is probably wrong{hint}{about}, or the "
        "file is that of another test"
    )
