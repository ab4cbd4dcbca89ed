"""The three-stage model as users of other tools would write it: numba, JAX, solve_ivp.

Every peer does the same arithmetic as `mfd_bayes.friction` on the same path: LuGre friction by
its exact step, the gap as a play operator that changes only at turning points, the three
transitions and the carried force (model.md sections 2 to 4). Each takes theta (n, 14), a
`Motion` and start (n,), and gives the force at the path's rows, (n, P), kip, in float64.
"""

from __future__ import annotations

import math
from functools import cached_property

import jax
import jax.numpy as jnp
import numba
import numpy as np
from scipy.integrate import solve_ivp

FLOOR = 1e-9
"""Smallest slip force, kip, as ours has it."""

SATURATED = 40.0
"""Transition lengths after which the scalar loops take a transition as complete, as ours does."""


class Motion:
    """What the peers need of a path, worked out once and outside the timing."""

    def __init__(self, path):
        self.time, self.direction = path.time, int(path.direction)
        self.x = np.ascontiguousarray(path.displacement)
        self.v = np.ascontiguousarray(path.velocity)
        self.dx = np.diff(self.x)
        self.rate = self.dx / np.diff(path.time)
        self.turns = np.asarray(path.turning_points, dtype=np.int64)
        # number of turning points before each sample, and the direction after each of them
        self.stretch = np.searchsorted(self.turns, np.arange(self.x.size))
        self.headings = self.direction * (-1.0) ** np.arange(1, self.turns.size + 1)

    @cached_property
    def on_device(self):
        """JAX's copy."""
        names = ("x", "v", "dx", "rate", "turns", "stretch", "headings")
        arrays = {name: getattr(self, name) for name in names}
        return jax.device_put(arrays | {"direction": float(self.direction)})


compiled = numba.njit(fastmath=True, error_model="numpy")


@compiled
def _lugre(p, dx, rate, v, forces):
    """F1 of one vector along the path, into `forces`."""
    sigma0, sigma1, sigma2, v_s = p[0], p[1], p[2], p[13]
    z = 0.0
    for n in range(len(dx)):
        forward = rate[n] >= 0.0
        static, kinetic = (p[3], p[4]) if forward else (p[5], p[6])
        ratio = rate[n] / v_s
        level = max(kinetic + (static - kinetic) * math.exp(-ratio * ratio), FLOOR)
        reach = sigma0 / level
        if n == 0:
            forces[0] = (sigma1 + sigma2) * v[0]
        decay = math.exp(-reach * abs(dx[n]))
        if dx[n] > 0.0:
            z = decay * z + (1.0 - decay) / reach
        elif dx[n] < 0.0:
            z = decay * z - (1.0 - decay) / reach
        speed = v[n + 1]
        forces[n + 1] = (sigma0 - sigma1 * reach * abs(speed)) * z + (sigma1 + sigma2) * speed


@compiled
def _blend(u, side, slip, k2, k3, d2, width, ell):
    """Force of the three stages at travel u, given F1."""
    if u <= -SATURATED * ell or u >= width + SATURATED * ell:
        return slip
    force = slip
    if u > 0.0:
        force += math.tanh(0.5 * u / ell) * (side * k2 * u - slip)
    build_up = side * (k2 * d2 + k3 * (u - d2))
    force += (build_up - force) / (1.0 + math.exp((d2 - u) / ell))
    return force + (slip - force) / (1.0 + math.exp((width - u) / ell))


@compiled
def _cross(p, start, x, turns, direction, forces):
    """F of one vector, in place of F1 in `forces`."""
    k2, k3, d2, width, ell = p[7], p[8], p[9], p[9] + p[10], p[12] / p[11]
    side = float(direction)
    heading = side
    offset = start * width - side * x[0]
    carry = 0.0
    k = 0
    for n in range(len(x)):
        slip = forces[n]
        u = offset + side * x[n]
        force = _blend(u, side, slip, k2, k3, d2, width, ell)
        if carry != 0.0 and abs(u) < SATURATED * ell:
            force += carry * (1.0 - math.tanh(0.5 * abs(u) / ell))
        forces[n] = force
        if k < len(turns) and n == turns[k]:
            k += 1
            heading = -heading
            if u >= width or u <= 0.0:
                carry = force - _blend(0.0, heading, slip, k2, k3, d2, width, ell)
                side = heading
                offset = -heading * x[n]


@compiled
def _loop(theta, start, dx, rate, x, v, turns, direction):
    forces = np.empty((theta.shape[0], x.size))
    for i in range(theta.shape[0]):
        _lugre(theta[i], dx, rate, v, forces[i])
        _cross(theta[i], start[i], x, turns, direction, forces[i])
    return forces


def numba_loop(theta, motion, start):
    """Peer that loops in numba over vectors and samples, compiled when it is first called."""
    m = motion
    return _loop(theta, start, m.dx, m.rate, m.x, m.v, m.turns, m.direction)


# The ordinary way to integrate friction: an ODE solver, one vector at a time.


def lsoda(theta, motion, start, velocity):
    """Peer that integrates ż by solve_ivp's LSODA; `velocity(t)` is that of the smooth motion.

    The gap has no differential equation: it is crossed afterwards, by numba's loop.
    """
    forces = np.array([_integrated(p.tolist(), velocity, motion) for p in theta])
    for i, p in enumerate(theta):
        _cross(p, start[i], motion.x, motion.turns, motion.direction, forces[i])
    return forces


def _integrated(p, velocity, motion):
    """F1 of one vector by LSODA, (P,)."""
    sigma0, sigma1, sigma2, v_s = p[0], p[1], p[2], p[13]

    def z_rate(t, z):
        v = velocity(t)
        static, kinetic = (p[3], p[4]) if v >= 0 else (p[5], p[6])
        level = max(kinetic + (static - kinetic) * math.exp(-((v / v_s) ** 2)), FLOOR)
        return [v - sigma0 * abs(v) * z[0] / level]

    span = (motion.time[0], motion.time[-1])
    run = solve_ivp(z_rate, span, [0.0], "LSODA", motion.time, rtol=1e-6, atol=1e-9)
    z = run.y[0]
    rates = [z_rate(t, [state])[0] for t, state in zip(motion.time.tolist(), z, strict=True)]
    return sigma0 * z + sigma1 * np.array(rates) + sigma2 * motion.v


# JAX: one vector in plain array code, vmapped and jitted.


def _scanned(decay, drive):
    """States of z' = decay z + drive by lax.scan, (P - 1,)."""

    def step(z, now):
        z = now[0] * z + now[1]
        return z, z

    return jax.lax.scan(step, 0.0, (decay, drive))[1]


def _jax_slip(p, m):
    """F1 of one vector, (P,)."""
    sigma0, sigma1, sigma2, v_s = p[0], p[1], p[2], p[13]
    forward = m["rate"] >= 0
    static, kinetic = jnp.where(forward, p[3], p[5]), jnp.where(forward, p[4], p[6])
    level = kinetic + (static - kinetic) * jnp.exp(-((m["rate"] / v_s) ** 2))
    reach = sigma0 / jnp.maximum(level, FLOOR)
    decay = jnp.exp(-reach * jnp.abs(m["dx"]))
    z = _scanned(decay, (1.0 - decay) * jnp.sign(m["dx"]) / reach)
    z, reach = jnp.append(0.0, z), jnp.append(reach[0], reach)
    return (sigma0 - sigma1 * reach * jnp.abs(m["v"])) * z + (sigma1 + sigma2) * m["v"]


def _jax_blend(u, side, slip, gap):
    """Force of the three stages at travel u, given F1, of any shape."""
    k2, k3, d2, width, ell = gap
    force = slip + jnp.tanh(jnp.maximum(u, 0.0) * (0.5 / ell)) * (side * k2 * u - slip)
    build_up = side * (k2 * d2 + k3 * (u - d2))
    force += (build_up - force) * jax.nn.sigmoid((u - d2) / ell)  # 1/(1 + exp) has no gradient
    return force + (slip - force) * jax.nn.sigmoid((u - width) / ell)


def jax_force(p, start, m):
    """Force of one vector, (P,)."""
    slip = _jax_slip(p, m)
    width, ell = p[9] + p[10], p[12] / p[11]
    gap = (p[7], p[8], p[9], width, ell)

    def fade(u):
        return 1.0 - jnp.tanh(jnp.abs(u) * (0.5 / ell))

    def turn(state, now):
        side, offset, carry = state
        x, f1, heading = now
        u = offset + side * x
        jump = _jax_blend(u, side, f1, gap) + carry * fade(u) - _jax_blend(0.0, heading, f1, gap)
        slipped = (u >= width) | (u <= 0.0)
        fresh = (heading, -heading * x, jump)
        updated = tuple(jnp.where(slipped, a, b) for a, b in zip(fresh, state, strict=True))
        return updated, updated

    initial = (m["direction"], start * width - m["direction"] * m["x"][0], 0.0)
    at_turns = (m["x"][m["turns"]], slip[m["turns"]], m["headings"])
    states = jax.lax.scan(turn, initial, at_turns)[1]
    side, offset, carry = (
        jnp.append(a, b)[m["stretch"]] for a, b in zip(initial, states, strict=True)
    )
    u = offset + side * m["x"]
    return _jax_blend(u, side, slip, gap) + carry * fade(u)


def jax_batch(chunk):
    """Peer in JAX, jit and vmap, `chunk` vectors at a time."""
    batch = jax.jit(jax.vmap(jax_force, in_axes=(0, 0, None)))

    def force(theta, motion, start):
        m, starts = motion.on_device, range(0, len(theta), chunk)
        blocks = [batch(theta[i : i + chunk], start[i : i + chunk], m) for i in starts]
        return np.concatenate([np.asarray(block) for block in blocks])

    return force
