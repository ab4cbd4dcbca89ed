"""The backlash model as users of other tools would write it, step by step, to race against ours.

Both take the same short steps of the motion (`backlash.cut`) by the same two-point rule, and solve
each step by Newton's method before the next: numba in scalar loops, JAX in a scan over the steps
with all vectors at once and as many of Newton's steps as numba needs at most on this motion.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numba
import numpy as np

jax.config.update("jax_enable_x64", True)

NEWTON = 5
"""Newton's steps of JAX's scan, whose number must be fixed."""

CLOSE = 1e-6


@numba.njit(fastmath=True, error_model="numpy")
def _spring(z, p):
    a = math.exp((z - 0.5 * p[2]) / p[3])
    b = math.exp(-(z + 0.5 * p[2]) / p[3])
    force = p[0] * p[3] * math.log1p(a) - p[1] * p[3] * math.log1p(b) + p[4] * z
    return force, p[0] * a / (1.0 + a) + p[1] * b / (1.0 + b) + p[4]


@numba.njit(fastmath=True, error_model="numpy")
def _slip(force, slope, limit, n, h):
    if force <= 0.0:
        return 1.0, 0.0, 0.0
    q = math.exp(min(n * math.log(force) - limit, 8.0))
    b = n * h * slope / force
    return 1.0 - q, b * q, b


@numba.njit(fastmath=True, error_model="numpy")
def _loop(theta, first, way, sign, rate, out):
    for i in range(theta.shape[0]):
        p = theta[i]
        n, z = p[7], first[i]
        force, slope = _spring(z, p)
        for k in range(way.size):
            s, h = sign[k], way[k]
            j = 0 if s > 0 else 1
            ratio = rate[k] / p[11]
            g = p[5 + j] * (1.0 + p[9 + j] * math.exp(-ratio * ratio))
            limit = n * math.log(g)
            f0, c0, _ = _slip(s * force, slope, limit, n, h)
            begin = z + s * h * (0.5 - c0 / 12.0) * f0
            z += s * h * max(f0, 0.0) / (1.0 + c0)
            for _ in range(40):
                force, slope = _spring(z, p)
                f1, c1, b1 = _slip(s * force, slope, limit, n, h)
                short = begin + s * h * (0.5 + c1 / 12.0) * f1 - z
                own = 1.0 + 0.5 * c1 + c1 / 12.0 * (c1 - (1.0 - 1.0 / n) * b1 * f1)
                step = short / own
                z += step
                force += slope * step
                if abs(step) * n * p[0] <= CLOSE * g:
                    break
            out[i, k] = force


def numba_loop(theta, first, course, rate):
    """Spring force after each step of a course, (n, R), kip, by scalar loops."""
    out = np.empty((len(theta), course.sign.size))
    _loop(theta, first, course.way[:, 0], course.sign, rate[course.origin], out)
    return out


def _jax_spring(z, p):
    a, b = jnp.exp((z - 0.5 * p[2]) / p[3]), jnp.exp(-(z + 0.5 * p[2]) / p[3])
    force = p[0] * p[3] * jnp.log1p(a) - p[1] * p[3] * jnp.log1p(b) + p[4] * z
    return force, p[0] * a / (1.0 + a) + p[1] * b / (1.0 + b) + p[4]


def _jax_slip(force, slope, limit, n, h):
    pushes = force > 0.0
    known = jnp.where(pushes, force, 1.0)
    q = jnp.where(pushes, jnp.exp(jnp.minimum(n * jnp.log(known) - limit, 8.0)), 0.0)
    b = n * h * slope / known
    return 1.0 - q, b * q, b


@jax.jit
def _scan(p, first, way, sign, rate):
    n = p[7]

    def step(state, now):
        z, force, slope = state
        h, s, v = now
        kinetic, excess = (jnp.where(s > 0, p[i], p[i + 1]) for i in (5, 9))
        limit = n * jnp.log(kinetic * (1.0 + excess * jnp.exp(-((v / p[11]) ** 2))))
        f0, c0, _ = _jax_slip(s * force, slope, limit, n, h)
        begin = z + s * h * (0.5 - c0 / 12.0) * f0
        z = z + s * h * jnp.maximum(f0, 0.0) / (1.0 + c0)
        for _ in range(NEWTON):
            force, slope = _jax_spring(z, p)
            f1, c1, b1 = _jax_slip(s * force, slope, limit, n, h)
            short = begin + s * h * (0.5 + c1 / 12.0) * f1 - z
            move = short / (1.0 + 0.5 * c1 + c1 / 12.0 * (c1 - (1.0 - 1.0 / n) * b1 * f1))
            z, force = z + move, force + slope * move
        return (z, force, slope), force

    start = (first, *_jax_spring(first, p))
    return jax.lax.scan(step, start, (way, sign, rate))[1].T


def jax_scan(theta, first, course, rate):
    """Spring force after each step of a course, (n, R), kip, by JAX."""
    parts = (theta.T, first, course.way[:, 0], course.sign, rate[course.origin])
    return np.asarray(_scan(*(jnp.asarray(part) for part in parts)))
