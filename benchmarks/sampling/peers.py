"""Other samplers of the same posterior: emcee with its defaults, and NumPyro's NUTS.

NUTS needs the density in JAX: `jax_density` writes sections 2 to 5 of model.md and the priors of
`priors/*.toml` in the coordinates of `Posterior`. `benchmarks.sampling.run` checks that both
densities are the same before it measures.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from numpyro.infer import NUTS

from benchmarks.forward import peers as forward_peers
from benchmarks.sampling.draws import halves
from mfd_bayes.calibration.diagnostics import autocorrelation_time, measure

LOG_2PI = float(np.log(2 * np.pi))


# The density in JAX, of one q (dim,).


def jax_density(posterior):
    """Log posterior density of one q (dim,) in JAX, not yet compiled.

    Raises
    ------
    ValueError
        When the posterior has an option that is not ported.
    """
    step = np.diff(posterior.trace.time)
    ported = posterior.noise.name == "ou" and posterior.model.name == "three_stage"
    if not ported or posterior.first or np.ptp(step) > 1e-6 * step[0]:
        raise ValueError("only the three-stage model with OU noise at a uniform rate is ported")
    motion = forward_peers.Motion.of(posterior.trace.path).on_device
    fixed = {"gamma1": 1.0, "start": 0.5}
    fixed |= {k: p.figures["value"] for k, p in posterior.priors.items() if p.fixed}
    constants = {
        "force": jnp.asarray(posterior.trace.force),
        "rows": jnp.asarray(posterior.trace.path.samples),
        "step": float(step[0]),
    }

    def log_prob(q):
        own = dict(zip(posterior.names, q, strict=True))
        for pivot in posterior.pivots:
            kinetic, excess = posterior.names[pivot.kinetic], posterior.names[pivot.excess]
            own[kinetic] -= jnp.log1p(pivot.share * _value(pivot.prior, own[excess]))
        priors = {name: posterior.priors[name] for name in posterior.names}
        values = fixed | {name: _value(priors[name], own[name]) for name in own}
        prior = sum(_log_density(priors[name], own[name]) for name in own)
        force = _force(values, posterior.model.parameters, motion)[constants["rows"]]
        residual = constants["force"] - force - values["offset"]
        return prior + _ornstein_uhlenbeck(residual, constants["step"], values)

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
        return _normal(q, np.log(f["median"]), f["spread"])
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
    """Force at the path's rows, (P,), kip; F1 and the scans are from `benchmarks.forward.peers`."""
    sources = values | {
        "Fs_fwd": values["Fc_fwd"] * (1.0 + values["static_excess_fwd"]),
        "Fs_bwd": values["Fc_bwd"] * (1.0 + values["static_excess_bwd"]),
        "gamma2": values["ell"] * values["gamma1"],
    }
    p = jnp.stack([jnp.asarray(sources[name]) for name in parameters])
    slip = forward_peers._jax_slip(p, motion, forward_peers._scanned)
    width, ell = p[9] + p[10], p[12] / p[11]
    blend = partial(_blend, gap=(p[7], p[8], p[9], width, ell))

    def fade(u):
        return 1.0 - jnp.tanh(jnp.abs(u) * (0.5 / ell))

    def turn(state, now):
        side, offset, carry = state
        x, f1, heading = now
        u = offset + side * x
        left = blend(u, side, f1) + carry * fade(u) - blend(0.0, heading, f1)
        slipped = (u >= width) | (u <= 0.0)
        fresh = (heading, -heading * x, left)
        after = tuple(jnp.where(slipped, a, b) for a, b in zip(fresh, state, strict=True))
        return after, after

    side = motion["direction"]
    first = (side, values["start"] * width - side * motion["x"][0], 0.0)
    at_turns = (motion["x"][motion["turns"]], slip[motion["turns"]], motion["headings"])
    states = jax.lax.scan(turn, first, at_turns)[1]
    side, offset, carry = (
        jnp.append(a, b)[motion["stretch"]] for a, b in zip(first, states, strict=True)
    )
    u = offset + side * motion["x"]
    return blend(u, side, slip) + carry * fade(u)


def _blend(u, side, slip, gap):
    """`forward_peers`' blend, but with sigmoids: 1/(1 + exp) has NaN for gradient far away."""
    k2, k3, d2, width, ell = gap
    force = slip + jnp.tanh(jnp.maximum(u, 0.0) * (0.5 / ell)) * (side * k2 * u - slip)
    build_up = side * (k2 * d2 + k3 * (u - d2))
    force += (build_up - force) * jax.nn.sigmoid((u - d2) / ell)
    return force + (slip - force) * jax.nn.sigmoid((u - width) / ell)


# The samplers. They run until the smallest bulk effective sample size is as large as ours must be,
# or until their time is up. Their one chain or ensemble is measured as two, its halves in time.


@dataclass(frozen=True)
class Goal:
    """When a sampler may stop: smallest bulk effective sample size, or seconds of CPU.

    The seconds are those after JAX has compiled.
    """

    ess: float
    seconds: float


@dataclass(frozen=True)
class Run:
    """What a sampler gave.

    Attributes
    ----------
    chains : (ensemble, step, walker, dim)
        What is kept.
    seconds : float
        Of CPU, all that it took, warm-up included.
    warm_up : float
        Seconds of it that gave nothing that is kept.
    compiling : float
        Seconds of these in which JAX compiled.
    evaluations : int
        Of the density, or of its gradient.
    """

    chains: np.ndarray
    seconds: float
    warm_up: float
    compiling: float
    evaluations: int


@dataclass(frozen=True)
class Start:
    """What NUTS is given.

    Attributes
    ----------
    q : (dim,)
    covariance : (dim, dim) or None
        What its mass matrix is adapted from; NumPyro's unit matrix when left out.
    warm_up : int
        Draws that adapt, fewer where they take over half of the time.
    """

    q: np.ndarray
    covariance: np.ndarray | None = None
    warm_up: int = 1000


class Clock:
    """Seconds of CPU since it was made, without those in which it was paused."""

    def __init__(self):
        self._began = time.process_time()

    def read(self):
        """Seconds so far."""
        return time.process_time() - self._began

    @contextmanager
    def paused(self):
        """Stop counting for a while."""
        at = time.process_time()
        yield
        self._began += time.process_time() - at


def stretch(density, mode, goal, seed, *, walkers=64, block=1000):
    """Run of emcee with all its defaults but `vectorize`, from Laplace draws around the mode.

    Five autocorrelation times are its burn-in, or half of all if that is less.
    """
    clock = Clock()
    sampler = emcee.EnsembleSampler(walkers, len(mode.q), density, vectorize=True)
    twister = np.random.RandomState(seed)
    begin = twister.multivariate_normal(mode.q, mode.covariance, walkers)
    state = emcee.State(begin, random_state=twister.get_state())
    ess = 0.0
    while ess < goal.ess and clock.read() < goal.seconds:
        state = sampler.run_mcmc(state, block)
        with clock.paused():
            chain = sampler.get_chain()
            steps = len(chain)
            slowest = float(autocorrelation_time(chain[None, steps // 2 :]).max())
            burn_in = min(steps // 2, int(5.0 * slowest))
            kept = halves(chain[burn_in:])
            ess = smallest(kept)
    spent = clock.read()
    evaluations = walkers * (steps + 1)
    return Run(kept, spent, spent * burn_in / steps, 0.0, evaluations)


def nuts(posterior, start, goal, seed, *, block=500):
    """Run of NumPyro's NUTS: one chain with a dense mass matrix that it adapts."""
    clock = Clock()
    density = jax_density(posterior)
    kernel = NUTS(
        potential_fn=lambda q: -density(q),
        dense_mass=True,
        inverse_mass_matrix=None if start.covariance is None else jnp.asarray(start.covariance),
    )
    key, warm_up = jax.random.PRNGKey(seed), start.warm_up
    state = kernel.init(key, warm_up, jnp.asarray(start.q), (), {})
    step = jax.jit(lambda state: kernel.sample(state, (), {})).lower(state).compile()
    compiling = clock.read()
    end, gradients, ess, draws = compiling + goal.seconds, 0, 0.0, []
    while int(state.i) < warm_up and clock.read() < end - 0.5 * goal.seconds:
        state = step(state)
        gradients += int(state.num_steps)
    warmed = clock.read()
    # from here on the kernel does not adapt
    state = state._replace(i=jnp.full_like(state.i, warm_up))
    while len(draws) < 20 or (ess < goal.ess and clock.read() < end):
        state = step(state)
        gradients += int(state.num_steps)
        draws.append(np.asarray(state.z))
        if len(draws) % block == 0:
            with clock.paused():
                ess = smallest(halves(np.array(draws)[:, None]))
    return Run(halves(np.array(draws)[:, None]), clock.read(), warmed, compiling, gradients)


def smallest(chains):
    """Smallest bulk effective sample size of a coordinate; 0 where one never moved."""
    if np.any(np.ptp(chains, axis=(0, 1, 2)) == 0):
        return 0.0
    return float(measure(chains).ess_bulk.min())
