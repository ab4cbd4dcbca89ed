"""A look at a record before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.messages import Message, Quantity
from mfd_bayes.records.channels import NO_ACTUATION
from mfd_bayes.records.data_quality import Fault, find_faults
from mfd_bayes.records.file_name_check import contradictions
from mfd_bayes.records.loops import Loops, find_loops, measured_cycles
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Array, Trace, without_spikes


@dataclass(frozen=True, eq=False)
class Inspection:
    """Facts, loops and faults of a record."""

    name: str
    facts: dict[str, Message]  # by title: file, columns, rate, ranges, loops, measured values
    trace: Trace  # at the record's own rate
    loops: Loops
    faults: tuple[Fault, ...]


def inspect_record(name: str, record: Record, gap: float | None = None) -> Inspection:
    """Columns, units, rate, loops, measured values, drifts and faults of a record.

    `gap` is the median width of the gap, in, under the priors, if there are any.
    """
    raw = record.trace()
    trace = without_spikes(raw)
    loops = find_loops(trace)
    facts = _facts_of_file(record, trace) | _facts_of_motion(record, trace, loops)
    if trace.force is not None:
        facts |= _facts_of_force(record, trace, loops)
    faults = (*contradictions(record, trace), *find_faults(raw, gap))
    return Inspection(name, facts, raw, loops, faults)


def _facts_of_file(record: Record, trace: Trace) -> dict[str, Message]:
    name, columns = record.axes.name, record.columns.items()
    texts = {
        "file": record.path.name,
        "columns": ", ".join(f"{name(role)}: {n} [{unit}]" for role, (n, unit) in columns),
        **{f"{name(role)} is made of": text for role, text in record.derived.items()},
        "columns not used": ", ".join(record.other_columns),
        "rows not used": "; ".join(record.notes),
        "samples": f"{trace.samples}",
    }
    if trace.timed:
        texts["samples"] += f" over {trace.time[-1] - trace.time[0]:.6g} s"
        texts["rate"] = record.clock.words()
    return {title: Message("{text}", {"text": text}) for title, text in texts.items() if text}


def _facts_of_motion(record: Record, trace: Trace, loops: Loops) -> dict[str, Message]:
    x, turns, strong = trace.displacement, trace.cycle_turns.size, loops.strong
    facts = {"displacement": _range(x, "in")}
    if trace.timed:
        facts["velocity"] = _range(trace.velocity, "in/s")
    facts["turning points"] = Message(f"{turns} ({turns / 2:g} cycles)")
    if strong.size:
        some = "" if strong.all() else f", {np.count_nonzero(strong)} of them at full stroke"
        amplitude, stroke = _middle(loops.amplitude[strong], "amplitude", "in")
        text = f"{strong.size}{some}: amplitude {amplitude}"
        if trace.timed:
            frequency, rates = _middle(1.0 / loops.period[strong], "frequency", "Hz")
            text, stroke = f"{text}, frequency {frequency}", stroke | rates
        facts["full loops"] = Message(text, stroke)
    if record.actuation is not None and record.given_actuation != NO_ACTUATION:
        level = Quantity.of(float(np.mean(record.actuation)), unit=str(record.actuation_unit))
        history = " (mean of a history)" if trace.varying else ""
        facts["actuation"] = Message(f"{{level}}{history}", {"level": level})
    return facts


def _facts_of_force(record: Record, trace: Trace, loops: Loops) -> dict[str, Message]:
    """Range of the force, measured values of the cycles, and drifts."""
    force = np.asarray(trace.force)
    at_peak = max(np.count_nonzero(force == end) for end in (force.min(), force.max()))
    facts = {"force": _range(force, "kip", f", samples at a peak: {at_peak}")}
    cycles = measured_cycles(record)
    assert cycles is not None
    if not cycles.energy.size:
        return facts
    own = cycles.of_test()
    facts["peak force"] = _both("{fwd} forward, {bwd} backward", own, "peak", "kip")
    for title, kept, which in (
        ("energy per cycle", cycles.full_stroke, "at full stroke"),
        ("energy of ramps", ~cycles.full_stroke, "smaller"),
    ):
        energy = cycles.energy[kept]
        if energy.size:
            mean = Quantity.of(energy.mean(), unit="kip*in", digits=4)
            ends = Quantity.of(energy.min(), energy.max(), unit="kip*in", digits=4)
            facts[title] = Message(
                f"{{mean}} (mean of {energy.size} {which}, {{ends}})", {"mean": mean, "ends": ends}
            )
    since = "from the first loops to the last"
    if loops.energy_drift is not None:
        facts["energy drift"] = Message(f"{loops.energy_drift:+.1%} {since}")
    offset = Quantity.of(np.median(cycles.offset), unit="kip")
    facts["force offset"] = Message("{offset}, mean along a loop", {"offset": offset})
    if loops.offset_drift is not None:
        drift = Quantity.of(loops.offset_drift, unit="kip")
        facts["force drift"] = Message(f"{{drift}} {since}", {"drift": drift})
    facts["slip force"] = _both("{fwd} forward, {bwd} backward, at mid-stroke", own, "slip", "kip")
    for title, name, unit in (
        ("effective stiffness", "effective_stiffness", "kip/in"),
        ("effective damping", "effective_damping", "1"),
        ("equivalent damping", "c_eq", "kip*s/in"),
        ("gap", "gap", "in"),
        ("build-up slope", "build_up_slope", "kip/in"),
    ):
        value = Quantity.of(own[name], unit=unit, digits=4)
        text = f"{own[name]:.4g}" if unit == "1" else "{value}"
        if np.isfinite(own[name]):
            facts[title] = Message(text, {"value": value})
    dropped = {title for title, name in _TITLES.items() if not record.axes.has(name)}
    return {t: fact for t, fact in facts.items() if t not in dropped and "nan" not in str(fact)}


_TITLES = {
    "energy per cycle": "energy",
    "energy of ramps": "energy",
    "energy drift": "energy",
    "slip force": "slip",
    "effective damping": "effective_damping",
    "equivalent damping": "c_eq",
    "gap": "gap",
    "build-up slope": "build_up_slope",
}
"""Facts that not every model's quantities have, and the property that each is of."""


def _both(template: str, values: dict[str, float], name: str, unit: str) -> Message:
    """A sentence with a value of each direction."""
    sides = {side: Quantity.of(values[f"{name}_{side}"], unit=unit, digits=4) for side in _SIDES}
    return Message(template, sides)


_SIDES = ("fwd", "bwd")


def _range(values: Array, unit: str, more: str = "") -> Message:
    """The smallest and the largest value."""
    ends = Quantity.of(values.min(), values.max(), unit=unit, digits=4)
    return Message(f"{{ends}}{more}", {"ends": ends})


def _middle(values: Array, name: str, unit: str) -> tuple[str, dict[str, Quantity]]:
    """Median, with the smallest and the largest where they differ by more than 1 %."""
    low, middle, high = (float(v) for v in np.quantile(values, [0.0, 0.5, 1.0]))
    quantities = {name: Quantity.of(middle, unit=unit)}
    if high - low <= 0.01 * middle:
        return f"{{{name}}}", quantities
    ends = Quantity.of(low, high, unit=unit)
    return f"{{{name}}} ({{{name}_ends}})", quantities | {f"{name}_ends": ends}
