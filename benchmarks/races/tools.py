"""Samplers of the field, each as its own manual recommends, tuned to win.

A tool is a function of a `Problem` and a seed that gives an `Outcome`. Tools that take the density
of many points at once are given it so. Those that step are measured every few hundred steps, which
costs them nothing, and stop as soon as every coordinate has what a person waits for. Ensembles and
single chains are measured as two, their halves in time, which is kind to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.races.problem import ESS
from benchmarks.sampling.draws import Counted, by_step, halves


@dataclass(frozen=True)
class Outcome:
    """What a tool gave.

    Attributes
    ----------
    chains : (ensemble, step, walker, dim)
        What is kept; of nested samplers (1, draws, 1, dim), resampled to equal weights.
    warm_up : float
        Processor time that gave nothing that is kept, s; compiling is in it.
    reached : bool
        Whether every coordinate had what a person waits for.
    ess : float or None
        Effective draws of weighted ones, by Kish's formula; else measured from the chains.
    """

    chains: np.ndarray
    warm_up: float
    reached: bool
    ess: float | None = None


def stepped(problem, advance, arrange, discard, warm=0.0):
    """Outcome of a tool that goes on until every coordinate has what a person waits for.

    Parameters
    ----------
    advance : callable
        Goes on, and gives all steps so far, (step, walker, dim).
    arrange : callable
        Puts what is kept of these into chains, (ensemble, step, walker, dim).
    discard : float
        Share of the steps that is warm-up.
    warm : float
        Processor time before the first step, s.
    """
    while True:
        steps = advance()
        first = int(discard * len(steps))
        kept = arrange(steps[first:])
        reached = problem.enough(kept)
        if reached or problem.late:
            spent = warm + (problem.spent - warm) * first / len(steps)
            return Outcome(kept, spent, reached)


def each_a_chain(steps):
    """Independent chains (step, chain, dim), each an ensemble of one walker."""
    return steps.swapaxes(0, 1)[:, :, None]


def weighted(draws, weights):
    """Outcome of weighted draws (n, dim) of a tool that has ended."""
    weights = weights / np.sum(weights)
    size = float(1.0 / np.sum(weights**2))
    pick = np.random.default_rng(0).choice(len(draws), size=max(int(size), 10), p=weights)
    return Outcome(draws[pick][None, :, None], 0.0, size >= ESS, size)


def ours(problem, seed):
    """`sample` at effort standard, with its search for modes."""
    from mfd_bayes.calibration.sampling import sample

    counted = Counted(problem.posterior)
    marks = []  # processor time and steps, each time that convergence was measured
    draws = sample(
        counted.counting,
        "standard",
        seed,
        report=lambda found: marks.append((problem.spent, found.steps)),
    )
    chains = draws.chains
    (began, first), (ended, last) = marks[0], marks[-1]
    pace = (ended - began) / (last - first) if last > first else ended / last  # s a step, once warm
    warm_up = problem.spent - pace * (chains.steps - chains.discarded)
    problem.evaluations = counted.count
    kept = by_step(chains)
    return Outcome(kept, warm_up, problem.enough(kept))


def emcee_stretch(problem, seed, moves=None):
    """The stretch move of emcee, its default, with 64 walkers."""
    import emcee

    sampler = emcee.EnsembleSampler(64, problem.dim, problem.log_prob, moves=moves, vectorize=True)
    state = problem.around_mode(64, seed)

    def advance():
        nonlocal state
        state = sampler.run_mcmc(state, 500)
        return sampler.get_chain()

    return stepped(problem, advance, halves, 0.3)


def emcee_de(problem, seed):
    """Differential evolution by emcee, a tenth of it full jumps; its snooker move is wrong."""
    import emcee

    moves = [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    return emcee_stretch(problem, seed, moves)


def zeus(problem, seed):
    """Ensemble slice sampling with its default move."""
    import zeus as tool

    sampler = tool.EnsembleSampler(64, problem.dim, problem.log_prob, vectorize=True, verbose=False)
    state = problem.around_mode(64, seed)

    def advance():
        nonlocal state
        sampler.run_mcmc(state, 100, progress=False)
        state = sampler.get_last_sample()
        return sampler.get_chain()

    return stepped(problem, advance, halves, 0.3)


def pints_haario(problem, seed):
    """PINTS: Haario-Bardenet adaptive covariance, four chains stepped together."""
    import pints

    begin = problem.around_mode(4, seed)
    spread = np.diag(np.var(problem.around_mode(200, seed), axis=0))
    chains = [pints.HaarioBardenetACMC(x, spread) for x in begin]
    kept, iterations, initial = [], 0, 2000

    def advance():
        nonlocal iterations
        for _ in range(2000):
            asked = np.array([chain.ask() for chain in chains])
            heights = problem.log_prob(asked)
            pairs = zip(chains, heights, strict=True)
            told = [chain.tell(float(height)) for chain, height in pairs]
            kept.append([point for point, *_ in told])
            iterations += 1
            if iterations == initial:
                for chain in chains:
                    chain.set_initial_phase(False)
        return np.array(kept)

    return stepped(problem, advance, each_a_chain, 0.5)


def pints_dream(problem, seed):
    """PINTS: DREAM, with as many chains as it has by default for this size."""
    import pints

    tool = pints.DreamMCMC(8, problem.around_mode(8, seed))
    kept, iterations = [], 0

    def advance():
        nonlocal iterations
        for _ in range(2000):
            told = tool.tell(problem.log_prob(np.asarray(tool.ask())))
            if told is not None:
                kept.append(np.array(told[0]))
            iterations += 1
            if iterations == 2000:
                tool.set_initial_phase(False)
        return np.array(kept)

    return stepped(problem, advance, each_a_chain, 0.5)


def numpyro_nuts(problem, seed):
    """NumPyro's NUTS, four chains at once, dense mass matrix, 1000 draws of warm-up."""
    import jax
    from numpyro.infer import MCMC, NUTS

    from benchmarks.sampling.peers import jax_density

    density = jax_density(problem.posterior)
    kernel = NUTS(potential_fn=lambda q: -density(q), dense_mass=True)
    tool = MCMC(
        kernel,
        num_warmup=1000,
        num_samples=250,
        num_chains=4,
        chain_method="vectorized",
        progress_bar=False,
    )
    begin = problem.around_mode(4, seed)
    tool.warmup(jax.random.PRNGKey(seed), init_params=begin)

    def one(state, _):
        state = kernel.sample(state, (), {})
        return state, state.z

    # its own `run` compiles again in every call
    run = jax.jit(lambda state: jax.lax.scan(one, state, None, 250))
    state, _ = run(tool.post_warmup_state)
    jax.block_until_ready(state)
    warm, kept = problem.spent, []

    def advance():
        nonlocal state
        state, drawn = run(state)
        kept.append(np.asarray(drawn))
        return np.concatenate(kept)

    return stepped(problem, advance, each_a_chain, 0.0, warm)


def blackjax_nuts(problem, seed):
    """NUTS of blackjax: window adaptation of a dense mass matrix, then four chains at once."""
    import blackjax
    import jax

    from benchmarks.sampling.peers import jax_density

    density = jax_density(problem.posterior)
    begin, key = problem.around_mode(4, seed), jax.random.PRNGKey(seed)
    adapt = blackjax.window_adaptation(blackjax.nuts, density, is_mass_matrix_diagonal=False)
    (state, parameters), _ = adapt.run(key, jax.numpy.asarray(begin[0]), num_steps=1000)
    kernel = blackjax.nuts(density, **parameters)

    def one(state, key):
        state, _ = kernel.step(key, state)
        return state, state.position

    def block(states, key):
        keys = jax.random.split(key, (250, 4))
        return jax.lax.scan(lambda s, k: jax.vmap(one)(s, k), states, keys)

    run = jax.jit(block)
    states = jax.vmap(lambda q: kernel.init(q))(jax.numpy.stack([state.position] * 4))
    states, _ = run(states, jax.random.PRNGKey(seed + 1))
    jax.block_until_ready(states)
    warm, kept = problem.spent, []

    def advance():
        nonlocal states
        states, drawn = run(states, jax.random.PRNGKey(seed + 2 + len(kept)))
        kept.append(np.asarray(drawn))
        return np.concatenate(kept)

    return stepped(problem, advance, each_a_chain, 0.0, warm)


def flowmc(problem, seed):
    """flowMC: MALA of 32 chains and proposals of a spline flow, in coordinates scaled by the mode.

    The training loops are warm-up. It draws until the time is up, or as many loops as its buffers
    hold, which are made before.
    """
    import jax
    from flowMC.resource_strategy_bundle.RQSpline_MALA import RQSpline_MALA_Bundle

    from benchmarks.sampling.peers import jax_density

    chains, local, overall, production = 32, 10, 20, 400
    density, begin = jax_density(problem.posterior), problem.around_mode(1000, seed)
    middle, scale = begin.mean(axis=0), np.linalg.cholesky(np.cov(begin, rowvar=False))
    x = jax.numpy.asarray(np.linalg.solve(scale, (begin[:chains] - middle).T).T)
    bundle = RQSpline_MALA_Bundle(
        jax.random.PRNGKey(seed),
        chains,
        problem.dim,
        lambda x, data: density(middle + scale @ x),
        n_local_steps=local,
        n_global_steps=overall,
        n_training_loops=4,
        n_production_loops=production,
        n_epochs=10,
        mala_step_size=0.3,
    )
    split = bundle.strategy_order.index("reset_steppers")
    key, resources = jax.random.PRNGKey(seed + 1), bundle.resources

    def go(names):
        nonlocal key, resources, x
        for name in names:
            key, resources, x = bundle.strategies[name](key, resources, x, {})
        jax.block_until_ready(x)

    go(bundle.strategy_order[:split])
    warm = problem.spent
    rest = bundle.strategy_order[split:]
    each = max(1, len(rest) // production)
    block, done = 5 * each, 0

    def advance():
        nonlocal done
        if done >= len(rest):
            raise TimeoutError("its buffers are full")
        go(rest[done : done + block])
        done += block
        drawn = np.asarray(resources["positions_production"].data)
        filled = np.isfinite(drawn[0, :, 0])
        return (middle + drawn[:, filled] @ scale.T).swapaxes(0, 1)

    return stepped(problem, advance, each_a_chain, 0.0, warm)


def nutpie(problem, seed):
    """NUTS of nutpie with its defaults, four chains on one core, density and gradient by JAX."""
    import jax
    import nutpie as tool
    from nutpie.compiled_pyfunc import from_pyfunc

    from benchmarks.sampling.peers import jax_density

    both = jax.jit(jax.value_and_grad(jax_density(problem.posterior)))

    def make_density():
        def density(q):
            value, slope = both(q)
            return float(value), np.asarray(slope, dtype=np.float64)

        return density

    def make_expand(*_):
        return lambda q: {"q": np.asarray(q, dtype=np.float64)}

    dim, starts = problem.dim, iter(problem.around_mode(100, seed))
    model = from_pyfunc(
        dim,
        make_density,
        make_expand,
        [np.dtype("float64")],
        [(dim,)],
        ["q"],
        make_initial_point_fn=lambda _: next(starts),
    )
    draws = 500
    while True:
        trace = tool.sample(
            model, draws=draws, tune=400, chains=4, cores=1, seed=seed, progress_bar=False
        )
        kept = np.asarray(trace.posterior["q"])[:, :, None]
        warm = problem.spent * 400 / (400 + draws)
        reached = problem.enough(kept)
        if reached or problem.late:
            return Outcome(kept, warm, reached)
        draws *= 2  # a person would run it again, longer


def dynesty(problem, seed):
    """Dynamic nested sampling of dynesty with its defaults."""
    import dynesty as tool

    sampler = tool.DynamicNestedSampler(
        lambda q: float(problem.log_likelihood(q[None])[0]),
        lambda u: problem.transform(u[None])[0],
        problem.dim,
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False)
    found = sampler.results
    return weighted(found.samples, found.importance_weights())


def ultranest(problem, seed):
    """Reactive nested sampling of UltraNest, with a population of slice samplers."""
    import ultranest as tool
    import ultranest.popstepsampler as steps

    names = [f"q{i}" for i in range(problem.dim)]
    sampler = tool.ReactiveNestedSampler(
        names, problem.log_likelihood, problem.transform, vectorized=True
    )
    sampler.stepsampler = steps.PopulationSliceSampler(
        popsize=64,
        nsteps=2 * problem.dim,
        generate_direction=steps.generate_mixture_random_direction,
    )
    found = sampler.run(show_status=False, viz_callback=False, min_num_live_points=400)
    drawn = found["weighted_samples"]
    return weighted(np.asarray(drawn["points"]), np.asarray(drawn["weights"]))


def nautilus(problem, seed):
    """Importance nested sampling of nautilus with its defaults, and neural networks."""
    from nautilus import Sampler

    given = {"n_dim": problem.dim, "vectorized": True, "pass_dict": False, "seed": seed}
    sampler = Sampler(problem.transform, problem.log_likelihood, **given)
    sampler.run(n_eff=1000, verbose=False)
    draws, log_weights, _ = sampler.posterior()
    return weighted(draws, np.exp(log_weights - log_weights.max()))


def pocomc(problem, seed):
    """Preconditioned Monte Carlo of pocoMC with its defaults and a normalising flow."""
    import pocomc as tool
    from scipy import stats

    prior = tool.Prior([stats.norm(0.0, 1.0)] * problem.dim)

    def likelihood(z):
        return problem.log_likelihood(problem.transform(stats.norm.cdf(z)))

    sampler = tool.Sampler(prior, likelihood, vectorize=True, random_state=seed)
    sampler.run(progress=False)
    draws, weights, *_ = sampler.posterior()
    return weighted(problem.transform(stats.norm.cdf(draws)), weights)


TOOLS = {
    "ours": ours,
    "emcee, stretch": emcee_stretch,
    "emcee, DE": emcee_de,
    "zeus": zeus,
    "PINTS, Haario-Bardenet": pints_haario,
    "PINTS, DREAM": pints_dream,
    "NumPyro, NUTS": numpyro_nuts,
    "blackjax, NUTS": blackjax_nuts,
    "flowMC": flowmc,
    "nutpie": nutpie,
    "dynesty": dynesty,
    "UltraNest": ultranest,
    "nautilus": nautilus,
    "pocoMC": pocomc,
}
