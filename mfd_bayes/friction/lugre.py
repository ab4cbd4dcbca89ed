"""Stage 1: LuGre friction by its exact exponential step, and the model that is LuGre alone.

Every formula serves a record, with motions (T, 1) and parameters (n,), and a step, with (n,) of
both. Parameters that follow a varying actuation are (T, n) along a record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Columns, Model, State
from mfd_bayes.friction.quantity import STATIC, Array, columns_in_order, named_vectors, sampled_for
from mfd_bayes.records.trace import Trace

FLOOR = 1e-9
"""Least slip force g, kip, and bristle stiffness, kip/in, so that nothing divides by zero."""

PIECE = 1 << 15  # size of a piece's arrays, in numbers: they stay in the cache

SHORT = 24  # up to this many steps of a recurrence are taken one after the other

PARAMETERS = (
    "sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd",
    "k2", "k3", "d2", "d3", "gamma1", "gamma2", "v_s",
)  # fmt: skip
"""All parameters of the MFD paper, in its order."""


def solve(decay: Array, drive: Array, first: Array) -> Array:
    """States z_k = decay_k z_{k−1} + drive_k after each of N steps, (N, n).

    `decay` and `drive` are (N, n); `first`, (n,), is z before the first step. The steps are taken
    in blocks: a step in all of them at once, and then from block to block.
    """
    steps, n = decay.shape
    if steps <= SHORT:
        states, last = drive.copy(), first
        for a, z in zip(decay, states, strict=True):
            z += a * last
            last = z
        return states
    length = round(1.3 * steps ** (1 / 3) if steps > SHORT**2 else steps**0.5)
    count = -(-steps // length)
    # (length, count, n): the j-th steps of all blocks together; what fills up the last one is 0
    a, z = np.zeros((2, length, count, n))
    for blocks, given in ((a, decay), (z, drive)):
        by_block = blocks.swapaxes(0, 1)
        by_block[:-1] = given[: (count - 1) * length].reshape(count - 1, length, n)
        by_block[-1, : steps - (count - 1) * length] = given[(count - 1) * length :]
    for j in range(1, length):
        z[j] += a[j] * z[j - 1]
        a[j] *= a[j - 1]
    # the last block is followed by none, so that its end does not matter
    before = np.concatenate([first[None], solve(a[-1, :-1], z[-1, :-1], first)])
    a *= before
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
    most = np.maximum(np.maximum(c["Fs_fwd"], c["Fs_bwd"]), FLOOR)
    most = most / np.maximum(np.minimum(c["Fc_fwd"], c["Fc_bwd"]), FLOOR)
    limit: Array = np.minimum(1.0, most / np.maximum(np.abs(z / steady), 1e-300))
    return limit


class PaperModel(Model):
    """What LuGre and the three stages have in common: the paper's friction."""

    positive = frozenset({"sigma0", "gamma1", "gamma2", "v_s"})
    slip_forces = ("Fc_fwd", "Fc_bwd")
    laws = MappingProxyType(
        {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine"}
    )
    tied_laws = MappingProxyType({static: kinetic for static, (kinetic, _) in STATIC.items()})

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p): F_s = F_c (1 + excess), γ2 = ℓ γ1."""
        known = named_vectors(values, [q.name for q in self.quantities if q.sampled])
        for static, (kinetic, excess) in STATIC.items():
            known[static] = known[kinetic] * (1.0 + known[excess])
        if "gamma2" in self.parameters:
            known["gamma2"] = known["ell"] * known["gamma1"]
        return np.stack([known[name] for name in self.parameters], axis=1)

    def vectors(self, theta: ArrayLike) -> Array:
        """Theta as numbers, (n, p).

        LuGre takes its own from a theta in the paper's order, (n, 14), too.
        """
        values = columns_in_order("theta", theta, self.parameters)
        if values.ndim == 2 and values.shape[1] == len(PARAMETERS) != len(self.parameters):
            values = values[:, [PARAMETERS.index(name) for name in self.parameters]]
        return super().vectors(values)

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
                at = np.arange(samples)[rows]
                last = np.maximum(at - 1, 0)
                now = c | {k: f[at] * c[k] for k, f in factors.items()}
                mean = {k: 0.5 * (f[last] + f[at]) * c[k] for k, f in factors.items()}
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
            before, now = _at(c, state.scales), _at(c, scales)
            names = {*scales, *state.scales}
            curve = Curve.of(c | {name: 0.5 * (before[name] + now[name]) for name in names})
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
    """LuGre friction alone: the device without its gap (paper Eqs. 3 and 4).

    theta holds this model's own parameters, (n, 8), or all of the paper's, (n, 14).
    """

    name = "lugre"
    parameters = (*PARAMETERS[:7], "v_s")
    quantities = sampled_for(parameters)

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """F1 at the samples, (T, n), kip."""
        return self.slip_along(c, trace, factors).take(trace.path.samples, axis=0)
