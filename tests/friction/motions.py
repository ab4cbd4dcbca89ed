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


def solved(rate, time, edges, velocity, first):
    """z of dz/dt = rate(t, z, v) by LSODA, restarted at `edges`, where v may jump or turn.

    v = velocity(t, m), with the middle m of the leg between two edges.
    """
    z, state = np.empty(time.size), [first]
    z[0] = first
    for begin, end in itertools.pairwise(edges):
        inside, middle = (time > begin) & (time <= end), 0.5 * (begin + end)
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
        z[inside], state = leg.sol(time[inside])[0], [leg.y[0, -1]]
    return z


def solved_along_sine(rate, trace, amplitude, first=0.0):
    time = trace.time
    turns = (np.arange(np.ceil(time[-1] * OMEGA / np.pi)) + 0.5) * np.pi / OMEGA
    edges = [0.0, *turns[turns < time[-1]], time[-1]]
    return solved(rate, time, edges, lambda t, _: amplitude * OMEGA * np.cos(OMEGA * t), first)


def solved_along_walk(rate, trace, first=0.0):
    time = trace.time
    speeds = np.diff(trace.displacement) / np.diff(time)
    return solved(rate, time, time, lambda _, m: speeds[np.searchsorted(time, m) - 1], first)


def cut(trace, at):
    """Both parts of a trace; they share a sample."""
    return [
        Trace.from_arrays(
            trace.time[part],
            trace.displacement[part],
            trace.actuation[part] if trace.varying else None,
            velocity=trace.velocity[part],
            hysteresis=trace.hysteresis,
        )
        for part in (slice(0, at + 1), slice(at, None))
    ]


def off_after_cut(model, theta, trace, at, start=None):
    """Largest difference of the second part's force from the whole's, at each sample."""
    first, second = cut(trace, at)
    if start is None:
        start = model.start_at(model.end(theta, first, 0.3), second)
    whole = model.force(theta, trace, 0.3)[:, at:]
    return np.max(np.abs(model.force(theta, second, start) - whole), axis=0)
