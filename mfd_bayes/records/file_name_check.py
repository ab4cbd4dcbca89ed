"""What a file and its name declare of a test, against what its record shows."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

import numpy as np

from mfd_bayes.records.channels import ROLES, header_unit, stated_unit
from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.readers.table import own_name
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import (
    actuation_factor,
    factor,
    force_meant,
    may_mean,
    measure,
    parse_actuation,
    same_unit,
)

TOLERANCE = 0.1  # most difference of a record from its name, as a share of the name's value
SLOW_RATE, SLOW_PERIOD = 5.0, 3600.0
"""Where no unit of time is stated, a slower rate (Hz) with longer cycles (s) is not of a time in s:
qualification tests take a sample each few seconds, and up to an hour."""

NUMBER = (
    r"(?<![\d.])(?<!\d[eE])(?<![A-Za-z]\d,)"  # no part of 1.5e3, nor of "seal3,5bar"
    r"(0,\d+(?![\d.,])|(?<![A-Za-z])\d{1,3},\d{1,2}(?![\d.,])"
    r"|(?!(?<=\d,)\d{3}(?!\d))"  # no part of 1,200
    r"(?:\d+[.p]\d+(?!\d)|\d+(?!\d|[.p]\d)))"  # whole: Python 3.11.2 misreads (\d++)?+
)
"""Number in a name: ``0.5``, ``0p5``, ``0,5``. Of ``1,200`` it is not known which it is, and commas
may stand between words too, as in ``2022,36lb,0.25Hz``.
"""

_ALONE = rf"(?<![A-Za-z]){NUMBER}"
_FREQUENCY = re.compile(rf"{NUMBER}[ _-]?hz(?![a-z])", re.IGNORECASE)
_LENGTH = re.compile(rf"{_ALONE}(in|inch|mm)(?![a-z])", re.IGNORECASE)
_ACTUATION = re.compile(
    rf"{_ALONE}[ _-]?(psi|ksi|kpa|mpa|bar|lbf|lbs|lb|kips|kip|kn)(?![a-z])", re.IGNORECASE
)
_HALF = re.compile(r"(?<![a-z])amp(?:l|litude)?(?![a-z])", re.IGNORECASE)
_FULL = re.compile(
    r"(?<![a-z])(?:stroke|pp|p2p|pk-?pk|peak[ _-]?to[ _-]?peak)(?![a-z])", re.IGNORECASE
)
_SPELLED = {"kpa": "kPa", "mpa": "MPa", "kn": "kN"}


def contradictions(
    record: Record, trace: Trace | None = None, *, roles: Collection[str] = ROLES
) -> tuple[Fault, ...]:
    """Gaps in time, and units in columns' names or figures in a file's that its record has not.

    Words are numbers with a unit, as ``36lb_0.25Hz_1.0in``. A length is the amplitude or the whole
    stroke, whichever agrees, unless the name has a word for one of them (``amp``, ``stroke``,
    ``pp``); a rate may also be that of the samples. Of several it is enough that one agrees. Only
    roles whose unit is known, `roles`, are compared.
    """
    trace = record.trace() if trace is None else trace
    faults = []
    if record.gap and "time" in roles:
        faults.append(Fault.of("gap in time", "{gap}", gap=record.gap))
    faults += [Fault.of("rows not used", "{rows}", rows=doubt) for doubt in record.doubts]
    faults += _of_columns(record, roles)
    if "time" in roles:
        faults += _of_time(record, trace)
    return (*faults, *_of_motion(record, trace, roles), *_of_actuation(record, trace))


def _of_columns(record: Record, roles: Collection[str]) -> Iterator[Fault]:
    """Columns that are read in another unit than the file says, or whose own is not known."""
    for role, (name, unit) in record.columns.items():
        if role in record.derived or (role not in roles and role != "actuation"):
            continue
        row = record.stated_units.get(role, "")
        own, where = stated_unit(own_name(name), row), "the file" if row else "its name"
        if not own or measure(own) != measure(unit):  # "kN" of "load_kN"
            last = header_unit(own_name(name))
            if last and measure(last) == measure(unit):
                own, where = last, "its name"
        if not own or " " in own or same_unit(own, unit):
            continue
        if measure(own) == measure(unit):
            question = "which is it?"
        elif not may_mean(own, unit):
            question = f"which is no known unit of {role}: which is it{force_meant(own)}?"
        else:
            continue
        comma = ":" if question == "which is it?" else ","
        yield Fault.of(
            "column unit",
            f"column {{name}} is read in {{unit}}, and {where} says {{own}}{comma} {question}",
            name=repr(name),
            unit=repr(unit),
            own=repr(own),
        )


def _of_time(record: Record, trace: Trace) -> Iterator[Fault]:
    """Times read as s, without the file's word for it, that are plausible as ms alone."""
    name = own_name(record.columns.get("time", ("", ""))[0])
    stated = (header_unit(name), stated_unit(name), record.stated_units.get("time"))
    duration = float(np.ptp(trace.time))
    cycle, rate = duration / max(trace.turning_points.size / 2, 1.0), trace.samples / duration
    is_stated = any(unit and measure(unit) == "time" for unit in stated)
    if rate <= SLOW_RATE and cycle > SLOW_PERIOD and not is_stated:
        yield Fault.of(
            "time unit",
            f"a rate of {rate:.3g} Hz with cycles of {cycle:.3g} s is implausible, and the file "
            "states no unit of time: is time in ms rather than in s?",
        )


def _of_motion(record: Record, trace: Trace, roles: Collection[str]) -> Iterator[Fault]:
    """Amplitude and frequency of the loops at full stroke."""
    loops, name = find_loops(trace), record.path.stem
    if not loops.period.size:
        return
    amplitude = float(np.median(loops.amplitude[loops.strong]))
    rate = float(1.0 / np.median(loops.period[loops.strong]))
    if "displacement" in roles:
        lengths = {
            m[0]: number_in(m[1]) * factor(m[2], "displacement") for m in _LENGTH.finditer(name)
        }
        yield from _contradiction(
            record,
            lengths,
            _sizes(name, amplitude),
            "the record has an amplitude of {amplitude} (a stroke of {stroke})",
            amplitude=(amplitude, "in"),
            stroke=(2 * amplitude, "in"),
        )
    if "time" in roles:
        rates = {m[0]: number_in(m[1]) for m in _FREQUENCY.finditer(name)}
        shown = f"the record's motion has {rate:.3g} Hz"
        yield from _contradiction(record, rates, [rate, record.rate], shown)


def _sizes(name: str, amplitude: float) -> list[float]:
    """Sizes that a file's name may give: the amplitude, the whole stroke, or either."""
    half, full = bool(_HALF.search(name)), bool(_FULL.search(name))
    return [amplitude] * (half or not full) + [2.0 * amplitude] * (full or not half)


def length_in_name(record: Record) -> tuple[str, str] | None:
    """The one unit with which a displacement, read as inches, is as long as its name says; why."""
    loops, name = find_loops(record.trace()), record.path.stem
    if not loops.period.size:
        return None
    amplitude = float(np.median(loops.amplitude[loops.strong]))
    lengths = {
        unit: m[0]
        for unit in ("mm", "cm", "m", "in")
        for m in _LENGTH.finditer(name)
        for size in _sizes(name, amplitude * factor(unit, "displacement"))
        if _near(size, number_in(m[1]) * factor(m[2], "displacement"))
    }
    if len(lengths) != 1:
        return None
    unit, length = lengths.popitem()
    return (
        unit,
        f"the file's name says {length}, and the numbers have an amplitude of {amplitude:.3g}",
    )


def _of_actuation(record: Record, trace: Trace) -> Iterator[Fault]:
    """Pressure or tension, as the campaign or a column gives it, of the same kind as the name's."""
    if record.actuation is None:
        return
    declared = {}
    for match in _ACTUATION.finditer(record.path.stem):
        unit = _SPELLED.get(match[2].lower(), match[2].lower())
        value, internal = parse_actuation(f"{number_in(match[1]):g} {unit}")
        if internal == record.actuation_unit:
            declared[match[0]] = value
    level = float(np.mean(record.actuation))
    if "actuation" in record.columns:
        unit = record.columns["actuation"][1]
        shown = "its column has an actuation of {level}"
        words = f"{level / actuation_factor(unit)[0]:.4g} {unit}"
    else:
        shown = "the campaign has an actuation of {level}"
        words = record.given_actuation or f"{level:.4g} {record.actuation_unit}"
    yield from _contradiction(record, declared, [level], shown, level=words)


def number_in(text: str) -> float:
    """Number that `NUMBER` has found."""
    return float(text.lower().replace("p", ".").replace(",", "."))


def _near(size: float, declared: float) -> bool:
    return abs(size - declared) <= TOLERANCE * declared + 1e-9


def _contradiction(
    record: Record,
    declared: dict[str, float],
    measured: list[float],
    shown: str,
    **values: str | tuple[float, str],
) -> Iterator[Fault]:
    """A warning where none of the declared values, by word, is among the measured ones."""
    agree = any(_near(size, value) for value in declared.values() for size in measured)
    if declared and not agree:
        yield Fault.of(
            "file name",
            f"the name of {{file}} says {{words}}, but {shown}",
            file=record.path.name,
            words=" and ".join(declared),
            **values,
        )
