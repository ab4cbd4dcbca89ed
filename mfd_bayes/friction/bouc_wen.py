"""Bouc-Wen hysteresis with a yield force for each direction, a competing model.

Bouc (1967), Wen (1976); the admissible range of β is that of Erlicher and Point (2004).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import (
    QUANTITIES,
    Array,
    Columns,
    Model,
    Rows,
    State,
    through_vertices,
)
from mfd_bayes.friction.three_stage import PIECE
from mfd_bayes.records.trace import Trace

ACTUATED = ("Fy_fwd", "Fy_bwd")

FLOOR = 1e-6  # least share of F_y that is left at zero actuation, so that nothing divides by zero
NEAR = 2e-9  # distance from w = 1 at which z has reached F_y
REACH = 4.0  # the curve is resolved down to w = −`REACH` times the ratio of the two F_y
FAR = 1e7  # factor by which w may go below that range after friction has fallen
CELLS = 96  # cells of each part of the curve, where it is evaluated
QUADRATURE = 128  # cells of each part of the curve, where it is integrated
_NODES = np.array([-(0.6**0.5), 0.0, 0.6**0.5])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 9.0  # Gauss-Legendre on [-1, 1]


class Part(NamedTuple):
    """A part of the curve: its knots' w and their slopes over a cell, (n, cells + 1) each.

    It begins at ξ = `begin` and is `length` long, (n,) each. Cells are graded as t² from its lower
    end, or its upper one where `flipped`.
    """

    begin: Array
    length: Array
    knots: Array
    slopes: Array
    flipped: bool = False

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(self.knots.shape[1]) - 1


@dataclass(frozen=True, eq=False)
class Curve:
    """Curve of z in one direction s = ±1, for n vectors: w = s z/F_y against ξ = k |x|/F_y.

        dw/dξ = 1 + (2β − 1) |w|^n for w < 0,   1 − |w|^n for w ≥ 0;   w(0) = 0

    Tabulated by Gauss-Legendre quadrature of dξ/dw and resampled so that a formula
    gives the cell of any ξ. Between knots it is the monotone rational quadratic spline of
    Gregory and Delbourgo (1982), which a formula inverts too.

    Its parts are w below and above 0. A wide curve has three more, needed only where friction
    falls: one cell for w far below 0; a gap of length 1 in ξ; and w above 1, where ξ measures the
    distance to the end.

    Attributes
    ----------
    parts : list of Part
        By increasing w.
    end : (n,)
        ξ at which w has reached 1.
    low, rise, entry, bend : (cells n,)
        Of each cell: w at its start, rise of w, slope at the start divided by the rise, and
        sum of the slopes at both ends divided by the rise, minus 2.
    keys : (n (cells + 1),)
        Search keys of the knots: they increase with the vector and with w.
    """

    parts: list[Part]
    end: Array
    low: Array
    rise: Array
    entry: Array
    bend: Array
    keys: Array

    @classmethod
    def of(cls, c: Columns, *, wide: bool) -> Curve:
        """Curves of Bouc-Wen's parameters, (n,) each."""
        power, soft = c["exponent"][:, None, None], 2.0 * c["beta"][:, None, None] - 1.0

        def slope(w: Array) -> Array:
            log = power * np.log(np.maximum(np.abs(w), 1e-300))
            grown = np.exp(np.minimum(log, 200.0))
            return np.asarray(np.where(w < 0, 1.0 + soft * grown, np.abs(grown - 1.0)))

        pair = c["Fy_fwd"], c["Fy_bwd"]
        reach = REACH * (np.maximum(*pair) / np.minimum(*pair))[:, None]
        y, near = np.linspace(0.0, 1.0, QUADRATURE + 1), np.log(NEAR)
        up = np.broadcast_to(1.0 - np.exp(near * y**1.5), (len(reach), y.size))
        below, above = _part(-np.expm1(y[::-1] * np.log1p(reach)), slope), _part(up, slope)
        below, end = below._replace(begin=-below.length), above.length
        parts = [below, above]
        if wide:
            far = _part(-reach * FAR ** y[::-1], slope, cells=1)
            one = np.ones((len(reach), 1))
            gap = np.hstack([one - NEAR, one + NEAR]), 2.0 * NEAR * np.hstack([one, one])
            over = 1.0 + np.exp(near + y * (np.log(reach - 1.0) - near))
            beyond = _part(over, slope, flipped=True)
            parts = [
                far._replace(begin=below.begin - far.length),
                *parts,
                Part(end, one[:, 0], *gap),
                beyond._replace(begin=end + 1.0),
            ]
        low = np.hstack([part.knots[:, :-1] for part in parts])
        rise = np.hstack([np.diff(part.knots) for part in parts])
        entry = np.hstack([part.slopes[:, :-1] for part in parts]) / rise
        leave = np.hstack([part.slopes[:, 1:] for part in parts]) / rise
        keys = _key(np.hstack([low, parts[-1].knots[:, -1:]]), np.arange(len(low))[:, None]).ravel()
        tables = (low, rise, entry, entry + leave - 2.0)
        low, rise, entry, bend = (table.T.ravel() for table in tables)
        return cls(parts, end, low, rise, entry, bend, keys)

    @property
    def cells(self) -> int:
        """Number of cells of each vector."""
        return sum(part.cells for part in self.parts)

    def move(self, xi: Array, way: Array, row: Rows) -> Array:
        """ξ after a distance `way`, (…, n), from `xi`, (n,); it stops where w has reached 1."""
        end = self.end[row]
        after = np.minimum(xi + way, end)
        if len(self.parts) > 2 and np.any(over := xi > end + 0.5):
            after = np.where(over, np.maximum(xi - way, end + 1.0), after)
        return np.asarray(after)

    def value(self, xi: Array, row: Rows) -> Array:
        """Value w at ξ, (…, n), of the vectors `row`, (n,)."""
        at = np.zeros(xi.shape)
        for part in self.parts:
            share = (xi - part.begin[row]) / part.length[row]
            np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
            if part.flipped:
                np.subtract(1.0, share, out=share)
            np.sqrt(share, out=share)
            if part.flipped:
                np.subtract(1.0, share, out=share)
            share *= part.cells
            at += share
        cell = np.minimum(at.astype(np.intp), self.cells - 1)
        at -= cell
        cell *= self.end.size
        cell += row
        return _spline(at, *(c.take(cell) for c in (self.low, self.rise, self.entry, self.bend)))

    def place(self, w: Array, row: Rows) -> Array:
        """ξ at which the value is w, (n,), of the vectors `row`."""
        cell = np.searchsorted(self.keys, _key(w, row), side="right") - 1
        cell = np.clip(cell - row * (self.cells + 1), 0, self.cells - 1)
        k = cell * self.end.size + row
        share = np.clip((w - self.low[k]) / self.rise[k], 0.0, 1.0)
        at = cell + _inverse(share, self.entry[k], self.bend[k])
        xi = np.zeros(w.shape)
        for part in self.parts:
            share = np.minimum(np.maximum(at, 0.0), part.cells) / part.cells
            share = 1.0 - (1.0 - share) ** 2 if part.flipped else share**2
            # counted from ξ = 0, where small numbers are exact
            xi += part.length[row] * (share - (part.begin[row] < 0.0))
            at -= part.cells
        return xi


def _key(w: Array, row: Rows) -> Array:
    return np.asarray(w / (1.0 + np.abs(w)) + 4.0 * row)


def _part(
    w: Array, slope: Callable[[Array], Array], cells: int = CELLS, *, flipped: bool = False
) -> Part:
    """A part of a curve through values w, (n, M), which increase; it begins at 0."""
    half = 0.5 * np.diff(w)
    inside = (w[:, :-1] + half)[..., None] + half[..., None] * _NODES
    xi = np.zeros(w.shape)
    np.cumsum(half * ((1.0 / slope(inside)) @ _WEIGHTS), axis=1, out=xi[:, 1:])
    length = np.maximum(xi[:, -1:], 1e-250)
    xi /= length
    t = np.linspace(0.0, 1.0, cells + 1)
    share, rate = (1.0 - (1.0 - t) ** 2, 2.0 - 2.0 * t) if flipped else (t**2, 2.0 * t)
    row = np.arange(len(w))[:, None]
    found = np.searchsorted((xi + 2.0 * row).ravel(), (share + 2.0 * row).ravel(), side="right")
    cell = np.clip(found.reshape(len(w), -1) - 1 - row * w.shape[1], 0, w.shape[1] - 2)
    rise, long = 2.0 * half, np.maximum(np.diff(xi), 1e-300)
    steep = slope(w[..., None])[..., 0] * length
    entry, leave = steep[:, :-1] * long / rise, steep[:, 1:] * long / rise
    columns = (w[:, :-1], rise, entry, entry + leave - 2.0)
    at = np.clip((share - xi[row, cell]) / long[row, cell], 0.0, 1.0)
    knots = _spline(at, *(c[row, cell] for c in columns))
    knots[:, 0], knots[:, -1] = w[:, 0], w[:, -1]
    slopes = slope(knots[..., None])[..., 0] * length * rate / cells
    return Part(np.zeros(len(w)), length[:, 0], knots, slopes, flipped)


def _spline(at: Array, low: Array, rise: Array, entry: Array, bend: Array) -> Array:
    """Rational quadratic spline at a share `at` of each cell; all but `rise` are overwritten."""
    rest = 1.0 - at
    entry *= rest
    entry += at
    entry *= at
    rest *= at
    bend *= rest
    bend += 1.0
    entry /= bend
    entry *= rise
    entry += low
    return entry


def _inverse(share: Array, entry: Array, bend: Array) -> Array:
    """Share of the cell at which `_spline` has made a given share of its rise."""
    b = entry - share * bend
    root = np.sqrt(np.maximum(b * b + 4.0 * (1.0 - b) * share, 0.0))
    stable = 2.0 * share / np.maximum(b + root, 1e-300)
    return np.where(b >= 0, stable, (root - b) / np.maximum(2.0 - 2.0 * b, 1.0))


def strength_of(
    c: Mapping[str, Any], forward: bool | NDArray[np.bool_], before: Columns, after: Columns
) -> Array:
    """F_y of a step between two samples, with the sign of its direction, (n,), kip."""
    shares = (0.5 * (before.get(name, 1.0) + after.get(name, 1.0)) for name in ACTUATED)
    ahead, back = (c[k] * np.maximum(s, FLOOR) for k, s in zip(ACTUATED, shares, strict=True))
    return np.asarray(np.where(forward, ahead, -back))


def advanced(c: Mapping[str, Any], row: Rows, strength: Array, z: Array, way: Array) -> Array:
    """Force z, (…, n), kip, after distances `way` in the direction of `strength`'s sign."""
    curve: Curve = c["curve"]
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
    z/F_y depends on k |x − x_turn|/F_y alone and is taken from a `Curve`.
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
        given: dict[str, Any] = {**c, "curve": Curve.of(c, wide=bool(factors))}
        row = np.arange(n)
        _, x, nearest, samples = through_vertices(trace)
        z = np.zeros((x.size, n))
        for begin, end, forward in _stretches(x, PIECE // max(n, 1), each=bool(factors)):
            way = np.abs(x[begin:end, None] - x[begin - 1])
            before, after = (
                {name: f[nearest[i]] for name, f in factors.items()} for i in (begin - 1, begin)
            )
            strength = strength_of(c, forward, before, after)
            z[begin:end] = advanced(given, row, strength, z[begin - 1], way)
        moved = trace.displacement[:, None] - trace.displacement[0]
        return total_force(c, z[samples], moved, trace.velocity[:, None])

    def constants(self, c: Columns) -> dict[str, Any]:
        """Columns and the curve of z."""
        return c | {"curve": Curve.of(c, wide=True), "row": np.arange(c["k"].size)}

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
        after = advanced(c, c["row"], strength, z, np.abs(way))
        return state.memory | {"z": np.where(way == 0.0, z, after)}

    def total(self, state: State) -> Array:
        """F, (n,), kip."""
        moved = state.displacement - state.memory["origin"]
        return total_force(state.constants, state.memory["z"], moved, state.velocity)


def _stretches(x: Array, most: int, *, each: bool) -> list[tuple[int, int, bool]]:
    """Ranges of at most `most` steps in one direction: first row, row after the last, forward.

    Steps of zero length belong to the range before them; at the start they are left out.
    With `each` every step that moves is a range of its own.
    """
    sign = np.sign(np.diff(x))
    moving = np.flatnonzero(sign)
    new = np.diff(sign[moving], prepend=0.0) != 0
    length = max(sign.size if each else most, 1)
    edges = [*(moving if each else moving[new]).tolist(), sign.size]
    return [
        (begin + 1, min(begin + length, end) + 1, bool(sign[first] > 0))
        for first, end in pairwise(edges)
        for begin in range(first, end, length)
    ]
