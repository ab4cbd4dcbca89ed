"""Stage 1: LuGre friction, by its exact exponential step (paper Eqs. 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

FORCE_FLOOR = 1e-9
"""Smallest slip force g, kip: at zero actuation friction vanishes and nothing divides by zero."""


@dataclass(frozen=True)
class Friction:
    """LuGre's parameters, time first.

    `sigma0` and the four forces are (1, n) where the actuation is constant and
    (T, n) where it varies; the others are (1, n).
    """

    sigma0: Array
    sigma1: Array
    sigma2: Array
    Fs_fwd: Array
    Fc_fwd: Array
    Fs_bwd: Array
    Fc_bwd: Array
    v_s: Array


def slip_force(friction: Friction, trace: Trace) -> Array:
    """Force F1 of the bristles that start undeflected, (T, n), kip.

    F1 = σ0 z + σ1 ż + σ2 v with ż = v − σ0 |v| z / g(v). Between samples the velocity is
    taken constant, so that Δx is exact and the equation for z linear (model.md section 2):

        z_{n+1} = a_n z_n + (1 − a_n) sgn(Δx_n) g_n/σ0,   a_n = exp(−σ0 |Δx_n| / g_n)

    The rate terms at sample n use the velocity of the trace and the g of the step before it.
    """
    dx = np.diff(trace.displacement)[:, None]
    mean_velocity = dx / np.diff(trace.time)[:, None]
    reach = _slip_level(friction, mean_velocity)
    np.divide(_midpoints(friction.sigma0), reach, out=reach)  # σ0/g, 1/in
    decay = reach * -np.abs(dx)
    np.exp(decay, out=decay)
    drive = np.sign(dx) * (1.0 - decay)
    drive /= reach
    z = linear_recurrence(decay, drive)

    v = trace.velocity[:, None]
    force = np.empty_like(z)
    force[0] = reach[0]
    force[1:] = reach
    force *= np.abs(v)
    force *= -friction.sigma1
    force += friction.sigma0
    force *= z
    force += v * (friction.sigma1 + friction.sigma2)
    return force


def _slip_level(friction: Friction, velocity: Array) -> Array:
    """Stribeck curve g(v) = F_c + (F_s − F_c) exp(−(v/v_s)²) of each step, (T−1, n), kip."""
    level = velocity**2 * (-1.0 / friction.v_s**2)
    np.exp(level, out=level)
    forward = velocity[:, 0] >= 0
    for rows, static, kinetic in (
        (forward, friction.Fs_fwd, friction.Fc_fwd),
        (~forward, friction.Fs_bwd, friction.Fc_bwd),
    ):
        static, kinetic = _midpoints(static), _midpoints(kinetic)
        if static.shape[0] > 1:
            static, kinetic = static[rows], kinetic[rows]
        level[rows] = level[rows] * (static - kinetic) + kinetic
    return np.maximum(level, FORCE_FLOOR, out=level)


def _midpoints(values: Array) -> Array:
    """Values in the middle of each step, for a history; a constant as it is."""
    return values if values.shape[0] == 1 else 0.5 * (values[1:] + values[:-1])


def linear_recurrence(decay: Array, drive: Array) -> Array:
    """Solution of z_{k+1} = decay_k z_k + drive_k from z_0 = 0.

    Solved in blocks of about √N steps, all blocks at once and then one after the
    other, so that it needs about 2√N numpy calls rather than N.

    Parameters
    ----------
    decay, drive : (N, n)
        Not kept: both may be overwritten.

    Returns
    -------
    (N + 1, n)
    """
    steps, n = decay.shape
    length = isqrt(steps - 1) + 1
    blocks = -(-steps // length)
    padded = np.zeros((2, blocks * length, n))
    padded[0, :steps], padded[1, :steps] = decay, drive
    a, z = padded.reshape(2, blocks, length, n)
    work = np.empty((blocks, n))
    for j in range(1, length):
        np.multiply(a[:, j], z[:, j - 1], out=work)
        z[:, j] += work
        a[:, j] *= a[:, j - 1]
    carried = np.zeros((blocks, 1, n))
    for i in range(1, blocks):
        np.multiply(a[i - 1, -1], carried[i - 1, 0], out=carried[i, 0])
        carried[i, 0] += z[i - 1, -1]
    a *= carried
    z += a
    solution = np.zeros((steps + 1, n))
    solution[1:] = padded[1, :steps]
    return solution
