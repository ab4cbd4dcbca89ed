"""How long the computation of a force takes: ours beside other implementations.

    pip install -e '.[bench]'
    python -m benchmarks.forward.run > benchmarks/forward/forward.txt

runs on one thread of one core (Linux) for three minutes. It compares sizes, memory and real
records. The package itself imports neither numba nor JAX.

The implementations take turns, round by round, because a shared machine's speed changes from one
second to the next. In each turn one function is called many times, so that the cache is warm.
"best" is the shortest time over the rounds and "median" the middle one; every ratio is the median
of the ratios within a round. A "pass" is one np.exp over a 2000 × 64 array into an existing array.

The first table has the parameters of a plausible damper, and those of real records, whose
transitions are five times as long, in two motions.

Exit status 1: an implementation does not agree with ours. What is faster is only told: one set of
formulas for records and steps counts for more. The real records come from --data
(MFD_BAYES_DATA, ../shared/data); without them that table is left out.
"""

from __future__ import annotations

import os

# Read when numpy and JAX are imported.
os.environ.update(
    OMP_NUM_THREADS="1",
    OPENBLAS_NUM_THREADS="1",
    MKL_NUM_THREADS="1",
    JAX_PLATFORMS="cpu",
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import argparse
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numba
import numpy as np
from numpy._core._multiarray_umath import __cpu_features__ as cpu_features

from benchmarks.common.data import add_data_option
from benchmarks.common.machine import load, print_bars, processor, versions
from benchmarks.forward import peers
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace

MODEL = ThreeStage()
SAMPLES, VECTORS = 2000, 64
AGREEMENT = {"solve_ivp": 2e-3, "same of samples": 2e-3}  # they integrate between samples too
CLOSE = 1e-8
BURST = 0.01  # seconds
STEP_AGREEMENT = 1e-9
RATE, HERTZ, PHASE = 100.0, 0.5, 0.3  # 1 in; the phase puts turns between samples
SLOW_HERTZ = 0.1
FAST = ("numba", "JAX scan")
BATCHES = (*FAST, "JAX associative scan")
EVERY = (*BATCHES, "Python loop", "solve_ivp", "same of samples")
HEADER = (
    ("best µs", "median µs", "µs/1000", "times", "np.exp", "largest", "first"),
    ("per vector", "per vector", "samples", "ours", "passes", "deviation", "call, s"),
)
FEW, MANY = 10, 700  # turning points of the motions that tell what one of them costs
RECORDS = {
    "harmonic": "2023_30lb_0.25Hz_1.0in.csv",
    "earthquake": "2023_36lb_ImperialValleyDBE.csv",
}
CENTRE = np.array([60, 0.02, 0.01, 2.4, 2, 1.9, 1.5, 0.5, 30, 0.1, 0.08, 1, 0.007, 0.5])
"""A plausible damper, in the paper's order of parameters and internal units."""

REAL = np.array([16, 0.02, 0.01, 2.4, 2, 1.9, 1.5, 2.3, 37, 0.28, 0.044, 1, 0.037, 0.5])
"""The same of the band brake's records, whose transitions are five times as long."""
REAL_LENGTHS = (0.03, 0.07)
"""Transition lengths ℓ = γ2/γ1 of its posteriors, in."""


@dataclass(frozen=True)
class Contender:
    """A call to time: the vectors it handles, and in how many rounds at most it runs."""

    run: Callable[[], object]
    vectors: int = VECTORS
    rounds: int = 1000


def race(contenders, rounds):
    """Seconds per call of each contender in each round, (rounds,) each.

    A sampler calls its force again and again, so what is timed is a run of calls, of about
    `BURST` seconds, after one call that is not.
    """
    seconds = {name: [] for name in contenders}
    for done in range(rounds):
        for name, contender in contenders.items():
            if done < contender.rounds:
                seconds[name].append(_burst(contender.run))
    return {name: np.array(values) for name, values in seconds.items()}


def _burst(run):
    """Mean seconds of a call among some that follow one another."""
    begin = time.perf_counter()
    run()
    calls = math.ceil(BURST / (time.perf_counter() - begin))
    begin = time.perf_counter()
    for _ in range(calls):
        run()
    return (time.perf_counter() - begin) / calls


def ratio(above, below):
    """Median of the ratios of the rounds in which both ran."""
    both = min(len(above), len(below))
    return float(np.median(above[:both] / below[:both]))


def draw_theta(n, centre=CENTRE, lengths=(0.005, 0.01)):
    """Vectors in which all fourteen parameters vary, (n, 14); the first is the centre.

    Their spread of 20 % is that of a test's posterior in its worst directions; their transition
    lengths lie between `lengths`, in.
    """
    rng = np.random.default_rng(1)
    theta = centre * rng.lognormal(0, 0.2, (n, centre.size))
    for static in (3, 5):
        theta[:, static] = theta[:, static + 1] * rng.uniform(1, 1.5, n)
    theta[:, 12] = theta[:, 11] * rng.uniform(*lengths, n)  # ℓ = γ2/γ1, in
    theta[0] = centre
    return theta


def sine(samples, hertz=HERTZ):
    """Trace of 1 in, sampled at 100 Hz."""
    t = np.arange(samples) / RATE
    angle = 2 * np.pi * hertz * t + PHASE
    trace = Trace.from_arrays(t, np.sin(angle), velocity=2 * np.pi * hertz * np.cos(angle))
    _ = trace.path  # worked out once per record, not once per force
    return trace


def sine_velocity(t):
    """Velocity of the same motion at any time, in/s."""
    return 2 * math.pi * HERTZ * math.cos(2 * math.pi * HERTZ * t + PHASE)


def exp_pass():
    """One np.exp over a 2000 × 64 array, to be timed."""
    exponents = -np.random.default_rng(0).uniform(0, 5, (SAMPLES, VECTORS))
    result = np.empty_like(exponents)
    return Contender(lambda: np.exp(exponents, out=result))


def ours(theta, trace):
    """Our force, to be timed."""
    return Contender(lambda: MODEL.force(theta, trace, start=0.5), len(theta))


def peer(force, theta, trace, rounds=1000):
    """A peer's force at the path's rows, to be timed."""
    motion, start = peers.Motion.of(trace.path), np.full(len(theta), 0.5)
    return Contender(lambda: force(theta, motion, start), len(theta), rounds)


def deviation(contender, trace, expected):
    """Largest deviation from our force over that vector's peak, and seconds of this first call."""
    begin = time.perf_counter()
    force = contender.run()
    seconds = time.perf_counter() - begin
    expected = expected[: len(force)]
    off = np.abs(force[:, trace.path.samples] - expected).max(axis=1)
    return float(np.max(off / np.abs(expected).max(axis=1))), seconds


def entrants(theta, trace, names):
    """Peers by name: every way that we know to run each, the fastest of which counts."""
    found = {
        "numba": {
            "njit": peer(peers.numba_loop(fastmath=False), theta, trace),
            "njit, fastmath": peer(peers.numba_loop(fastmath=True), theta, trace),
        }
    }
    for name, associative in (("JAX scan", False), ("JAX associative scan", True)):
        found[name] = {
            f"{chunk or 'all'} at a time": peer(
                peers.jax_batch(associative=associative, chunk=chunk), theta, trace
            )
            for chunk in (None, 32)
        }
    found["Python loop"] = {"2 vectors": peer(peers.python_loop, theta[:2], trace, 5)}
    lsoda = peers.lsoda(sine_velocity)
    found["solve_ivp"] = {"LSODA, 2 vectors": peer(lsoda, theta[:2], trace, 5)}
    recorded = peers.lsoda(lambda t: float(np.interp(t, trace.time, trace.velocity)))
    found["same of samples"] = {"np.interp": peer(recorded, theta[:2], trace, 5)}
    return {name: found[name] for name in names}


def compare(theta, trace, names, rounds):
    """Time ours and the others on a trace, print the table; limits that were missed."""
    expected = MODEL.force(theta, trace, start=0.5)
    found = entrants(theta, trace, names)
    flat = {(name, way): c for name, ways in found.items() for way, c in ways.items()}
    checks = {key: deviation(contender, trace, expected) for key, contender in flat.items()}
    field = {"exp": exp_pass(), "ours": ours(theta, trace)} | flat
    seconds = race(field, rounds)
    each = {key: values / field[key].vectors for key, values in seconds.items()}
    scale = SAMPLES * VECTORS / (trace.samples * len(theta))
    for words in HEADER:
        print(_line("", words))
    passes = ratio(seconds["ours"], seconds["exp"]) * scale
    print(_row("ours", each["ours"], trace, 1.0, passes))
    failed = []
    for name, ways in found.items():
        way = min(ways, key=lambda way: np.median(each[name, way]))
        slower = ratio(each[name, way], each["ours"])
        off, first = checks[name, way]
        row = _row(f"{name} ({way})", each[name, way], trace, slower, passes * slower)
        print(f"{row}{off:11.0e}{first:11.2f}")
    for (name, way), (off, _) in checks.items():
        if not off <= AGREEMENT.get(name, CLOSE):
            failed.append(f"{name} ({way}) deviates from ours by {off:.1e} of the peak")
    return failed, passes, seconds


def _row(name, each, trace, times, passes):
    best, middle = 1e6 * np.min(each), 1e6 * np.median(each)
    per_sample = 1000 * middle / trace.samples
    figures = (f"{best:.1f}", f"{middle:.1f}", f"{per_sample:.2f}", f"{times:.2f}", f"{passes:.1f}")
    return _line(name, figures)


def _line(name, words):
    return f"{name:38s}" + "".join(f"{word:>11}" for word in words)


def table_peers(quick):
    """Table 1: the peers on harmonic motions, at a plausible damper's and at real parameters."""
    plausible, real = draw_theta(VECTORS), draw_theta(VECTORS, REAL, REAL_LENGTHS)
    lengths = f"ℓ {REAL_LENGTHS[0]} to {REAL_LENGTHS[1]} in"
    failed = []
    for label, theta, hertz, names in (
        ("1a. A plausible damper, ℓ 0.005 to 0.01 in", plausible, HERTZ, EVERY),
        (f"1b. As in posteriors of real records, {lengths}", real, HERTZ, FAST),
        (f"1c. As in posteriors of real records, {lengths}", real, SLOW_HERTZ, FAST),
    ):
        print(f"\n{label}: {VECTORS} vectors × {SAMPLES} samples at 100 Hz, 1 in, {hertz:g} Hz")
        fell, passes, seconds = compare(theta, sine(SAMPLES, hertz), names, 5 if quick else 40)
        every = seconds["ours"] / seconds["exp"]
        print(
            f"ours: {passes:.1f} passes of {1e6 * np.median(seconds['exp']):.0f} µs "
            f"({every.min():.1f} to {every.max():.1f} over {every.size} rounds)"
        )
        failed += [f"{label[:2]}: {bar}" for bar in fell]
    return failed


def table_cost(quick):
    """Table 2: cost over samples and over vectors."""
    samples = (500, 2000, 10_000) if quick else (500, 2000, 10_000, 50_000, 100_000)
    vectors = (1, 32, 64, 128) if quick else (1, 32, 64, 128, 256, 512)
    print("\n2. Cost of ours over size (passes: of np.exp over as many elements as 2000 × 64,")
    print("   scaled to the size's own number of elements)")
    _sizes({(t, VECTORS): t for t in samples}, samples[0], 3 if quick else 7)
    _sizes({(SAMPLES, n): n for n in vectors}, 32, 5 if quick else 20)
    return []


def _sizes(sizes, least, rounds):
    """Race sizes (T, n) against one another; the spread is over those of `least` and more."""
    traces = {t: sine(t) for t, _ in sizes}
    field = {(t, n): ours(draw_theta(n), traces[t]) for t, n in sizes}
    seconds = race({"exp": exp_pass()} | field, rounds)
    print(f"{'':18s}{'µs per vector and 1000 samples':>32}{'np.exp':>11}")
    print(f"{'samples':>9}{'vectors':>9}{'best':>21}{'median':>11}{'passes':>11}")
    passes = {}
    for t, n in sizes:
        each = seconds[t, n] * 1e9 / (t * n)
        scale = SAMPLES * VECTORS / (t * n)
        passes[t, n] = ratio(seconds[t, n], seconds["exp"]) * scale
        best, middle = np.min(each), np.median(each)
        print(f"{t:9,d}{n:9d}{best:21.2f}{middle:11.2f}{passes[t, n]:11.1f}")
    kept = [passes[size] for size, measure in sizes.items() if measure >= least]
    print(f"   from {least} on, dearest over cheapest: {max(kept) / min(kept):.2f}")


def table_memory(quick):
    """Table 3: peak memory, in a process of its own."""
    samples = 10_000 if quick else 100_000
    print(f"\n3. Peak memory of one call, 512 vectors × {samples:,} samples")
    command = [sys.executable, "-m", "benchmarks.forward.run", "--peak", str(samples)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    grown, output = (float(word) for word in run.stdout.split())
    print(
        f"{grown:.0f} MB above the process before the call, of which the output is {output:.0f} MB"
    )
    return []


def print_peak(samples):
    """Print by how many MB a call raises this process's peak, and its output's size."""
    theta, trace = draw_theta(512), sine(samples)
    MODEL.force(theta[:2], sine(500), start=0.5)
    before = _memory("VmRSS")
    force = MODEL.force(theta, trace, start=0.5)
    print(_memory("VmHWM") - before, force.nbytes / 1e6)


def _memory(name):
    """A line of /proc/self/status, MB; ru_maxrss would start at the parent's own peak."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) * 1.024e-3


def table_records(quick, folder):
    """Table 4: real records at their full rate."""
    print(f"\n4. Real records, {VECTORS} vectors, every sample")
    missing = [name for name in RECORDS.values() if not (folder / name).is_file()]
    if missing:
        print(f"left out: {folder} does not hold {', '.join(missing)}")
        return []
    failed = []
    theta = draw_theta(VECTORS)
    for kind, name in RECORDS.items():
        record = read_record(folder / name)
        trace = record.trace()
        print(
            f"{kind}, {name}: {trace.samples:,} samples at {record.rate:.0f} Hz, "
            f"{trace.turning_points.size} turning points"
        )
        fell, _, _ = compare(theta, trace, BATCHES, 3 if quick else 11)
        failed += [f"{kind} record: {bar}" for bar in fell]
        _turns_share(theta, trace, 3 if quick else 15)
    return failed


def _turns_share(theta, trace, rounds):
    """Print the share of turning points in the time, from times of whole forces.

    Sines of the record's number of samples and of one amplitude spend the same share of their
    samples in the gap whatever their frequency: they differ by their turning points alone. A
    ramp turns nowhere and crosses the gap once, so that it leaves out the crossings as well.
    """
    ramp = np.linspace(0, np.ptp(trace.displacement), trace.samples)
    traces = {
        "record": trace,
        "few": _sine_with(FEW, trace.time),
        "many": _sine_with(MANY, trace.time),
        "ramp": Trace.from_arrays(trace.time, ramp),
    }
    seconds = race({name: ours(theta, motion) for name, motion in traces.items()}, rounds)
    record = seconds["record"]
    extra = traces["many"].turning_points.size - traces["few"].turning_points.size
    each = np.median(seconds["many"] - seconds["few"]) / extra
    turns = trace.turning_points.size
    print(
        f"   turning points: {1e6 * each / len(theta):.2f} µs per vector each, "
        f"{turns * each / np.median(record):.1%} of this record's cost\n"
        f"   with all crossings of the gap (against a ramp of {trace.samples:,} samples): "
        f"{1 - ratio(seconds['ramp'], record):.1%}"
    )


def _sine_with(turns, t):
    """Trace of 1 in at the times of another, with a number of turning points."""
    pace = np.pi * turns / (t[-1] - t[0])
    angle = pace * (t - t[0]) + PHASE
    return Trace.from_arrays(t, np.sin(angle), velocity=pace * np.cos(angle))


def table_steps(quick):
    """Time of one step of the step interface, and its deviation from the whole motion's force."""
    trace = sine(500 if quick else SAMPLES)
    print("\n5. Step by step, for hybrid simulation (1024 Hz leaves 977 µs)")
    print("  vectors    median µs    99 % below    largest deviation, kip")
    failed = []
    for vectors in (1, 8, VECTORS):
        theta = draw_theta(vectors)
        state, forces, times = MODEL.start(theta), [], []
        for x, v in zip(trace.displacement, trace.velocity, strict=True):
            begin = time.perf_counter()
            force, state = MODEL.step(state, x, v, 1 / RATE)
            times.append(1e6 * (time.perf_counter() - begin))
            forces.append(force)
        largest = np.max(np.abs(np.array(forces).T - MODEL.force(theta, trace)))
        print(
            f"  {vectors:7d} {np.median(times):12.0f} {np.quantile(times, 0.99):13.0f}"
            f" {largest:25.0e}"
        )
        if largest > STEP_AGREEMENT:
            failed.append(f"steps of {vectors} vectors are {largest:.0e} kip from the whole force")
    return failed


def print_machine():
    """Print what the table was measured on."""
    vector = next((k for k in ("AVX512_SKX", "AVX2", "AVX") if cpu_features.get(k)), "no AVX")
    svml = "with" if numba.config.USING_SVML else "without"
    print("What a force costs, one thread of one core\n")
    print(f"{processor()}, {vector} (numpy); {load()}")
    print(f"{versions('numpy', 'scipy', 'numba')} {svml} SVML, JAX {jax.__version__}, float64")


def parse():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--quick", action="store_true", help="fewer rounds and smaller sizes")
    parser.add_argument("--peak", type=int, help=argparse.SUPPRESS)
    return parser.parse_args()


def main():
    options = parse()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if options.peak:
        print_peak(options.peak)
        return
    print_machine()
    failed = table_peers(options.quick)
    failed += table_cost(options.quick)
    failed += table_memory(options.quick)
    failed += table_records(options.quick, options.data / "brfd")
    failed += table_steps(options.quick)
    print_bars(failed)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
