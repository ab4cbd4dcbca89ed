"""What the tests of a run cover, and where a motion leaves it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mfd_bayes.population.design import RATE, SAME_LEVEL, STROKE
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import UnitSystem

MARGIN = 0.1
"""A stroke, speed or frequency within this share of a tested one counts as tested."""

FAR = 2.0
"""Far outside: so many times the largest tested value, or so many times below the smallest
tested actuation."""

FASTEST = 0.995
"""Quantile of the speeds of a motion that is its peak: the noise of a few samples is not."""

PARTIAL = 0.5
"""A motion more of whose strokes than this share are partial has no cycles at full stroke."""

_SHARE = 20  # of a half-cycle, over which a speed is taken, so that noise does not make it
_UNITS = {"stroke": "in", "speed": "in/s", "frequency": "Hz"}
_MARGINS = {"stroke": MARGIN, "speed": MARGIN, "frequency": MARGIN, "actuation": SAME_LEVEL}


@dataclass(frozen=True)
class Range:
    """Smallest and largest value of one condition, in its internal unit."""

    name: str
    unit: str
    lowest: float
    highest: float

    def words(self, system: UnitSystem) -> str:
        """Both values with their unit, such as "500 to 1500 psi"."""
        actuation = self.name == "actuation"
        ends = self.lowest, self.highest
        return system.words(ends, self.unit, 4 if actuation else 3, actuation=actuation)


@dataclass(frozen=True)
class Extrapolation:
    """A condition of a motion that lies outside what was tested."""

    reached: Range
    tested: Range

    @property
    def times(self) -> float:
        """How many times the largest tested value it is; below 1 where it is too small."""
        if self.reached.highest > self.tested.highest * (1.0 + _MARGINS[self.reached.name]):
            return self.reached.highest / self.tested.highest if self.tested.highest else np.inf
        return self.reached.lowest / self.tested.lowest

    @property
    def far(self) -> bool:
        """Whether it lies so far outside that a prediction has to be asked for expressly."""
        margin = _MARGINS[self.reached.name]
        if self.reached.highest > FAR * (1.0 + margin) * self.tested.highest:
            return True
        low = self.tested.lowest * (1.0 - margin) / FAR
        return self.reached.name == "actuation" and self.reached.lowest < low

    def sentence(self, system: UnitSystem, *, widened: bool = False) -> str:
        """What lies outside, of what, and what a band, `widened` for it or not, rests on there."""
        name, times = self.reached.name, self.times
        form = "the form of the laws" if name == "actuation" else "the form of the model"
        rests = f"relies only on {form}"
        if widened and name != "actuation":
            of_stroke = name == "stroke"
            subject, slope = ("slip force and gap", STROKE) if of_stroke else ("slip force", RATE)
            rests = (
                f"is wider, by what {subject} may do ({100 * slope:.0f} % for each factor of 2.7), "
                f"but relies on {form}"
            )
        return (
            f"the {name}, {self.reached.words(system)}, lies {'far ' if self.far else ''}outside "
            f"the tested range, {self.tested.words(system)} ({float(f'{times:.2g}'):g} times the "
            f"{'largest' if times > 1 else 'smallest'}): there the band {rests}"
        )


def conditions_of(trace: Trace) -> dict[str, float]:
    """Stroke (in), peak speed (in/s), frequency (Hz) and level of actuation of a trace.

    And its share of partial strokes, "partial", where it turns twice or more. Frequency is left
    out where the motion has no full loop, actuation where it is not known.
    """
    turns = trace.cycle_turns
    half = float(np.median(np.diff(turns))) if turns.size > 1 else trace.samples - 1.0
    step = max(1, int(half) // _SHARE)
    speeds = (trace.displacement[step:] - trace.displacement[:-step]) / (
        trace.time[step:] - trace.time[:-step]
    )
    conditions = {"stroke": float(np.ptp(trace.displacement))}
    if trace.timed:
        conditions["speed"] = float(np.quantile(np.abs(speeds), FASTEST))
    if trace.cycle_turns.size > 1:
        conditions["partial"] = partial_strokes(trace)
    loops = find_loops(trace)
    if loops.period.size and trace.timed:
        conditions["frequency"] = float(1.0 / np.median(loops.period[loops.strong]))
    if np.isfinite(trace.reference_actuation):
        conditions["actuation"] = float(trace.reference_actuation)
    return conditions


def partial_strokes(trace: Trace) -> float:
    """Share of the strokes of a motion, from turn to turn, that go over less than half of it all.

    Cycles of a constant or a growing amplitude have few, an earthquake has most. 0 without a turn.
    """
    strokes = np.abs(np.diff(trace.displacement[trace.cycle_turns]))
    shorter = strokes < 0.5 * np.ptp(trace.displacement)
    return float(np.mean(shorter)) if strokes.size else 0.0


def kind_sentence(tests: Iterable[Mapping[str, float]], trace: Trace) -> str:
    """That a motion is of another kind than all tests, whose conditions are given; "" if not."""
    share = partial_strokes(trace)
    tested = max((test.get("partial", 1.0) for test in tests), default=1.0)
    if share <= PARTIAL or tested > PARTIAL:
        return ""
    return (
        f"most strokes of this motion are partial, as those of an earthquake ({100 * share:.0f} % "
        "go over less than half of its whole stroke), and the tests went through full cycles (at "
        f"most {100 * tested:.0f} %): a motion of another kind is predicted less well, and its "
        "force and energy lie outside of the band more often than its probability says"
    )


def range_of(tests: Iterable[Mapping[str, float]], actuation_unit: str) -> tuple[Range, ...]:
    """Smallest and largest value of each condition among tests, of `conditions_of`."""
    several = list(tests)
    spans = []
    for name in _MARGINS:
        values = [test[name] for test in several if name in test]
        if values:
            unit = _UNITS.get(name, actuation_unit)
            spans.append(Range(name, unit, min(values), max(values)))
    return tuple(spans)


def reach_of(trace: Trace, actuation_unit: str) -> tuple[Range, ...]:
    """As `conditions`, but with the least and the largest actuation of a history."""
    reached, levels = conditions_of(trace), np.atleast_1d(trace.actuation)
    if not np.all(np.isfinite(levels)):
        reached.pop("actuation", None)
        return range_of([reached], actuation_unit)
    ends = ({**reached, "actuation": float(level)} for level in (levels.min(), levels.max()))
    return range_of(ends, actuation_unit)


def extrapolations(tested: Iterable[Range], reached: Iterable[Range]) -> tuple[Extrapolation, ...]:
    """Which of the reached conditions lie outside what was tested.

    A peak speed below those of the tests is none: every test passes through all speeds down to
    rest. A stroke below is one, for the damper may then not slip at all.
    """
    by_name = {span.name: span for span in reached}
    extrapolations = []
    for tested_span in tested:
        span, margin = by_name.get(tested_span.name), _MARGINS[tested_span.name]
        if span is None:
            continue
        is_above = span.highest > tested_span.highest * (1.0 + margin)
        is_below = span.lowest < tested_span.lowest * (1.0 - margin) and tested_span.name != "speed"
        if is_above or is_below:
            extrapolations.append(Extrapolation(span, tested_span))
    return tuple(extrapolations)


def extrapolation_messages(extrapolations: Iterable[Extrapolation], system: UnitSystem) -> str:
    """The extrapolations that are far, as one text; empty where there are none."""
    return "; ".join(
        extrapolation.sentence(system) for extrapolation in extrapolations if extrapolation.far
    )
