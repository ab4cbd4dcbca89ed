"""The joint density of a population and all its tests in JAX, and NumPyro's NUTS on it.

Of `mfd_bayes/population` only numbers are used: those of the prior, which quantities are common to
the tests, and what the joint fit fixes in each test's likelihood (discrepancy, shape of the noise,
share of independent samples) and in its scatter (weights of what stands apart). Levels, laws,
deviations, coordinates and likelihood are written here again. The force is that of
`benchmarks.sampling.peers`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpyro.infer import MCMC, NUTS

from benchmarks.forward import peers as forward_peers
from benchmarks.population.study import FOLLOWERS, LEVELS, Joint, deviation_root
from benchmarks.sampling import peers
from mfd_bayes.population.design import WIDER
from mfd_bayes.population.laws import LAW_NAMES


@dataclass(frozen=True, eq=False)
class Layout:
    """The joint density's variables, in prior units.

    A test's coordinates are not sampled themselves, for funnels would hold up NUTS, but in units
    of the Gaussian that its likelihood and the population would make of them were both Gaussian.
    This is a change of variables, with its Jacobian, and the joint density stays what it is.

    Attributes
    ----------
    joint : Joint
        A test's coordinates are d shared ones, then that of the place in the gap at the start.
    """

    joint: Joint

    @property
    def ours(self):
        """The design, for the numbers of the prior."""
        return self.joint.mixed.design

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
        return np.flatnonzero(~self.ours.common)

    @property
    def differ(self):
        """Coordinates that differ between tests: `free`, then the start."""
        return np.append(self.free, len(self.names))

    def begin(self, rng):
        """A start: levels where the Gaussians of the tests have them, the rest about that."""
        mixed = self.joint.mixed
        near = mixed.of_numbers(mixed.mode(_chosen(self.ours))[None])
        z = mixed.marginal(near, _chosen(self.ours)[None])[1].mean[0]
        followers = {f"deviation {g}": (len(m), 3) for g, m in FOLLOWERS.items()}
        scatter_sd = self.ours.scatter_sd[self.free]
        u = {
            "level": z[: len(self.names)],
            "log_scatter": np.log(0.5 * scatter_sd) + 0.3 * rng.standard_normal(self.free.size),
            "log_deviation": np.log(0.1) + 0.3 * rng.standard_normal(len(FOLLOWERS)),
            "share": 0.5 * rng.standard_normal(),
            "exponent": 1.0 + 0.3 * rng.standard_normal(),
            **{name: 0.3 * rng.standard_normal(shape) for name, shape in followers.items()},
        }
        return u | {"tests": 0.3 * rng.standard_normal((len(LEVELS), self.differ.size))}

    def population(self, u):
        """Means of the tests' shared coordinates (J, d), and scatter of `free` in them, (J, f)."""
        ours = self.ours
        relative = np.array(LEVELS) / np.exp(np.mean(np.log(LEVELS)))
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
        scatter = jnp.exp(u["log_scatter"]) / ours.spread[self.free]
        return mean, scatter / np.sqrt(self.joint.mixed.weight)

    def conditional(self, mean, scatter):
        """Cholesky factors of precisions, and means, of Gaussians near what differs in the tests.

        They are near the tests' likelihoods, given what is common, times the population.
        """
        precisions = self.joint.fit.precision
        pulls = np.einsum("jab,jb->ja", precisions, self.joint.fit.mean)
        those, common = self.differ, self.common
        kept = jnp.pad(1.0 / scatter**2, ((0, 0), (0, 1)), constant_values=1.0)
        inner = precisions[:, those][:, :, those] + kept[:, :, None] * np.eye(those.size)
        factor = jnp.linalg.cholesky(inner)
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
        ours, free, tests = self.ours, self.free, self.joint.fit.tests
        density = jax.vmap(likelihood(tests[0]))  # all have one motion
        data = [jnp.asarray(column) for column in zip(*map(data_of, tests), strict=True)]
        scatter_sds = [ours.scatter_sd[self.names.index(m[0])] for m in FOLLOWERS.values()]
        sds = WIDER * np.array(scatter_sds)

        def potential(u):
            mean, scatter = self.population(u)
            x, total = self.tests(u, mean, scatter)
            total -= 0.5 * jnp.sum(u["level"] ** 2)
            size = jnp.exp(u["log_scatter"]) / ours.scatter_sd[free]
            total += jnp.sum(u["log_scatter"] - 0.5 * size**2)
            deviation = jnp.exp(u["log_deviation"])
            total += jnp.sum(u["log_deviation"] - 0.5 * (deviation / sds) ** 2)
            total -= sum(0.5 * jnp.sum(u[f"deviation {g}"] ** 2) for g in FOLLOWERS)
            total += jax.nn.log_sigmoid(u["share"]) + jax.nn.log_sigmoid(-u["share"])
            total -= 0.5 * ((u["exponent"] - 1.0) / 0.5) ** 2
            away = (x[:, free] - mean[:, free]) / scatter
            total -= jnp.sum(0.5 * away**2 + jnp.log(scatter))
            start = _start(tests[0], x[:, -1])
            total += jnp.sum(jax.nn.log_sigmoid(start) + jax.nn.log_sigmoid(-start))
            return -total - jnp.sum(density(x, *data))

        return potential


def _chosen(design):
    """Numbers of the laws, (L,)."""
    return np.array([LAW_NAMES.index(law) for law in design.laws.values()])


def _start(test, x):
    """Logit of the place in the gap at the start, which has a uniform prior, of its coordinate."""
    known = test.coordinates
    if known.names[-1] != "start" or known.priors["start"].family != "uniform":
        raise ValueError("the last coordinate of a test is to be a start with a uniform prior")
    return known.centre[-1] + known.spread[-1] * x


def data_of(test):
    """Force without discrepancy (T,), shape of the noise (T,), share of independent samples."""
    return test.posterior.trace.force - test.discrepancy, test.shape, test.information


def likelihood(test):
    """Log likelihood under a test's motion, of coordinates (d + 1,) and `data_of`."""
    posterior, known = test.posterior, test.coordinates
    motion = forward_peers.Motion.of(posterior.trace.path).on_device
    rows = jnp.asarray(posterior.trace.path.samples)
    fixed = {k: p.figures["value"] for k, p in posterior.priors.items() if p.fixed}

    def values_of(x):
        """Quantities of one test at its coordinates, model.md section 6."""
        q = dict(zip(known.names, known.centre + known.spread * x, strict=True))
        values = fixed | {n: peers._value(known.priors[n], q[n]) for n in q}
        if "d2" in q and "d3" in q:  # the width of the gap, and d3/d2
            gap, share = jnp.exp(q["d2"]), jax.nn.sigmoid(q["d3"])
            values |= {"d2": gap * (1.0 - share), "d3": gap * share}
        if "v_s" in q:
            stribeck = jnp.exp(-((known.speed / values["v_s"]) ** 2))
            for side in ("fwd", "bwd"):
                if f"static_excess_{side}" in q:
                    values[f"Fc_{side}"] /= 1.0 + values[f"static_excess_{side}"] * stribeck
        return values

    def log_likelihood(x, measured, shape, information):
        values = values_of(x)
        force = peers._force({"gamma1": 1.0} | values, posterior.model.parameters, motion)[rows]
        standard = (measured - force - values["offset"]) / (shape * values["noise_sd"])
        scales = shape.size * jnp.log(values["noise_sd"])
        return -information * (0.5 * jnp.sum(standard**2) + scales)

    return log_likelihood


def deviation(joint, j, rng):
    """Largest deviation of JAX's log likelihood of test j, over its size where that exceeds 1.

    It is asked at points of the Gaussian near the test's posterior; ours must be finite there.
    """
    test, mean, precision = joint.fit.tests[j], joint.fit.mean[j], joint.fit.precision[j]
    root = np.linalg.cholesky(precision + np.eye(mean.size))
    away = rng.standard_normal((200, mean.size))
    x = np.linalg.solve(root @ root.T, precision @ mean)
    x = x + np.linalg.solve(root.T, away.T).T
    expected = test.log_likelihood(x)
    one = likelihood(test)
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
    centre = ours.coordinates.centre[: len(names)]
    level = centre + ours.spread * found["level"]
    values = {f"level {name}": level[..., k] for k, name in enumerate(names)}
    scatter = np.exp(found["log_scatter"])
    values |= {f"scatter {names[k]}": scatter[..., i] for i, k in enumerate(layout.free)}
    deviation = np.exp(found["log_deviation"])
    values |= {f"deviation {group}": deviation[..., i] for i, group in enumerate(FOLLOWERS)}
    values["share sigma0"] = 1.0 / (1.0 + np.exp(-found["share"]))
    values["exponent noise_sd"] = found["exponent"]
    unfold = jax.jit(jax.vmap(jax.vmap(lambda u: layout.tests(u, *layout.population(u))[0])))
    x = np.asarray(unfold(found))[..., :-1]  # (chain, draw, J, d)
    q = centre + ours.spread * x
    for j in range(q.shape[2]):
        values |= {f"test {j + 1}: {name}": q[:, :, j, k] for k, name in enumerate(names)}
    return values
