"""A look at a record before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.messages import Message, Quantity
from mfd_bayes.records.data_quality import Fault, contradictions, find_faults
from mfd_bayes.records.loops import Loops, find_loops, measured_cycles
from mfd_bayes.records.record import NO_ACTUATION, Record
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
    turns, strong = trace.cycle_turns.size, loops.strong
    facts = {"displacement": _message("{}", (trace.displacement, "in"))}
    if trace.timed:
        facts["velocity"] = _message("{}", (trace.velocity, "in/s"))
    facts["turning points"] = Message(f"{turns} ({turns / 2:g} cycles)")
    if strong.size:
        some = "" if strong.all() else f", {np.count_nonzero(strong)} of them at full stroke"
        text, values = f"{strong.size}{some}", dict[str, Quantity]()
        named = {"amplitude": (loops.amplitude, "in"), "frequency": (1.0 / loops.period, "Hz")}
        for which, (own, unit) in list(named.items())[: 1 + trace.timed]:
            low, middle, high = (float(v) for v in np.quantile(own[strong], [0.0, 0.5, 1.0]))
            text += f"{', ' if values else ': '}{which} {{{which}}}"
            values[which] = Quantity.of(middle, unit=unit)
            if high - low > 0.01 * middle:
                text += f" ({{{which}_ends}})"
                values[f"{which}_ends"] = Quantity.of(low, high, unit=unit)
        facts["full loops"] = Message(text, values)
    if record.actuation is not None and record.given_actuation != NO_ACTUATION:
        history = " (mean of a history)" if trace.varying else ""
        level = (float(np.mean(record.actuation)), str(record.actuation_unit))
        facts["actuation"] = _message(f"{{}}{history}", level, digits=3)
    return facts


def _facts_of_force(record: Record, trace: Trace, loops: Loops) -> dict[str, Message]:
    """Range of the force, measured values of the cycles, and drifts.

    Values that not every model's quantities have are left out where the record's have not.
    """
    force, has = np.asarray(trace.force), record.axes.has
    at_peak = max(np.count_nonzero(force == end) for end in (force.min(), force.max()))
    facts = {"force": _message(f"{{}}, samples at a peak: {at_peak}", (force, "kip"))}
    cycles = measured_cycles(record)
    if cycles is None or not cycles.energy.size:
        return facts
    own, since = cycles.of_test(), "from the first loops to the last"
    sides = "{} forward, {} backward"
    peaks, slips = ([(own[f"{n}_{s}"], "kip") for s in ("fwd", "bwd")] for n in ("peak", "slip"))
    facts["peak force"] = _message(sides, *peaks)
    for title, kept, which in (
        ("energy per cycle", cycles.full_stroke, "at full stroke"),
        ("energy of ramps", ~cycles.full_stroke, "smaller"),
    ):
        energy = cycles.energy[kept]
        if energy.size and has("energy"):
            text = f"{{}} (mean of {energy.size} {which}, {{}})"
            facts[title] = _message(text, (energy.mean(), "kip*in"), (energy, "kip*in"))
    if loops.energy_drift is not None and has("energy"):
        facts["energy drift"] = Message(f"{loops.energy_drift:+.1%} {since}")
    offset = (float(np.median(cycles.offset)), "kip")
    facts["force offset"] = _message("{}, mean along a loop", offset, digits=3)
    if loops.offset_drift is not None:
        facts["force drift"] = _message(f"{{}} {since}", (loops.offset_drift, "kip"), digits=3)
    if has("slip") and np.isfinite([value for value, _ in slips]).all():
        facts["slip force"] = _message(f"{sides}, at mid-stroke", *slips)
    for title, name, unit in (
        ("effective stiffness", "effective_stiffness", "kip/in"),
        ("effective damping", "effective_damping", ""),
        ("equivalent damping", "c_eq", "kip*s/in"),
        ("gap", "gap", "in"),
        ("build-up slope", "build_up_slope", "kip/in"),
    ):
        if np.isfinite(own[name]) and (has(name) or name == "effective_stiffness"):
            shown = _message("{}", (own[name], unit)) if unit else Message(f"{own[name]:.4g}")
            facts[title] = shown
    return facts


def _message(text: str, *values: tuple[Array | float, str], digits: int = 4) -> Message:
    """A text with quantities, each a value or the ends of several, and its internal unit."""
    quantities = {}
    for number, (value, unit) in enumerate(values):
        ends = (np.min(value), np.max(value)) if np.ndim(value) else (value,)
        quantities[f"value{number}"] = Quantity.of(*map(float, ends), unit=unit, digits=digits)
    return Message(text.format(*(f"{{{name}}}" for name in quantities)), quantities)
