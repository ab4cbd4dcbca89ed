"""Values of each cycle of a loop, as the standards define them: measured, or of predicted forces.

With D+ and D- the largest and the smallest displacement of a cycle and F+ and F- the forces there,

    K_eff = (F+ - F-) / (D+ - D-),    beta_eff = (2/pi) E / (K_eff (D+ - D-)^2),    E = ∮ F dx

(ASCE/SEI 7, chapters 17 and 18; EN 15129 has the same damping as E / (2 pi K_eff d^2), with d half
of the stroke). Zero displacement is the middle of the cycle's stroke, whatever zero the sensor has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.loops import find_loops, stroke_estimates
from mfd_bayes.records.motion import Array
from mfd_bayes.records.record import Record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace

UNITS: Mapping[str, str] = {
    "slip_fwd": "kip",
    "slip_bwd": "kip",
    "peak_fwd": "kip",
    "peak_bwd": "kip",
    "effective_stiffness": "kip/in",
    "effective_damping": "1",
    "energy": "kip*in",
    "c_eq": "kip*s/in",
    "build_up_slope": "kip/in",
    "gap": "in",
}
"""Internal unit of the values of a cycle, in the order of tables."""

FORMULAS: Mapping[str, str] = {
    "slip_force": "force at zero displacement, in the direction of the motion; zero displacement "
    "is the middle of the stroke",
    "peak_force": "largest force of the cycle in the direction of the motion",
    "effective_stiffness": "K_eff = (|F+| + |F-|) / (|D+| + |D-|), F+ and F- at the largest and "
    "the smallest displacement D+ and D- (ASCE/SEI 7, 17.2.8)",
    "effective_damping": "beta_eff = (2/pi) E_loop / (K_eff (|D+| + |D-|)^2) (ASCE/SEI 7, 17.2.8)",
    "energy": "E_loop, the area of the loop: the integral of F dx over the cycle",
    "c_eq": "E_loop over the integral of v^2 dt over the cycle",
    "build_up_slope": "slope of the force after the gap, from 20 % to 80 % of the slip force; mean "
    "of both strokes",
    "gap": "travel after a turn at which the line of the build-up, from 20 % to 80 % of the slip "
    "force, meets the slip force; mean of both strokes",
}
"""How each value is computed, in words, by quantity."""


@dataclass(frozen=True, eq=False)
class MeasuredCycles:
    """Measured values of the L full cycles of a record, (L,) each, in internal units (`UNITS`).

    They are of the record's own samples: no model, no filter, and no offset is taken off. Forces
    are positive in the direction of the motion.
    """

    time: Array  # s, at which each cycle begins
    stroke: Array  # in, from the smallest to the largest displacement
    frequency: Array  # Hz
    full_stroke: NDArray[np.bool_]  # at least 95 % of the largest stroke; others ramp in or out
    slip_fwd: Array  # force at zero displacement
    slip_bwd: Array
    peak_fwd: Array
    peak_bwd: Array
    effective_stiffness: Array
    effective_damping: Array
    energy: Array
    c_eq: Array  # equivalent viscous damping coefficient
    build_up_slope: Array  # this and the gap are NaN where they cannot be read off
    gap: Array
    offset: Array  # kip; would make the mean force of both directions equal; it is not applied
    largest_fwd: float  # kip, of all samples, also of those in no full cycle; so are the next two
    largest_bwd: float
    total_energy: float

    def of_test(self) -> dict[str, float]:
        """One value of each quantity: the largest peak, of others the mean at full stroke."""
        means = {name: float(mean_of(getattr(self, name), self.full_stroke)) for name in UNITS}
        return means | {"peak_fwd": self.largest_fwd, "peak_bwd": self.largest_bwd}

    def to_content(self) -> dict[str, tuple[float, ...]]:
        """The values as plain numbers by name, for JSON."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: tuple(np.atleast_1d(value).astype(float).tolist()) for name, value in values}

    @classmethod
    def from_content(cls, content: Mapping[str, Sequence[float]]) -> MeasuredCycles:
        """The values from `to_content`; ValueError where some are missing."""
        if missing := [f.name for f in fields(cls) if f.name not in content]:
            raise ValueError(f"{missing[0]} is missing")
        values: dict[str, Any] = {f.name: np.array(content[f.name]) for f in fields(cls)}
        whole = ("largest_fwd", "largest_bwd", "total_energy")
        cycles = values["time"].size
        if wrong := [n for n, v in values.items() if v.size != (1 if n in whole else cycles)]:
            raise ValueError(f"{wrong[0]} has {values[wrong[0]].size} values")
        values["full_stroke"] = values["full_stroke"] > 0.0
        for name in whole:
            values[name] = float(values[name][0])
        return cls(**values)


def measured_cycles(record: Record | Trace) -> MeasuredCycles | None:
    """Measured values of every full cycle of a record in its fit window; None without a force.

    Spikes, which `inspect` names, count for nothing. Of a trace, its own samples are taken.
    """
    trace = without_spikes(record.trace() if isinstance(record, Record) else record)
    if trace.force is None:
        return None
    force, loops = trace.force[None], find_loops(trace)
    values = {name: value[0] for name, value in cycle_values(trace, force).items()}
    return MeasuredCycles(
        time=trace.time[loops.bounds[:-1]],
        stroke=2.0 * loops.amplitude,
        frequency=1.0 / loops.period,
        full_stroke=loops.strong,
        offset=np.asarray(loops.offset),
        largest_fwd=float(force.max()),
        largest_bwd=float(-force.min()),
        total_energy=float(np.trapezoid(force[0], trace.displacement)),
        **values,
    )


def cycle_values(trace: Trace, force: Array) -> dict[str, Array]:
    """Values of every full cycle of a motion under forces (n, T), kip: (n, L) each, by name."""
    loops, x = find_loops(trace), trace.displacement
    n, count = len(force), max(loops.bounds.size - 1, 0)
    values = {name: np.full((n, count), np.nan) for name in UNITS}
    if not count:
        return values
    strokes = stroke_estimates(trace, force)
    turns = trace.cycle_turns[: 2 * count + 1]
    for cycle, (begin, end) in enumerate(pairwise(loops.bounds.tolist())):
        kept = slice(begin, end + 1)
        f, motion = force[:, kept], x[kept]
        high, low = begin + int(motion.argmax()), begin + int(motion.argmin())
        stroke = x[high] - x[low]
        stiffness = (force[:, high] - force[:, low]) / stroke
        stiffness[stiffness == 0.0] = np.nan
        energy = np.trapezoid(f, motion, axis=1)
        values["peak_fwd"][:, cycle], values["peak_bwd"][:, cycle] = f.max(axis=1), -f.min(axis=1)
        values["effective_stiffness"][:, cycle] = stiffness
        values["effective_damping"][:, cycle] = 2.0 / np.pi * energy / (stiffness * stroke**2)
        values["energy"][:, cycle] = energy
        values["c_eq"][:, cycle] = energy / np.trapezoid(
            trace.velocity[kept] ** 2, trace.time[kept]
        )
        halves = turns[2 * cycle : 2 * cycle + 3].tolist()
        for first, last in pairwise(halves):
            sign = 1.0 if x[last] > x[first] else -1.0
            side = "slip_fwd" if sign > 0.0 else "slip_bwd"
            values[side][:, cycle] = sign * _at(x, force, first, last, 0.5 * (x[high] + x[low]))
        both = slice(2 * cycle, 2 * cycle + 2)
        for name, read in (("build_up_slope", strokes.slope), ("gap", strokes.gap)):
            values[name][:, cycle] = mean_of(read[:, both])
    return values


def mean_of(values: Array, kept: NDArray[np.bool_] | None = None) -> Array:
    """Mean of values (…, L) that are known, of some cycles or of all, (…); NaN where none is."""
    known = np.isfinite(values) if kept is None else np.isfinite(values) & kept
    count, total = known.sum(axis=-1), np.where(known, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _at(x: Array, force: Array, first: int, last: int, level: float) -> Array:
    """Forces, (n,), where the motion first crosses a displacement between two turns."""
    away = (x[first : last + 1] - level) * (1.0 if x[last] > x[first] else -1.0)
    after = first + int(np.argmax(away >= 0.0))
    if after == first:
        return force[:, first]
    share = (level - x[after - 1]) / (x[after] - x[after - 1])
    return np.asarray(force[:, after - 1] + share * (force[:, after] - force[:, after - 1]))
