"""Reference posteriors for `benchmarks.sampling.run`, by a long plain run of emcee.

    pip install -e '.[bench]'
    python -m benchmarks.sampling.reference

writes benchmarks/sampling/reference.json, two records at a time, in 17 minutes of processor time.

Each record is sampled by four independent ensembles with emcee's own differential evolution (ter
Braak 2006: 80 % of the moves with the usual length, 20 % full jumps between walkers) and nothing
else: no learned proposal, no code of `mfd_bayes.calibration.sampling`. Every ensemble searches for
the modes again, from its own draws of the prior. Its walkers start around all modes found, with
twice the standard deviation of Laplace's approximation; the share of a mode follows its evidence.
So R-hat shows when the ensembles disagree. The first half of each run is discarded as warm-up. A
run ends when the smallest bulk effective sample size is `ESS`, R-hat is at most `R_HAT`, and what
is kept is `LENGTH` autocorrelation times long.
Exit status 1: a record did not reach that within `MOST` steps.

The real records come from --data (MFD_BAYES_DATA, ../shared/data).
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import json
import multiprocessing
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import emcee
import numpy as np
import scipy

from benchmarks.common.data import add_data_option
from mfd_bayes.calibration.diagnostics import autocorrelation_time, measure
from mfd_bayes.calibration.modes import find_modes
from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace

FILE = Path(__file__).with_name("reference.json")
COMMAND = "python -m benchmarks.sampling.reference"
RATE = 64.0  # Hz
RECORDS = {
    "30 lb, 0.25 Hz": "2023_30lb_0.25Hz_1.0in.csv",
    "20 lb, 0.50 Hz": "2022_20lb_0.50Hz_1.0in.csv",
    "80 lb, 0.50 Hz": "2022_80lb_0.50Hz_1.0in.csv",
}
SYNTHETIC = "synthetic"
TRUTH = {
    "sigma0": 50.0,  # kip/in
    "sigma1": 0.02,  # kip·s/in
    "sigma2": 0.015,
    "Fc_fwd": 1.3,  # kip
    "Fc_bwd": 1.65,
    "static_excess_fwd": 0.18,
    "static_excess_bwd": 0.12,
    "k2": 0.6,  # kip/in
    "k3": 20.0,
    "d2": 0.09,  # in
    "d3": 0.07,
    "ell": 0.02,
    "gamma1": 1.0,
    "v_s": 0.4,  # in/s
    "start": 0.4,
    "offset": 0.03,  # kip
    "noise_sd": 0.05,
    "noise_time": 0.1,  # s
}
"""Of the synthetic record: 16 s of 1 in at 0.5 Hz, OU noise."""
QUANTILES = (2.5, 25.0, 50.0, 75.0, 97.5)  # percent
ENSEMBLES, WALKERS = 4, 128
ESS, R_HAT, LENGTH = 8000.0, 1.01, 10.0
LEAST = 0.02
"""Least share of the walkers that start at a mode, over the best mode's; else by evidence."""
BLOCK, THIN, MOST = 1000, 10, 120_000  # steps
SEED = 20240


def synthetic():
    """Trace of a known damper, always the same."""
    angle = 2 * np.pi * 0.5 * np.arange(16 * RATE + 1) / RATE + 0.3
    t = np.arange(angle.size) / RATE
    x, v = np.sin(angle), np.pi * np.cos(angle)
    truth = {name: np.array([value]) for name, value in TRUTH.items()}
    model = ThreeStage()
    force = model.force(model.theta(truth), Trace.from_arrays(t, x, velocity=v), truth["start"])
    noise = find_noise("ou").draw(np.random.default_rng(SEED), t, truth)
    return Trace.from_arrays(t, x, force=(force + noise)[0] + TRUTH["offset"], velocity=v)


def find_posterior(name, folder):
    """Posterior of one of the four records."""
    if name == SYNTHETIC:
        return Posterior(synthetic(), "mfd")
    return Posterior(read_record(folder / "brfd" / RECORDS[name]).trace(RATE), "brfd")


def begin(posterior, seed):
    """Where an ensemble's walkers start, (walkers, dim)."""
    rng = np.random.default_rng(seed)
    modes = find_modes(posterior, rng, starts=16)
    modes = [m for m in modes if m.log_evidence > modes[0].log_evidence - 30.0]
    evidence = np.array([m.log_evidence for m in modes])
    share = np.maximum(np.exp(evidence - evidence.max()), LEAST)
    homes = rng.choice(len(modes), size=WALKERS, p=share / share.sum())
    starts = [_near(posterior, modes[home], rng) for home in homes]
    return np.array(starts), len(modes)


def _near(posterior, mode, rng):
    """A point of finite density with twice the spread of Laplace's around a mode, (dim,)."""
    while True:
        q = rng.multivariate_normal(mode.q, 4.0 * mode.covariance)
        if np.isfinite(posterior.log_prob(q[None])[0]):
            return q


def evolve(posterior, seed):
    """Sampler of one ensemble, its state, and the number of modes that it started at."""
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DEMove(gamma0=1.0), 0.2)]
    sampler = emcee.EnsembleSampler(
        WALKERS, posterior.dim, posterior.log_prob, moves=moves, vectorize=True
    )
    starts, modes = begin(posterior, seed)
    # emcee takes a RandomState's state and silently ignores anything else
    twister = np.random.RandomState(np.random.default_rng([*seed, 1]).integers(2**32))
    return sampler, emcee.State(starts, random_state=twister.get_state()), modes


def run(name, folder, ess):
    """Reference of one record, as it is stored."""
    warnings.simplefilter("ignore", FutureWarning)
    began = time.perf_counter()
    posterior = find_posterior(name, folder)
    index = [*RECORDS, SYNTHETIC].index(name)
    ensembles = [evolve(posterior, [SEED, index, e]) for e in range(ENSEMBLES)]
    states = [state for _, state, _ in ensembles]
    for steps in range(BLOCK, MOST + 1, BLOCK):
        for e, (sampler, _, _) in enumerate(ensembles):
            states[e] = sampler.run_mcmc(states[e], BLOCK // THIN, thin_by=THIN)
        late = steps // THIN // 2
        chains = np.stack([sampler.get_chain(discard=late) for sampler, _, _ in ensembles])
        found, slowest = measure(chains), THIN * float(autocorrelation_time(chains).max())
        enough = steps / 2 >= LENGTH * slowest
        if enough and found.ess_bulk.min() >= ess and found.worst_r_hat <= R_HAT:
            break
    q = chains.reshape(-1, posterior.dim)
    mean = q.mean(axis=0)
    quantiles = np.percentile(q, QUANTILES, axis=0).T
    return {
        "steps": steps,
        "modes": [modes for _, _, modes in ensembles],
        "autocorrelation_steps": slowest,
        "acceptance": float(np.mean([s.acceptance_fraction.mean() for s, _, _ in ensembles])),
        "seconds": time.perf_counter() - began,
        "log_prob_at_mean": float(posterior.log_prob(mean[None])[0]),
        "coordinates": {
            quantity: {
                "mean": float(mean[k]),
                "sd": float(q[:, k].std(ddof=1)),
                "quantiles": quantiles[k].tolist(),
                "ess_bulk": float(found.ess_bulk[k]),
                "ess_tail": float(found.ess_tail[k]),
                "r_hat": float(found.r_hat[k]),
            }
            for k, quantity in enumerate(posterior.names)
        },
    }


def reached(reference, ess):
    """Whether a record's reference is as good as it should be."""
    found = reference["coordinates"].values()
    if reference["steps"] / 2 < LENGTH * reference["autocorrelation_steps"]:
        return False
    return all(c["ess_bulk"] >= ess and c["r_hat"] <= R_HAT for c in found)


def settings(ess):
    """What the references were made with."""
    return {
        "command": COMMAND,
        "about": "coordinates q of mfd_bayes.calibration.posterior.Posterior, 64 Hz, OU noise; "
        "log_prob_at_mean tells whether a posterior is still the same density",
        "method": "emcee DEMove() 0.8 and DEMove(gamma0=1.0) 0.2; first half discarded",
        "ensembles": ENSEMBLES,
        "walkers": WALKERS,
        "thin": THIN,
        "ess": ess,
        "r_hat": R_HAT,
        "seed": SEED,
        "quantiles_percent": QUANTILES,
        "records": RECORDS | {SYNTHETIC: TRUTH},
        "versions": {
            "python": sys.version.split()[0],
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "emcee": emcee.__version__,
        },
    }


def rounded(values):
    """The same with numbers of nine digits."""
    if isinstance(values, dict):
        return {key: rounded(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [rounded(value) for value in values]
    return float(f"{values:.9g}") if isinstance(values, float) else values


def parse():
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--ess", type=float, default=ESS, help="least bulk ESS of a coordinate")
    parser.add_argument("--output", type=Path, default=FILE)
    return parser.parse_args()


def main():
    options = parse()
    names = [*RECORDS, SYNTHETIC]
    short = []
    stored = settings(options.ess) | {"posteriors": {}}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        runs = {name: pool.submit(run, name, options.data, options.ess) for name in names}
        for name, future in runs.items():
            reference = future.result()
            coordinates = reference["coordinates"].values()
            print(
                f"{name:16s} {reference['steps']:6d} steps, {reference['seconds']:4.0f} s, modes "
                f"{reference['modes']}, autocorrelation {reference['autocorrelation_steps']:.0f} "
                f"steps, smallest bulk ESS {min(c['ess_bulk'] for c in coordinates):.0f}, "
                f"largest R̂ {max(c['r_hat'] for c in coordinates):.4f}",
                flush=True,
            )
            stored["posteriors"][name] = reference
            if not reached(reference, options.ess):
                short.append(name)
    text = json.dumps(rounded(stored), indent=1, ensure_ascii=False)
    options.output.write_text(text + "\n", encoding="utf-8")
    if short:
        print(f"FAILED: {', '.join(short)} fell short of ESS {options.ess:g} or R̂ {R_HAT}")
    sys.exit(1 if short else 0)


if __name__ == "__main__":
    main()
