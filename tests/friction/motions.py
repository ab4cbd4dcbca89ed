"""Motions, and an ODE solver along them to hold the models of hysteresis against."""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from mfd_bayes import Trace

OMEGA = np.pi  # 0.5 Hz


def sine(amplitude=1.0, seconds=5.0, rate=200.0, **options):
    time = np.arange(0, seconds, 1 / rate)
    velocity = amplitude * OMEGA * np.cos(OMEGA * time)
    return Trace.from_arrays(time, amplitude * np.sin(OMEGA * time), velocity=velocity, **options)


def walk(seed, samples=200, size=0.03, **options):
    """Straight pieces, some of them at rest, with corners at the samples."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.02, samples))
    motion = np.cumsum(rng.normal(size=samples) * (rng.uniform(size=samples) < 0.8)) * size
    velocity = np.zeros(samples)  # so that no turning point lies beyond its corner
    return Trace.from_arrays(time, motion, velocity=velocity, hysteresis=0.0, **options)


def solved(rate, time, edges, velocity, initial):
    """z of dz/dt = rate(t, z, v) by LSODA, restarted at `edges`, where v may jump or turn.

    v = velocity(t, m), with the middle m of the leg between two edges.
    """
    z, state = np.empty(time.size), [initial]
    z[0] = initial
    for begin, end in itertools.pairwise(edges):
        in_leg, middle = (time > begin) & (time <= end), 0.5 * (begin + end)
        leg = solve_ivp(
            lambda t, z, m=middle: [rate(t, z[0], velocity(t, m))],
            (begin, end),
            state,
            "LSODA",
            dense_output=True,
            rtol=1e-9,
            atol=1e-11,
            max_step=max((end - begin) / 20, 1e-4),
        )
        z[in_leg], state = leg.sol(time[in_leg])[0], [leg.y[0, -1]]
    return z


def solved_along_sine(rate, trace, amplitude, initial=0.0):
    time = trace.time
    turns = (np.arange(np.ceil(time[-1] * OMEGA / np.pi)) + 0.5) * np.pi / OMEGA
    edges = [0.0, *turns[turns < time[-1]], time[-1]]
    return solved(rate, time, edges, lambda t, _: amplitude * OMEGA * np.cos(OMEGA * t), initial)


def solved_along_walk(rate, trace, initial=0.0):
    time = trace.time
    speeds = np.diff(trace.displacement) / np.diff(time)
    return solved(rate, time, time, lambda _, m: speeds[np.searchsorted(time, m) - 1], initial)


def cut(trace, index):
    """Both parts of a trace; they share a sample."""
    return [
        Trace.from_arrays(
            trace.time[segment],
            trace.displacement[segment],
            trace.actuation[segment] if trace.varying else None,
            velocity=trace.velocity[segment],
            hysteresis=trace.hysteresis,
        )
        for segment in (slice(0, index + 1), slice(index, None))
    ]


def off_after_cut(model, theta, trace, index, start=None):
    """Largest difference of the second part's force from the whole's, at each sample."""
    head, tail = cut(trace, index)
    if start is None:
        start = model.start_at(model.end(theta, head, 0.3), tail)
    force = model.force(theta, trace, 0.3)[:, index:]
    return np.max(np.abs(model.force(theta, tail, start) - force), axis=0)
