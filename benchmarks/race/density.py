"""The posterior of the three-stage model in JAX: model.md sections 2 to 5 and the priors."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln

from benchmarks.forward.peers import Motion, jax_force

LOG_2PI = float(np.log(2 * np.pi))


def jax_density(posterior):
    """Log posterior density of one q (dim,) in JAX, not yet compiled."""
    step = np.diff(posterior.trace.time)
    ported = posterior.noise.name == "ou" and posterior.model.name == "three_stage"
    if not ported or posterior.first or np.ptp(step) > 1e-6 * step[0]:
        raise ValueError("only the three-stage model with OU noise at a uniform rate is ported")
    motion = Motion(posterior.trace.path).on_device
    fixed = {"gamma1": 1.0, "start": 0.5}
    fixed |= {k: p.figures["value"] for k, p in posterior.priors.items() if p.fixed}
    measured, rows = posterior.trace.force, posterior.trace.path.samples

    def log_prob(q):
        sampled = dict(zip(posterior.names, q, strict=True))
        priors = {name: posterior.priors[name] for name in posterior.names}
        values = fixed | {name: _value(priors[name], sampled[name]) for name in sampled}
        prior = sum(_log_density(priors[name], sampled[name]) for name in sampled)
        force = _force(values, posterior.model.parameters, motion)[rows]
        residual = measured - force - values["offset"]
        return prior + _ornstein_uhlenbeck(residual, float(step[0]), values)

    return log_prob


def _value(prior, q):
    """Quantity at a coordinate, as `Prior.value`."""
    if np.isinf(prior.lower):
        return q
    if np.isinf(prior.upper):
        return prior.lower + jnp.exp(q)
    return prior.lower + (prior.upper - prior.lower) * jax.nn.sigmoid(q)


def _log_density(prior, q):
    """Log density of a coordinate with its Jacobian, as `Prior.log_density`."""
    f, family = prior.figures, prior.family
    if family == "normal":
        return _normal(q, f["mean"], f["sd"])
    if family == "lognormal":  # x = exp(q), whose Jacobian takes the 1/x away
        return _normal(q, np.log(f["median"]), f["sigma"])
    logits = jax.nn.log_sigmoid(q), jax.nn.log_sigmoid(-q)
    if family == "uniform":
        return logits[0] + logits[1]
    if family == "beta":
        a, b = f["a"], f["b"]
        return a * logits[0] + b * logits[1] - (gammaln(a) + gammaln(b) - gammaln(a + b))
    raise ValueError(f"prior family {family} is not ported")


def _normal(x, mean, sd):
    return -0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * LOG_2PI


def _ornstein_uhlenbeck(residual, step, values):
    """Normalised log density of a uniformly sampled residual (T,)."""
    scale, ratio = values["noise_sd"], step / values["noise_time"]
    shrink = -jnp.expm1(-2.0 * ratio)
    innovation = residual[1:] - jnp.exp(-ratio) * residual[:-1]
    squares = residual[0] ** 2 + jnp.sum(innovation**2) / shrink
    log_scale = residual.size * jnp.log(scale) + 0.5 * innovation.size * jnp.log(shrink)
    return -0.5 * squares / scale**2 - log_scale - 0.5 * LOG_2PI * residual.size


def _force(values, parameters, motion):
    """Force at the path's rows, (P,), kip."""
    sources = values | {
        "Fs_fwd": values["Fc_fwd"] * (1.0 + values["static_excess_fwd"]),
        "Fs_bwd": values["Fc_bwd"] * (1.0 + values["static_excess_bwd"]),
        "gamma2": values["ell"] * values["gamma1"],
    }
    theta = jnp.stack([jnp.asarray(sources[name]) for name in parameters])
    return jax_force(theta, values["start"], motion)
