"""Is the exact sampler exact? Its posterior of a small campaign beside that of NumPyro's NUTS.

    pip install -e '.[bench]'
    python -m benchmarks.population.nuts > benchmarks/population/nuts.txt
    python -m benchmarks.population.nuts --tests 10 >> benchmarks/population/nuts.txt

takes two minutes of a core, and five with ten tests (--quick: few draws). NUTS samples the joint
density of population and tests, written here in JAX (section 6 of model.md). Of the package only
numbers are used: those of the prior, which quantities are common to the tests, and what the joint
fit fixes in each test's likelihood (discrepancy, shape of the noise, share of independent samples);
draws of the discrepancy, which levels follow, are left out on both sides.
A test's coordinates are sampled in units of the Gaussian that its likelihood and the population
would make of them if both were Gaussian: this is a change of variables, with its Jacobian. Every
level, scatter, deviation, shape and quantity of a test must have a mean within MEAN sds of NUTS and
an sd within SD. The control is our own posterior under a prior of the scatter four times as wide.
Exit status 1: the likelihoods differ, a mean or an sd is off, or the control passes.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy and JAX)

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular
from numpyro.infer import MCMC, NUTS

from benchmarks.forward.peers import Motion
from benchmarks.population import study
from benchmarks.population.study import FOLLOWERS
from benchmarks.race.density import _force, _value
from mfd_bayes.calibration.diagnostics import intervals_of, measure
from mfd_bayes.calibration.effort import EFFORTS
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.population import inference
from mfd_bayes.population.design import WIDER
from mfd_bayes.population.exact_sampler import ExactSampler
from mfd_bayes.population.joint_fit import fit_jointly

MEAN, SD = 0.1, 0.1
CLOSE = 1e-8  # largest deviation of JAX's log likelihoods, over their size where that exceeds 1
NOISE_TIME = 0.2  # s
BLOCK = 100  # draws
LEVELS = {4: study.LEVELS, 10: (0.5, 0.6, 0.7, 0.8, 1.0, 1.0, 1.2, 1.4, 1.6, 1.6)}


class Recorded(ExactSampler):
    """The sampler, which tells what it samples."""

    def __init__(self, fit, *arguments, **options):
        super().__init__(fit, *arguments, **options)
        Recorded.fit, Recorded.last = fit, self.mixed


def certain_discrepancy(*arguments):
    """The joint fit, with the discrepancy at its mean in all draws."""
    fit = fit_jointly(*arguments)
    return replace(fit, knot_root=0.0 * fit.knot_root)


def ours(campaign, seed, ess, wider=1.0):
    """The package's inference, what its joint fit fixes, and the design."""
    tests = {}
    for j, test in enumerate(campaign.tests):
        intervals = intervals_of(sample(test, study.SINGLE, (seed, 1, j)).values)
        tests[f"t{j}"] = TestResult(f"t{j}", test, Path(), intervals=intervals)
    scatter = {
        name: replace(prior, sd=wider * prior.sd) for name, prior in campaign.priors.scatter.items()
    }
    effort = replace(EFFORTS["thorough"], ess=ess, kept=32000)
    settings = inference.InferenceSettings(study.LAWS, "ksi", effort, (seed, 2))
    inference.ExactSampler, inference.fit_jointly = Recorded, certain_discrepancy
    priors = replace(campaign.priors, scatter=scatter)
    return inference.infer_population(tests, priors, settings), Recorded.fit, Recorded.last


class Joint:
    """The joint density of a population and its tests, in prior units."""

    def __init__(self, fit, mixed, levels):
        self.fit, self.design, self.levels = fit, mixed.design, np.array(levels)
        self.names = list(self.design.names)
        self.common = np.flatnonzero(self.design.common)
        self.free = np.flatnonzero(~self.design.common)
        self.differing = np.append(self.free, len(self.names))  # and the start in the gap
        self.root_weight = np.sqrt(mixed.weight)
        self.coordinates, self.posterior = fit.tests[0].coordinates, fit.tests[0].posterior
        self.motion = Motion(self.posterior.trace.path).on_device
        self.rows = jnp.asarray(self.posterior.trace.path.samples)
        columns = [(t.posterior.trace.force - t.discrepancy, t.shape) for t in fit.tests]
        self.measured = jnp.asarray(np.array([force for force, _ in columns]))
        shapes = [np.broadcast_to(shape, force.shape) for force, shape in columns]
        self.shapes = jnp.asarray(np.array(shapes))
        self.information = fit.tests[0].information

    def log_likelihood(self, x, measured, shape):
        """Of a test's coordinates, (d + 1,)."""
        known, fixed = self.coordinates, self.posterior.priors.items()
        q = dict(zip(known.names, known.centre + known.spread * x, strict=True))
        values = {"gamma1": 1.0} | {n: p.figures["value"] for n, p in fixed if p.fixed}
        values |= {name: _value(known.priors[name], q[name]) for name in q}
        force = _force(values, self.posterior.model.parameters, self.motion)[self.rows]
        standard = (measured - force - values["offset"]) / (shape * values["noise_sd"])
        scales = shape.size * jnp.log(values["noise_sd"])
        return -self.information * (0.5 * jnp.sum(standard**2) + scales)

    def population(self, u):
        """Means of the tests' shared coordinates, (J, d), and their scatter, (J, F)."""
        relative = self.levels / self.design.reference
        share = jax.nn.sigmoid(u["share"])
        columns = {
            "Fc_fwd": jnp.log(relative),
            "Fc_bwd": jnp.log(relative),
            "sigma0": jnp.log(share * relative + 1.0 - share),
            "noise_sd": u["exponent"] * jnp.log(relative),
        }
        levels, home = np.unique(self.levels, return_inverse=True)
        root = deviation_root(levels, self.levels)
        for i, (group, members) in enumerate(FOLLOWERS.items()):
            swing = jnp.exp(u["log_deviation"][i]) * u[f"deviation {group}"] @ root.T
            for row, name in zip(swing, members, strict=True):
                columns[name] = columns[name] + row[home]
        mean = jnp.tile(u["level"], (self.levels.size, 1))
        for name, column in columns.items():
            k = self.names.index(name)
            mean = mean.at[:, k].add(column / self.design.spread[k])
        scatter = jnp.exp(u["log_scatter"]) / self.design.spread[self.free]
        return mean, scatter / self.root_weight

    def tests(self, u, mean, scatter):
        """Coordinates of the tests, (J, d + 1), and the log of the change's Jacobian."""
        precision, differing = self.fit.precision, self.differing
        pulls = np.einsum("jab,jb->ja", precision, self.fit.mean)
        prior = jnp.pad(1.0 / scatter**2, ((0, 0), (0, 1)), constant_values=1.0)
        inner = precision[:, differing][:, :, differing]
        factor = jnp.linalg.cholesky(inner + prior[:, :, None] * np.eye(differing.size))
        pull = pulls[:, differing] + prior * jnp.pad(mean[:, self.free], ((0, 0), (0, 1)))
        across = precision[:, differing][:, :, self.common]
        pull -= jnp.einsum("jab,jb->ja", across, mean[:, self.common])
        centre = jax.vmap(lambda f, b: cho_solve((f, True), b))(factor, pull)
        solve = jax.vmap(partial(solve_triangular, trans=1, lower=True))
        values = centre + solve(factor, u["tests"])
        x = jnp.pad(mean, ((0, 0), (0, 1))).at[:, differing].set(values)
        return x, -jnp.sum(jnp.log(jnp.diagonal(factor, axis1=1, axis2=2)))

    def potential(self, u):
        """Minus the log of the joint density, of the variables by name."""
        design, free = self.design, self.free
        mean, scatter = self.population(u)
        x, total = self.tests(u, mean, scatter)
        total -= 0.5 * jnp.sum(u["level"] ** 2)
        size = jnp.exp(u["log_scatter"]) / design.scatter_sd[free]
        total += jnp.sum(u["log_scatter"] - 0.5 * size**2)
        members = [self.names.index(names[0]) for names in FOLLOWERS.values()]
        size = jnp.exp(u["log_deviation"]) / (WIDER * design.scatter_sd[members])
        total += jnp.sum(u["log_deviation"] - 0.5 * size**2)
        total -= sum(0.5 * jnp.sum(u[f"deviation {group}"] ** 2) for group in FOLLOWERS)
        total += jax.nn.log_sigmoid(u["share"]) + jax.nn.log_sigmoid(-u["share"])
        total -= 0.5 * ((u["exponent"] - 1.0) / 0.5) ** 2
        distance = (x[:, free] - mean[:, free]) / scatter
        total -= jnp.sum(0.5 * distance**2 + jnp.log(scatter))
        start = self.coordinates.centre[-1] + self.coordinates.spread[-1] * x[:, -1]
        total += jnp.sum(jax.nn.log_sigmoid(start) + jax.nn.log_sigmoid(-start))
        return -total - jnp.sum(jax.vmap(self.log_likelihood)(x, self.measured, self.shapes))

    def deviation(self, seed):
        """Largest deviation of JAX's log likelihoods from ours, near the tests' posteriors."""
        rng, largest = np.random.default_rng(seed), 0.0
        for j, test in enumerate(self.fit.tests):
            mean, precision = self.fit.mean[j], self.fit.precision[j]
            root = np.linalg.cholesky(precision + np.eye(mean.size))
            away = np.linalg.solve(root.T, rng.standard_normal((200, mean.size)).T).T
            x = np.linalg.solve(root @ root.T, precision @ mean) + away
            one = partial(self.log_likelihood, measured=self.measured[j], shape=self.shapes[j])
            expected, theirs = test.log_likelihood(x), np.asarray(jax.vmap(one)(jnp.asarray(x)))
            largest = max(largest, np.max(np.abs(theirs - expected) / (1.0 + np.abs(expected))))
        return float(largest)

    def start(self, rng, levels):
        """A point from which a chain begins."""
        count = np.unique(self.levels).size
        u = {
            "level": levels[rng.integers(len(levels))],
            "log_scatter": np.log(0.5 * self.design.scatter_sd[self.free]),
            "log_deviation": np.log(0.1) + 0.3 * rng.standard_normal(len(FOLLOWERS)),
            "share": 0.5 * rng.standard_normal(),
            "exponent": 1.0 + 0.3 * rng.standard_normal(),
            "tests": 0.3 * rng.standard_normal((self.levels.size, self.differing.size)),
        }
        swings = {g: 0.3 * rng.standard_normal((len(m), count)) for g, m in FOLLOWERS.items()}
        return u | {f"deviation {group}": values for group, values in swings.items()}

    def sample(self, levels, seed, warm_up, count):
        """Draws of NUTS by variable, (chain, draw, …), and the share that diverged."""
        rng = np.random.default_rng(seed)
        starts = [self.start(rng, levels) for _ in range(4)]
        begin = {name: jnp.stack([jnp.asarray(s[name]) for s in starts]) for name in starts[0]}
        kernel = NUTS(
            potential_fn=self.potential,
            target_accept_prob=0.95,
            max_tree_depth=(7, 9),
            dense_mass=[("level",)],
        )
        options = {"num_chains": 4, "chain_method": "sequential", "progress_bar": False}
        mcmc = MCMC(kernel, num_warmup=warm_up, num_samples=count, **options)
        mcmc.run(jax.random.PRNGKey(seed), init_params=begin, extra_fields=("diverging",))
        draws = {n: np.asarray(v) for n, v in mcmc.get_samples(group_by_chain=True).items()}
        return draws, float(np.mean(mcmc.get_extra_fields()["diverging"]))

    def values(self, level, scatters, deviations, share, exponent, x):
        """Draws by name, (chain, draw) each."""
        centre = self.coordinates.centre[: len(self.names)]
        values = {}
        for k, name in enumerate(self.names):
            spread = self.design.spread[k]
            values[f"level {name}"] = centre[k] + spread * level[..., k]
            for j in range(x.shape[2]):
                values[f"test {j + 1}: {name}"] = centre[k] + spread * x[:, :, j, k]
        for i, k in enumerate(self.free):
            values[f"scatter {self.names[k]}"] = scatters[..., i]
        values |= {f"deviation {g}": v for g, v in zip(FOLLOWERS, deviations, strict=True)}
        return values | {"share sigma0": share, "exponent noise_sd": exponent}

    def of_nuts(self, draws):
        """Values of NUTS."""
        unfold = jax.jit(jax.vmap(lambda u: self.tests(u, *self.population(u))[0]))
        scatters = np.exp(draws["log_scatter"])
        deviations = np.moveaxis(np.exp(draws["log_deviation"]), -1, 0)
        share = 1.0 / (1.0 + np.exp(-draws["share"]))
        # in blocks: XLA on one thread waits for ever on all of them at once
        blocks = [
            {name: values[chain, i : i + BLOCK] for name, values in draws.items()}
            for chain in range(share.shape[0])
            for i in range(0, share.shape[1], BLOCK)
        ]
        x = np.concatenate([np.asarray(unfold(block)) for block in blocks])
        x = x.reshape(*share.shape, *x.shape[1:])
        return self.values(draws["level"], scatters, deviations, share, draws["exponent"], x)

    def of_ours(self, result):
        """Values of the package."""
        population = result.population
        sds = [
            population.effect_sds[f"level_{self.design.groups[m[0]]}"] for m in FOLLOWERS.values()
        ]
        return self.values(
            population.draws.z[..., : len(self.names)],
            np.exp(population.draws.h[..., : self.free.size]),
            sds,
            population.shapes("sigma0")[0],
            population.shapes("noise_sd")[1],
            result.tests,
        )


def deviation_root(levels, tests):
    """Factor of the covariance of the deviations from a law at levels of actuation."""
    r = np.sqrt(3.0) * np.abs(np.log(levels[:, None] / levels)) / np.log(2.0)
    sizes = np.clip(np.exp(np.mean(np.log(tests))) / levels, 0.5, 2.0)
    covariance = sizes[:, None] * sizes * (1.0 + r) * np.exp(-r)
    return np.linalg.cholesky(covariance + 1e-9 * np.eye(levels.size))


def sizes(values, walkers):
    """Bulk effective sample sizes by name, and the largest R-hat."""
    stacked = np.stack(list(values.values()), axis=-1)
    chains = stacked.reshape(len(stacked), walkers, -1, stacked.shape[-1]).swapaxes(1, 2)
    convergence = measure(chains)
    return dict(zip(values, convergence.ess_bulk.tolist(), strict=True)), convergence.worst_r_hat


def compare(label, mine, my_sizes, theirs, their_sizes):
    """Print the largest deviations with their Monte Carlo errors; names of what is off."""
    rows = {}
    for name, other in theirs.items():
        errors = []
        for draws, size in ((mine[name], my_sizes[name]), (other, their_sizes[name])):
            squares = (draws - draws.mean()) ** 2
            errors.append(0.5 * squares.std() / squares.mean() / np.sqrt(size))
        mean = (mine[name].mean() - other.mean()) / other.std()
        error = np.sqrt(1.0 / my_sizes[name] + 1.0 / their_sizes[name])
        rows[name] = mean, error, mine[name].std() / other.std() - 1.0, float(np.hypot(*errors))
    table = np.array(list(rows.values()))
    ratios = [np.sqrt(np.mean((table[:, i] / table[:, i + 1]) ** 2)) for i in (0, 2)]
    print(f"\n{label}: {len(rows)} quantities; deviations in their errors, root mean square:")
    print(f"means {ratios[0]:.2f}, sds {ratios[1]:.2f}")
    for i, words in ((0, "mean, in sds"), (2, "sd, relative")):
        for name in sorted(rows, key=lambda name, i=i: -abs(rows[name][i]))[:4]:
            print(f"  {words}  {rows[name][i]:+.3f} ± {rows[name][i + 1]:.3f}  {name}")
    if "level k3" in rows:
        print("  level k3: mean {:+.3f} ± {:.3f}, sd {:+.3f} ± {:.3f}".format(*rows["level k3"]))
    return [n for n, (mean, _, sd, _) in rows.items() if abs(mean) > MEAN or abs(sd) > SD]


def main():
    parser = common.parser_of(__doc__)
    parser.add_argument("--tests", type=int, choices=tuple(LEVELS), default=4)
    options = common.begin(parser)
    ess, warm_up, count = (400, 200, 100) if options.quick else (4000, 800, 2000)
    study.LEVELS = LEVELS[options.tests]
    campaign = study.synthesize(options.seed, 0, NOISE_TIME)
    began = time.perf_counter()
    result, fit, mixed = ours(campaign, options.seed, ess)
    seconds = time.perf_counter() - began
    joint = Joint(fit, mixed, study.LEVELS)
    failed = [] if joint.deviation(options.seed) <= CLOSE else ["the log likelihoods differ"]
    mine, walkers = joint.of_ours(result), result.population.walkers
    my_sizes, r_hat = sizes(mine, walkers)
    print(f"{options.tests} tests of {fit.tests[0].posterior.trace.samples} samples")
    told = f"{result.sweeps} sweeps, R-hat {r_hat:.3f}, bulk ESS {min(my_sizes.values()):.0f}"
    print(f"ours: {seconds:.0f} s, {told}")
    began = time.perf_counter()
    levels = result.population.draws.z.reshape(-1, result.population.draws.z.shape[-1])
    levels = levels[:, : len(joint.names)]
    draws, diverged = joint.sample(levels, options.seed, warm_up, count)
    theirs = joint.of_nuts(draws)
    their_sizes, r_hat = sizes(theirs, 1)
    told = f"R-hat {r_hat:.3f}, bulk ESS {min(their_sizes.values()):.0f}"
    spent = time.perf_counter() - began
    print(f"NUTS: {spent:.0f} s, 4 chains of {count}, {diverged:.1%} diverged, {told}")
    failed += compare("ours beside NUTS", mine, my_sizes, theirs, their_sizes)
    control, *_ = ours(campaign, options.seed, 400, wider=4.0)
    wide = joint.of_ours(control)
    words = "control, a prior of the scatter four times as wide"
    if not compare(words, wide, sizes(wide, control.population.walkers)[0], theirs, their_sizes):
        failed.append("the control agrees too")
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
