"""Bouc-Wen hysteresis with a yield force for each direction, a competing model.

Bouc (1967), Wen (1976); the admissible range of β is that of Erlicher and Point (2004).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.evaluation import check_start, check_state
from mfd_bayes.friction.hysteresis import Curve
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.yield_shares import (
    ACTUATED,
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


_QUANTITIES = (
    Quantity("k", "stiffness", "k", "k", "stiffness of Bouc-Wen hysteresis"),
    Quantity(
        *("alpha", "dimensionless", r"\alpha", "α"),
        "share of the stiffness that remains in slip",
        most=1.0,
    ),
    Quantity(
        *("Fy_fwd", "force", r"F_{y,\mathrm{fwd}}", "F<sub>y,fwd</sub>"),
        "yield force, forward",
    ),
    Quantity(
        *("Fy_bwd", "force", r"F_{y,\mathrm{bwd}}", "F<sub>y,bwd</sub>"),
        "yield force, backward",
    ),
    Quantity(
        *("beta", "dimensionless", r"\beta", "β", "shape of the unloading"), least=0.5, most=1.0
    ),
    Quantity("exponent", "dimensionless", "n", "n", "sharpness of the knee", least=1.0),
    Quantity("c", "damping", "c", "c", "viscous damping of Bouc-Wen hysteresis"),
)


FLOOR = 1e-6
"""Least share of F_y that is left at zero actuation, so that nothing divides by zero."""

PIECE = 1 << 15
"""Size of a piece's arrays, in numbers: small enough for the cache."""

_POSITIVE = frozenset({"k", "Fy_fwd", "Fy_bwd"})


@dataclass(frozen=True, eq=False)
class State:
    """State of n dampers that are stepped in time; `BoucWen.step` returns a new one.

    Attributes
    ----------
    columns : dict of (n,)
        Parameters by name.
    reference : float, ksi or kip, or None
        Actuation that theta belongs to.
    z : (n,), kip
    origin : float, in, or None
        Displacement of the first sample; None before it.
    displacement, velocity : float, in, in/s
        At the last sample.
    shares : dict of (n,) or (1,)
        Factors of F_y at the last sample.
    """

    columns: dict[str, Array]
    curve: Curve
    reference: float | None
    z: Array
    origin: float | None = None
    displacement: float = 0.0
    velocity: float = 0.0
    shares: Shares = field(default_factory=dict)


@dataclass(frozen=True)
class BoucWen(Model):
    """Bouc-Wen hysteresis, a spring and a dashpot side by side.

        F = α k (x − x_0) + (1 − α) z + c v
        dz/dx = k [1 − |z/F_y|^n (γ + β sgn(z dx))],   γ = 1 − β,   z(0) = 0

    x_0 is the trace's first displacement. F_y is Fy_fwd in forward and Fy_bwd in backward
    motion; under a varying actuation it is the mean of its values at both ends of a step. z
    is a force: like LuGre's bristles it stays unchanged while nothing moves, even when the
    actuation falls.

    Every change of direction is a turn. A turn between samples has its vertex as in
    `Trace.path`, so that the force does not depend on the trace's hysteresis. Between turns
    z/F_y depends on k |x − x_turn|/F_y alone and is taken from a `Curve`.
    """

    name: ClassVar[str] = "bouc_wen"
    quantities: ClassVar[tuple[Quantity, ...]] = _QUANTITIES
    laws: ClassVar[Mapping[str, str]] = MappingProxyType(dict.fromkeys(ACTUATED, "proportional"))
    laws_from: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"Fy_fwd": "Fc_fwd", "Fy_bwd": "Fc_bwd"}
    )
    slip_forces: ClassVar[tuple[str, ...]] = ACTUATED

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector (n, 7), (n, T), kip; see `Model.force`.

        Fy_fwd and Fy_bwd follow the actuation. There is no gap: `start` is ignored.
        """
        columns = _check_theta(self, theta)
        n = columns["k"].size
        check_start(start, n)
        shares = trace_shares(trace, n, scales)
        t, x, v = trace.time, trace.displacement, trace.velocity
        left, place, vertex = vertices(t, x, v)
        nearest = np.insert(np.arange(t.size), left + 1, np.where(place < 0.5, left, left + 1))
        x = np.insert(x, left + 1, vertex)
        rows = np.arange(t.size) + np.searchsorted(left + 1, np.arange(t.size), side="right")

        curve = Curve.of(columns["exponent"], columns["beta"], _ratio(columns), wide=bool(shares))
        z = np.zeros((n, x.size))
        for begin, end, sign in _stretches(x, max(PIECE // max(n, 1), 1), each=bool(shares)):
            way = np.abs(x[begin:end] - x[begin - 1])
            ends = [
                {name: s[:, nearest[i]] for name, s in shares.items()} for i in (begin - 1, begin)
            ]
            strength = _strength(columns, sign, *ends)
            z[:, begin:end] = _advance(curve, columns["k"], strength, z[:, begin - 1], way)
        return _total(columns, z[:, rows], trace.displacement - trace.displacement[0], v)

    def _sound(self, theta: ArrayLike) -> int:
        """As `Model._sound`, of dampers within the limits of their quantities."""
        return int(_check_theta(self, theta)["k"].size)

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
        theta : (n, 7)
        start, direction : ignored
            There is no gap.
        reference_actuation : float, ksi or kip, optional
            Actuation that theta belongs to; when left out, that of the first sample with one.

        Raises
        ------
        FitError
            When a shape or a value does not fit.
        """
        columns = _check_theta(self, theta)
        check_start(start, columns["k"].size)
        reference = check_reference(reference_actuation)
        curve = Curve.of(columns["exponent"], columns["beta"], _ratio(columns), wide=True)
        return State(columns, curve, reference, np.zeros(columns["k"].size))

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
            F_y is proportional to it; when left out, the reference actuation.
        scales : mapping of (n,), (1,) or a number, optional
            Factors of Fy_fwd and Fy_bwd, used instead of the actuation.

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, the actuation negative, or a name
            or a value in `scales` does not fit.
        """
        check_state(state, State, self.name)
        first = state.origin is None
        displacement, velocity, dt = check_step(displacement, velocity, dt, first=first)
        level = check_level(actuation)
        state = replace(state, reference=reference_of(state.reference, level))
        shares = step_shares(state.z.size, state.reference, level, scales)
        after = replace(
            state,
            origin=displacement if first else state.origin,
            displacement=displacement,
            velocity=velocity,
            shares=shares,
        )
        if not first:
            after = replace(after, z=_moved(state, after, dt))
        way = np.array([displacement - (after.origin or 0.0)])
        return _total(state.columns, after.z[:, None], way, np.array([velocity]))[:, 0], after


def _moved(before: State, after: State, dt: float) -> Array:
    """Force z at the end of a step, (n,), kip, through the vertex if the motion turns in it."""
    x = np.array([before.displacement, after.displacement])
    v = np.array([before.velocity, after.velocity])
    _, place, vertex = vertices(np.array([0.0, dt]), x, v)
    nearest = [before.shares if p < 0.5 else after.shares for p in place]
    x, at = np.insert(x, 1, vertex), [before.shares, *nearest, after.shares]
    columns, z = before.columns, before.z
    for i in np.flatnonzero(np.diff(x)):
        strength = _strength(columns, np.sign(x[i + 1] - x[i]), at[i], at[i + 1])
        way = np.abs(x[i + 1 : i + 2] - x[i])
        z = _advance(before.curve, columns["k"], strength, z, way)[:, 0]
    return z


def _advance(curve: Curve, k: Array, strength: Array, z: Array, way: Array) -> Array:
    """Force z after each distance `way` in the direction of `strength`'s sign, (n, m), kip."""
    xi = curve.place(z / strength)
    w = curve.value(curve.move(xi[:, None], (k / np.abs(strength))[:, None] * way))
    w *= strength[:, None]
    return w


def _total(columns: dict[str, Array], z: Array, x: Array, v: Array) -> Array:
    """F = α k x + (1 − α) z + c v, (n, m), kip."""
    alpha, k, c = (columns[name][:, None] for name in ("alpha", "k", "c"))
    force = (1.0 - alpha) * z
    force += alpha * k * x
    force += c * v
    return force


def _strength(columns: dict[str, Array], sign: float, before: Shares, after: Shares) -> Array:
    """F_y of a step between two samples, with the sign of its direction, (n,), kip."""
    name = ACTUATED[0] if sign > 0 else ACTUATED[1]
    share = 0.5 * (before.get(name, 1.0) + after.get(name, 1.0))
    return np.asarray(sign * columns[name] * np.maximum(share, FLOOR))


def _stretches(x: Array, most: int, *, each: bool) -> list[tuple[int, int, float]]:
    """Ranges of at most `most` steps in one direction: first row, row after the last, direction.

    Steps of zero length belong to the range before them; at the start they are left out.
    With `each` every step that moves is a range of its own.
    """
    sign = np.sign(np.diff(x))
    moving = np.flatnonzero(sign)
    new = np.diff(sign[moving], prepend=0.0) != 0
    length = max(sign.size, 1) if each else most
    edges = [*(moving if each else moving[new]).tolist(), sign.size]
    return [
        (begin + 1, min(begin + length, end) + 1, float(sign[first]))
        for first, end in pairwise(edges)
        for begin in range(first, end, length)
    ]


def _ratio(columns: dict[str, Array]) -> Array:
    """The larger of the two F_y over the smaller, (n,)."""
    forward, backward = columns["Fy_fwd"], columns["Fy_bwd"]
    return np.maximum(forward, backward) / np.minimum(forward, backward)


def _check_theta(model: BoucWen, theta: ArrayLike) -> dict[str, Array]:
    """Columns of theta by name, (n,) each, or a FitError that names what does not fit."""
    values = np.array(model.vectors(theta).T, order="C")  # not the caller's
    columns = dict(zip(model.parameters, values, strict=True))
    for q in model.quantities:
        column = columns[q.name]
        bad = ~(np.isfinite(column) & (column >= q.least) & (column <= q.most))
        bad |= (column == 0.0) & (q.name in _POSITIVE)
        if np.any(bad):
            words = "positive" if q.name in _POSITIVE else f"in [{q.least:g}, {q.most:g}]"
            got = column[np.argmax(bad)]
            raise FitError(f"parameter {q.name} must be finite and {words}, got {got}")
    return columns
