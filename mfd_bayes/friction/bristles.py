"""Stage 1: LuGre friction, by its exact exponential step (paper Eqs. 3 and 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import Along, add_outer, add_row, aligned, outer, rows_of, scratch
from mfd_bayes.friction.recurrence import Blocks
from mfd_bayes.records.motion import MotionPath

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FLOOR = 1e-9
"""Least slip force g, kip, and bristle stiffness, kip/in, so that nothing divides by zero."""

NO_STEP = 1e-30
"""Length, in, that replaces a step of zero: nothing moves, and nothing divides by zero."""

PIECE = 1 << 16
"""Size of a piece's arrays, in numbers: four of them are small enough for the second cache."""


@dataclass(frozen=True)
class Friction:
    """LuGre's parameters for n vectors.

    `sigma0` and the four forces are (1, n) where the actuation is constant and (P, n), one
    row for each sample of the path, where it varies; the others are (1, n).
    """

    sigma0: Array
    sigma1: Array
    sigma2: Array
    Fs_fwd: Array
    Fc_fwd: Array
    Fs_bwd: Array
    Fc_bwd: Array
    v_s: Array

    @property
    def vectors(self) -> int:
        """Number of parameter vectors n."""
        return int(self.v_s.shape[1])

    @property
    def varying(self) -> bool:
        """Whether friction varies from sample to sample with the actuation."""
        followers = (self.sigma0, self.Fs_fwd, self.Fc_fwd, self.Fs_bwd, self.Fc_bwd)
        return max(map(len, followers)) > 1

    @classmethod
    def of(cls, stations: list[Friction]) -> Friction:
        """Friction at several samples, joined from that at each, (1, n) columns."""
        columns = {}
        for f in fields(cls):
            values = [getattr(station, f.name) for station in stations]
            same = all(value is values[0] for value in values)
            columns[f.name] = values[0] if same else np.concatenate(values)
        return cls(**columns)

    def at(self, rows: Rows) -> Friction:
        """Friction at some samples of the path; what is constant stays (1, n)."""
        return self._each(lambda values: values[rows])

    def midway(self, rows: Rows) -> Friction:
        """Friction in the middle of the steps that end at some samples of the path."""
        before = np.maximum(rows - 1, 0)
        return self._each(lambda values: 0.5 * (values[before] + values[rows]))

    def _each(self, change: Callable[[Array], Array]) -> Friction:
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{k: change(c) for k, c in columns.items() if len(c) > 1})


def friction_of(columns: dict[str, Array]) -> Friction:
    """Friction from a model's columns by name."""
    return Friction(**{f.name: columns[f.name] for f in fields(Friction)})


@dataclass(frozen=True)
class Motion:
    """Some samples of a path, (rows,) each, and what is the same for all parameter vectors.

    Attributes
    ----------
    rows : int
        The samples.
    step : in
        Length of the step that ends at the sample; never 0, see `NO_STEP`.
    square : in²/s²
        Square of the step's mean velocity.
    backward : int
        1 where the mean velocity is negative, else 0.
    velocity : in/s
        At the sample.
    share : 1/s
        |velocity| over |step|.
    """

    rows: Rows
    step: Array
    square: Array
    backward: Rows
    velocity: Array
    share: Array

    @classmethod
    def of(cls, rows: Rows, step: Array, rate: Array, velocity: Array) -> Motion:
        """Motion of steps with their mean velocities, (rows,) each."""
        step = np.where(step == 0.0, NO_STEP, step)
        backward = (rate < 0).astype(np.intp)
        return cls(rows, step, rate**2, backward, velocity, np.abs(velocity / step))

    @cached_property
    def lines(self) -> tuple[Along, Along]:
        """Points at the squares and at the steps, on lines forward and backward."""
        return Along.of(self.backward, self.square), Along.of(self.backward, self.step)


@dataclass(frozen=True)
class Curve:
    """Stribeck curve g = F_c {1 + (F_s/F_c − 1) exp(−(v/v_s)²)} of friction that does not vary.

    Attributes
    ----------
    kinetic : (2, n), in
        Deflection F_c/σ0 forward and, negative, backward.
    fall, relaxing : (2, 2, n)
        Lines over v² of ln(g/F_c − 1), and over Δx of −σ0 |Δx|/F_c, forward and backward.
    """

    kinetic: Array
    fall: Array
    relaxing: Array

    @classmethod
    def of(cls, friction: Friction) -> Curve:
        """The curve of friction."""
        stiffness = np.maximum(friction.sigma0, FLOOR)
        least = np.maximum(np.concatenate([friction.Fc_fwd, friction.Fc_bwd]), FLOOR)
        excess = np.concatenate([friction.Fs_fwd, friction.Fs_bwd]) / least - 1.0
        kinetic = least / stiffness
        kinetic[1] *= -1.0
        fall = np.empty((2, *kinetic.shape))
        fall[:, 0], fall[:, 1] = -1.0 / friction.v_s**2, np.log(np.maximum(excess, 1e-300))
        relaxing = np.zeros(fall.shape)
        relaxing[:, 0] = -1.0 / kinetic
        return cls(kinetic, fall, relaxing)

    def along(self, motion: Motion, exponent: Array, steady: Array, work: Array) -> None:
        """Compute what `_approach` does, in few passes."""
        squares, steps = motion.lines
        squares.lines(self.fall, out=steady, work=work)
        np.exp(steady, out=steady)
        steady += 1.0
        steps.lines(self.relaxing, out=exponent, work=work)
        exponent /= steady
        steady *= rows_of(self.kinetic, motion.backward, out=work)


@dataclass(frozen=True)
class Piece:
    """Consecutive samples of a path in the order of their blocks.

    Attributes
    ----------
    own, turns : slice
        The trace's samples and the turning points that are in the piece.
    own_place, turns_place : int
        Rows of both in the piece's arrays.
    """

    motion: Motion
    blocks: Blocks
    own: slice
    own_place: Rows
    turns: slice
    turns_place: Rows

    @classmethod
    def of(cls, path: MotionPath, begin: int, end: int) -> Piece:
        """The path's samples from `begin` to `end`."""
        blocks = Blocks.of(end - begin)
        rows = begin + blocks.order
        motion = Motion.of(rows, path.step[rows], path.rate[rows], path.velocity[rows])
        own, turns = (
            slice(*np.searchsorted(samples, [begin, end]).tolist())
            for samples in (path.samples, path.turning_points)
        )
        own_place = blocks.place[path.samples[own] - begin]
        turns_place = blocks.place[path.turning_points[turns] - begin]
        return cls(motion, blocks, own, own_place, turns, turns_place)


@lru_cache(maxsize=8)
def _pieces(path: MotionPath, length: int) -> list[Piece]:
    """A path in pieces; cached, since a sampler evaluates the same path many times."""
    samples = path.time.size
    return [
        Piece.of(path, begin, min(begin + length, samples)) for begin in range(0, samples, length)
    ]


def slip_force(friction: Friction, path: MotionPath) -> tuple[Array, Array]:
    """Force F1 of the bristles that start undeflected.

    F1 = σ0 z + σ1 ż + σ2 v with ż = v − σ0 |v| z / g(v). Between samples the velocity is
    taken constant, so that Δx is exact and the equation for z linear (model.md section 2):

        z_{n+1} = a_n z_n + (1 − a_n) sgn(Δx_n) g_n/σ0,   a_n = exp(−σ0 |Δx_n| / g_n)

    The rate terms at sample n use the velocity of the path and the g of the step before it.

    Returns
    -------
    (T, n) at the trace's samples, and (K, n) at the path's turning points, kip
    """
    n = friction.vectors
    force = aligned(path.samples.size, n)
    at_turns = np.empty((path.turning_points.size, n))
    z = np.zeros(n)
    curve = None if friction.varying else Curve.of(friction)
    for piece in _pieces(path, max(PIECE // n, 1)):
        slip, z = advance(friction, piece.motion, z, piece.blocks, curve)
        rows_of(slip, piece.own_place, out=force[piece.own])
        at_turns[piece.turns] = slip[piece.turns_place]
    return force, at_turns


def advance(
    friction: Friction, motion: Motion, z: Array, blocks: Blocks, curve: Curve | None = None
) -> tuple[Array, Array]:
    """Force F1 at some samples of a path, in the order of the blocks.

    Parameters
    ----------
    z : (n,), in
        Deflection of the bristles before the first step.
    curve : Curve, optional
        Of friction that does not vary, worked out before.

    Returns
    -------
    (rows, n), kip, in scratch memory, and the deflection after the last step, (n,), in
    """
    exponent, decay, state, work = scratch(4, blocks.rows, friction.vectors)
    varying = friction.varying
    now = friction.at(motion.rows) if varying else friction
    if curve is not None:
        curve.along(motion, exponent, state, work)
    else:
        _approach(friction.midway(motion.rows), motion, exponent, state)
    np.exp(exponent, out=decay)
    blocks.relax(decay, state, z)
    last = state[blocks.place[-1]].copy()
    # F1 = (σ0 − σ1 |v|/|steady|) z + (σ1 + σ2) v
    force = exponent
    if varying:
        force *= _unrelaxed(now, exponent / motion.step[:, None] * state)
    force *= outer(motion.share, now.sigma1[0], out=decay)
    force = force + now.sigma0 if varying else add_row(now.sigma0[0], force)
    force *= state
    return add_outer(motion.velocity, (now.sigma1 + now.sigma2)[0], force), last


def _approach(friction: Friction, motion: Motion, exponent: Array, steady: Array) -> None:
    """Deflection that the bristles approach in each step, and how much of it they do.

    The deflection is sgn(v) g(v)/σ0, in, with the Stribeck curve
    g = F_c + (F_s − F_c) exp(−(v/v_s)²), and the logarithm of a is −|Δx| over its magnitude.
    """
    backward = motion.backward[:, None] > 0
    least = np.maximum(np.where(backward, friction.Fc_bwd, friction.Fc_fwd), FLOOR)
    static = np.where(backward, friction.Fs_bwd, friction.Fs_fwd)
    g = np.exp(-motion.square[:, None] / friction.v_s**2)
    g *= np.maximum(static - least, 0.0)
    g += least
    np.divide(g, np.maximum(friction.sigma0, FLOOR), out=steady)
    np.negative(steady, out=steady, where=backward)
    # both are negative backward
    np.divide(-motion.step[:, None], steady, out=exponent)


def _unrelaxed(friction: Friction, share: Array) -> Array:
    """Factor that limits σ0 |z|/g, (rows, n), needed where the actuation fell while at rest.

    Under constant actuation σ0 |z|/g is at most the largest static over the least kinetic friction.
    """
    static = np.maximum(friction.Fs_fwd, friction.Fs_bwd)
    kinetic = np.minimum(friction.Fc_fwd, friction.Fc_bwd)
    most = np.maximum(static, FLOOR) / np.maximum(kinetic, FLOOR)
    factor: Array = np.minimum(1.0, most / np.maximum(np.abs(share), 1e-300))
    return factor
