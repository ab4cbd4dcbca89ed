"""Properties of a device: what each one is, and its values for the cycles of a test.

`PROPERTIES` has a record for each. Tables, checks, acceptance, pages and stored runs read it: a new
one is written there, and nowhere else. Measured and computed forces are read alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.loops import (
    OFF_CENTRE,
    UNLOADING,
    WINDOW,
    find_loops,
    mean_of,
    stroke_estimates,
)
from mfd_bayes.records.trace import Array, Trace, without_spikes
from mfd_bayes.units import Axes


@dataclass(frozen=True, eq=False)
class Cycle:
    """One full cycle of a motion, of m samples, under n forces."""

    time: Array  # (m,), s
    displacement: Array  # (m,), in
    velocity: Array  # (m,), in/s
    force: Array  # (n, m), kip
    slip: Array  # (n, 2), kip, of the stroke forward and of the one backward, see `Strokes`
    slope: Array  # (n, 2), kip/in, of the build-up of the force in both strokes
    gap: Array  # (n, 2), in

    @cached_property
    def stroke(self) -> float:
        """From the smallest to the largest displacement, in."""
        high, low = self._ends
        return np.float64(self.displacement[high] - self.displacement[low])

    def slip_force(self, sign: float) -> Array:
        """Slip force forward (1) or backward (−1), (n,), kip."""
        return self.slip[:, 0 if sign > 0.0 else 1]

    def peak_force(self, sign: float) -> Array:
        """Largest force forward (1) or backward (−1), (n,), kip."""
        return np.asarray(np.max(sign * self.force, axis=1))

    @cached_property
    def _ends(self) -> tuple[int, int]:
        """Samples of the largest and of the smallest displacement, each at the end of its stroke.

        The first sample is the end of the stroke before the cycle.
        """
        later = self.displacement[1:]
        return int(later.argmax()) + 1, int(later.argmin()) + 1

    def force_at_max(self, sign: float) -> Array:
        """Force at the largest (1) or the smallest (−1) displacement, outward, (n,), kip."""
        return np.asarray(sign * self.force[:, self._ends[0 if sign > 0.0 else 1]])

    @property
    def asymmetry(self) -> Array:
        """Slip force forward over that backward, (n,)."""
        backward = np.where(self.slip[:, 1] == 0.0, np.nan, self.slip[:, 1])
        return np.asarray(self.slip[:, 0] / backward)

    @property
    def post_slip_stiffness(self) -> Array:
        """Slope from zero to the largest displacement, mean of both directions, (n,), kip/in."""
        reach = np.array([self.displacement[self._ends[0]], -self.displacement[self._ends[1]]])
        ends = np.column_stack([self.force_at_max(1.0), self.force_at_max(-1.0)])
        slopes = (ends - self.slip) / np.where(reach > 0.0, reach, np.nan)
        return np.asarray(slopes.mean(axis=1))

    @cached_property
    def energy(self) -> Array:
        """Area of the loop, ∮ F dx, (n,), kip*in."""
        return np.asarray(np.trapezoid(self.force, self.displacement, axis=1))

    @cached_property
    def stiffness(self) -> Array:
        """Slope between the ends of the stroke, (n,), kip/in; NaN where it is zero."""
        high, low = self._ends
        stiffness = (self.force[:, high] - self.force[:, low]) / self.stroke
        return np.where(stiffness == 0.0, np.nan, stiffness)

    @property
    def damping(self) -> Array:
        """Effective damping ratio, (n,)."""
        return np.asarray(2.0 / np.pi * self.energy / (self.stiffness * self.stroke**2))

    @property
    def dashpot(self) -> Array:
        """Coefficient of a dashpot that dissipates as much, (n,), kip*s/in; NaN without motion."""
        squares = np.trapezoid(self.velocity**2, self.time)
        return np.asarray(self.energy / (squares if squares > 0.0 else np.nan))


FULL, SMALLER, RECORD = "full", "smaller", "record"
"""What the value of a test is of: the mean of its cycles at full stroke, that of the smaller ones,
or all samples of its record."""

TOLERANCES: Mapping[str, tuple[float, str]] = {
    "energy": (0.05, "energy of a cycle at full stroke, and in all"),
    "peak": (0.15, "peak forces"),
    "slip_force": (0.1, "slip force, against the one read off the loop"),
    "build_up": (0.3, "stiffness where the force comes back, likewise"),
    "gap": (0.15, "width of the gap, likewise"),
}
"""By how much a model may miss a property, as a share, and in words; in the order of checks."""

LIMITS: Mapping[str, str] = {
    "slip": "slip force, forward and backward",
    "build_up": "stiffness where the force comes back",
    "gap": "width of the gap",
    "peak": "peak forces",
    "energy": "energy of a cycle at full stroke",
    "stiffness": "effective stiffness",
    "damping": "effective damping",
}
"""What `accept` compares, in words, in the order of its tables."""


@dataclass(frozen=True)
class DeviceProperty:
    """A property of a device under a motion."""

    name: str
    unit: str  # internal
    label: str  # in words; both directions have the same
    direction: str = ""
    symbol: str = ""  # in mathtext; empty where it has that of the model's quantity of its name
    meaning: str = ""  # beside the symbol
    of_cycle: Callable[[Cycle], Array] | None = None  # value of a cycle, (n,)
    extent: str = FULL  # or SMALLER or RECORD
    stored: str = ""  # name of the values of cycles, where it is not the property's
    requires: tuple[str, ...] = ()  # attributes of `Axes` without which it makes no sense
    estimate: bool = False  # read off a stretch of the loop: a check that misses it is a note
    rate_dependent: bool = False  # read off a line through few samples
    tolerance: str = ""  # of `TOLERANCES`; empty where it is not checked
    limit: str = ""  # of `LIMITS`; empty where `accept` does not compare it
    accept_label: str = ""  # what `accept` calls it, where that is not the label
    sheet: str = ""  # what the data sheet calls it; empty where it is not there
    design: int = 0  # place among the bounds for design; 0 where it has none
    formula: str = ""

    @property
    def feature(self) -> str:
        """In words, with the direction."""
        return f"{self.label} {self.direction}".strip()

    @property
    def key(self) -> str:
        """Name of its values of cycles, also in a stored run."""
        return self.stored or self.name

    @property
    def quantity(self) -> str:
        """Its name on the data sheet and in standards: the same in both directions."""
        return self.sheet or self.name

    def applies(self, axes: Axes) -> bool:
        """Whether it makes sense for a motion and a response."""
        return all(getattr(axes, name) for name in self.requires)


_DIRECTIONS = (("fwd", "forward", 1.0), ("bwd", "backward", -1.0))

_PROPERTIES = (
    *(
        DeviceProperty(
            f"slip_{side}", "kip", "slip force", direction,
            symbol=rf"F_{{0,\mathrm{{{side}}}}}",
            meaning=f"slip force at zero displacement, {direction}",
            of_cycle=partial(Cycle.slip_force, sign=sign),
            requires=("of_damper",), estimate=True, tolerance="slip_force", limit="slip",
            sheet="slip_force", design=1,
            formula=f"mean force over the window of {WINDOW:.0%} of the stroke on both sides of "
            "zero displacement, in the direction of the motion; mid-stroke, where zero "
            f"displacement lies more than {OFF_CENTRE:.0%} of the stroke from it",
        )
        for side, direction, sign in _DIRECTIONS
    ),
    *(
        DeviceProperty(
            f"peak_{side}", "kip", "peak force", direction,
            symbol=rf"F_{{\max,\mathrm{{{side}}}}}", meaning=f"peak force, {direction}",
            of_cycle=partial(Cycle.peak_force, sign=sign), extent=RECORD,
            tolerance="peak", limit="peak", sheet="peak_force", design=6,
            formula="largest force of the test in the direction of the motion",
        )
        for side, direction, sign in _DIRECTIONS
    ),
    *(
        DeviceProperty(
            f"force_at_max_{side}", "kip", "force at maximum displacement", direction,
            symbol=rf"F_{{D,\mathrm{{{side}}}}}",
            meaning=f"force at maximum displacement, {direction}",
            of_cycle=partial(Cycle.force_at_max, sign=sign), requires=("of_damper",),
            sheet="force_at_max_displacement", design=8,
            formula="force at the largest displacement of a cycle, and at the smallest",
        )
        for side, direction, sign in _DIRECTIONS
    ),
    DeviceProperty(
        "effective_stiffness", "kip/in", "effective stiffness",
        symbol=r"K_\mathrm{eff}", meaning="effective stiffness",
        of_cycle=lambda cycle: cycle.stiffness,
        limit="stiffness", sheet="effective_stiffness", design=3,
        formula="K_eff = (|F+| + |F-|) / (|D+| + |D-|), F+ and F- at the largest and the smallest "
        "displacement D+ and D- (ASCE/SEI 7, Eq. 17.8-1)",
    ),
    DeviceProperty(
        "effective_damping", "1", "effective damping",
        symbol=r"\beta_\mathrm{eff}", meaning="effective damping ratio",
        of_cycle=lambda cycle: cycle.damping, requires=("energetic",),
        limit="damping", sheet="effective_damping", design=4,
        formula="beta_eff = (2/pi) E_loop / (K_eff (|D+| + |D-|)^2) (ASCE/SEI 7, Eq. 17.8-2)",
    ),
    DeviceProperty(
        "energy_per_cycle", "kip*in", "energy per cycle",
        symbol="E", meaning="energy dissipated in a cycle at full stroke, their mean",
        of_cycle=lambda cycle: cycle.energy, stored="energy", requires=("energetic",),
        tolerance="energy", limit="energy", accept_label="energy of a cycle",
        sheet="energy", design=2,
        formula="E_loop, the area of the loop: the integral of F dx over the cycle",
    ),
    DeviceProperty(
        "energy_of_ramps", "kip*in", "energy of ramps",
        symbol=r"E_\mathrm{ramp}", meaning="the same of smaller full cycles",
        of_cycle=lambda cycle: cycle.energy, extent=SMALLER, stored="energy",
        requires=("energetic",),
    ),
    DeviceProperty(
        "total_energy", "kip*in", "energy in all",
        symbol=r"E_\mathrm{all}", meaning="energy of the whole record",
        extent=RECORD, requires=("energetic",), tolerance="energy",
    ),
    DeviceProperty(
        "c_eq", "kip*s/in", "equivalent damping",
        symbol=r"c_\mathrm{eq}", meaning="equivalent viscous damping coefficient",
        of_cycle=lambda cycle: cycle.dashpot, requires=("timed", "energetic"), design=5,
        formula="E_loop over the integral of v^2 dt over the cycle",
    ),
    DeviceProperty(
        "build_up_slope", "kip/in", "build-up slope",
        symbol=r"k_\mathrm{up}", meaning="slope of the build-up",
        of_cycle=lambda cycle: mean_of(cycle.slope),
        requires=("of_damper",), estimate=True, rate_dependent=True, tolerance="build_up",
        limit="build_up", accept_label="stiffness of the build-up", sheet="build_up_slope",
        formula="slope of the force after the gap, from 20 % to 80 % of the slip force; mean of "
        "both strokes",
    ),
    DeviceProperty(
        "gap", "in", "gap", of_cycle=lambda cycle: mean_of(cycle.gap),
        requires=("of_damper",), estimate=True, rate_dependent=True, tolerance="gap",
        limit="gap", sheet="gap", design=7,
        formula="travel after a turn at which the line of the build-up, from 20 % to 80 % of the "
        "slip force, meets the slip force; mean of both strokes",
    ),
    DeviceProperty(
        "forward_over_backward", "1", "slip force forward over backward",
        symbol=r"F_{0,\mathrm{fwd}}/F_{0,\mathrm{bwd}}",
        meaning="slip force forward over that backward", of_cycle=lambda cycle: cycle.asymmetry,
        requires=("of_damper",), sheet="forward_over_backward",
        formula="slip force forward over that backward, of a cycle",
    ),
    DeviceProperty(
        "post_slip_stiffness", "kip/in", "stiffness after slip", symbol="K_2",
        meaning="slope from zero to maximum displacement",
        of_cycle=lambda cycle: cycle.post_slip_stiffness, requires=("of_damper",),
        formula="K2: slope of the force from zero displacement (slip force) to maximum "
        "displacement; mean of both directions",
    ),
    # of the parameters, not of a loop
    DeviceProperty(
        "slip_to_slip", "in", "travel from slip to slip", symbol=r"D_\mathrm{slip}",
        meaning="travel from slip to slip, of the parameters", requires=("of_damper",),
    ),
    *(
        DeviceProperty(
            f"C_{side}", "1", "self-energizing factor", direction, symbol=rf"C_\mathrm{{{side}}}",
            meaning=f"self-energizing factor, {direction}", requires=("of_damper",),
        )
        for side, direction, _ in _DIRECTIONS
    ),
)  # fmt: skip
PROPERTIES: Mapping[str, DeviceProperty] = {p.name: p for p in _PROPERTIES}
"""By name, in the order of tables."""


def quantities() -> dict[str, tuple[DeviceProperty, ...]]:
    """Properties that cycles at full stroke have, one or two directions, by name of the quantity.

    Standards and targets call them so.
    """
    by_name: dict[str, tuple[DeviceProperty, ...]] = {}
    for item in PROPERTIES.values():
        if item.of_cycle and item.extent == FULL:
            by_name[item.quantity] = (*by_name.get(item.quantity, ()), item)
    return by_name


def properties_called(name: str) -> tuple[DeviceProperty, ...]:
    """Properties of a quantity, in both directions, or the one of that name; none where unknown."""
    single = PROPERTIES.get(name)
    is_full = single is not None and single.of_cycle and single.extent == FULL
    return quantities().get(name) or ((single,) if single is not None and is_full else ())


_OF_CYCLES = {p.key: p.of_cycle for p in PROPERTIES.values() if p.of_cycle}


@dataclass(frozen=True, eq=False)
class MeasuredCycles:
    """Measured values of the L full cycles of a record, (L,) each, in internal units.

    They are of the trace's own samples: no model, no filter, and no offset is taken off. Forces
    are positive in the direction of the motion.
    """

    time: Array  # s, at which each cycle begins
    stroke: Array  # in, from the smallest to the largest displacement
    frequency: Array  # Hz
    full_stroke: NDArray[np.bool_]  # at least 95 % of the largest stroke; others ramp in or out
    values: Mapping[str, Array]  # by `DeviceProperty.key`; NaN where they cannot be read off
    offset: Array  # kip; would make the mean force of both directions equal; it is not applied
    largest_fwd: float  # kip, of all samples, also of those in no full cycle; so are the next two
    largest_bwd: float
    total_energy: float

    def of_test(self) -> dict[str, float]:
        """Value of each property of the test, by name."""
        means = means_of_test(self.values, self.full_stroke)
        return {name: float(mean) for name, mean in means.items()} | {
            "peak_fwd": self.largest_fwd,
            "peak_bwd": self.largest_bwd,
            "total_energy": self.total_energy,
        }

    def standard_error(self, name: str) -> float:
        """Standard error of a mean over the cycles at full stroke; NaN with fewer than two."""
        values = self.values[PROPERTIES[name].key][self.full_stroke]
        values = values[np.isfinite(values)]
        count = values.size
        return float(values.std(ddof=1) / np.sqrt(count)) if count > 1 else float("nan")

    def to_content(self) -> dict[str, tuple[float, ...]]:
        """The values as plain numbers by name, for JSON."""
        content: dict[str, Any] = {}
        for name, value in vars(self).items():
            content |= value if name == "values" else {name: value}
        return {n: tuple(np.atleast_1d(v).astype(float).tolist()) for n, v in content.items()}

    @classmethod
    def from_content(cls, content: Mapping[str, Sequence[float]]) -> MeasuredCycles:
        """The values from `to_content`, NaN for a property that is missing; else a ValueError."""
        count, values = len(content.get("time", ())), dict[str, Any]()
        for name in (*_OF_EACH, *_OF_CYCLES, *_OF_ALL):
            if name in _OF_EACH and name not in content:
                raise ValueError(f"{name} is missing")
            size = 1 if name in _OF_ALL else count
            values[name] = np.array(content.get(name, [np.nan] * size))
            if values[name].size != size:
                raise ValueError(f"{name} has {values[name].size} values")
        values |= {name: float(values[name].item()) for name in _OF_ALL}
        values["full_stroke"] = values["full_stroke"] > 0.0
        return cls(values={name: values.pop(name) for name in _OF_CYCLES}, **values)


_OF_EACH = ("time", "stroke", "frequency", "full_stroke", "offset")
_OF_ALL = ("largest_fwd", "largest_bwd", "total_energy")


def measured_cycles(trace: Trace) -> MeasuredCycles | None:
    """Measured values of every full cycle of a record's trace; None without a force.

    Spikes, which `inspect` names, count for nothing.
    """
    trace = without_spikes(trace)
    if trace.force is None:
        return None
    force, loops = trace.force[None], find_loops(trace)
    return MeasuredCycles(
        time=trace.time[loops.bounds[:-1]],
        stroke=2.0 * loops.amplitude,
        frequency=1.0 / loops.period,
        full_stroke=loops.strong,
        values={name: value[0] for name, value in cycle_values(trace, force).items()},
        offset=np.asarray(loops.offset),
        largest_fwd=float(force.max()),
        largest_bwd=float(-force.min()),
        total_energy=float(np.trapezoid(force[0], trace.displacement)),
    )


def cycle_values(trace: Trace, force: Array) -> dict[str, Array]:
    """Values of every full cycle of a motion under forces (n, T), kip: (n, L) each.

    By the names of `DeviceProperty.key`.
    """
    bounds, strokes = find_loops(trace).bounds, stroke_estimates(trace, force)
    count = max(bounds.size - 1, 0)
    values = {name: np.full((len(force), count), np.nan) for name in _OF_CYCLES}
    for number, (begin, end) in enumerate(pairwise(bounds.tolist())):
        span = slice(begin, end + 1)
        pair = sorted((2 * number, 2 * number + 1), key=lambda k: -strokes.sign[k])
        cycle = Cycle(
            *(trace.time[span], trace.displacement[span], trace.velocity[span], force[:, span]),
            *(strokes.slip[:, pair], strokes.slope[:, pair], strokes.gap[:, pair]),
        )
        for name, of_cycle in _OF_CYCLES.items():
            values[name][:, number] = of_cycle(cycle)
    return values


def means_of_test(values: Mapping[str, Array], full: NDArray[np.bool_]) -> dict[str, Array]:
    """Mean over cycles of each property that is one, by name, (…), of values (…, L) by `key`.

    `full` (L,) says which cycles are at full stroke.
    """
    masks = {FULL: full, SMALLER: ~full}
    return {
        name: mean_of(values[quantity.key], masks[quantity.extent])
        for name, quantity in PROPERTIES.items()
        if quantity.of_cycle and quantity.extent != RECORD
    }


def features_of(trace: Trace) -> dict[str, float]:
    """`MeasuredCycles.of_test` of a record, NaN without a force, and its "slip" force, kip.

    That is the mean of both directions, free of the load cell's offset.
    """
    cycles = measured_cycles(trace)
    values = dict.fromkeys(PROPERTIES, float("nan")) if cycles is None else cycles.of_test()
    return values | {"slip": 0.5 * (values["slip_fwd"] + values["slip_bwd"])}


@dataclass(frozen=True)
class Scales:
    """What a record shows of its device, internal units; all positive but the offset."""

    force: float  # slip force of both directions, else half the range of the force
    unloading: float  # slope of the force right after a turn
    build_up: float  # slope at which the force comes back
    length: float  # travel from a turn until the force has come back, the gap included
    stroke: float  # from one end of the motion to the other
    speed: float
    noise: float  # standard deviation of what differs from sample to sample
    offset: float  # middle of the slip forces of both directions


def scales_of(trace: Trace) -> Scales | None:
    """Scales of one record; None where it has no force or no motion."""
    trace = without_spikes(trace)
    force, stroke = trace.force, float(np.ptp(trace.displacement))
    if force is None or not np.ptp(force) > 0.0 or not stroke > 0.0:
        return None
    offsets = find_loops(trace).offset
    offset = float(np.mean(force) if offsets is None or not offsets.size else np.median(offsets))
    strong, values = find_loops(trace).strong, cycle_values(trace, force[None] - offset)
    read = {name: float(mean_of(value[0], strong)) for name, value in values.items()}
    slip = _positive(0.5 * (read["slip_fwd"] + read["slip_bwd"]), 0.5 * float(np.ptp(force)))
    length = _positive(read["gap"], 0.05 * stroke)
    # White noise whose second differences have the size of these.
    noise = float(np.median(np.abs(np.diff(force, 2))) / 0.6745 / np.sqrt(6.0))
    return Scales(
        force=slip,
        unloading=_positive(_unloading(trace, force - offset, slip), slip / length),
        build_up=_positive(read["build_up_slope"], slip / length),
        length=length,
        stroke=stroke,
        speed=_positive(float(np.quantile(np.abs(trace.velocity), 0.9)), 1e-9),
        noise=_positive(noise, 1e-3 * slip),
        offset=offset,
    )


def middle(scales: Iterable[Scales]) -> Scales:
    """Scales in the middle of several records: the median of each."""
    return Scales(*np.median([astuple(item) for item in scales], axis=0).tolist())


def _positive(value: float, default: float) -> float:
    return value if np.isfinite(value) and value > 0.0 else default


def _unloading(trace: Trace, force: Array, slip: float) -> float:
    """Median slope after the turns of full strokes, kip/in; NaN where it cannot be read."""
    strokes, x = stroke_estimates(trace, np.empty((0, trace.samples))), trace.displacement
    slopes = [np.nan]
    for (start, end), sign in zip(
        strokes.ends[strokes.full], strokes.sign[strokes.full], strict=True
    ):
        share = -sign * force[start : end + 1] / slip  # falls from 1 after the turn
        upper, lower = (int(np.argmax(share <= level)) for level in UNLOADING)
        travel, drop = abs(x[start + lower] - x[start + upper]), share[upper] - share[lower]
        if share[0] > UNLOADING[0] and travel > 0.0 < drop:
            slopes.append(drop * slip / travel)
    return float(np.median(slopes[1:] or slopes))
