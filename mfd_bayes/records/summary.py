"""A look at a record before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.records.data_quality import Fault, find_faults
from mfd_bayes.records.file_name_check import contradictions
from mfd_bayes.records.loop_features import read_off
from mfd_bayes.records.loops import Loops, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.record import Record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace


@dataclass(frozen=True, eq=False)
class Inspection:
    """Facts, loops and faults of a record."""

    name: str
    facts: dict[str, str]  # title to text: file, columns, rate, ranges, loops, drifts
    trace: Trace  # at the record's own rate
    loops: Loops
    faults: tuple[Fault, ...]


def inspect_record(name: str, record: Record, gap: float | None = None) -> Inspection:
    """Columns, units, rate, loops, drifts and faults of a record.

    `gap` is the median width of the gap, in, under the priors, if there are any.
    """
    raw = record.trace()
    trace = without_spikes(raw)
    loops = find_loops(trace)
    x, turns = trace.displacement, trace.cycle_turns.size
    columns = ", ".join(f"{role}: {n} [{unit}]" for role, (n, unit) in record.columns.items())
    others = ", ".join(record.other_columns)
    facts = {
        "file": record.path.name,
        "columns": columns,
        **{f"{role} is made of": text for role, text in record.derived.items()},
        **({"columns not used": others} if others else {}),
        **({"rows not used": "; ".join(record.notes)} if record.notes else {}),
        "samples": f"{trace.samples} over {trace.time[-1] - trace.time[0]:.6g} s",
        "rate": record.clock.words(),
        "displacement": f"{x.min():.4g} to {x.max():.4g} in",
        "velocity": f"{trace.velocity.min():.4g} to {trace.velocity.max():.4g} in/s",
        "turning points": f"{turns} ({turns / 2:g} cycles)",
    }
    strong, force = loops.strong, trace.force
    if strong.size:
        some = "" if strong.all() else f", {np.count_nonzero(strong)} of them at full stroke"
        amplitude, frequency = _range(loops.amplitude[strong]), _range(1 / loops.period[strong])
        facts["full loops"] = f"{strong.size}{some}: amplitude {amplitude} in, "
        facts["full loops"] += f"frequency {frequency} Hz"
    if record.actuation is not None:
        level = float(np.mean(record.actuation))
        history = " (mean of a history)" if trace.varying else ""
        facts["actuation"] = f"{level:.4g} {record.actuation_unit}{history}"
    if force is not None:
        low, high = force.min(), force.max()
        at_peak = max(np.count_nonzero(force == high), np.count_nonzero(force == low))
        facts["force"] = f"{low:.4g} to {high:.4g} kip, samples at a peak: {at_peak}"
        if loops.energy is not None and loops.offset is not None and loops.energy.size:
            for title, kept, which in (
                ("energy per cycle", strong, "at full stroke"),
                ("energy of ramps", ~strong, "smaller"),
            ):
                if kept.any():
                    energy = loops.energy[kept]
                    facts[title] = (
                        f"{energy.mean():.4g} kip·in (mean of {energy.size} {which}, "
                        f"{energy.min():.4g} to {energy.max():.4g} kip·in)"
                    )
            since = "from the first loops to the last"
            if loops.energy_drift is not None:
                facts["energy drift"] = f"{loops.energy_drift:+.1%} {since}"
            facts["force offset"] = f"{np.median(loops.offset):.3g} kip, mean along a loop"
            if loops.offset_drift is not None:
                facts["force drift"] = f"{loops.offset_drift:+.3g} kip {since}"
        read = read_off(trace)
        slip = f"{read.plateau_fwd:.3g} kip forward, {read.plateau_bwd:.3g} kip backward"
        rise = f"{read.slope:.3g} kip/in, gap {read.gap:.3g} in"
        named = {"slip force, read off": slip, "build-up, read off": rise}
        facts |= {name: text for name, text in named.items() if "nan" not in text}
    faults = (*contradictions(record, trace), *find_faults(raw, gap))
    return Inspection(name, facts, raw, loops, faults)


def _range(values: Array) -> str:
    """Median, with the smallest and the largest where they differ by more than 1 %."""
    low, middle, high = (float(v) for v in np.quantile(values, [0.0, 0.5, 1.0]))
    wide = high - low > 0.01 * middle
    return f"{middle:.3g} ({low:.3g} to {high:.3g})" if wide else f"{middle:.3g}"
