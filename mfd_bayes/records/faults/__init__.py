"""Faults of a record that would spoil its fit: of the sensors, the clock and the units."""

from __future__ import annotations

from mfd_bayes.records.faults import clock, signals
from mfd_bayes.records.faults.fault import Fault
from mfd_bayes.records.faults.signals import mended, without_spikes
from mfd_bayes.records.trace import Trace

__all__ = ["NAMES", "Fault", "find_faults", "mended", "without_spikes"]

NAMES = (
    *(
        "no force",
        "force sign",
        "channels",
        "velocity",
        "time unit",
        "short record",
        "stroke",
        "clipping",
        "lag",
    ),
    *("jump", "held", "displacement zero"),
    *("spikes", "dropped samples", "repeated samples", "resolution", "noise", "rate", "drift"),
)
"""Names of the faults, the most serious first."""

_OF_RECORD = (
    *(
        signals.no_force,
        signals.force_sign,
        signals.velocity,
        signals.clipping,
        signals.lag,
        signals.noise,
        signals.jumps,
        signals.held,
        signals.zero_moves,
    ),
    *(signals.drift, clock.time_unit, clock.short_record, clock.dropped, clock.repeated),
)
_CONSEQUENCES = {
    "channels": {"clipping", "lag", "noise", "drift", "held"},
    "held": {"clipping", "lag", "drift", "repeated samples"},
}
"""Faults that need not be told where another is."""

_OF_GAP = (clock.stroke, clock.rate)


def find_faults(trace: Trace, gap: float | None = None) -> tuple[Fault, ...]:
    """Faults of a record, the most serious first; empty where none was found.

    The trace must have every sample of its record: decimation hides faults. `gap` is the median
    width of the device's gap, in; without it, rate and stroke are not checked.
    """
    found = list(signals.spikes(trace))
    trace = without_spikes(trace)
    found += [fault for check in _OF_RECORD for fault in check(trace)]
    found += signals.resolution(trace, gap)
    if gap is not None:
        found += [fault for check in _OF_GAP for fault in check(trace, gap)]
    hidden = {name for fault in found for name in _CONSEQUENCES.get(fault.name, ())}
    found = [fault for fault in found if fault.name not in hidden]
    return tuple(sorted(found, key=lambda fault: NAMES.index(fault.name)))
