"""What a force of the backlash model costs, beside numba, JAX and the other models.

    pip install -e '.[bench]'
    python -m benchmarks.backlash.speed > benchmarks/backlash/speed.txt

runs on one thread of one core for about a minute. Contenders take turns, round by round; times are
of the processor, since a shared machine's clock also runs for others. A "pass" is one np.exp over
a 2000 × 64 array into an existing array, timed in the same round; ratios are medians over rounds.

Exit status 1: a peer does not agree with ours. What is faster is only told.
"""

from __future__ import annotations

import os

os.environ.update(
    OMP_NUM_THREADS="1",
    OPENBLAS_NUM_THREADS="1",
    MKL_NUM_THREADS="1",
    JAX_PLATFORMS="cpu",
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import sys
import time
from types import SimpleNamespace

import numpy as np

from benchmarks.backlash import peers
from benchmarks.common.machine import load, print_bars, processor, versions
from mfd_bayes.friction.backlash import BacklashLuGre, Damper, cut, strokes_of
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

MODEL = BacklashLuGre()
SAMPLES, VECTORS, ROUNDS = 2000, 64, 15
AGREEMENT = 1e-6
CENTRE = np.array([50.0, 45.0, 0.2, 0.02, 0.3, 2.2, 1.8, 3.0, 0.01, 0.2, 0.15, 0.5])
REAL = np.array([150.0, 79.0, 0.3, 0.0265, 0.86, 1.29, 0.88, 9.0, 0.11, 0.31, 0.71, 1.7])
"""Fitted to the record 2022_22lb_0.50Hz_1.0in: low friction, a stiff spring, sudden slip."""

THREE = np.array([60, 0.02, 0.01, 2.4, 2, 1.9, 1.5, 0.5, 30, 0.1, 0.08, 1, 0.007, 0.5])
BOUC = np.array([40.0, 0.02, 2.0, 1.7, 0.7, 2.0, 0.01])


def motion(samples):
    """1 in at 0.5 Hz and 100 Hz, with turns between samples."""
    angle = np.pi * np.arange(samples) * 0.01 + 0.3
    time_ = np.arange(samples) * 0.01
    return Trace.from_arrays(time_, np.sin(angle), velocity=np.pi * np.cos(angle))


def around(centre, vectors, spread=0.1):
    """Vectors around one, as draws of a posterior."""
    return centre * np.random.default_rng(0).lognormal(0.0, spread, (vectors, centre.size))


def peer(force, theta, trace):
    """Call of a peer: every plan's vectors along their course; the rest is outside the timing."""
    damper = Damper(dict(zip(MODEL.parameters, np.ascontiguousarray(theta.T), strict=True)))
    first = damper.begin(np.full(len(theta), 0.5))
    x = trace.path.displacement
    moves = np.diff(x)
    rate = moves / np.diff(trace.path.time)
    sign, since = strokes_of(moves)
    kinds, which = np.unique(np.stack(damper.steps), axis=1, return_inverse=True)
    parts = []
    for i, kind in enumerate(kinds.T):
        chosen = np.flatnonzero(which.ravel() == i)
        cuts = cut(np.abs(moves)[:, None], since[:, None], *kind[:, None])
        course = SimpleNamespace(
            way=cuts.way, sign=sign[cuts.origin], origin=cuts.origin, ends=cuts.ends
        )
        parts.append((chosen, np.ascontiguousarray(theta[chosen]), first[chosen], course))

    def run():
        out = np.empty((len(theta), trace.samples))
        out[:, 0] = damper.spring.evaluate(first)[0]
        for chosen, some, begin, course in parts:
            found = force(some, begin, course, rate)
            out[chosen, 1:] = found[:, course.ends[trace.path.samples[1:] - 1] - 1]
        return out + np.outer(theta[:, 8], trace.velocity)

    return run


def race(contenders, rounds=ROUNDS):
    """Processor seconds of a call in each round, by name, (rounds,) each."""
    seconds = {name: [] for name in contenders}
    for name, run in contenders.items():
        run()
        del name
    for _ in range(rounds):
        for name, run in contenders.items():
            begin = time.process_time()
            run()
            seconds[name].append(time.process_time() - begin)
    return {name: np.array(values) for name, values in seconds.items()}


def exp_pass():
    """Call that is one pass."""
    given = np.random.default_rng(0).normal(size=(SAMPLES, VECTORS))
    out = np.empty_like(given)
    return lambda: np.exp(given, out=out)


def other_models(trace):
    """Calls of the other models."""
    return {
        "three stages": lambda: ThreeStage().force(around(THREE, VECTORS, 0.0), trace),
        "Bouc-Wen": lambda: BoucWen().force(around(BOUC, VECTORS, 0.0), trace),
    }


def beside_peers(words, centre, others=None):
    """Table of vectors around one, beside peers and calls of others; what failed."""
    trace, theta, failed = motion(SAMPLES), around(centre, VECTORS), []
    ours = MODEL.force(theta, trace)
    contenders = {
        "one pass": exp_pass(),
        "ours": lambda: MODEL.force(theta, trace),
        "numba (njit, fastmath)": peer(peers.numba_loop, theta, trace),
        "JAX scan": peer(peers.jax_scan, theta, trace),
        **(others or {}),
    }
    seconds = race(contenders)
    print(f"{words}: {VECTORS} vectors × {SAMPLES} samples at 100 Hz, 1 in, 0.5 Hz")
    print(f"{'':26s}{'best ms':>9s}{'median ms':>11s}{'passes':>9s}{'deviation':>11s}")
    for name, values in seconds.items():
        passes = float(np.median(values / seconds["one pass"]))
        off = ""
        if name in ("numba (njit, fastmath)", "JAX scan"):
            deviation = float(np.max(np.abs(contenders[name]() - ours)))
            off = f"{deviation:.0e}"
            failed += [] if deviation < AGREEMENT else [f"{words}: {name} agrees"]
        best, middle = 1e3 * values.min(), 1e3 * np.median(values)
        print(f"{name:26s}{best:9.1f}{middle:11.1f}{passes:9.1f}{off:>11s}")
    return failed


def over_size():
    """Third table: passes of np.exp over as many elements."""
    print("\n3. Cost over size, in passes over as many elements")
    sizes = [(s, 64) for s in (500, 2000, 10_000, 30_000)] + [(2000, v) for v in (1, 8, 32, 256)]
    for samples, vectors in sizes:
        trace, theta = motion(samples), around(CENTRE, vectors)
        run = {"one pass": exp_pass(), "ours": lambda th=theta, tr=trace: MODEL.force(th, tr)}
        seconds = race(run, 3)
        share = SAMPLES * VECTORS / (samples * vectors)
        passes = float(np.median(seconds["ours"] / seconds["one pass"])) * share
        print(f"{samples:9,d} samples {vectors:6d} vectors {passes:9.1f}")


def step_by_step():
    """Fourth table."""
    print("\n4. Step by step at 1024 Hz (977 µs)")
    rate = 1024.0
    for vectors in (1, 8, 64):
        theta = around(CENTRE, vectors)
        state, seconds = MODEL.start(theta), []
        for k in range(2048):
            angle = np.pi * k / rate
            begin = time.process_time()
            _, state = MODEL.step(state, np.sin(angle), np.pi * np.cos(angle), 1.0 / rate)
            seconds.append(time.process_time() - begin)
        middle, late = 1e6 * np.median(seconds), 1e6 * np.quantile(seconds, 0.99)
        print(f"{vectors:6d} vectors: median {middle:5.0f} µs, 99 % below {late:5.0f} µs")


def main():
    """Print the tables; exit status 1 where a bar does not hold."""
    print("What a force of the backlash model costs, one thread of one core\n")
    print(f"{processor()}; {load()}")
    print(f"{versions('numpy', 'scipy', 'numba', 'jax')}\n")
    failed = beside_peers("1. Middling values", CENTRE, other_models(motion(SAMPLES)))
    print()
    failed += beside_peers("2. As fitted to a real record, 22 lb", REAL)
    over_size()
    step_by_step()
    print_bars(failed)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
