"""Stage 1: LuGre friction, by its exact exponential step (paper Eqs. 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Path

Array = NDArray[np.float64]

FORCE_FLOOR = 1e-9
"""Smallest slip force g, kip: at zero actuation friction vanishes and nothing divides by zero."""


@dataclass(frozen=True)
class Friction:
    """LuGre's parameters, time first.

    `sigma0` and the four forces are (1, n) where the actuation is constant and
    (P, n) where it varies; the others are (1, n).
    """

    sigma0: Array
    sigma1: Array
    sigma2: Array
    Fs_fwd: Array
    Fc_fwd: Array
    Fs_bwd: Array
    Fc_bwd: Array
    v_s: Array


def slip_force(friction: Friction, path: Path) -> Array:
    """Force F1 of the bristles that start undeflected, (P, n), kip.

    F1 = σ0 z + σ1 ż + σ2 v with ż = v − σ0 |v| z / g(v). Between samples the velocity is
    taken constant, so that Δx is exact and the equation for z linear (model.md section 2):

        z_{n+1} = a_n z_n + (1 − a_n) sgn(Δx_n) g_n/σ0,   a_n = exp(−σ0 |Δx_n| / g_n)

    The rate terms at sample n use the velocity of the path and the g of the step before it.
    """
    dx = np.diff(path.displacement)[:, None]
    n = max(friction.sigma1.shape[1], friction.sigma0.shape[1])
    steps = Steps.allocate(dx.size, n)
    # σ0/g, 1/in
    reach = _slip_level(friction, dx / np.diff(path.time)[:, None], n)
    np.divide(_midpoints(friction.sigma0), reach, out=reach)
    decay = np.multiply(reach, -np.abs(dx), out=steps.decay)
    np.exp(decay, out=decay)
    drive = np.subtract(1.0, decay, out=steps.drive)
    drive /= reach
    drive *= np.sign(dx)
    z = steps.solve()

    v = path.velocity[:, None]
    force = np.empty_like(z)
    np.multiply(reach, np.abs(v[1:]), out=force[1:])
    np.multiply(reach[0], np.abs(v[0]), out=force[0])
    if len(friction.Fc_fwd) > 1:
        force *= _unrelaxed(friction, z, reach)
    force *= -friction.sigma1
    force += friction.sigma0
    force *= z
    force += np.multiply(v, friction.sigma1 + friction.sigma2, out=z)
    return force


def _slip_level(friction: Friction, velocity: Array, n: int) -> Array:
    """Stribeck curve g(v) = F_c + (F_s − F_c) exp(−(v/v_s)²) of each step, (P − 1, n), kip."""
    level = np.empty((velocity.size, n))
    np.multiply(velocity**2, -1.0 / friction.v_s**2, out=level)
    np.exp(level, out=level)
    forward = velocity[:, 0] >= 0
    ends = [0, *(np.flatnonzero(np.diff(forward)) + 1).tolist(), len(forward)]
    sides = {
        True: (_midpoints(friction.Fs_fwd), _midpoints(friction.Fc_fwd)),
        False: (_midpoints(friction.Fs_bwd), _midpoints(friction.Fc_bwd)),
    }
    for begin, end in pairwise(ends):
        static, kinetic = sides[bool(forward[begin])]
        if len(static) > 1:
            static, kinetic = static[begin:end], kinetic[begin:end]
        run = level[begin:end]
        run *= static - kinetic
        run += kinetic
    return np.maximum(level, FORCE_FLOOR, out=level)


def _unrelaxed(friction: Friction, z: Array, reach: Array) -> Array:
    """Factor that bounds σ0 |z|/g, which has no bound where actuation fell at rest, (P, n).

    Under constant actuation it is at most the largest static over the least kinetic friction.
    """
    static = np.maximum(friction.Fs_fwd, friction.Fs_bwd)
    kinetic = np.minimum(friction.Fc_fwd, friction.Fc_bwd)
    most = np.maximum(static, FORCE_FLOOR) / np.maximum(kinetic, FORCE_FLOOR)
    found = np.abs(z) * np.concatenate([reach[:1], reach])
    factor: Array = np.minimum(1.0, most / np.maximum(found, 1e-300))
    return factor


def _midpoints(values: Array) -> Array:
    """Values in the middle of each step, for a history; a constant as it is."""
    return values if values.shape[0] == 1 else 0.5 * (values[1:] + values[:-1])


@dataclass(frozen=True)
class Steps:
    """The recurrence z_{k+1} = decay_k z_k + drive_k from z_0 = 0, for n vectors at once.

    It is solved in blocks of about √N steps, all blocks at once and then one after the
    other, so that it needs about 2√N numpy calls rather than N.

    Attributes
    ----------
    decay, drive : (N, n)
        To be filled in; `solve` overwrites both.
    """

    decay: Array
    drive: Array
    _blocks: Array
    _states: Array

    @classmethod
    def allocate(cls, steps: int, n: int) -> Steps:
        """Room for N steps of n vectors."""
        length = isqrt(steps - 1) + 1
        blocks = -(-steps // length)
        decays = np.zeros((blocks * length, n))
        states = np.zeros((blocks * length + 1, n))
        return cls(decays[:steps], states[1 : steps + 1], decays.reshape(blocks, length, n), states)

    def solve(self) -> Array:
        """States z, (N + 1, n)."""
        a, z = self._blocks, self._states[1:].reshape(self._blocks.shape)
        blocks, length, n = a.shape
        work = np.empty((blocks, n))
        for j in range(1, length):
            z[:, j] += np.multiply(a[:, j], z[:, j - 1], out=work)
            a[:, j] *= a[:, j - 1]
        carried = np.zeros((blocks, 1, n))
        for i in range(1, blocks):
            np.multiply(a[i - 1, -1], carried[i - 1, 0], out=carried[i, 0])
            carried[i, 0] += z[i - 1, -1]
        a *= carried
        z += a
        return self._states[: len(self.decay) + 1]
