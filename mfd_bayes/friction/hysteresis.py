"""Curve of Bouc-Wen hysteresis in one direction, tabulated for many vectors at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEAR = 2e-9
"""Distance from w = 1 at which z has reached F_y."""

REACH = 4.0
"""The curve is resolved down to w = −`REACH` times the ratio of the two F_y."""

FAR = 1e7
"""Factor by which w may go below that range after friction has fallen."""

CELLS = 96
"""Cells of each part of the curve, where it is evaluated."""

QUADRATURE = 128
"""Cells of each part of the curve, where it is integrated."""

_NODES = np.array([-(0.6**0.5), 0.0, 0.6**0.5])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 9.0  # Gauss-Legendre on [-1, 1]


@dataclass(frozen=True, eq=False)
class Curve:
    """Curve of z in one direction s = ±1, for n vectors: w = s z/F_y against ξ = k |x|/F_y.

        dw/dξ = 1 + (2β − 1) |w|^n for w < 0,   1 − |w|^n for w ≥ 0;   w(0) = 0

    Tabulated by Gauss-Legendre quadrature of dξ/dw and resampled so that a formula
    gives the cell of any ξ. Between knots it is the monotone rational quadratic spline of
    Gregory and Delbourgo (1982), which a formula inverts too. Cell sizes are graded as t²
    from the steep, lower end of each part.

    A wide curve has three more parts, needed only where friction falls: one cell for w far
    below 0; a gap of length 1 in ξ; and w above 1, where ξ measures the distance to the end.

    Attributes
    ----------
    parts : list of (n, 1)
        Lengths in ξ: below and above w = 0; when wide, far below, below, above, gap, beyond 1.
    cells : int
        Number of cells of each vector.
    low, rise, entry, bend : (n cells,)
        Of each cell: w at its start, rise of w, slope at the start divided by the rise, and
        sum of the slopes at both ends divided by the rise, minus 2.
    keys : (n (cells + 1),)
        Search keys of the knots: they increase with the vector and with w.
    """

    parts: list[Array]
    cells: int
    low: Array
    rise: Array
    entry: Array
    bend: Array
    keys: Array

    @classmethod
    def of(cls, exponent: Array, beta: Array, ratio: Array, *, wide: bool) -> Curve:
        """Curves for w ≥ −`REACH` × `ratio`, larger over smaller F_y; all arguments are (n,)."""
        power, soft = exponent[:, None, None], 2.0 * beta[:, None, None] - 1.0

        def slope(w: Array) -> Array:
            log = power * np.log(np.maximum(np.abs(w), 1e-300))
            grown = np.exp(np.minimum(log, 200.0))
            return np.asarray(np.where(w < 0, 1.0 + soft * grown, np.abs(grown - 1.0)))

        reach, y = REACH * ratio[:, None], np.linspace(0.0, 1.0, QUADRATURE + 1)
        near = np.log(NEAR)
        up = np.broadcast_to(1.0 - np.exp(near * y**1.5), (exponent.size, y.size))
        tables = [_part(-np.expm1(y[::-1] * np.log1p(reach)), slope), _part(up, slope)]
        if wide:
            far = _part(-reach * FAR ** y[::-1], slope, cells=1)
            one = np.ones((exponent.size, 1))
            gap = one, np.hstack([one - NEAR, one + NEAR]), 2.0 * NEAR * np.hstack([one, one])
            beyond = _part(1.0 + np.exp(near + y * (np.log(reach - 1.0) - near)), slope, flip=True)
            tables = [far, *tables, gap, beyond]
        rise = np.hstack([np.diff(knots) for _, knots, _ in tables])
        entry = np.hstack([rate[:, :-1] for *_, rate in tables]) / rise
        leave = np.hstack([rate[:, 1:] for *_, rate in tables]) / rise
        low = np.hstack([knots[:, :-1] for _, knots, _ in tables])
        knots = np.hstack([low, tables[-1][1][:, -1:]])
        return cls(
            parts=[length for length, *_ in tables],
            cells=rise.shape[1],
            low=low.ravel(),
            rise=rise.ravel(),
            entry=entry.ravel(),
            bend=(entry + leave - 2.0).ravel(),
            keys=_keys(knots).ravel(),
        )

    @property
    def wide(self) -> bool:
        """Whether it has the parts that falling friction needs."""
        return len(self.parts) > 2

    def move(self, xi: Array, way: Array) -> Array:
        """ξ after a distance `way`, (n, m), from `xi`, (n, 1); it stops where w has reached 1."""
        end = self.parts[2 if self.wide else 1]
        after = np.minimum(xi + way, end)
        if self.wide and np.any(over := xi > end + 0.5):
            after = np.where(over, np.maximum(xi - way, end + 1.0), after)
        return after

    def value(self, xi: Array) -> Array:
        """Value w at ξ, (n, m)."""
        below, above = self.parts[1:3] if self.wide else self.parts
        at = np.sqrt(np.clip(xi / below + 1.0, 0.0, 1.0))
        at += np.sqrt(np.clip(xi / above, 0.0, 1.0))
        at *= CELLS
        if self.wide:
            far, *_, beyond = self.parts
            at += np.sqrt(np.clip((xi + below) / far + 1.0, 0.0, 1.0))
            at += np.clip(xi - above, 0.0, 1.0)
            at += CELLS * (1.0 - np.sqrt(1.0 - np.clip((xi - above - 1.0) / beyond, 0.0, 1.0)))
        cell = np.minimum(at.astype(np.intp), self.cells - 1)
        at -= cell
        cell += self.cells * np.arange(len(xi))[:, None]
        return _spline(at, *(c[cell] for c in (self.low, self.rise, self.entry, self.bend)))

    def place(self, w: Array) -> Array:
        """ξ at which the value is w, (n,)."""
        row = np.arange(w.size)
        cell = np.searchsorted(self.keys, _keys(w[:, None])[:, 0], side="right") - 1
        cell = np.clip(cell - row * (self.cells + 1), 0, self.cells - 1)
        k = cell + row * self.cells
        at = cell + _inverse(
            np.clip((w - self.low[k]) / self.rise[k], 0.0, 1.0), self.entry[k], self.bend[k]
        )
        lengths = [length[:, 0] for length in self.parts]
        xi = np.zeros(w.size)
        if self.wide:
            xi -= lengths[0] * (1.0 - np.minimum(at, 1.0) ** 2)
            at -= 1.0
            xi += np.clip(at - 2 * CELLS, 0.0, 1.0)
            xi += lengths[4] * (1.0 - (1.0 - np.clip(at - 2 * CELLS - 1, 0, CELLS) / CELLS) ** 2)
            lengths = lengths[1:3]
        xi -= lengths[0] * (1.0 - (np.clip(at, 0.0, CELLS) / CELLS) ** 2)
        xi += lengths[1] * (np.clip(at - CELLS, 0.0, CELLS) / CELLS) ** 2
        return xi


def _part(
    w: Array, slope: Callable[[Array], Array], cells: int = CELLS, *, flip: bool = False
) -> tuple[Array, Array, Array]:
    """Length in ξ, (n, 1), and w and its slope at the knots, (n, cells + 1), of a part of a curve.

    Its `w`, (n, M), increases. With `flip` the cells are graded from the upper end.
    """
    half = 0.5 * np.diff(w)
    inside = (w[:, :-1] + half)[..., None] + half[..., None] * _NODES
    xi = np.zeros(w.shape)
    np.cumsum(half * ((1.0 / slope(inside)) @ _WEIGHTS), axis=1, out=xi[:, 1:])
    length = np.maximum(xi[:, -1:], 1e-250)
    xi /= length
    t = np.linspace(0.0, 1.0, cells + 1)
    share, rate = (1.0 - (1.0 - t) ** 2, 2.0 - 2.0 * t) if flip else (t**2, 2.0 * t)
    row = np.arange(len(w))[:, None]
    keys = (xi + 2.0 * row).ravel()
    found = np.searchsorted(keys, (share + 2.0 * row).ravel(), side="right").reshape(len(w), t.size)
    cell = np.clip(found - 1 - row * w.shape[1], 0, w.shape[1] - 2)
    rise, long = 2.0 * half, np.maximum(np.diff(xi), 1e-300)
    steep = slope(w[..., None])[..., 0] * length
    entry, leave = steep[:, :-1] * long / rise, steep[:, 1:] * long / rise
    columns = (w[:, :-1], rise, entry, entry + leave - 2.0)
    at = np.clip((share - xi[row, cell]) / long[row, cell], 0.0, 1.0)
    knots = _spline(at, *(c[row, cell] for c in columns))
    knots[:, 0], knots[:, -1] = w[:, 0], w[:, -1]
    return length, knots, slope(knots[..., None])[..., 0] * length * rate / cells


def _spline(at: Array, low: Array, rise: Array, entry: Array, bend: Array) -> Array:
    """Rational quadratic spline at a share `at` of each cell; `entry` is overwritten."""
    rest = 1.0 - at
    entry *= rest
    entry += at
    entry *= at
    rest *= at
    bend = bend * rest
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


def _keys(w: Array) -> Array:
    """Search keys, (n, m), which increase with the vector and with its values w."""
    return w / (1.0 + np.abs(w)) + 4.0 * np.arange(len(w))[:, None]
