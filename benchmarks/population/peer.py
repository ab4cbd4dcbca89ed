"""The joint density of a population and all its tests in JAX, and NumPyro's NUTS on it.

Of `mfd_bayes/population` only numbers are used: those of the prior, which quantities are common to
the tests, and what the first fit fixes in each test's likelihood (discrepancy, shape of the noise,
share of independent samples). Levels, laws, deviations, tests and likelihood are written here
again. The force is that of `benchmarks.sampling.peers`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from mfd_bayes.population.sharing import draw_common
from mfd_bayes.population.test_likelihood import TestLikelihood
from numpyro.infer import MCMC, NUTS

from benchmarks.forward import peers as forward_peers
from benchmarks.population.study import FOLLOWERS, LEVELS, deviation_root
from benchmarks.sampling import peers
from mfd_bayes.population.design import WIDER
from mfd_bayes.population.design import WIDER as FAR
from mfd_bayes.population.design import Layout as OurLayout


@dataclass(frozen=True, eq=False)
class Layout:
    """The joint density's variables, in prior units.

    A test's coordinates are not sampled themselves, for funnels would hold up NUTS, but in units
    of the Gaussian that its likelihood and the population would make of them were both Gaussian.
    This is a change of variables, with its Jacobian, and the joint density stays what it is.

    Attributes
    ----------
    ours : Layout
        With what the tests leave common.
    likelihoods : tuple of TestLikelihood
        After the first fit: d shared coordinates, then that of the place in the gap at the start.
    """

    ours: OurLayout
    likelihoods: tuple[TestLikelihood, ...]

    @property
    def names(self):
        """The shared quantities."""
        return self.ours.names

    @property
    def common(self):
        """Shared quantities that are the same in all tests."""
        return np.flatnonzero(self.ours.common)

    @property
    def free(self):
        """Shared quantities that differ between tests."""
        return np.flatnonzero(~np.array(self.ours.common))

    @property
    def differ(self):
        """Coordinates that differ between tests: `free`, then the start."""
        return np.append(self.free, len(self.names))

    def begin(self, rng):
        """A start: tests at the middle of their likelihoods, the rest about them."""
        means = np.array([test.mean for test in self.likelihoods])
        level = means.mean(axis=0)[: len(self.names)]
        level[self.common] = draw_common(self.ours, self.likelihoods, rng, 1)[0]
        followers = {f"deviation {g}": (len(m), 3) for g, m in FOLLOWERS.items()}
        scatter_sd = self.ours.scatter_sd[self.free]
        u = {
            "level": level,
            "log_scatter": np.log(0.5 * scatter_sd) + 0.3 * rng.standard_normal(self.free.size),
            "log_deviation": np.log(0.1) + 0.3 * rng.standard_normal(len(FOLLOWERS)),
            "share": 0.5 * rng.standard_normal(),
            "exponent": 1.0 + 0.3 * rng.standard_normal(),
            **{name: 0.3 * rng.standard_normal(shape) for name, shape in followers.items()},
        }
        return u | {"tests": 0.3 * rng.standard_normal((len(means), self.differ.size))}

    def population(self, u):
        """Means of the tests' shared coordinates (J, d), and the scatter of `free`, (f,)."""
        ours = self.ours
        relative = np.array(LEVELS) / ours.reference
        share = jax.nn.sigmoid(u["share"])
        columns = {
            "Fc_fwd": jnp.log(relative),
            "Fc_bwd": jnp.log(relative),
            "sigma0": jnp.log(share * relative + 1.0 - share),
            "noise_sd": u["exponent"] * jnp.log(relative),
        }
        at, home = np.unique(LEVELS, return_inverse=True)
        root = deviation_root(at)
        for i, (group, members) in enumerate(FOLLOWERS.items()):
            swing = jnp.exp(u["log_deviation"][i]) * u[f"deviation {group}"] @ root.T
            for row, name in zip(swing, members, strict=True):
                columns[name] = columns[name] + row[home]
        mean = jnp.tile(u["level"], (len(LEVELS), 1))
        for name, column in columns.items():
            k = self.names.index(name)
            mean = mean.at[:, k].add(column / ours.spread[k])
        return mean, jnp.exp(u["log_scatter"]) / ours.spread[self.free]

    def conditional(self, mean, scatter):
        """Cholesky factors of precisions, and means, of Gaussians near what differs in the tests.

        They are near the tests' likelihoods, given what is common, times the population.
        """
        precisions = np.array([test.precision for test in self.likelihoods])
        pulls = np.array([test.precision @ test.mean for test in self.likelihoods])
        those, common = self.differ, self.common
        kept = jnp.append(1.0 / scatter**2, 1.0)
        factor = jnp.linalg.cholesky(precisions[:, those][:, :, those] + jnp.diag(kept))
        pull = pulls[:, those] + kept * jnp.pad(mean[:, self.free], ((0, 0), (0, 1)))
        pull -= jnp.einsum("jab,jb->ja", precisions[:, those][:, :, common], mean[:, common])
        solve = jax.vmap(lambda f, b: jax.scipy.linalg.cho_solve((f, True), b))
        return factor, solve(factor, pull)

    def tests(self, u, mean, scatter):
        """Coordinates of the tests (J, d + 1), and the log of the change's Jacobian."""
        factor, centre = self.conditional(mean, scatter)
        solve = partial(jax.scipy.linalg.solve_triangular, trans=1, lower=True)
        found = centre + jax.vmap(solve)(factor, u["tests"])
        x = jnp.pad(mean, ((0, 0), (0, 1))).at[:, self.differ].set(found)
        return x, -jnp.sum(jnp.log(jnp.diagonal(factor, axis1=1, axis2=2)))

    def potential(self):
        """Minus the log of the joint density, of the variables by name."""
        ours, free = self.ours, self.free
        density = jax.vmap(likelihood(self.likelihoods[0].log_likelihood))  # all have one motion
        data = [jnp.asarray(column) for column in zip(*map(data_of, self.likelihoods), strict=True)]
        middle, scale = start_units(self.likelihoods[0])
        scatter_sds = [ours.scatter_sd[self.names.index(m[0])] for m in FOLLOWERS.values()]
        sds = WIDER * np.array(scatter_sds)
        exponential = np.array(ours.sparse)[free]

        def potential(u):
            mean, scatter = self.population(u)
            x, total = self.tests(u, mean, scatter)
            total -= 0.5 * jnp.sum(u["level"] ** 2)
            size = jnp.exp(u["log_scatter"]) / ours.scatter_sd[free]
            total += jnp.sum(u["log_scatter"] - jnp.where(exponential, size, 0.5 * size**2))
            deviation = jnp.exp(u["log_deviation"])
            total += jnp.sum(u["log_deviation"] - 0.5 * (deviation / sds) ** 2)
            total -= sum(0.5 * jnp.sum(u[f"deviation {g}"] ** 2) for g in FOLLOWERS)
            total += jax.nn.log_sigmoid(u["share"]) + jax.nn.log_sigmoid(-u["share"])
            total -= 0.5 * ((u["exponent"] - 1.0) / 0.5) ** 2
            away = (x[:, free] - mean[:, free]) / scatter
            near = np.log1p(-ours.odd) - 0.5 * away**2
            far = np.log(ours.odd / FAR) - 0.5 * (away / FAR) ** 2
            total += jnp.sum(jnp.logaddexp(near, far)) - len(x) * jnp.sum(jnp.log(scatter))
            start = middle + scale * x[:, -1]
            total += jnp.sum(jax.nn.log_sigmoid(start) + jax.nn.log_sigmoid(-start))
            return -total - jnp.sum(density(x, *data))

        return potential


def start_units(test):
    """Origin and length of the prior units of the logit of the place in the gap at the start."""
    working = test.log_likelihood
    if working.own != ("start",):
        raise ValueError(f"own quantities of a test are {working.own}, not the start alone")
    return float(working.middle[-1]), float(working.scale[-1])


def data_of(test):
    """Force without discrepancy (T,), shape of the noise (T,), share of independent samples."""
    working = test.log_likelihood
    return working.posterior.trace.force - working.discrepancy, working.shape, working.information


def likelihood(working):
    """Log likelihood under a test's motion, of coordinates (d + 1,) and `data_of`."""
    posterior, ours = working.posterior, working.layout
    motion = forward_peers.Motion.of(posterior.trace.path).on_device
    rows = jnp.asarray(posterior.trace.path.samples)

    def values_of(x):
        """Quantities of one test at its coordinates, model.md section 6."""
        q = working.middle + working.scale * x
        known = dict(zip(ours.names, q[:-1], strict=True))
        gap, share = jnp.exp(known.pop("d2")), jax.nn.sigmoid(known.pop("d3"))  # d3/d2, log scale
        values = {n: peers._value(ours.coordinates.priors[n], known[n]) for n in known}
        values |= {"start": jax.nn.sigmoid(q[-1]), "d2": gap * (1.0 - share), "d3": gap * share}
        stribeck = jnp.exp(-((ours.coordinates.speed / values["v_s"]) ** 2))
        for side in ("fwd", "bwd"):
            values[f"Fc_{side}"] /= 1.0 + values[f"static_excess_{side}"] * stribeck
        return values

    def log_likelihood(x, measured, shape, information):
        values = values_of(x)
        force = peers._force({"gamma1": 1.0} | values, posterior.model.parameters, motion)[rows]
        standard = (measured - force - values["offset"]) / (shape * values["noise_sd"])
        scales = jnp.sum(jnp.log(shape)) + shape.size * jnp.log(values["noise_sd"])
        scales += 0.5 * peers.LOG_2PI * shape.size
        return -information * (0.5 * jnp.sum(standard**2) + scales)

    return log_likelihood


def deviation(test, rng):
    """Largest deviation of JAX's log likelihood, over its size where that exceeds 1.

    It is asked at points of the Gaussian near the test's posterior; ours must be finite there.
    """
    root = np.linalg.cholesky(test.precision + np.eye(test.mean.size))
    away = rng.standard_normal((200, test.mean.size))
    x = np.linalg.solve(root @ root.T, test.precision @ test.mean)
    x = x + np.linalg.solve(root.T, away.T).T
    expected = test.log_likelihood(x)
    one = likelihood(test.log_likelihood)
    found = jax.jit(jax.vmap(lambda row: one(row, *data_of(test))))(jnp.asarray(x))
    return float(np.max(np.abs(np.asarray(found) - expected) / np.maximum(1.0, np.abs(expected))))


def nuts(layout, *, chains, warm_up, kept, seed):
    """Draws of NUTS by variable, (chain, draw, …), and the share of them that diverged."""
    rng = np.random.default_rng(seed)
    starts = [layout.begin(rng) for _ in range(chains)]
    begin = {name: jnp.stack([jnp.asarray(s[name]) for s in starts]) for name in starts[0]}
    kernel = NUTS(
        potential_fn=layout.potential(),
        target_accept_prob=0.95,
        max_tree_depth=(7, 9),
        dense_mass=[("level",)],  # what is common is known best, and trades off
    )
    mcmc = MCMC(
        kernel,
        num_warmup=warm_up,
        num_samples=kept,
        num_chains=chains,
        chain_method="sequential",
        progress_bar=False,
    )
    mcmc.run(jax.random.PRNGKey(seed), init_params=begin, extra_fields=("diverging", "num_steps"))
    found = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    extra = mcmc.get_extra_fields()
    return found, float(np.mean(extra["diverging"]))


def drawn_values(layout, found):
    """Draws by the names of the true values of `study`, and the tests' quantities."""
    ours, names = layout.ours, layout.names
    level = ours.centre + ours.spread * found["level"]
    values = {f"level {name}": level[..., k] for k, name in enumerate(names)}
    scatter = np.exp(found["log_scatter"])
    scatters = {names[k]: scatter[..., i] for i, k in enumerate(layout.free) if not ours.sparse[k]}
    values |= {f"scatter {name}": column for name, column in scatters.items()}
    deviation = np.exp(found["log_deviation"])
    values |= {f"deviation {group}": deviation[..., i] for i, group in enumerate(FOLLOWERS)}
    values["share sigma0"] = 1.0 / (1.0 + np.exp(-found["share"]))
    values["exponent noise_sd"] = found["exponent"]
    unfold = jax.jit(jax.vmap(jax.vmap(lambda u: layout.tests(u, *layout.population(u))[0])))
    x = np.asarray(unfold(found))[..., :-1]  # (chain, draw, J, d)
    q = ours.centre + ours.spread * x
    for j in range(q.shape[2]):
        values |= {f"test {j + 1}: {name}": q[:, :, j, k] for k, name in enumerate(names)}
    return values
