"""Bouc-Wen hysteresis with a yield force for each direction, a competing model.

Bouc (1967), Wen (1976); the admissible range of β is that of Erlicher and Point (2004).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import PIECE, Array, Columns, Model, Rows, State, through_vertices
from mfd_bayes.friction.quantities import QUANTITIES
from mfd_bayes.records.trace import Trace

ACTUATED = ("Fy_fwd", "Fy_bwd")

FLOOR = 1e-6  # least share of F_y that is left at zero actuation, so that nothing divides by zero
NEAR = 2e-9  # distance from w = 1 at which z has reached F_y
REACH = 4.0  # the curve is resolved down to w = −`REACH` times the ratio of the two F_y
FAR = 1e7  # factor by which w may go below that range after friction has fallen
CELLS = 96  # cells of each part of the curve
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class EnergyCurve:
    """Curve of z in one direction s = ±1, for n vectors: w = s z/F_y against ξ = k |x|/F_y.

        dw/dξ = 1 + (2β − 1) |w|^n for w < 0,   1 − |w|^n for w ≥ 0;   w(0) = 0

    Tabulated by Gauss-Legendre quadrature of dξ/dw. Between its knots it is the monotone rational
    quadratic spline of Gregory and Delbourgo (1982), which a formula inverts. Where friction falls,
    w may lie far below 0, or above 1: there ξ, after a gap of length 1, grows as w does.

    Attributes
    ----------
    knots : (2, n, cells + 1)
        ξ and w.
    end : (n,)
        ξ at which w has reached 1.
    length, rise, entry, bend : (n, cells)
        Of each cell: its length in ξ, rise of w, slope at the start divided by their ratio, and sum
        of the slopes at both ends divided by it, minus 2.
    """

    knots: Array
    end: Array
    length: Array
    rise: Array
    entry: Array
    bend: Array

    @classmethod
    def of(cls, c: Columns) -> EnergyCurve:
        """Curves of Bouc-Wen's parameters, (n,) each."""
        power, soft = c["exponent"][:, None], 2.0 * c["beta"][:, None] - 1.0

        def slope(w: Array) -> Array:
            log = power * np.log(np.maximum(np.abs(w), 1e-300))
            grown = np.exp(np.minimum(log, 200.0))
            steep = np.where(w < 0, 1.0 + soft * grown, np.abs(grown - 1.0))
            return np.maximum(steep, 1e-300)

        pair = c["Fy_fwd"], c["Fy_bwd"]
        reach = REACH * (np.maximum(*pair) / np.minimum(*pair))[:, None]
        y, log_near = np.linspace(0.0, 1.0, CELLS + 1), np.log(NEAR)
        negative = [-reach * FAR ** y[:0:-8], -np.expm1(y[:0:-1] * np.log1p(reach))]
        rising = np.broadcast_to(1.0 - np.exp(log_near * y**1.5), (len(reach), y.size))
        w = np.hstack(
            [*negative, rising, 1.0 + np.exp(log_near + y * (np.log(reach - 1.0) - log_near))]
        )
        half, zero = 0.5 * np.diff(w), negative[0].shape[1] + CELLS
        middle, gap = w[:, :-1] + half, zero + CELLS
        pairs = zip(_NODES, _WEIGHTS, strict=True)
        length = half * sum(weight / slope(middle + half * node) for node, weight in pairs)
        length[:, gap] = 1.0
        # counted from ξ = 0, where small numbers are exact
        xi_negative = -np.cumsum(length[:, :zero][:, ::-1], axis=1)[:, ::-1]
        xi = np.hstack([xi_negative, np.zeros((len(w), 1)), np.cumsum(length[:, zero:], axis=1)])
        steep, rise = slope(w), 2.0 * half
        entry, leave = (s * length / rise for s in (steep[:, :-1], steep[:, 1:]))
        knots = np.stack([xi, w])
        return cls(knots, xi[:, gap], length, rise, entry, entry + leave - 2.0)

    def move(self, xi: Array, way: Array, row: Rows) -> Array:
        """ξ after a distance `way`, (…, n), from `xi`, (n,); it stops where w has reached 1."""
        end = self.end[row]
        moved = np.minimum(xi + way, end)
        if np.any(overshot := xi > end + 0.5):
            moved = np.where(overshot, np.maximum(xi - way, end + 1.0), moved)
        return np.asarray(moved)

    def value(self, xi: Array, row: Rows) -> Array:
        """Value w at ξ, (…, n), of the vectors `row`, (n,)."""
        cell, offset, entry, bend = self._cell(0, xi, row)
        t = np.clip(offset / self.length[row, cell], 0.0, 1.0)
        u = 1.0 - t
        share = t * (entry * u + t) / (1.0 + bend * t * u)
        return np.asarray(self.knots[1, row, cell] + self.rise[row, cell] * share)

    def place(self, w: Array, row: Rows) -> Array:
        """ξ at which the value is w, (n,), of the vectors `row`."""
        cell, offset, entry, bend = self._cell(1, w, row)
        share = np.clip(offset / self.rise[row, cell], 0.0, 1.0)
        b = entry - share * bend
        root = np.sqrt(np.maximum(b * b + 4.0 * (1.0 - b) * share, 0.0))
        stable = 2.0 * share / np.maximum(b + root, 1e-300)
        t = np.where(b >= 0, stable, (root - b) / np.maximum(2.0 - 2.0 * b, 1.0))
        return np.asarray(self.knots[0, row, cell] + self.length[row, cell] * t)

    def _cell(self, axis: int, values: Array, row: Rows) -> tuple[Rows, Array, Array, Array]:
        """Cells of values of ξ or w, the way from their start, and their `entry` and `bend`."""
        index = np.searchsorted(self._keys[axis], _key(values, row), side="right") - 1
        knots = self.knots.shape[2]
        cell = np.clip(index - row * knots, 0, knots - 2)
        offset = values - self.knots[axis, row, cell]
        return cell, offset, self.entry[row, cell], self.bend[row, cell]

    @cached_property
    def _keys(self) -> Array:
        """Search keys of ξ and of w, which increase with the vector too."""
        keys = _key(self.knots, np.arange(len(self.end))[:, None])
        return keys.reshape(2, -1)


def _key(values: Array, row: Rows) -> Array:
    return values / (1.0 + np.abs(values)) + 4.0 * row


def strength_of(
    c: Mapping[str, Any],
    forward: bool | NDArray[np.bool_],
    start_scales: Columns,
    end_scales: Columns,
) -> Array:
    """F_y of a step between two samples, with the sign of its direction, (n,), kip."""
    shares = (0.5 * (start_scales.get(name, 1.0) + end_scales.get(name, 1.0)) for name in ACTUATED)
    fwd, bwd = (c[k] * np.maximum(s, FLOOR) for k, s in zip(ACTUATED, shares, strict=True))
    return np.asarray(np.where(forward, fwd, -bwd))


def advanced(c: Mapping[str, Any], row: Rows, strength: Array, z: Array, way: Array) -> Array:
    """Force z, (…, n), kip, after distances `way` in the direction of `strength`'s sign."""
    curve: EnergyCurve = c["curve"]
    xi = curve.move(curve.place(z / strength, row), c["k"] / np.abs(strength) * way, row)
    return curve.value(xi, row) * strength


def total_force(c: Mapping[str, Any], z: Array, x: Array, v: Array) -> Array:
    """F = α k x + (1 − α) z + c v, kip."""
    force: Array = (1.0 - c["alpha"]) * z
    force += c["alpha"] * c["k"] * x
    force += c["c"] * v
    return force


@dataclass(frozen=True)
class BoucWen(Model):
    """Bouc-Wen hysteresis, a spring and a dashpot side by side.

        F = α k (x − x_0) + (1 − α) z + c v
        dz/dx = k [1 − |z/F_y|^n (γ + β sgn(z dx))],   γ = 1 − β,   z(0) = 0

    x_0 is the trace's first displacement. F_y is Fy_fwd in forward and Fy_bwd in backward
    motion; under a varying actuation it is the mean of its values at both ends of a step. z
    is a force: like LuGre's bristles it stays unchanged while nothing moves, even when the
    actuation falls. There is no gap: `start` is ignored.

    Every change of direction is a turn. A turn between samples has its vertex as in
    `Trace.path`, so that the force does not depend on the trace's hysteresis. Between turns
    z/F_y depends on k |x − x_turn|/F_y alone and is taken from a `EnergyCurve`.
    """

    name = "bouc_wen"
    parameters = ("k", "alpha", *ACTUATED, "beta", "exponent", "c")
    quantities = tuple(map(QUANTITIES.__getitem__, parameters))
    positive = frozenset({"k", *ACTUATED})
    slip_forces = ACTUATED
    laws = MappingProxyType(dict.fromkeys(ACTUATED, "proportional"))
    laws_from = MappingProxyType({"Fy_fwd": "Fc_fwd", "Fy_bwd": "Fc_bwd"})

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Force at the samples, (T, n), kip."""
        n = start.size
        constants: dict[str, Any] = {**c, "curve": EnergyCurve.of(c)}
        row = np.arange(n)
        _, x, nearest, samples = through_vertices(trace)
        z = np.zeros((x.size, n))
        for begin, end, forward in _stretches(x, PIECE // max(n, 1), single=bool(factors)):
            way = np.abs(x[begin:end, None] - x[begin - 1])
            start_scales, end_scales = (
                {name: f[nearest[i]] for name, f in factors.items()} for i in (begin - 1, begin)
            )
            strength = strength_of(c, forward, start_scales, end_scales)
            z[begin:end] = advanced(constants, row, strength, z[begin - 1], way)
        moved = trace.displacement[:, None] - trace.displacement[0]
        return total_force(c, z[samples], moved, trace.velocity[:, None])

    def constants(self, c: Columns) -> dict[str, Any]:
        """Columns and the curve of z."""
        return c | {"curve": EnergyCurve.of(c), "row": np.arange(c["k"].size)}

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """No force, and the displacement that α k counts from."""
        return {"z": np.zeros(start.size), "origin": state.displacement}

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Force z after a straight way."""
        c, z = state.constants, state.memory["z"]
        way = displacement - state.displacement
        strength = strength_of(c, way > 0.0, state.scales, scales)
        z_next = advanced(c, c["row"], strength, z, np.abs(way))
        return state.memory | {"z": np.where(way == 0.0, z, z_next)}

    def total(self, state: State) -> Array:
        """F, (n,), kip."""
        moved = state.displacement - state.memory["origin"]
        return total_force(state.constants, state.memory["z"], moved, state.velocity)


def _stretches(x: Array, limit: int, *, single: bool) -> list[tuple[int, int, bool]]:
    """Ranges of at most `limit` steps in one direction: first row, row after the last, forward.

    Steps of zero length belong to the range before them; at the start they are left out.
    With `single` every step that moves is a range of its own.
    """
    sign = np.sign(np.diff(x))
    moving = np.flatnonzero(sign)
    turns = np.diff(sign[moving], prepend=0.0) != 0
    length = max(sign.size if single else limit, 1)
    edges = [*(moving if single else moving[turns]).tolist(), sign.size]
    return [
        (begin + 1, min(begin + length, end) + 1, bool(sign[start] > 0))
        for start, end in pairwise(edges)
        for begin in range(start, end, length)
    ]
