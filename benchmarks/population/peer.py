"""The joint density of a population and all its tests in JAX, and NumPyro's NUTS on it.

Of `mfd_bayes/population` only the numbers of the prior are used: levels, laws, deviations and tests
are written again here. Force and likelihood are those of `benchmarks.sampling.peers`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import MCMC, NUTS

from benchmarks.forward import peers as forward_peers
from benchmarks.population.study import FOLLOWERS, LEVELS, Campaign, deviation_root
from benchmarks.sampling import peers
from mfd_bayes.population.effects import WIDER

LOGISTIC = float(np.pi / np.sqrt(3.0))
"""Sd of a uniform number's logit."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The joint density's variables.

    A test's coordinates are not sampled themselves, for funnels would hold up NUTS, but in units
    of the Gaussian that its likelihood and the population would make of them were both Gaussian.
    This is a change of variables, with its Jacobian, and the joint density stays what it is.

    Attributes
    ----------
    campaign : Campaign
    means : (J, d + 1)
    precisions : (J, d + 1, d + 1)
        Of Gaussians near the tests' likelihoods, in shared coordinates and the logit of the
        place in the gap at the start, which is not shared.
    """

    campaign: Campaign
    means: np.ndarray
    precisions: np.ndarray

    @classmethod
    def of(cls, campaign, draws):
        """Layout near the draws of the tests by themselves."""
        ours = campaign.layout
        centre, spread = np.append(ours.centre, 0.0), np.append(ours.spread, LOGISTIC)
        means, precisions = [], []
        for drawn in draws:
            q = (_coordinates(ours, drawn) - centre) / spread
            covariance = np.cov(q, rowvar=False)
            variance, axes = np.linalg.eigh(covariance)
            precision = (axes * np.maximum(1.0 / variance - 1.0, 1e-2)) @ axes.T
            mean = np.linalg.solve(precision, np.linalg.solve(covariance, q.mean(axis=0)))
            means.append(centre + spread * mean)
            precisions.append(precision / np.outer(spread, spread))
        return cls(campaign, np.array(means), np.array(precisions))

    @property
    def names(self):
        """The shared quantities."""
        return self.campaign.layout.names

    def begin(self, draws, rng):
        """A start: tests at draws of themselves alone, the rest about them or from the prior."""
        ours, d = self.campaign.layout, len(self.names)
        q = np.array([rng.choice(_coordinates(ours, drawn)) for drawn in draws])
        followers = {f"deviation {g}": (len(m), 3) for g, m in FOLLOWERS.items()}
        u = {
            "level": (q.mean(axis=0)[:d] - ours.centre) / ours.spread,
            "log_scatter": np.log(0.5 * ours.scatter_sd) + 0.3 * rng.standard_normal(d),
            "log_deviation": np.log(0.1) + 0.3 * rng.standard_normal(len(FOLLOWERS)),
            "share": 0.5 * rng.standard_normal(),
            "exponent": 1.0 + 0.3 * rng.standard_normal(),
            **{name: 0.3 * rng.standard_normal(shape) for name, shape in followers.items()},
        }
        factor, centre = self.conditional(*self.population(u))
        return u | {"tests": np.einsum("jab,ja->jb", factor, q - centre)}

    def population(self, u):
        """Means of the tests' shared coordinates (J, d), and their scatter (d,)."""
        ours = self.campaign.layout
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
        level = ours.centre + ours.spread * u["level"]
        mean = jnp.tile(level, (len(LEVELS), 1))
        for name, column in columns.items():
            mean = mean.at[:, self.names.index(name)].add(column)
        return mean, jnp.exp(u["log_scatter"])

    def conditional(self, mean, scatter):
        """Cholesky factors of precisions, and means, of the tests' Gaussians, as `means`."""
        kept = jnp.append(1.0 / scatter**2, 1.0 / LOGISTIC**2)
        factor = jnp.linalg.cholesky(self.precisions + jnp.diag(kept))
        pull = jnp.einsum("jab,jb->ja", self.precisions, self.means)
        pull += kept * jnp.pad(mean, ((0, 0), (0, 1)))
        solve = jax.vmap(lambda f, b: jax.scipy.linalg.cho_solve((f, True), b))
        return factor, solve(factor, pull)

    def tests(self, u, mean, scatter):
        """Coordinates of the tests (J, d + 1), and the log of the change's Jacobian."""
        factor, centre = self.conditional(mean, scatter)
        solve = partial(jax.scipy.linalg.solve_triangular, trans=1, lower=True)
        q = centre + jax.vmap(solve)(factor, u["tests"])
        return q, -jnp.sum(jnp.log(jnp.diagonal(factor, axis1=1, axis2=2)))

    def values(self, row):
        """Quantities of one test at its coordinates (d + 1,), model.md section 6."""
        ours = self.campaign.layout
        q = dict(zip(self.names, row[:-1], strict=True))
        gap, share = jnp.exp(q.pop("d2")), jax.nn.sigmoid(q.pop("d3"))  # d3/d2 on a log scale
        values = {n: peers._value(ours.coordinates.priors[n], q[n]) for n in q}
        values["start"] = jax.nn.sigmoid(row[-1])
        values |= {"d2": gap * (1.0 - share), "d3": gap * share}
        stribeck = jnp.exp(-((ours.coordinates.speed / values["v_s"]) ** 2))
        for side in ("fwd", "bwd"):
            values[f"Fc_{side}"] /= 1.0 + values[f"static_excess_{side}"] * stribeck
        return values

    def potential(self):
        """Minus the log of the joint density, of the variables by name."""
        ours, d = self.campaign.layout, len(self.names)
        density = jax.vmap(likelihood(self.campaign.tests[0]))  # all have the same motion
        forces = jnp.asarray([test.trace.force for test in self.campaign.tests])
        scatter_sds = [ours.scatter_sd[self.names.index(m[0])] for m in FOLLOWERS.values()]
        sds = WIDER * np.array(scatter_sds)

        def potential(u):
            mean, scatter = self.population(u)
            q, total = self.tests(u, mean, scatter)
            total -= 0.5 * jnp.sum(u["level"] ** 2)
            total += jnp.sum(u["log_scatter"] - 0.5 * (scatter / ours.scatter_sd) ** 2)
            deviation = jnp.exp(u["log_deviation"])
            total += jnp.sum(u["log_deviation"] - 0.5 * (deviation / sds) ** 2)
            total -= sum(0.5 * jnp.sum(u[f"deviation {g}"] ** 2) for g in FOLLOWERS)
            total += jax.nn.log_sigmoid(u["share"]) + jax.nn.log_sigmoid(-u["share"])
            total -= 0.5 * ((u["exponent"] - 1.0) / 0.5) ** 2
            total -= 0.5 * jnp.sum(((q[:, :d] - mean) / scatter) ** 2)
            total -= len(q) * jnp.sum(u["log_scatter"])
            total += jnp.sum(jax.nn.log_sigmoid(q[:, d]) + jax.nn.log_sigmoid(-q[:, d]))
            return -total - jnp.sum(density(jax.vmap(self.values)(q), forces))

        return potential


def _coordinates(ours, drawn):
    """Shared coordinates of a test's draws, and the logit of their start, (n, d + 1)."""
    values = {name: v.reshape(-1) for name, v in drawn.values.items()}
    start = values["start"][:, None]
    return np.append(ours.coordinates.of(values), np.log(start / (1.0 - start)), axis=1)


def likelihood(posterior):
    """Log likelihood under a test's motion, of quantities by name and the force (T,)."""
    motion = forward_peers.Motion.of(posterior.trace.path).on_device
    rows = jnp.asarray(posterior.trace.path.samples)
    step = float(posterior.trace.time[1] - posterior.trace.time[0])

    def log_likelihood(values, measured):
        force = peers._force({"gamma1": 1.0} | values, posterior.model.parameters, motion)[rows]
        residual = measured - force - values["offset"]
        return peers._ornstein_uhlenbeck(residual, step, values)

    return log_likelihood


def deviation(posterior, values):
    """Largest deviation of JAX's log likelihood, over its size where that exceeds 1."""
    expected = posterior.log_likelihood(posterior.coordinates(values))
    found = jax.jit(jax.vmap(likelihood(posterior), in_axes=(0, None)))(
        {name: jnp.asarray(value) for name, value in values.items()}, posterior.trace.force
    )
    return float(np.max(np.abs(np.asarray(found) - expected) / np.maximum(1.0, np.abs(expected))))


def nuts(layout, draws, *, chains, warm_up, kept, seed):
    """Draws of NUTS by variable, (chain, draw, …), and the share of them that diverged."""
    rng = np.random.default_rng(seed)
    starts = [layout.begin(draws, rng) for _ in range(chains)]
    begin = {name: jnp.stack([jnp.asarray(s[name]) for s in starts]) for name in starts[0]}
    kernel = NUTS(potential_fn=layout.potential(), target_accept_prob=0.99, max_tree_depth=(7, 9))
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
    ours, names = layout.campaign.layout, layout.names
    level = ours.centre + ours.spread * found["level"]
    values = {f"level {name}": level[..., k] for k, name in enumerate(names)}
    scatter = np.exp(found["log_scatter"])
    values |= {f"scatter {name}": scatter[..., k] for k, name in enumerate(names)}
    deviation = np.exp(found["log_deviation"])
    values |= {f"deviation {group}": deviation[..., i] for i, group in enumerate(FOLLOWERS)}
    values["share sigma0"] = 1.0 / (1.0 + np.exp(-found["share"]))
    values["exponent noise_sd"] = found["exponent"]
    unfold = jax.jit(jax.vmap(jax.vmap(lambda u: layout.tests(u, *layout.population(u))[0])))
    q = np.asarray(unfold(found))  # (chain, draw, J, d + 1)
    for j in range(q.shape[2]):
        values |= {f"test {j + 1}: {name}": q[:, :, j, k] for k, name in enumerate(names)}
    return values
