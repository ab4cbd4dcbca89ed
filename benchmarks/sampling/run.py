"""Effective draws per second, and whether they are right: ours, emcee's stretch move, and NUTS.

    pip install -e '.[bench]'
    python -m benchmarks.sampling.run > benchmarks/sampling/sampling.txt

runs on one thread of one core (Linux) for about 25 minutes, on three real records and a
synthetic one. Every sampler draws from the same posterior in the same coordinates q, until the
smallest bulk effective sample size of a coordinate is that of "thorough", or its time is up. The
figure of merit is this size, measured by one function for all samplers, divided by all the seconds
that were used. Seconds are processor time.

- Ours is `sample(posterior, "thorough", seed)`, with its search for modes. It runs with several
  seeds, before, between and after the others, because a shared machine's speed changes; the middle
  rate counts.
- Stretch is emcee with its defaults, 64 walkers and the same density in batches. It starts at
  draws of Laplace's approximation around our mode, which costs it nothing; its warm-up counts.
- NUTS (NumPyro) has the density in JAX (x64, checked against ours) and a dense mass matrix, which
  it adapts in NumPyro's usual 1000 draws from our mode, which costs it nothing. Compiling and
  warm-up count, and rates without them are shown too. "alone" starts at the prior's medians, as it
  would have to without our mode; "helped" is also given Laplace's covariance, and adapts in 300.

Means and standard deviations are compared with reference.json, which
`benchmarks.sampling.reference` makes. Exit status 1: a density differs from JAX's or from the
reference's, a reference did not reach its own limits, ours is not as many times as fast as `BARS`
say, or a mean or a standard deviation is off by more than `MEAN` or `SPREAD`.

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
    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
)

import argparse
import json
import sys
import time
import warnings
from pathlib import Path

import jax
import numpy as np

from benchmarks.common.data import add_data_option
from benchmarks.common.machine import load, print_bars, processor, versions
from benchmarks.sampling import peers
from benchmarks.sampling.draws import Counted, by_step, disagreement
from benchmarks.sampling.reference import (
    COMMAND,
    ESS,
    FILE,
    RECORDS,
    SYNTHETIC,
    find_posterior,
    reached,
)
from mfd_bayes.calibration.diagnostics import EFFORTS, measure
from mfd_bayes.calibration.sampling import sample

BARS = {"emcee, stretch move": 5.0, "NUTS": 30.0}
"""How many times as fast our sampler must be, on every record."""
MEAN, SPREAD = 0.1, 0.1
"""Largest deviations of a mean, in sds, and of the ratio of two sds from 1."""
CLOSE = 1e-6
"""Largest deviation of JAX's log density, over its size where that exceeds 1."""
SECONDS, QUICK = 90.0, 30.0
"""Seconds that another sampler may run at most, in full and in quick runs."""
SEEDS = (1, 2, 3)
WORDS = ("seconds", "warm-up", "evaluations", "bulk ESS", "ESS/s", "ours is", "R̂", "mean", "sd")


def ours(posterior, seed):
    """Our draws as a `Run`, and the best mode."""
    counted = Counted(posterior)
    began = time.process_time()
    draws = sample(counted.counting, "thorough", seed)
    seconds = time.process_time() - began
    chains = by_step(draws.chains)
    return peers.Run(chains, seconds, np.nan, 0.0, counted.count), draws.modes[0]


def deviation(posterior, points):
    """Largest deviation of JAX's log density, over its size where that exceeds 1."""
    density = jax.jit(jax.vmap(peers.jax_density(posterior)))
    expected = posterior.log_prob(points)
    return float(np.max(np.abs(density(points) - expected) / np.maximum(1, np.abs(expected))))


def check_densities(posterior, reference):
    """Print how far JAX's and the reference's density are from ours; return what failed."""
    prior = posterior.coordinates(posterior.draw_prior(np.random.default_rng(0), 200))
    found = reference["coordinates"]
    if list(found) != list(posterior.names):
        return [f"reference.json has other coordinates: {COMMAND}"]
    mean, sd = (np.array([c[key] for c in found.values()]) for key in ("mean", "sd"))
    near = mean + 0.3 * sd * np.random.default_rng(1).standard_normal((200, mean.size))
    off = [deviation(posterior, points) for points in (prior, near)]
    at_mean = posterior.log_prob(mean[None])[0] - reference["log_prob_at_mean"]
    print(
        f"   JAX's log density: {off[0]:.0e} of its size off at 200 prior draws, {off[1]:.0e} "
        f"at 200 near the mean; the reference's: {abs(at_mean):.0e}"
    )
    failed = [] if max(off) <= CLOSE else [f"JAX's log density is off by {max(off):.1e}"]
    if not abs(at_mean) <= 1e-3:
        failed.append(f"reference.json is of another density: {COMMAND}")
    if not reached(reference, ESS):
        failed.append(
            "the reference itself has not converged, so the record shows nothing about ours"
        )
    return failed


def rate(run, seconds=None):
    """Smallest bulk ESS per second."""
    return peers.smallest(run.chains) / (run.seconds if seconds is None else seconds)


def race(posterior, seconds, seeds):
    """Runs of ours by seed, and of the others by name, in turns."""
    goal = peers.Goal(EFFORTS["thorough"].ess, seconds)
    mine, first = {}, seeds[0]
    mine[first], mode = ours(posterior, first)
    others = {"emcee, stretch move": peers.stretch(posterior.log_prob, mode, goal, first)}
    for seed in seeds[1:2]:
        mine[seed], _ = ours(posterior, seed)
    prior = posterior.coordinates(posterior.draw_prior(np.random.default_rng(first), 1001))
    for name, start in (
        ("NUTS", peers.Start(mode.q)),
        ("NUTS, alone", peers.Start(np.median(prior, axis=0))),
        ("NUTS, helped", peers.Start(mode.q, mode.covariance, warm_up=300)),
    ):
        others[name] = peers.nuts(posterior, start, goal, first)
    for seed in seeds[2:]:
        mine[seed], _ = ours(posterior, seed)
    return mine, others


def compare(posterior, reference, seconds, seeds):
    """Compare samplers on one record, print the table; limits that were missed, and the ratios."""
    failed = check_densities(posterior, reference)
    mine, others = race(posterior, seconds, seeds)
    print(f"{'':26s}" + "".join(f"{word:>12}" for word in WORDS))
    middle = float(np.median([rate(run) for run in mine.values()]))
    for seed, run in mine.items():
        failed += _row(f"ours, seed {seed}", run, reference, middle, bar=True)
    ratios = {}
    for name, run in others.items():
        _row(name, run, reference, middle)
        ratios[name] = middle / rate(run) if rate(run) else np.inf
        if run.compiling:
            _part("   without compiling", run, run.seconds - run.compiling, middle)
        _part("   after its warm-up", run, run.seconds - run.warm_up, middle)
    for name, bar in BARS.items():
        if not ratios[name] >= bar:
            failed.append(f"ours is {ratios[name]:.1f} times as fast as {name}, not {bar:g}")
    return failed, ratios


def _part(words, run, seconds, middle):
    """Print the rate over some of the seconds, against all of ours."""
    speed = rate(run, seconds)
    times = middle / speed if speed else np.inf
    print(f"{words:26s}{seconds:12.1f}{'':36s}{speed:12.2f}{times:11.1f}×")


def _row(name, run, reference, middle, *, bar=False):
    """Print the figures of one sampler; return where it disagrees with the reference."""
    found, ess = measure(run.chains), peers.smallest(run.chains)
    (mean, at), (sd, there) = disagreement(run.chains, reference)
    warm_up = "" if np.isnan(run.warm_up) else f"{run.warm_up:.1f}"
    speed = ess / run.seconds
    times = middle / speed if speed else np.inf
    print(
        f"{name:26s}{run.seconds:12.1f}{warm_up:>12}{run.evaluations:12,d}{ess:12.0f}{speed:12.2f}"
        f"{times:11.1f}×{found.worst_r_hat:12.3f}{mean:12.3f}{sd:12.1%}   {at}, {there}"
    )
    failed = []
    if bar and not mean <= MEAN:
        failed.append(f"{name}: mean of {at} is {mean:.3f} sd off, more than {MEAN:g}")
    if bar and not sd <= SPREAD:
        failed.append(f"{name}: sd of {there} is {sd:.1%} off, more than {SPREAD:.0%}")
    return failed


def print_machine():
    """Print what the table was measured on."""
    print("Effective draws per second, one thread of one core\n")
    print(f"{processor()}; {load()}")
    print(f"{versions('numpy', 'scipy', 'emcee', 'numpyro', 'jax')}, float64")
    print(
        "\nevaluations: of the density, modes included, or of its gradient; ours is: times as "
        "fast;\nmean, sd: largest deviations from reference.json, of means in sds and of sds, and "
        "whose they are"
    )


def parse():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--quick", action="store_true", help="one seed of ours, shorter races")
    parser.add_argument("--only", choices=[*RECORDS, SYNTHETIC], help="one record alone")
    parser.add_argument("--reference", type=Path, default=FILE)
    return parser.parse_args()


def main():
    options = parse()
    warnings.simplefilter("ignore", FutureWarning)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    references = json.loads(options.reference.read_text(encoding="utf-8"))["posteriors"]
    seconds, seeds = (QUICK, SEEDS[:1]) if options.quick else (SECONDS, SEEDS)
    measure(np.random.default_rng(0).standard_normal((4, 100, 2, 1)))  # ArviZ loads slowly
    print_machine()
    failed, table = [], {}
    for name in [options.only] if options.only else [*RECORDS, SYNTHETIC]:
        posterior = find_posterior(name, options.data)
        samples = f"{posterior.trace.samples:,} samples, {posterior.dim} coordinates"
        print(f"\n{name} ({RECORDS.get(name, 'known truth')}): {samples}")
        fell, table[name] = compare(posterior, references[name], seconds, seeds)
        failed += [f"{name}: {bar}" for bar in fell]
        sys.stdout.flush()
    others = next(iter(table.values()))
    print(f"\n{'times as fast as':18s}" + "".join(f"{name:>22}" for name in others))
    for name, ratios in table.items():
        print(f"{name:18s}" + "".join(f"{ratio:22.1f}" for ratio in ratios.values()))
    print(f"{'bar':18s}" + "".join(f"{BARS.get(name, ''):>22}" for name in others))
    print_bars(failed)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
