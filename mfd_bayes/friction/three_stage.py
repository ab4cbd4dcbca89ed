"""The paper's friction: LuGre alone, and the three stages slip, stick and build-up with a gap.

LuGre takes its exact exponential step. The three stages are joined by smooth transitions. The gap
is a play operator that remembers on which side it last slipped. It lies between the displacements
`edge` and `edge` + D and is crossed in the direction `side` = ±1; `origin` is where the travel u
since the last slip is 0: the edge forward, the other end backward. `carry` is the jump of the
force, kip, at the last turning point, which fades as the gap is crossed.

Every formula serves a record, with motions (T, 1) or stretches (K, n) and parameters (n,), and a
step, with (n,) of both. Parameters that follow a varying actuation are (T, n) along a record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import (
    PIECE,
    Array,
    Columns,
    Model,
    State,
    named_columns,
    named_vectors,
)
from mfd_bayes.friction.quantities import STATIC, sampled_for
from mfd_bayes.records.trace import MotionPath, Trace

FLOOR = 1e-9
"""Least slip force g, kip, and bristle stiffness, kip/in, so that nothing divides by zero."""

SHORT = 24  # up to this many steps of a recurrence are taken one after the other

PARAMETERS = (
    "sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd",
    "k2", "k3", "d2", "d3", "gamma1", "gamma2", "v_s",
)  # fmt: skip
"""All parameters of the MFD paper, in its order."""


def solve(decay: Array, drive: Array, z0: Array) -> Array:
    """States z_k = decay_k z_{k−1} + drive_k after each of N steps, (N, n).

    `decay` and `drive` are (N, n); `z0`, (n,), is z before the first step. The steps are taken
    in blocks: a step in all of them at once, and then from block to block.
    """
    steps, n = decay.shape
    if steps <= SHORT:
        states, state = drive.copy(), z0
        for a, z in zip(decay, states, strict=True):
            z += a * state
            state = z
        return states
    length = round(1.3 * steps ** (1 / 3) if steps > SHORT**2 else steps**0.5)
    count = -(-steps // length)
    # (length, count, n): the j-th steps of all blocks together; what fills up the last one is 0
    a, z = np.zeros((2, length, count, n))
    for blocks, source in ((a, decay), (z, drive)):
        by_block = blocks.swapaxes(0, 1)
        by_block[:-1] = source[: (count - 1) * length].reshape(count - 1, length, n)
        by_block[-1, : steps - (count - 1) * length] = source[(count - 1) * length :]
    for j in range(1, length):
        z[j] += a[j] * z[j - 1]
        a[j] *= a[j - 1]
    # the last block is followed by none, so that its end does not matter
    starts = np.concatenate([z0[None], solve(a[-1, :-1], z[-1, :-1], z0)])
    a *= starts
    z += a
    z = z.swapaxes(0, 1).reshape(-1, n)
    return np.asarray(z[:steps])


class Curve(NamedTuple):
    """Stribeck curve g = F_c + (F_s − F_c) exp(−(v/v_s)²), over σ0 and with the sign of v; in.

    `kinetic` and `excess` are those of F_c and F_s − F_c, forward and, negative, backward: (2, …).
    `rate` is −1/v_s², s²/in².
    """

    kinetic: Array
    excess: Array
    rate: Array

    @classmethod
    def of(cls, c: Mapping[str, Array]) -> Curve:
        """The curve of LuGre's parameters by name."""
        stiff, kinetic, excess = np.maximum(c["sigma0"], FLOOR), [], []
        for side, sign in (("fwd", 1.0), ("bwd", -1.0)):
            low = np.maximum(c[f"Fc_{side}"], FLOOR)
            kinetic.append(sign * low / stiff)
            excess.append(sign * np.maximum(c[f"Fs_{side}"] - low, 0.0) / stiff)
        pairs = [np.stack(np.broadcast_arrays(*pair)) for pair in (kinetic, excess)]
        return cls(pairs[0], pairs[1], -1.0 / np.square(c["v_s"]))

    def steady(self, rate: Array) -> Array:
        """Deflection sgn(v) g(v)/σ0, in, that the bristles tend to at a mean velocity, in/s."""
        backward = rate < 0.0
        steady: Array = np.square(rate) * self.rate
        np.exp(steady, out=steady)
        steady *= of_direction(backward, self.excess)
        steady += of_direction(backward, self.kinetic)
        return steady


def of_direction(backward: NDArray[np.bool_], pair: Array) -> Array:
    """What belongs to the direction of each motion, of what is forward and backward."""
    if backward.ndim == pair.ndim and backward.shape[1] == 1:  # as np.where, in a fifth of the time
        return pair[backward[:, 0].astype(np.intp)]
    return np.asarray(np.where(backward, pair[1], pair[0]))


def slip_force(c: Mapping[str, Array], damping: Array, z: Array, velocity: Array) -> Array:
    """F1 = σ0 z + σ1 ż + σ2 v with ż = v − σ0 |v| z/g(v), kip (paper Eqs. 3 and 4).

    `damping` is σ0 |v|/g, 1/s, with the direction of the mean velocity, and is overwritten.
    """
    damping *= -c["sigma1"]
    damping += c["sigma0"]
    damping *= z
    damping += (c["sigma1"] + c["sigma2"]) * velocity
    return damping


def limit_of(c: Mapping[str, Array], z: Array, steady: Array) -> Array:
    """Factor of the damping where the actuation varies.

    Under constant actuation σ0 |z|/g is at most the largest static over the least kinetic
    friction. Where the actuation fell while at rest, it is limited to that.
    """
    ratio = np.maximum(np.maximum(c["Fs_fwd"], c["Fs_bwd"]), FLOOR)
    ratio = ratio / np.maximum(np.minimum(c["Fc_fwd"], c["Fc_bwd"]), FLOOR)
    limit: Array = np.minimum(1.0, ratio / np.maximum(np.abs(z / steady), 1e-300))
    return limit


class PaperModel(Model):
    """What LuGre and the three stages have in common: the paper's friction."""

    positive = frozenset({"sigma0", "gamma1", "gamma2", "v_s"})
    slip_forces = ("Fc_fwd", "Fc_bwd")
    laws = MappingProxyType(
        {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine"}
    )
    shared_laws = MappingProxyType({static: kinetic for static, (kinetic, _) in STATIC.items()})

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p): F_s = F_c (1 + excess), γ2 = ℓ γ1."""
        columns = named_vectors(values, [q.name for q in self.quantities if q.sampled])
        for static, (kinetic, excess) in STATIC.items():
            columns[static] = columns[kinetic] * (1.0 + columns[excess])
        if "gamma2" in self.parameters:
            columns["gamma2"] = columns["ell"] * columns["gamma1"]
        return np.stack([columns[name] for name in self.parameters], axis=1)

    def columns(self, theta: ArrayLike) -> Columns:
        """Theta's columns by name, (n,) each; F_s ≥ F_c holds."""
        columns = super().columns(theta)
        for static, (kinetic, _) in STATIC.items():
            if np.any(columns[static] < columns[kinetic] * (1 - 1e-12)):
                raise FitError(f"static friction {static} must be at least kinetic {kinetic}")
        return columns

    def composed(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Static friction, where its excess is sampled."""
        return tuple(static for static, (_, excess) in STATIC.items() if excess in names)

    def slip_along(self, c: Columns, trace: Trace, factors: Columns) -> Array:
        """F1 of bristles that start undeflected, (P, n), kip, at every sample of the trace's path.

        Between samples the velocity is taken constant, so that Δx is exact and the equation for z
        linear (model.md section 2):

            z_{n+1} = a_n z_n + (1 − a_n) sgn(Δx_n) g_n/σ0,   a_n = exp(−σ0 |Δx_n| / g_n)

        The rate terms at sample n use the velocity of the path and the g of the step before it.

        `c` are at the reference actuation, and `factors` along the trace, (T, n) or (T, 1).
        """
        path = trace.path
        factors = {name: f.take(path.nearest, axis=0) for name, f in factors.items()}
        samples, n = path.step.size, c["v_s"].size
        length = max(PIECE // n, 1)
        force, z, now, curve = np.empty((samples, n)), np.zeros(n), c, Curve.of(c)
        for begin in range(0, samples, length):
            rows = slice(begin, begin + length)
            if factors:
                index = np.arange(samples)[rows]
                previous = np.maximum(index - 1, 0)
                now = c | {k: f[index] * c[k] for k, f in factors.items()}
                mean = {k: 0.5 * (f[previous] + f[index]) * c[k] for k, f in factors.items()}
                curve = Curve.of(c | mean)
            way, rate, velocity = (a[rows, None] for a in (path.step, path.rate, path.velocity))
            steady = curve.steady(rate)
            decay = np.exp(-way / steady)
            state = solve(decay, steady - decay * steady, z)
            damping = np.copysign(velocity, rate) / steady
            if factors:
                damping *= limit_of(now, state, steady)
            force[rows], z = slip_force(now, damping, state, velocity), state[-1]
        return force

    def constants(self, c: Columns) -> dict[str, Any]:
        """Columns and the Stribeck curve."""
        return c | Curve.of(c)._asdict()

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """Undeflected bristles; of a direction that is not known, the first velocity's is taken."""
        v = state.velocity
        way = np.where(v < 0.0, -1.0, 1.0) if direction is None else direction
        return {
            "z": np.zeros(v.size),
            "slip": (state.constants["sigma1"] + state.constants["sigma2"]) * v,
            "start": start,
            "direction": way,
            "moved": np.full(v.size, direction is not None),
        }

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Bristles after a straight way; directions of those that turned before it."""
        c, memory = state.constants, state.memory
        now: Mapping[str, Any] = c
        way = displacement - state.displacement
        varying = bool(scales or state.scales)
        if varying:
            previous, now = _at(c, state.scales), _at(c, scales)
            names = {*scales, *state.scales}
            curve = Curve.of(c | {name: 0.5 * (previous[name] + now[name]) for name in names})
        else:
            curve = Curve(c["kinetic"], c["excess"], c["rate"])
        rate = way / dt
        steady = curve.steady(rate)
        z = steady + np.exp(-way / steady) * (memory["z"] - steady)
        damping = np.copysign(velocity, rate) / steady
        if varying:
            damping *= limit_of(now, z, steady)
        slip = slip_force(now, damping, z, velocity)
        direction = np.where(
            way * memory["direction"] < 0.0, -memory["direction"], memory["direction"]
        )
        moved = memory["moved"] | (way != 0.0)
        return memory | {"z": z, "slip": slip, "direction": direction, "moved": moved}

    def total(self, state: State) -> Array:
        """F1, (n,), kip."""
        return state.memory["slip"]


def _at(c: Mapping[str, Any], scales: Columns) -> Mapping[str, Any]:
    """Parameters under a changed actuation."""
    return {**c, **{name: c[name] * factor for name, factor in scales.items()}} if scales else c


@dataclass(frozen=True)
class LuGre(PaperModel):
    """LuGre friction alone: the device without its gap (paper Eqs. 3 and 4)."""

    name = "lugre"
    parameters = (*PARAMETERS[:7], "v_s")
    quantities = sampled_for(parameters)

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """F1 at the samples, (T, n), kip."""
        return self.slip_along(c, trace, factors).take(trace.path.samples, axis=0)


SATURATED = 26.0
"""Transition lengths after which a transition is taken as complete: exp(−26) is 5e-12."""

FARTHEST = 150.0
"""Exponents are limited to it, so that the product of three exponentials is a number. Up to a gap
of as many transition lengths one exponential serves all three transitions."""

Constants = Mapping[str, Any]


def gap_of(columns: Mapping[str, Array]) -> dict[str, Any]:
    """What the formulas need of a model's columns, (n,) each.

    `early` and `late` are d2/ℓ and D/ℓ; only ℓ = γ2/γ1 reaches the force. `build_up` is the weight
    of stage 3 less that of slip at a turn, and `jump` the force of stage 3 there.
    """
    k2, k3, d2 = (columns[name] for name in ("k2", "k3", "d2"))
    width, ell = d2 + columns["d3"], columns["gamma2"] / columns["gamma1"]
    early, late = d2 / ell, width / ell
    return {
        "k2": k2,
        "k3": k3,
        "width": width,
        "ell": ell,
        "early": early,
        "late": late,
        "build_up": scipy.special.expit(late) * scipy.special.expit(-early),
        "jump": (k2 - k3) * d2,
        "after": np.exp(-np.stack([early, late])),
        "sharp": bool(late.max() > FARTHEST),
    }


class Gap(NamedTuple):
    """State of the gap, (n,), or in each stretch between turning points, (K + 1, n)."""

    side: Array
    edge: Array
    origin: Array
    carry: Array

    @classmethod
    def at(cls, c: Constants, side: Array, edge: Array, carry: Array) -> Gap:
        """The state, with its origin."""
        return cls(side, edge, np.where(side > 0.0, edge, edge + c["width"]), carry)

    @classmethod
    def begun(cls, c: Constants, displacement: Array, direction: Array, start: Array) -> Gap:
        """State before the first turning point; `start` is u/D along the first direction."""
        share = np.where(direction > 0.0, start, 1.0 - start)
        edge = displacement - share * c["width"]
        return cls.at(c, direction, edge, np.zeros(edge.shape))


def blend(c: Constants, side: Array, y: Array, carry: Array | float, slip: Array) -> Array:
    """Force of the three stages, kip, of the force F1 in slip (paper Eqs. 1 and 2).

    With R = exp(u/ℓ) the weights (model.md section 4) are m12 = (R − 1)/(R + 1) for u ≥ 0,
    m23 = A/(1 + A) with A = R exp(−d2/ℓ) and m31 = B/(1 + B) with B = R exp(−D/ℓ), so that with
    q = (R + 1)/2

        F − F1 = {q [A (F3 − F1) + (F2 − F1)] − (F2 − F1)} / ((1 + A)(1 + B) q) + ΔF/q

    For u < 0 m12 is 0, as if R were 1 in q, and ΔF fades with |u|.

    y is the displacement from the origin, in, so that F2 = k2 y and F3 = k3 y + side (k2 − k3) d2;
    `carry` is the jump ΔF at the last turn, kip.
    """
    u = side * y
    u /= c["ell"]
    if c["sharp"]:
        a, b = (np.exp(np.minimum(u - c[key], FARTHEST)) for key in ("early", "late"))
    r = np.maximum(np.minimum(u, FARTHEST, out=u), -SATURATED, out=u)
    np.exp(r, out=r)
    if not c["sharp"]:
        a, b = r * c["after"][0], r * c["after"][1]
    fading = np.maximum(r, 1.0 / r)
    fading += 1.0
    q = np.maximum(r, 1.0, out=r)
    q += 1.0
    q *= 0.5
    stick = c["k2"] * y
    stick -= slip
    force = c["k3"] * y
    force += side * c["jump"]
    force -= slip
    force *= a
    force += stick
    force *= q
    force -= stick
    a += 1.0
    b += 1.0
    a *= b
    a *= q
    force /= a
    force += 2.0 * carry / fading
    force += slip
    return np.asarray(force)


def shift_play(c: Constants, edge: Array, x: Array) -> Array:
    """Edge of the gap after a turn: motion beyond either end drags the gap along."""
    return np.asarray(np.minimum(np.maximum(edge, x - c["width"]), x))


def residual_jump(
    c: Constants, gap: Gap, x: Array, slip: Array, direction: Array
) -> tuple[Array, Array]:
    """Blended force before minus after a turn after slip, kip, without the carry; and its fading.

    After such a turn into `direction` the travel restarts at 0.
    """
    y = x - gap.origin
    u = gap.side * y
    jump = c["build_up"] * (slip - direction * c["jump"])
    soon = u < c["width"] + SATURATED * c["ell"]
    if soon.any():
        jump = np.where(soon, jump + (blend(c, gap.side, y, 0.0, slip) - slip), jump)
    return jump, 1.0 - np.tanh(np.abs(u) / (2.0 * c["ell"]))


def turned(c: Constants, gap: Gap, x: Array, slip: Array, direction: Array) -> Gap:
    """State after a turn of each device at a displacement into a direction, (n,) each.

    After slip (u ≥ D or u ≤ 0) the travel restarts at 0, and the force before minus the force
    after that is carried on. Inside the gap nothing is reset, so that the force retraces.
    """
    edge = shift_play(c, gap.edge, x)
    slipped = (edge == x) | (edge == x - c["width"])
    jump, fading = residual_jump(c, gap, x, slip, direction)
    carry = np.where(slipped, fading * gap.carry + jump, gap.carry)
    return Gap.at(c, np.where(slipped, direction, gap.side), edge, carry)


def edges_along(
    c: Constants, path: MotionPath, start: Array
) -> tuple[Gap, NDArray[np.bool_], Array]:
    """As `along`, without the carry; whether each turn ends a slip, and the directions after."""
    x = path.displacement[path.turning_points]
    initial = Gap.begun(c, path.displacement[0], np.full(start.size, float(path.direction)), start)
    edge = np.empty((x.size + 1, start.size))
    edge[0], lower = initial.edge, x[:, None] - c["width"]
    for k, turn in enumerate(x.tolist()):
        np.maximum(edge[k], lower[k], out=edge[k + 1])
        np.minimum(edge[k + 1], turn, out=edge[k + 1])
    slipped = (edge[1:] == x[:, None]) | (edge[1:] == lower)
    direction = np.where(np.arange(x.size + 1) % 2, -1.0, 1.0)[:, None] * path.direction
    latest = np.zeros(edge.shape, dtype=np.intp)  # turn that set the side of each stretch
    np.multiply(slipped, np.arange(1, x.size + 1)[:, None], out=latest[1:])
    np.maximum.accumulate(latest, axis=0, out=latest)
    side = direction[latest, 0]
    return Gap.at(c, side, edge, np.zeros(edge.shape)), slipped, direction[1:]


def along(c: Constants, path: MotionPath, start: Array, slip: Array) -> Gap:
    """State in every stretch between turning points, (K + 1, n), as `turned` at each of them.

    `start` is u/D at the first sample, (n,), and `slip` F1 at the turning points, (K, n), kip.
    """
    gap, slipped, direction = edges_along(c, path, start)
    x = path.displacement[path.turning_points, None]
    if len(x):
        previous = Gap(*(column[:-1] for column in gap))
        jump, fading = residual_jump(c, previous, x, slip, direction)
        fading[~slipped], jump[~slipped] = 1.0, 0.0
        gap.carry[1:] = solve(fading, jump, gap.carry[0])
    return gap


@dataclass(frozen=True)
class ThreeStage(PaperModel):
    """Friction damper with a gap (Cao et al., Eqs. 1 to 4; model.md sections 2 to 4)."""

    name = "three_stage"
    parameters = PARAMETERS
    quantities = sampled_for(PARAMETERS)
    has_gap = True
    nonidentifiable = ("gamma1",)  # only ℓ = γ2/γ1 reaches the force

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Force at the samples, (T, n), kip."""
        path, n = trace.path, start.size
        slip = self.slip_along(c, trace, factors)
        c = gap_of(c)
        gap = along(c, path, start, slip[path.turning_points])
        force, x, stretch = slip.take(path.samples, axis=0), trace.displacement, path.stretch
        # elsewhere the force is F1: the carried force has faded, and the gap is crossed
        far = SATURATED * c["ell"]
        low, high = (gap.edge - far).min(axis=1), (gap.edge + (c["width"] + far)).max(axis=1)
        (index,) = ((x >= low[stretch]) & (x <= high[stretch])).nonzero()
        length = max(PIECE // n, 1)
        for begin in range(0, index.size, length):
            rows = index[begin : begin + length]
            side, origin, carry = (a[stretch[rows]] for a in (gap.side, gap.origin, gap.carry))
            force[rows] = blend(c, side, x[rows, None] - origin, carry, force[rows])
        return force

    def compute_travel(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Travel u since the last slip, (T, n), in.

        From 0 to d2 + d3 the gap is crossed; beyond, the device slips.
        """
        gap, *_ = edges_along(gap_of(c), trace.path, start)
        stretch = trace.path.stretch
        return gap.side[stretch] * (trace.displacement[:, None] - gap.origin[stretch])

    def compute_end(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Place in the gap at the last sample, ½ + y/D, (n,), 1; see `Model.end`.

        A motion that begins there does not know the deflection of the bristles, the force that
        fades after an early turn, and, inside the gap, on which side the device last slipped: it
        takes the side that its first direction leads away from. All that is forgotten at its
        first turn after slip.
        """
        c = gap_of(c)
        gap, *_ = edges_along(c, trace.path, start)
        x_end = trace.path.displacement[-1]
        width, edge = c["width"], shift_play(c, gap.edge[-1], x_end)
        position = np.divide(x_end - edge, width, out=np.full(edge.shape, 0.5), where=width > 0)
        return np.asarray(np.clip(position, 0.0, 1.0))

    def start_at(
        self,
        position: Array,
        trace: Trace,
        previous_theta: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion at a place in the gap, (n,): it counts along its first direction."""
        return position if trace.path.direction > 0 else 1.0 - position

    def gap(self, values: Mapping[str, Array]) -> Array:
        """Width of the gap, D = d2 + d3, (n,), in."""
        columns = named_columns(values, ("d2", "d3"))
        return columns["d2"] + columns["d3"]

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """Stage at each sample, (n, T): 1 slip, 2 stick, 3 build-up; see `Model.stages`."""
        travel, columns = self.travel(theta, trace, start), self.columns(theta)
        d2, d3 = columns["d2"][:, None], columns["d3"][:, None]
        return np.select([travel >= d2 + d3, travel >= d2], [1, 3], 2).astype(np.int8)

    def constants(self, c: Columns) -> dict[str, Any]:
        """Those of LuGre, and of the gap."""
        return super().constants(c) | gap_of(c)

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """Undeflected bristles, and the gap at a share of its width."""
        memory = super().begin(state, start, direction)
        gap = Gap.begun(state.constants, state.displacement, memory["direction"], start)
        return memory | gap._asdict()

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Bristles after a straight way, and gaps of those that turned before it."""
        memory = super().advance(state, displacement, velocity, dt, scales)
        turns = memory["direction"] != state.memory["direction"]
        if turns.any():
            c, x, direction = state.constants, state.displacement, memory["direction"]
            old_gap = _gap(state)
            new_gap = turned(c, old_gap, x, state.memory["slip"], direction)
            moved = state.memory["moved"]
            if not moved.all():  # the direction was assumed, and was the other one
                start_gap = Gap.begun(c, x, direction, memory["start"])
                pairs = zip(new_gap, start_gap, strict=True)
                new_gap = Gap(*(np.where(moved, value, initial) for value, initial in pairs))
            pairs = zip(old_gap, new_gap, strict=True)
            memory |= Gap(
                *(np.where(turns, value, previous) for previous, value in pairs)
            )._asdict()
        return memory

    def total(self, state: State) -> Array:
        """Force of the three stages, (n,), kip."""
        gap = _gap(state)
        y = state.displacement - gap.origin
        return blend(state.constants, gap.side, y, gap.carry, state.memory["slip"])


def _gap(state: State) -> Gap:
    """Where the gaps of a state are."""
    return Gap(*(state.memory[name] for name in Gap._fields))
