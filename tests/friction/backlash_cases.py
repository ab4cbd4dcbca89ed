"""Motions, dampers and an ODE solver to hold the backlash model against."""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.records.trace import Trace

MODEL = BacklashLuGre()
VALUES = dict(
    zip(
        MODEL.parameters,
        (50.0, 42.0, 0.2, 0.02, 0.4, 2.2, 1.8, 3.0, 0.02, 0.2, 0.15, 0.5),
        strict=True,
    )
)
OMEGA = np.pi  # 0.5 Hz


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in MODEL.parameters]])


def vectors(n, seed=0, spread=0.4):
    rng = np.random.default_rng(seed)
    batch = theta() * rng.lognormal(0, spread, size=(n, 12))
    batch[:, MODEL.parameters.index("n")] = rng.uniform(1.0, 10.0, n)
    return batch


def loads(batch, start):
    """Share of the slip force that dampers (n, 12) bear at their start, (n,)."""
    spring, _ = MODEL.step(MODEL.start(batch, start), 0.0, 0.0, 0.0)
    forward, backward = (batch[:, MODEL.parameters.index(name)] for name in ("Fc_fwd", "Fc_bwd"))
    return spring / np.where(spring > 0.0, forward, backward)


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


def spring(z, p):
    a, b = (z - p["gap"] / 2) / p["ell"], (z + p["gap"] / 2) / p["ell"]
    found = p["k_fwd"] * p["ell"] * np.logaddexp(0, a) - p["k_bwd"] * p["ell"] * np.logaddexp(0, -b)
    return found + p["k_0"] * z


def rate(z, v, p, level=1.0):
    force = spring(z, p)
    side = "fwd" if force > 0 else "bwd"
    slip = p[f"Fc_{side}"] * (1 + p[f"static_excess_{side}"] * np.exp(-((v / p["v_s"]) ** 2)))
    return v * (1 - abs(force / (level * slip)) ** p["n"]) if v * force > 0 else v


def first(p, w0=0.5):
    low = -p["gap"] / 2 - p["Fc_bwd"] / p["k_bwd"]
    return low + w0 * (p["gap"] / 2 + p["Fc_fwd"] / p["k_fwd"] - low)


def integrated(time, edges, velocity, p, level=lambda t: 1.0):
    """Force without σ2 v by LSODA, restarted at `edges`, where the velocity may jump or turn."""
    z, state = np.empty(time.size), [first(p)]
    z[0] = state[0]
    for begin, end in itertools.pairwise(edges):
        inside = (time > begin) & (time <= end)
        middle = 0.5 * (begin + end)
        options = {"rtol": 1e-8, "atol": 1e-10, "max_step": max((end - begin) / 20, 1e-4)}
        leg = solve_ivp(
            lambda t, z, m=middle: [rate(z[0], velocity(t, m), p, level(t))],
            *((begin, end), state, "LSODA"),
            dense_output=True,
            **options,
        )
        z[inside], state = leg.sol(time[inside])[0], [leg.y[0, -1]]
    return spring(z, p)


def of_sine(trace, amplitude, p, level=lambda t: 1.0):
    """Force by LSODA along `sine`."""
    time = trace.time
    turns = (np.arange(np.ceil(time[-1] * OMEGA / np.pi)) + 0.5) * np.pi / OMEGA
    edges = [0.0, *turns[turns < time[-1]], time[-1]]

    def velocity(t, _):
        return amplitude * OMEGA * np.cos(OMEGA * t)

    return integrated(time, edges, velocity, p, level) + p["sigma2"] * trace.velocity


def of_walk(trace, p):
    """Force by LSODA along `walk`."""
    time = trace.time
    speeds = np.diff(trace.displacement) / np.diff(time)

    def velocity(_, middle):
        return speeds[np.searchsorted(time, middle) - 1]

    return integrated(time, time, velocity, p) + p["sigma2"] * trace.velocity
