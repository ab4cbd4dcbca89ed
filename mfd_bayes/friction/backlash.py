"""LuGre friction in series with a spring that has a gap: no rule for turns, no energy gained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.arrays import add_outer
from mfd_bayes.friction.columns import named_columns
from mfd_bayes.friction.course import Place, cut_few
from mfd_bayes.friction.damper import Damper
from mfd_bayes.friction.driven import Drive, courses, follow, rows_of
from mfd_bayes.friction.evaluation import check_start, check_state
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.paper import quantities_of
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.single import Bent, advance_few
from mfd_bayes.friction.yield_shares import (
    Shares,
    check_level,
    check_reference,
    check_step,
    reference_of,
    step_shares,
    trace_shares,
)
from mfd_bayes.records.motion import vertices
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

ACTUATED = ("Fc_fwd", "Fc_bwd")
"""The parameters that follow the actuation. Stiffness does not: the spring is steel."""

_POSITIVE = frozenset({"k_fwd", "k_bwd", "ell", "Fc_fwd", "Fc_bwd", "v_s"})

_OWN = (
    Quantity(
        "k_fwd",
        "stiffness",
        r"k_\mathrm{fwd}",
        "k<sub>fwd</sub>",
        "stiffness beyond the gap, forward",
    ),
    Quantity(
        "k_bwd",
        "stiffness",
        r"k_\mathrm{bwd}",
        "k<sub>bwd</sub>",
        "stiffness beyond the gap, backward",
    ),
    Quantity("gap", "displacement", "D", "D", "width of the gap"),
    Quantity("k_0", "stiffness", "k_0", "k<sub>0</sub>", "stiffness inside the gap"),
    Quantity("n", "dimensionless", "n", "n", "how sharply slip sets in", least=1.0),
)
_ORDER = (
    *("k_fwd", "k_bwd", "gap", "ell", "k_0", "Fc_fwd", "Fc_bwd", "n", "sigma2"),
    *("static_excess_fwd", "static_excess_bwd", "v_s"),
)


def _quantities() -> tuple[Quantity, ...]:
    known = {q.name: q for q in (*quantities_of(_ORDER), *_OWN)}
    return tuple(known[name] for name in _ORDER)


@dataclass(frozen=True, eq=False)
class State:
    """State of n dampers that are stepped in time; `BacklashLuGre.step` returns a new one.

    Attributes
    ----------
    damper : Damper
        Parameters by name.
    reference : float, ksi or kip, or None
        Actuation that theta belongs to.
    bent : (n,), in, (n,), kip, (n,), kip/in
        Deflection, force and stiffness of the spring.
    place : Place
        Direction, and way since the last turn.
    displacement, velocity : float, in, in/s
        At the last sample; NaN before the first.
    shares : dict of (n,) or (1,)
        Factors of the slip forces at the last sample.
    """

    damper: Damper
    reference: float | None
    bent: Bent
    place: Place = field(default_factory=Place)
    displacement: float = float("nan")
    velocity: float = float("nan")
    shares: Shares = field(default_factory=dict)


@dataclass(frozen=True)
class BacklashLuGre(Model):
    """LuGre friction in series with a spring that has a gap (model.md section 9).

        G(z) = k_f ℓ ln(1 + e^((z − D/2)/ℓ)) − k_b ℓ ln(1 + e^(−(z + D/2)/ℓ)) + k_0 z
        g(v) = F_c [1 + e exp(−(v/v_s)²)],   F_c and e of the direction of G
        ż = v (1 − ½ [1 + sgn(v G)] |G/g|ⁿ),   F = G(z) + σ2 v

    Between samples the velocity is taken as constant; a turn between samples has its vertex as in
    `Trace.path`. Unloading is elastic, so the force retraces wherever the motion turns. Under a
    varying actuation the slip force changes linearly between samples; the spring does not.
    """

    name: ClassVar[str] = "backlash"
    quantities: ClassVar[tuple[Quantity, ...]] = _quantities()
    has_gap: ClassVar[bool] = True
    laws: ClassVar[Mapping[str, str]] = MappingProxyType(dict.fromkeys(ACTUATED, "proportional"))
    slip_forces: ClassVar[tuple[str, ...]] = ACTUATED

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector, (n, 12), (n, T), kip; see `Model.force`.

        Fc_fwd and Fc_bwd follow the actuation. `start` is the place between slip backward, 0,
        and slip forward, 1.
        """
        damper = _damper(self, theta)
        force, _ = _followed(damper, trace, check_start(start, damper.size), scales)
        return add_outer(trace.velocity, damper.columns["sigma2"], force).T

    def end(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Place of the deflection z at the last sample in the range of `start`, (n,), 1.

        A motion that begins there has the whole state of the device, but for a deflection beyond
        that range, which static friction, or an actuation above the reference, may hold: it is
        taken as the end of the range.
        """
        damper = _damper(self, theta)
        _, z = _followed(damper, trace, check_start(start, damper.size), scales)
        if not np.all(np.isfinite(z)):
            raise FitError(f"the place at the end of a motion is no finite number in {self.name}")
        return damper.place(z)

    def start_at(
        self,
        place: Array,
        trace: Trace,
        before: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion at a place in the gap, (n,): see `Damper.taken_over`."""
        if before is None or theta is None:
            return place
        ended, damper = _damper(self, before), _damper(self, theta)
        return damper.place(damper.taken_over(ended.begin(place), ended))

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: int | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State of n dampers before their first sample, to be stepped in time.

        Parameters
        ----------
        theta, start
            As in `force`.
        direction : ignored
            No direction has to be known before the motion.
        reference_actuation : float, ksi or kip, optional
            Actuation that theta belongs to; when left out, that of the first sample with one.

        Raises
        ------
        FitError
            When a shape or a value does not fit.
        """
        damper = _damper(self, theta)
        z = damper.begin(check_start(start, damper.size))
        reference = check_reference(reference_actuation)
        return State(damper, reference, (z, *damper.spring.evaluate(z)))

    def step(
        self,
        state: State,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
        *,
        scales: Mapping[str, ArrayLike] | None = None,
    ) -> tuple[Array, State]:
        """Force at the next sample, (n,), kip, and the state after it; equals `force`.

        Parameters
        ----------
        state : State
            It is not changed and may be used again.
        displacement, velocity : float, in, in/s
        dt : float, s
            Time since the previous sample; ignored at the first.
        actuation : float, ksi or kip, optional
            Slip forces are proportional to it; when left out, the reference actuation.
        scales : mapping of (n,), (1,) or a number, optional
            Factors of Fc_fwd and Fc_bwd, used instead of the actuation.

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, the actuation negative, or a name
            or a value in `scales` does not fit.
        """
        check_state(state, State, self.name)
        first = bool(np.isnan(state.displacement))
        displacement, velocity, dt = check_step(displacement, velocity, dt, first=first)
        level = check_level(actuation)
        state = replace(state, reference=reference_of(state.reference, level))
        size = state.damper.size
        shares = step_shares(size, state.reference, level, scales, ACTUATED)
        after = replace(state, displacement=displacement, velocity=velocity, shares=shares)
        if not first:
            after = _moved(state, after, dt)
        return after.bent[1] + velocity * state.damper.columns["sigma2"], after

    def gap(self, values: Mapping[str, Array]) -> Array:
        """Width of the gap D, (n,), in."""
        return named_columns(values, ("gap",))["gap"]

    def crossing(self, values: Mapping[str, Array]) -> Array:
        """Travel from slip to slip, D + F_c,fwd/k_f + F_c,bwd/k_b, (n,), in."""
        c = named_columns(values, ("gap", "Fc_fwd", "Fc_bwd", "k_fwd", "k_bwd"))
        return c["gap"] + c["Fc_fwd"] / c["k_fwd"] + c["Fc_bwd"] / c["k_bwd"]

    def unloaded(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Where the spring bears at most `LITTLE` of the slip force: see `Model.unloaded`."""
        needed = ("k_fwd", "k_bwd", "gap", "ell", "k_0", "Fc_fwd", "Fc_bwd")
        return Damper(named_columns(values, needed)).unloaded

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """Stage at each sample, (n, T): 1 slip, 2 stick, 3 build-up, 4 in the gap.

        It slips where the spring takes up less than half of the motion. Beyond the gap the force
        builds up where the motion loads the spring, and the device sticks where it unloads it.
        """
        damper = _damper(self, theta)
        force = self.force(theta, trace, start).T
        force -= trace.velocity[:, None] * damper.columns["sigma2"]
        z = damper.spring.deflection(force)
        moved = np.diff(trace.displacement, prepend=trace.displacement[0])[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.abs(np.diff(z, axis=0, prepend=z[:1]) / moved)
        loads = moved * force > 0
        inside = np.abs(z) < 0.5 * damper.columns["gap"]
        stage = np.select([loads & (share < 0.5), inside, loads], [1, 4, 3], 2)
        return stage.T.astype(np.int8)


def _followed(
    damper: Damper, trace: Trace, start: Array, scales: Mapping[str, Array] | None
) -> tuple[Array, Array]:
    """Spring force at the samples, (T, n), kip, and the deflection z at the last, (n,), in."""
    first = damper.begin(start)
    shares = trace_shares(trace, damper.size, scales, ACTUATED)
    moves, rate, nearest, rows = _path(trace)
    shares = {name: share.T[nearest] for name, share in shares.items()}
    force, last = np.empty((trace.samples, damper.size)), np.empty(damper.size)
    force[0] = damper.spring.force(first)
    for chosen, course in courses(damper, moves):
        drive = Drive(rate, {name: _of(share, chosen) for name, share in shares.items()})
        found, last[chosen] = follow(damper.along(chosen), course, drive, first[chosen])
        force[1:, chosen] = found[rows[1:] - 1]
    return force, last


def _path(trace: Trace) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Steps, in, and their speeds, in/s, with vertices; nearest samples; rows of the samples."""
    t, x = trace.time, trace.displacement
    left, place, vertex = vertices(t, x, trace.velocity)
    at, samples = left + 1, np.arange(t.size)
    nearest = np.insert(samples, at, np.where(place < 0.5, left, at))
    t = np.insert(t, at, t[left] + place * (t[at] - t[left]))
    moves = np.diff(np.insert(x, at, vertex))
    return moves, moves / np.diff(t), nearest, samples + np.searchsorted(at, samples, side="right")


def _moved(before: State, after: State, dt: float) -> State:
    """State at the end of a step, through the vertex if the motion turns in it."""
    x = np.array([before.displacement, after.displacement])
    t, histories = np.array([0.0, dt]), [before.shares, after.shares]
    if before.velocity * after.velocity < 0:
        left, place, vertex = vertices(t, x, np.array([before.velocity, after.velocity]))
        x, t = np.insert(x, left + 1, vertex), np.insert(t, left + 1, place * dt)
        histories[1:1] = [before.shares if share < 0.5 else after.shares for share in place]
    moves = np.diff(x)
    damper = before.damper
    course = cut_few(moves.tolist(), *damper.plan_of_each, before.place)
    drive = Drive(moves / np.diff(t), _together(histories, damper.size))
    rows = rows_of(damper, course, slice(0, None), drive)
    return replace(after, bent=advance_few(damper.material, rows, before.bent), place=course.place)


def _together(histories: list[Shares], n: int) -> Shares:
    """Factors at some instants, one after the other, (M, n); 1 where there is none."""
    names = {name for shares in histories for name in shares}
    one = np.ones(1)
    return {
        name: np.stack([np.broadcast_to(h.get(name, one), (n,)) for h in histories])
        for name in names
    }


def _of(share: Array, chosen: NDArray[np.intp]) -> Array:
    """Columns of some vectors, if each has its own."""
    return share if share.shape[1] == 1 else share[:, chosen]


def _damper(model: BacklashLuGre, theta: ArrayLike) -> Damper:
    """Dampers of theta, or a FitError that names what does not fit."""
    values = np.array(model.vectors(theta).T, order="C")  # not the caller's
    columns = dict(zip(model.parameters, values, strict=True))
    for q in model.quantities:
        column = columns[q.name]
        bad = ~(np.isfinite(column) & (column >= q.least))
        bad |= (column == 0.0) & (q.name in _POSITIVE)
        if np.any(bad):
            words = "positive" if q.name in _POSITIVE else f"at least {q.least:g}"
            got = column[np.argmax(bad)]
            raise FitError(f"parameter {q.name} must be finite and {words}, got {got}")
    return Damper(columns)
