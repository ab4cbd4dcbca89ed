"""What a file and its name declare of a test, against what its record shows."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from mfd_bayes.records.faults import Fault
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.readers.labels import own_name
from mfd_bayes.records.record import Record
from mfd_bayes.records.roles import header_unit
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor, factor, measure, parse_actuation, same_unit

TOLERANCE = 0.1
"""A name and its record agree if they differ by no more than this share of the name's value."""

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


def contradictions(record: Record, trace: Trace | None = None) -> tuple[Fault, ...]:
    """Gaps in time, and units in columns' names or figures in a file's that its record has not.

    Words are numbers with a unit, as ``36lb_0.25Hz_1.0in``. A length is the amplitude or the whole
    stroke, whichever agrees, unless the name has a word for one of them (``amp``, ``stroke``,
    ``pp``); a rate may also be that of the samples. Where a name has several of one kind it is
    enough that one agrees. Names without such words, and motions without a full loop, are not
    compared.
    """
    trace = record.trace() if trace is None else trace
    gaps = [Fault("gap in time", record.gap)] if record.gap else []
    return (
        *(*gaps, *_of_columns(record)),
        *(*_of_motion(record, trace), *_of_actuation(record, trace)),
    )


def _of_columns(record: Record) -> Iterator[Fault]:
    """Columns that have one unit in their name, and are read in another of the same measure."""
    for name, unit in record.columns.values():
        own = header_unit(own_name(name))
        if own and measure(own) == measure(unit) and not same_unit(own, unit):
            yield Fault(
                "column unit",
                f"column {name!r} is read in {unit!r}, and its name says {own!r}: which is it?",
            )


def _of_motion(record: Record, trace: Trace) -> Iterator[Fault]:
    """Amplitude and frequency of the loops at full stroke."""
    loops, name = find_loops(trace), record.path.stem
    if not loops.period.size:
        return
    amplitude = float(np.median(loops.amplitude[loops.strong]))
    rate = float(1.0 / np.median(loops.period[loops.strong]))
    lengths = [
        (m[0], number_in(m[1]) * factor(m[2], "displacement")) for m in _LENGTH.finditer(name)
    ]
    half, full = bool(_HALF.search(name)), bool(_FULL.search(name))
    may_be = [amplitude] * (half or not full) + [2.0 * amplitude] * (full or not half)
    shown = (
        f"the record has an amplitude of {amplitude:.3g} in (a stroke of {2 * amplitude:.3g} in)"
    )
    yield from _fault(record, lengths, may_be, shown)
    rates = [(m[0], number_in(m[1])) for m in _FREQUENCY.finditer(name)]
    shown = f"the record's motion has {rate:.3g} Hz"
    yield from _fault(record, rates, [rate, record.rate], shown)


def _of_actuation(record: Record, trace: Trace) -> Iterator[Fault]:
    """Pressure or tension, as the campaign or a column gives it, of the same kind as the name's."""
    if record.actuation is None:
        return
    found = []
    for match in _ACTUATION.finditer(record.path.stem):
        unit = _SPELLED.get(match[2].lower(), match[2].lower())
        value, internal = parse_actuation(f"{number_in(match[1]):g} {unit}")
        if internal == record.actuation_unit:
            found.append((match[0], value))
    level = float(np.mean(record.actuation))
    if "actuation" in record.columns:
        unit = record.columns["actuation"][1]
        shown = f"its column has an actuation of {level / actuation_factor(unit)[0]:.4g} {unit}"
    else:
        words = record.given_actuation or f"{level:.4g} {record.actuation_unit}"
        shown = f"the campaign has an actuation of {words}"
    yield from _fault(record, found, [level], shown)


def number_in(text: str) -> float:
    """Number that `NUMBER` has found."""
    return float(text.lower().replace("p", ".").replace(",", "."))


def _fault(
    record: Record, declared: list[tuple[str, float]], found: list[float], shown: str
) -> Iterator[Fault]:
    """A warning where none of the declared values, in internal units, is among those found."""
    agree = any(abs(f - value) <= TOLERANCE * value + 1e-9 for _, value in declared for f in found)
    if declared and not agree:
        said = " and ".join(dict.fromkeys(word for word, _ in declared))
        yield Fault("file name", f"the name of {record.path.name} says {said}, but {shown}")
