"""How long a person waits for one test's posterior, by ours and by the samplers of the field.

    pip install -e '.[bench]' zeus-mcmc pints blackjax nutpie dynesty ultranest
    pip install nautilus-sampler pocomc flowMC
    python -m benchmarks.races.run > benchmarks/races/races.txt

takes about two hours of processor time. Four posteriors, three of real records (those of
`benchmarks.sampling`). Each tool runs in a process of its own on one thread, as its manual
recommends and tuned to win (`benchmarks.races.tools`), with the same density: NumPy in batches, or
JAX for those that differentiate. Two figures each: processor time from the start until every
coordinate has a bulk and tail ESS of at least 400 and R-hat of at most 1.01, compiling and warm-up
included; and effective draws per second once warm. Beside them the largest deviations of means and
standard deviations from reference.json. Ours searches its modes; tools that take a start are given
points around those modes, as ours begins from, for nothing. A tool that has not come so far after
--seconds is stopped, and said to have no end.

The real records come from --data (MFD_BAYES_DATA, ../shared/data).
"""

from __future__ import annotations

import os

# Read when numpy and JAX are imported.
os.environ.update(
    OMP_NUM_THREADS="1",
    OPENBLAS_NUM_THREADS="1",
    MKL_NUM_THREADS="1",
    JAX_PLATFORMS="cpu",
    JAX_ENABLE_X64="1",
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import argparse
import json
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from benchmarks.common.data import add_data_option
from benchmarks.common.machine import load, platform_line, processor
from benchmarks.races.problem import problem_of
from benchmarks.races.tools import TOOLS
from benchmarks.sampling.draws import disagreement
from benchmarks.sampling.reference import FILE, RECORDS, SYNTHETIC
from mfd_bayes.calibration.diagnostics import measure

WORDS = ("seconds", "evaluations", "ESS", "R-hat", "ESS/s warm", "mean", "sd")
GRACE = 120.0
"""Seconds beyond its time after which a tool's process is killed."""


def run_one(tool, record, options):
    """Figures of a tool on a record, in this process."""
    warnings.simplefilter("ignore")
    np.random.seed(options.seed)  # noqa: NPY002 - some tools have no generator of their own
    measure(np.random.default_rng(0).standard_normal((4, 100, 2, 1)))  # ArviZ loads slowly
    problem = problem_of(record, options.data, options.seconds)
    try:
        outcome = TOOLS[tool](problem, options.seed)
    except TimeoutError as error:
        return {"error": str(error)}
    seconds = problem.spent
    reference = json.loads(FILE.read_text(encoding="utf-8"))["posteriors"][record]
    mean, sd = disagreement(outcome.chains, reference)
    found = None if outcome.ess else measure(outcome.chains)
    ess = outcome.ess or float(min(found.ess_bulk.min(), found.ess_tail.min()))
    return {
        "seconds": seconds,
        "reached": outcome.reached,
        "evaluations": problem.evaluations,
        "ess": ess,
        "r_hat": None if outcome.ess else float(found.worst_r_hat),
        "rate": ess / max(seconds - outcome.warm_up, 1e-9),
        "mean": mean,
        "sd": sd,
    }


def start(tool, record, options):
    """Figures of a tool on a record by a process of its own, or why there are none."""
    words = ["--tool", tool, "--record", record, "--seconds", str(options.seconds)]
    words += ["--seed", str(options.seed), "--data", str(options.data)]
    command = [sys.executable, "-m", "benchmarks.races.run", *words]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=4 * options.seconds + GRACE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"error": "did not stop when its time was up"}
    if done.returncode:
        return {"error": (done.stderr.strip().splitlines() or ["no message"])[-1][:150]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def line(tool, found):
    """One line of the table."""
    if "error" in found:
        return f"{tool:24s}  {found['error']}"
    seconds = f"{found['seconds']:.1f}" if found["reached"] else f"> {found['seconds']:.0f}"
    r_hat = "–" if found["r_hat"] is None else f"{found['r_hat']:.3f}"
    (mean, at), (sd, there) = found["mean"], found["sd"]
    return (
        f"{tool:24s}{seconds:>12}{found['evaluations']:12,d}{found['ess']:12.0f}{r_hat:>12}"
        f"{found['rate']:12.1f}{mean:12.3f}{sd:12.1%}   {at}, {there}"
    )


def parse():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--tool", choices=TOOLS, help="only this one, its figures as JSON")
    parser.add_argument("--record", choices=[*RECORDS, SYNTHETIC], help="only this one")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="tools at a time")
    return parser.parse_args()


def main():
    options = parse()
    if options.tool and options.record:
        print(json.dumps(run_one(options.tool, options.record, options)))
        return
    print(
        "Waiting for ESS ≥ 400 and R-hat ≤ 1.01 of every coordinate, processor time of one thread"
    )
    print(f"\n{processor()}; {load()}; {platform_line()}")
    print(f"a tool is stopped after {options.seconds:g} s; mean, sd: largest deviations from the")
    print(
        "reference, of means in sds and of sds, and whose they are; nested samplers have no R-hat"
    )
    for record in [options.record] if options.record else [*RECORDS, SYNTHETIC]:
        print(f"\n{record}\n{'':24s}" + "".join(f"{word:>12}" for word in WORDS), flush=True)
        with ThreadPoolExecutor(options.jobs) as pool:
            each = {tool: pool.submit(start, tool, record, options) for tool in TOOLS}
            for tool, found in each.items():
                print(line(tool, found.result()), flush=True)


if __name__ == "__main__":
    main()
