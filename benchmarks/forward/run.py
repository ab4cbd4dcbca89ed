"""How long does a force take: ours beside numba, JAX and an ODE solver, which must agree?

    pip install -e '.[bench]'
    python -m benchmarks.forward.run > benchmarks/forward/forward.txt

takes two minutes on one thread (--quick: some seconds). Ours computes 64 vectors at once by NumPy;
numba loops over vectors and samples, JAX scans, and solve_ivp integrates the bristles one vector at
a time, with numba for the gap. They take turns, round by round, because a shared machine's speed
changes from one second to the next; each time is the mean of calls that follow one another.
"best" is the shortest over the rounds, "times ours" the median of the ratios within a round.

Exit status 1: an implementation, or ours step by step, does not agree with ours. What is faster is
only told: one set of formulas for records and steps counts for more. Real records are those of
--data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import math
import time

import numpy as np

from benchmarks.forward import peers
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace

MODEL = ThreeStage()
SAMPLES, VECTORS = 2000, 64
CLOSE, OF_A_SOLVER, OF_STEPS = 1e-8, 2e-3, 1e-9  # largest deviations; a solver is between samples
BURST = 0.01  # s
RATE, HERTZ, PHASE = 100.0, 0.5, 0.3  # 1 in; the phase puts turns between samples
CENTRE = np.array([60, 0.02, 0.01, 2.4, 2, 1.9, 1.5, 0.5, 30, 0.1, 0.08, 1, 0.007, 0.5])
"""A plausible damper, in the paper's order of parameters and internal units."""
RECORDS = ("2023_30lb_0.25Hz_1.0in.csv", "2023_36lb_ImperialValleyDBE.csv")


def race(contenders, rounds):
    """Seconds per call of each contender in each round, (rounds,) each."""
    seconds = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            begin = time.perf_counter()
            run()
            calls = math.ceil(BURST / (time.perf_counter() - begin))
            begin = time.perf_counter()
            for _ in range(calls):
                run()
            seconds[name].append((time.perf_counter() - begin) / calls)
    return {name: np.array(values) for name, values in seconds.items()}


def draw_theta(n):
    """Vectors in which all fourteen parameters vary by 20 %, (n, 14); transition lengths in in."""
    rng = np.random.default_rng(1)
    theta = CENTRE * rng.lognormal(0, 0.2, (n, CENTRE.size))
    for static in (3, 5):
        theta[:, static] = theta[:, static + 1] * rng.uniform(1, 1.5, n)
    theta[:, 12] = theta[:, 11] * rng.uniform(0.005, 0.01, n)  # ℓ = γ2/γ1, in
    return theta


def sine(samples):
    """Trace of 1 in, sampled at 100 Hz."""
    t = np.arange(samples) / RATE
    angle = 2 * np.pi * HERTZ * t + PHASE
    return Trace.from_arrays(t, np.sin(angle), velocity=2 * np.pi * HERTZ * np.cos(angle))


def sine_velocity(t):
    """Velocity of the same motion at any time, in/s."""
    return 2 * math.pi * HERTZ * math.cos(2 * math.pi * HERTZ * t + PHASE)


def compare(label, theta, trace, rounds, *, solver=False):
    """Print a table of ours and the others on a trace; which do not agree."""
    motion, start = peers.Motion(trace.path), np.full(len(theta), 0.5)
    forces = {"numba": peers.numba_loop, "JAX, all at once": peers.jax_batch(len(theta))}
    forces["JAX, 32 at a time"] = peers.jax_batch(32)
    field = {"ours": lambda: MODEL.force(theta, trace, start=0.5)}
    field |= {n: lambda force=f: force(theta, motion, start) for n, f in forces.items()}
    if solver:
        single = theta[:1], motion, start[:1], sine_velocity
        field["solve_ivp, 1 vector"] = lambda: peers.lsoda(*single)
    expected = field["ours"]()
    largest, failed, warmup = np.abs(expected).max(axis=1), [], {}
    for name, run in field.items():
        begin = time.perf_counter()
        force = run()
        warmup[name] = time.perf_counter() - begin
        if name != "ours":
            error = np.abs(force[:, trace.path.samples] - expected[: len(force)]).max(axis=1)
            if np.max(error / largest[: len(force)]) > (OF_A_SOLVER if "ivp" in name else CLOSE):
                failed.append(f"{label}: {name} deviates from ours by {np.max(error):.1e} kip")
    print(f"{label}: {len(theta)} vectors, {trace.samples:,} samples")
    print(f"{'':22}{'best µs per vector':>20}{'median':>10}{'times ours':>12}{'first, s':>10}")
    seconds = race(field, rounds)
    per_vector = {n: 1e6 * s / (1 if "1 vector" in n else len(theta)) for n, s in seconds.items()}
    for name, times in per_vector.items():
        ratio = np.median(times / per_vector["ours"])
        print(
            f"{name:22}{times.min():20.1f}{np.median(times):10.1f}{ratio:12.2f}{warmup[name]:10.2f}"
        )
    print(flush=True)
    return failed


def steps(samples):
    """Print the time of one step of the step interface; where it deviates from the whole force."""
    print("\nStep by step, for hybrid simulation (1024 Hz leaves 977 µs)")
    print("  vectors    median µs    99 % below    largest deviation, kip")
    trace, failed = sine(samples), []
    for vectors in (1, 8, VECTORS):
        theta = draw_theta(vectors)
        state, forces, times = MODEL.start(theta), [], []
        for x, v in zip(trace.displacement, trace.velocity, strict=True):
            begin = time.perf_counter()
            force, state = MODEL.step(state, x, v, 1 / RATE)
            times.append(1e6 * (time.perf_counter() - begin))
            forces.append(force)
        error = np.max(np.abs(np.array(forces).T - MODEL.force(theta, trace)))
        print(f"{vectors:9d}{np.median(times):13.0f}{np.quantile(times, 0.99):14.0f}{error:26.0e}")
        if error > OF_STEPS:
            failed.append(f"steps of {vectors} vectors are {error:.0e} kip from the whole force")
    return failed


def main():
    options = common.begin(common.parser_of(__doc__, data=True), "numba", "jax")
    rounds = 1 if options.quick else 30
    count = 300 if options.quick else SAMPLES
    failed = compare("A plausible damper", draw_theta(VECTORS), sine(count), rounds, solver=True)
    for name in () if options.quick else RECORDS:
        trace = read_record(options.data / "brfd" / name).trace()
        failed += compare(name, draw_theta(VECTORS), trace, 10)
    failed += steps(count)
    common.finish(failed)


if __name__ == "__main__":
    main()
