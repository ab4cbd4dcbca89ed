"""How long does one test's posterior take: ours, emcee's stretch and DE moves, NumPyro's NUTS?

    pip install -e '.[bench]'
    python -m benchmarks.race.run > benchmarks/race/race.txt

takes a quarter of an hour on one thread (--quick: one record at a low rate with low limits). Every
tool draws from the same density, NumPy in batches or, for NUTS, JAX (checked against ours first),
until each coordinate has a bulk and tail ESS of ESS and R-hat of at most R_HAT, or its time is up.
Seconds are processor time from the start, with compiling, warm-up and ours' search for modes; the
others are given points around the best mode for nothing. NUTS runs four chains with a dense mass
matrix. Right or not: the largest deviations of means (in sds) and of sds from those of ours at
effort thorough with another seed, and whose they are. Exit status 1: a density is not the same,
or a tool that converged deviates by more than MEAN or SD. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import time
import warnings

import emcee
import jax
import numpy as np
from numpyro.infer import MCMC, NUTS

from benchmarks.race.density import jax_density
from mfd_bayes.calibration.diagnostics import measure
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import find_modes
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.records.record import read_record

ESS, R_HAT, SECONDS = 400.0, 1.01, 120.0
MEAN, SD = 0.25, 0.3
RATE, QUICK_RATE = 64.0, 16.0  # Hz
RECORDS = {
    "30 lb, 0.25 Hz": "2023_30lb_0.25Hz_1.0in.csv",
    "20 lb, 0.50 Hz": "2022_20lb_0.50Hz_1.0in.csv",
    "80 lb, 0.50 Hz": "2022_80lb_0.50Hz_1.0in.csv",
}


class Counted(Posterior):
    """A posterior that counts the vectors whose force was computed."""

    evaluations = 0

    def force(self, values, *words, **options):
        self.evaluations += len(values["offset"])
        return super().force(values, *words, **options)


def by_step(draws):
    """Our draws as (ensemble, step, walker, dim)."""
    chains = draws.chains
    ensembles, _, dim = chains.q.shape
    return chains.q.reshape(ensembles, chains.walkers, -1, dim).swapaxes(1, 2)


def halves(chain):
    """Halves in time of a chain (step, walker, dim), as two ensembles."""
    half = len(chain) // 2
    return np.stack([chain[-2 * half : -half], chain[-half:]])


def until_enough(advance, limits):
    """Chains (ensemble, step, walker, dim) of a tool that goes on, until they are enough."""
    ess, seconds = limits
    began, measuring = time.process_time(), 0.0
    while True:
        chains = advance()
        now = time.process_time()
        convergence = measure(chains)
        measuring += time.process_time() - now
        worst = min(convergence.ess_bulk.min(), convergence.ess_tail.min())
        if (worst >= ess and convergence.worst_r_hat <= R_HAT) or now - began - measuring > seconds:
            return chains, measuring


def ours(posterior, begin, seed, limits):
    return by_step(sample(posterior, "standard", seed)), 0.0


def stretch(posterior, begin, seed, limits, moves=None):
    options = {"moves": moves, "vectorize": True}
    sampler = emcee.EnsembleSampler(64, posterior.dim, posterior.log_prob, **options)
    state = begin[:64]

    def advance():
        nonlocal state
        state = sampler.run_mcmc(state, 500)
        steps = sampler.get_chain()
        return halves(steps[int(0.3 * len(steps)) :])

    return until_enough(advance, limits)


def evolution(posterior, begin, seed, limits):
    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    return stretch(posterior, begin, seed, limits, moves)


def nuts(posterior, begin, seed, limits):
    density = jax_density(posterior)
    options = {"num_chains": 4, "chain_method": "vectorized", "progress_bar": False}
    kernel = NUTS(potential_fn=lambda q: -density(q), dense_mass=True)
    warm_up, draws = (400, 250) if limits[0] >= ESS else (50, 50)
    mcmc = MCMC(kernel, num_warmup=warm_up, num_samples=draws, **options)
    samples, key = [], jax.random.PRNGKey(seed)

    def advance():
        if samples:
            mcmc.post_warmup_state = mcmc.last_state
            mcmc.run(mcmc.last_state.rng_key)
        else:
            mcmc.run(key, init_params=jax.numpy.asarray(begin[:4]))
        samples.append(np.asarray(mcmc.get_samples(group_by_chain=True)))
        return np.concatenate(samples, axis=1)[:, :, None]

    return until_enough(advance, limits)


TOOLS = {"ours": ours, "emcee, stretch": stretch, "emcee, DE": evolution, "NumPyro, NUTS": nuts}


def race(name, posterior, options):
    """Print a table of one record; what was missed."""
    limits = (50.0, 5.0) if options.quick else (ESS, SECONDS)
    effort = "quick" if options.quick else "thorough"
    reference = by_step(sample(posterior, effort, options.seed + 1)).reshape(-1, posterior.dim)
    mean, sd = reference.mean(axis=0), reference.std(axis=0)
    rng = np.random.default_rng(options.seed)
    modes, failed = find_modes(posterior, rng), []
    begin = rng.multivariate_normal(modes[0].q, modes[0].covariance, 2000)
    begin = begin[np.isfinite(posterior.log_prob(begin))]
    densities = np.array([jax.jit(jax_density(posterior))(q) for q in begin[:20]])
    if not np.allclose(densities, posterior.log_prob(begin[:20]), rtol=1e-8):
        failed.append(f"{name}: JAX's density is another")
    heads = ("seconds", "evaluations", "ESS", "R-hat", "mean", "sd")
    print(f"{name}: {posterior.trace.samples:,} samples, {posterior.dim} coordinates")
    print(f"{'':18}" + "".join(f"{head:>12}" for head in heads))
    for tool, draw in TOOLS.items():
        posterior.evaluations, began = 0, time.process_time()
        np.random.seed(options.seed)  # noqa: NPY002 - emcee's
        chains, measuring = draw(posterior, begin, options.seed, limits)
        seconds = time.process_time() - began - measuring
        convergence, q = measure(chains), chains.reshape(-1, posterior.dim)
        bias = np.abs(q.mean(axis=0) - mean) / sd, np.abs(q.std(axis=0) / sd - 1.0)
        worst = min(convergence.ess_bulk.min(), convergence.ess_tail.min())
        whose = ", ".join(posterior.names[error.argmax()] for error in bias)
        print(
            f"{tool:18}{seconds:12.1f}{posterior.evaluations:12,d}{worst:12.0f}"
            f"{convergence.worst_r_hat:12.3f}{bias[0].max():12.3f}{bias[1].max():12.1%}   {whose}",
            flush=True,
        )
        enough = worst >= limits[0] and convergence.worst_r_hat <= R_HAT
        if enough and not options.quick and (bias[0].max() > MEAN or bias[1].max() > SD):
            failed.append(f"{name}: {tool} draws from another posterior")
    print()
    return failed


def main():
    parser = common.parser_of(__doc__, data=True)
    parser.add_argument("--record", choices=RECORDS, action="append", help="only this one")
    options = common.begin(parser, "emcee", "jax", "numpyro")
    warnings.simplefilter("ignore")
    records, failed = options.record or list(RECORDS), []
    for name in records[:1] if options.quick else records:
        record = read_record(options.data / "brfd" / RECORDS[name])
        trace = record.trace(QUICK_RATE if options.quick else RATE)
        failed += race(name, Counted(trace, "brfd"), options)
    common.finish(failed)


if __name__ == "__main__":
    main()
