"""Time of an update with 64 samples of a record at 1024 Hz, beside the time in which they arrive.

    python -m benchmarks.given.speed --run OUT > benchmarks/given/speed.txt

follows 12 s of the Kocaeli record of the 36 lb session with draws of the run OUT, on one core.
Exit status 1: the slowest update takes longer than 64 samples take to arrive.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from benchmarks.common.data import add_data_option
from benchmarks.common.machine import load, processor, versions

SAMPLES = 64
SECONDS = 12.0
DRAWS = (256, 1000)


def follow(run: mb.Run, trace: mb.Trace, draws: int) -> tuple[np.ndarray, float, float]:
    """Times of all updates, of a band of the next 64 samples, and of a refresh, s."""
    forecaster = run.follow(0.036, amplitude=0.18, velocity=1.5, draws=draws, refresh=False)
    times = []
    last = int(np.searchsorted(trace.time, SECONDS)) // SAMPLES * SAMPLES
    for begin in range(0, last, SAMPLES):
        part = slice(begin, begin + SAMPLES)
        columns = trace.time[part], trace.displacement[part], None, np.asarray(trace.force)[part]
        began = time.perf_counter()
        forecaster.update(*columns)
        times.append(time.perf_counter() - began)
    ahead = slice(last, last + SAMPLES)
    motion = mb.Trace.from_arrays(trace.time[ahead], trace.displacement[ahead])
    began = time.perf_counter()
    forecaster.band(motion)
    band = time.perf_counter() - began
    began = time.perf_counter()
    forecaster.refresh()
    return np.array(times), band, time.perf_counter() - began


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, required=True)
    add_data_option(parser)
    options = parser.parse_args()
    run = mb.open_run(options.run)
    trace = mb.read_record(options.data / "brfd" / "2023_36lb_KocaeliDBE.csv").trace()
    arrive = SAMPLES * float(np.median(np.diff(trace.time)))
    print(f"{processor()}, {load()}, {versions('numpy')}; one core; times in ms")
    print(f"64 samples arrive in {1e3 * arrive:.1f} ms; {SECONDS:g} s of record\n")
    print(
        f"{'draws':>6}{'median':>9}{'95 %':>9}{'slowest':>9}{'first 2 s':>11}{'last 2 s':>10}"
        f"{'ratio':>8}{'band of 64':>12}{'refresh':>9}"
    )
    slowest = 0.0
    for draws in DRAWS:
        times, band, refresh = follow(run, trace, draws)
        ms, some = 1e3 * times, int(2.0 / arrive)
        ends = np.median(ms[:some]), np.median(ms[-some:])
        print(
            f"{draws:6}{np.median(ms):9.2f}{np.quantile(ms, 0.95):9.2f}{ms.max():9.2f}"
            f"{ends[0]:11.2f}{ends[1]:10.2f}{times.max() / arrive:8.2f}"
            f"{1e3 * band:12.1f}{1e3 * refresh:9.0f}"
        )
        slowest = max(slowest, times.max())
    print("\nratio: the slowest update over the time in which its samples arrive")
    return int(slowest > arrive)


if __name__ == "__main__":
    sys.exit(main())
