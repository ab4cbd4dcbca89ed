"""What the tests of a run cover, and where a motion leaves it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mfd_bayes.population.beyond import RATE, STROKE
from mfd_bayes.population.setting import SAME_LEVEL
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.systems import System

MARGIN = 0.1
"""A stroke, speed or frequency within this share of a tested one counts as tested."""

FAR = 2.0
"""Far outside: so many times the largest tested value, or so many times below the smallest
tested actuation."""

FASTEST = 0.995
"""Quantile of the speeds of a motion that is its peak: the noise of a few samples is not."""

_SHARE = 20  # of a half-cycle, over which a speed is taken, so that noise does not make it

_MARGINS = {"stroke": MARGIN, "speed": MARGIN, "frequency": MARGIN, "actuation": SAME_LEVEL}
_FORM = {"actuation": "the form of the laws"}


@dataclass(frozen=True)
class Span:
    """Smallest and largest value of one condition, in its internal unit.

    Attributes
    ----------
    name : {"stroke", "speed", "frequency", "actuation"}
        Stroke: from one end of the motion to the other, in. Speed: its peak, in/s. Frequency: of
        the largest loops, Hz. Actuation, ksi or kip: over a history, if it is one.
    """

    name: str
    unit: str
    lowest: float
    highest: float

    def words(self, system: System) -> str:
        """Both values with their unit, such as "500 to 1500 psi"."""
        ends = self.lowest, self.highest
        if self.name == "actuation":
            return system.words(ends, self.unit, actuation=True)
        return system.words(ends, self.unit, 3)


@dataclass(frozen=True)
class Departure:
    """A condition of a motion that lies outside what was tested."""

    asked: Span
    tested: Span

    @property
    def times(self) -> float:
        """How many times the largest tested value it is; below 1 where it is too small."""
        if self.asked.highest > self.tested.highest * (1.0 + _MARGINS[self.asked.name]):
            return self.asked.highest / self.tested.highest if self.tested.highest else np.inf
        return self.asked.lowest / self.tested.lowest

    @property
    def far(self) -> bool:
        """Whether it lies so far outside that a prediction has to be asked for expressly."""
        margin = _MARGINS[self.asked.name]
        if self.asked.highest > FAR * (1.0 + margin) * self.tested.highest:
            return True
        low = self.tested.lowest * (1.0 - margin) / FAR
        return self.asked.name == "actuation" and self.asked.lowest < low

    def sentence(self, system: System, *, widened: bool = False) -> str:
        """What lies outside, of what, and what the prediction rests on there.

        Parameters
        ----------
        system : System
        widened : bool
            Whether the band is wider for it.
        """
        name = self.asked.name
        how = "far outside" if self.far else "outside"
        times = self.times
        many = f" ({float(f'{times:.2g}'):g} times the {'largest' if times > 1 else 'smallest'})"
        return (
            f"the {name}, {self.asked.words(system)}, lies {how} the tested range, "
            f"{self.tested.words(system)}{many}: there the band {_relies(name, widened=widened)}"
        )


def _relies(condition: str, *, widened: bool) -> str:
    """What a band does outside the tested range of a condition."""
    form = _FORM.get(condition, "the form of the model")
    if not widened or condition == "actuation":
        return f"relies only on {form}"
    what, slope = ("slip force and gap", STROKE) if condition == "stroke" else ("slip force", RATE)
    return (
        f"is wider, by what {what} may do ({100 * slope:.0f} % for each factor of 2.7), but relies "
        f"on {form}"
    )


def reach_of(trace: Trace, actuation_unit: str) -> tuple[Span, ...]:
    """Stroke, peak speed, frequency and actuation that a motion reaches.

    Frequency is left out where the motion has no full loop, and actuation where it is not known.
    """
    loops = find_loops(trace)
    found = {
        "stroke": (float(np.ptp(trace.displacement)), "in"),
        "speed": (_peak_speed(trace), "in/s"),
    }
    if loops.period.size:
        found["frequency"] = (float(1.0 / np.median(loops.period[loops.strong])), "Hz")
    spans = [Span(name, unit, value, value) for name, (value, unit) in found.items()]
    levels = np.atleast_1d(trace.actuation)
    if np.all(np.isfinite(levels)):
        ends = float(levels.min()), float(levels.max())
        spans.append(Span("actuation", actuation_unit, *ends))
    return tuple(spans)


def conditions(trace: Trace, actuation_unit: str) -> tuple[Span, ...]:
    """Conditions of a test: as `reach_of`, but with the level that its parameters belong to."""
    level = trace.reference_actuation
    spans = (s for s in reach_of(trace, actuation_unit) if s.name != "actuation")
    own = (Span("actuation", actuation_unit, level, level),) if np.isfinite(level) else ()
    return (*spans, *own)


def range_of(traces: Iterable[Trace], actuation_unit: str) -> tuple[Span, ...]:
    """Smallest and largest value of each condition among tests."""
    found: dict[str, Span] = {}
    for trace in traces:
        for span in conditions(trace, actuation_unit):
            held = found.get(span.name, span)
            ends = min(held.lowest, span.lowest), max(held.highest, span.highest)
            found[span.name] = Span(span.name, span.unit, *ends)
    return tuple(found[name] for name in _MARGINS if name in found)


def departures(tested: Iterable[Span], trace: Trace, actuation_unit: str) -> tuple[Departure, ...]:
    """Where a motion leaves what was tested.

    A peak speed below those of the tests is none: every test passes through all speeds down to
    rest. A stroke below is one, for the damper may then not slip at all.
    """
    return leaving(tested, reach_of(trace, actuation_unit))


def leaving(tested: Iterable[Span], asked: Iterable[Span]) -> tuple[Departure, ...]:
    """Which of the conditions that are asked for lie outside what was tested."""
    known = {span.name: span for span in asked}
    return tuple(
        Departure(known[span.name], span)
        for span in tested
        if span.name in known and _leaves(known[span.name], span)
    )


def far_sentences(found: Iterable[Departure], system: System) -> str:
    """The departures that are far, as one text; empty where there are none."""
    return "; ".join(departure.sentence(system) for departure in found if departure.far)


def _peak_speed(trace: Trace) -> float:
    """Peak of the speed over a twentieth of the median half-cycle, in/s."""
    turns = trace.cycle_turns
    half = float(np.median(np.diff(turns))) if turns.size > 1 else trace.samples - 1.0
    step = max(1, int(half) // _SHARE)
    moved = trace.displacement[step:] - trace.displacement[:-step]
    return float(np.quantile(np.abs(moved / (trace.time[step:] - trace.time[:-step])), FASTEST))


def _leaves(asked: Span, tested: Span) -> bool:
    margin = _MARGINS[asked.name]
    above = asked.highest > tested.highest * (1.0 + margin)
    below = asked.lowest < tested.lowest * (1.0 - margin)
    return above or (below and asked.name != "speed")
