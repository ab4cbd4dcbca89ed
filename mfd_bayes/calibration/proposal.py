"""Student-t mixtures that are fitted to draws: proposals, and log evidence by bridge sampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import measure_draws, psis
from mfd_bayes.calibration.modes import Density, Mode, least_squares

Array = NDArray[np.float64]

SHRINKAGE = 2.0  # draws a dimension that a component's scale is shrunk by to that of all
PARTS = 12  # largest number of components of a fit, besides the wide one
ITERATIONS = 12  # steps of expectation-maximisation
ANCHORED = 0.25  # share of the anchors in a proposal that is learned from walkers
LEARNED = 8000  # largest number of walkers' draws from which a proposal is learned
BENT = 1.5  # bound on the parameters of a coordinate's warp, so that few draws distort it little
LOOSE = 0.01  # misfit of a quantile, arcsinh, that weighs as much as a parameter of size 1
# probabilities of the quantiles to which each coordinate's warp is fitted
PROBABILITIES = np.array([0.01, 0.025, 0.07, 0.16, 0.31, 0.5, 0.69, 0.84, 0.93, 0.975, 0.99])


@dataclass(frozen=True, eq=False)
class Warp:
    """Map of each coordinate separately to an approximately standard normal one, (dim,) each.

    z = sinh(tail asinh((q − centre)/scale) − skew), after Jones and Pewsey (2009): smooth,
    one-to-one, with an explicit inverse.
    """

    centre: Array
    scale: Array
    skew: Array
    tail: Array

    @classmethod
    def of(cls, draws: Array) -> Warp:
        """Map fitted so that quantiles of the draws (n, dim) become those of the normal."""
        target = special.ndtri(PROBABILITIES)
        quantiles = np.quantile(draws, PROBABILITIES, axis=0).T
        middle = quantiles[:, quantiles.shape[1] // 2]
        spread = np.maximum(quantiles[:, -1] - quantiles[:, 0], 1e-12) / (target[-1] - target[0])
        places = (quantiles - middle[:, None]) / spread[:, None]

        def misfit(w: Array, coordinates: NDArray[np.intp]) -> Array:
            shift, width, tail, skew = w.T[:, :, None]
            scaled = np.arcsinh((places[coordinates] - shift) * np.exp(-width))
            gap: Array = (np.exp(tail) * scaled - skew - np.arcsinh(target)) / LOOSE
            return gap

        shift, width, tail, skew = least_squares(misfit, np.zeros((len(middle), 4)), BENT).T
        return cls(middle + spread * shift, spread * np.exp(width), skew, np.exp(tail))

    def normal(self, q: Array) -> tuple[Array, Array]:
        """Standard coordinates, (n, dim), and the log of the map's Jacobian, (n,)."""
        y = (q - self.centre) / self.scale
        bent = self.tail * np.arcsinh(y) - self.skew
        slope = np.log(self.tail * np.cosh(bent) / (self.scale * np.hypot(1.0, y)))
        return np.sinh(bent), slope.sum(axis=1)

    def original(self, z: Array) -> Array:
        """The inverse of `normal`, (n, dim)."""
        return self.centre + self.scale * np.sinh((np.arcsinh(z) + self.skew) / self.tail)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Weighted Student-t densities in `dim` dimensions."""

    weights: Array  # (k,)
    means: Array  # (k, dim)
    factors: Array  # (k, dim, dim): lower Cholesky factors of the scale matrices
    dof: Array  # (k,): degrees of freedom
    warp: Warp | None = None  # Warp, optional: the components stand in warped coordinates

    @cached_property
    def _whitening(self) -> tuple[Array, Array, Array]:
        """What makes all components standard at once: (dim, k dim), (k dim,); log constants."""
        dim = self.means.shape[1]
        inverses: Array = np.asarray(np.linalg.inv(self.factors), dtype=np.float64)
        places = np.einsum("kij,kj->ki", inverses, self.means).reshape(-1)
        constants = special.gammaln(0.5 * (self.dof + dim)) - special.gammaln(0.5 * self.dof)
        constants -= 0.5 * dim * np.log(self.dof * np.pi)
        constants += np.log(np.diagonal(inverses, axis1=1, axis2=2)).sum(axis=1)
        return inverses.reshape(-1, dim).T, places, constants + np.log(self.weights)

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        z, slope = (q, 0.0) if self.warp is None else self.warp.normal(q)
        whitening, places, constants = self._whitening
        standard = (z @ whitening - places).reshape(len(z), *self.means.shape)
        squares = np.einsum("nki,nki->kn", standard, standard)
        dof, dim = self.dof[:, None], self.means.shape[1]
        parts = constants[:, None] - 0.5 * (dof + dim) * np.log1p(squares / dof)
        return np.asarray(special.logsumexp(parts, axis=0) + slope)

    def draw(self, rng: Any, n: int) -> Array:
        """Independent draws, (n, dim), of a Generator or a RandomState."""
        part = rng.choice(self.weights.size, size=n, p=self.weights)
        normal = rng.standard_normal((n, self.means.shape[1]))
        normal /= np.sqrt(rng.chisquare(self.dof[part]) / self.dof[part])[:, None]
        draws: Array = self.means[part] + np.einsum("nij,nj->ni", self.factors[part], normal)
        return draws if self.warp is None else self.warp.original(draws)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Density with a share of each of several parts; the shares sum to 1."""

    shares: Sequence[float]
    parts: Sequence[Mixture | Proposal]

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        densities = np.stack([part.log_density(q) for part in self.parts])
        return np.asarray(special.logsumexp(densities + np.log(self.shares)[:, None], axis=0))

    def draw(self, rng: Any, n: int) -> Array:
        """Independent draws, (n, dim), of a Generator or a RandomState."""
        counts = rng.multinomial(n, self.shares)
        draws = [part.draw(rng, k) for part, k in zip(self.parts, counts, strict=True)]
        order: NDArray[np.intp] = rng.permutation(n)
        return np.concatenate(draws)[order]


def fit_mixture(
    draws: Array,
    rng: np.random.Generator,
    weights: Array | None = None,
    *,
    parts: int = PARTS,
    warped: bool = False,
) -> Mixture:
    """Mixture that resembles draws and is somewhat wider.

    Components are fitted by expectation-maximisation to whitened draws, with covariances that are
    shrunk, and then have Student-t tails of those covariances. A component that is wider than all
    draws is added, so that no tail is left out.
    """
    dof, wide = (30.0, 0.1) if warped else (5.0, 0.2)
    if weights is not None:
        heavy = weights > 1e-2 / len(draws)  # the rest weighs less than 1 % together
        draws, weights = draws[heavy], weights[heavy] / weights[heavy].sum()
    n, dim = draws.shape
    size = float(n) if weights is None else 1.0 / float(np.sum(weights**2))
    counts = np.ones(n) if weights is None else size * weights
    middle = draws.mean(axis=0) if weights is None else weights @ draws
    overall = np.atleast_2d(np.cov(draws.T, aweights=weights)) + 1e-8 * np.eye(dim)
    factor = np.linalg.cholesky(overall)
    standard = np.linalg.solve(factor, (draws - middle).T).T
    parts = max(1, min(parts, int(size) // (4 * dim)))
    means = standard[rng.choice(n, parts, replace=False, p=weights)]
    covariances = np.tile(0.7 * np.eye(dim), (parts, 1, 1))
    shares, prior = np.full(parts, 1.0 / parts), SHRINKAGE * dim
    for _ in range(ITERATIONS if parts > 1 else 1):
        factors = np.linalg.cholesky(covariances)
        inverses = np.linalg.inv(factors).transpose(0, 2, 1)
        away = (standard - means[:, None]) @ inverses
        squares = np.einsum("kni,kni->kn", away, away)
        logs = -0.5 * (squares if warped else (dof + dim) * np.log1p(squares / dof))
        logs -= np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)[:, None]
        members = special.softmax(logs + np.log(shares)[:, None], axis=0) * counts
        mass = members.sum(axis=1) + 1e-9
        means = (members @ standard) / mass[:, None]
        away = (standard - means[:, None]) * np.sqrt(members)[..., None]
        scatter = away.transpose(0, 2, 1) @ away
        pooled = 0.5 * np.eye(dim) if warped else scatter.sum(axis=0) / size + 1e-9 * np.eye(dim)
        scatter += prior * pooled
        covariances = scatter / (mass + prior)[:, None, None]
        shares = mass / mass.sum()
    spreads = np.concatenate([1.1 * factor @ covariances @ factor.T, 1.5 * overall[None]])
    return Mixture(
        np.append((1.0 - wide) * shares, wide),
        np.vstack([middle + means @ factor.T, middle]),
        np.linalg.cholesky(spreads),
        np.append(np.full(parts, dof), 8.0),
    )


def learn(
    draws: Array, parts: int, rng: np.random.Generator, anchors: Mixture | Proposal
) -> Proposal:
    """Proposal that resembles walkers' draws (n, dim), with a share of anchors.

    Each coordinate is first warped separately to approximate normality. The wide component and
    the anchors, such as a mixture around the modes, reach what the draws have not visited.
    """
    if len(draws) > LEARNED:
        draws = draws[rng.choice(len(draws), LEARNED, replace=False)]
    warp = Warp.of(draws)
    fitted = fit_mixture(warp.normal(draws)[0], rng, parts=parts, warped=True)
    return Proposal((1.0 - ANCHORED, ANCHORED), (replace(fitted, warp=warp), anchors))


def around_modes(modes: Sequence[Mode], power: float = 1.0) -> Mixture:
    """Laplace's approximation to a power of the density, at every mode that may matter.

    Laplace's masses are rough, so each mode's weight is the cube root of its mass. Modes whose
    log mass is more than 20 below the best are left out.
    """
    best = max(mode.log_evidence for mode in modes)
    kept = [mode for mode in modes if mode.log_evidence > best - 20.0]
    weights = np.exp([(mode.log_evidence - best) / 3.0 for mode in kept])
    covariances = np.array([mode.covariance / power for mode in kept])
    return Mixture(
        weights / weights.sum(),
        np.array([mode.q for mode in kept]),
        np.asarray(np.linalg.cholesky(covariances)),
        np.full(len(kept), 6.0),
    )


def nearest_modes(modes: Sequence[Mode], q: Array) -> NDArray[np.intp]:
    """Mode whose Laplace approximation is densest at each of the draws (chain, draw, dim)."""
    flat = q.reshape(-1, q.shape[-1])
    heights = [around_modes([mode]).log_density(flat) for mode in modes]
    return np.asarray(np.argmax(heights, axis=0).reshape(q.shape[:2]))


# --- log evidence ---------------------------------------------------------------------------------

PROPOSED = 4000  # draws from each of the two proposals
# Pareto k, and standard error in nats, above which a log evidence is not to be trusted. A bridge
# needs draws from the proposal that overlap with the posterior, not light tails: the usual 0.7 is
# the limit of importance weights alone
LARGEST_K, LARGEST_ERROR = 1.0, 0.5


@dataclass(frozen=True)
class Evidence:
    """Log of the integral of likelihood times prior, in nats."""

    value: float  # and its standard error
    error: float
    pareto_k: float  # of the proposal's importance weights: above 1 it misses a part

    @property
    def trusted(self) -> bool:
        """Whether Pareto k and error are small enough."""
        return self.pareto_k <= LARGEST_K and self.error <= LARGEST_ERROR


def log_evidence(
    density: Density, q: Array, log_prob: Array, walkers: int, rng: np.random.Generator
) -> Evidence:
    """Log evidence by bridge sampling (Meng and Wong, 1996; Gronau et al., 2017).

    A mixture of Student-t densities is fitted to one half of the chains. The bridge goes from it to
    the draws of the other half, which it has not seen. Then the halves change places, and the mean
    of both counts.
    """
    first, second = slice(0, None, 2), slice(1, None, 2)
    parts = [
        _bridge(density, q[fitted], q[kept], log_prob[kept], walkers, rng)
        for fitted, kept in ((first, second), (second, first))
    ]
    values, errors = np.array([(part.value, part.error) for part in parts]).T
    # the two may differ by more than their errors say, where a mixture misses something
    error = max(0.5 * float(np.hypot(*errors)), 0.5 * float(np.ptp(values)))
    return Evidence(float(values.mean()), error, max(part.pareto_k for part in parts))


def _bridge(
    density: Density,
    fitted: Array,
    kept: Array,
    log_prob: Array,
    walkers: int,
    rng: np.random.Generator,
) -> Evidence:
    """Log evidence from the draws that are kept, with a proposal fitted to the others."""
    dim = fitted.shape[-1]
    flat = fitted.reshape(-1, dim)
    proposal = learn(flat, PARTS, rng, fit_mixture(flat, rng))
    proposed = proposal.draw(rng, PROPOSED)
    above = density(proposed) - proposal.log_density(proposed)
    below = log_prob - proposal.log_density(kept.reshape(-1, dim)).reshape(log_prob.shape)
    k = psis(above)[1]
    sizes = np.array([_size(below, walkers), PROPOSED])
    logs = np.log(sizes / sizes.sum())
    value = float(special.logsumexp(above) - np.log(PROPOSED))
    for _ in range(1000):
        before = value
        top = above - np.logaddexp(logs[0] + above, logs[1] + value)
        bottom = -np.logaddexp(logs[0] + below, logs[1] + value)
        value = float(special.logsumexp(top) - special.logsumexp(bottom))
        value += float(np.log(below.size / PROPOSED))
        if abs(value - before) < 1e-8:
            break
    # relative variances of both means (Frühwirth-Schnatter, 2004)
    top, bottom = np.exp(top - top.max()), np.exp(bottom - bottom.max())
    variance = (top.std() / top.mean()) ** 2 / PROPOSED
    variance += (bottom.std() / bottom.mean()) ** 2 / _size(bottom, walkers)
    return Evidence(value, float(np.sqrt(variance)), k)


def _size(values: Array, walkers: int) -> float:
    """Effective number of draws of a quantity (chain, draw)."""
    return max(float(measure_draws(values, walkers).ess_bulk[0]), 1.0)


def join_evidence(parts: Sequence[Evidence]) -> Evidence:
    """Log evidence of several tests that are fitted separately: the sum."""
    values, errors, k = np.array([(e.value, e.error, e.pareto_k) for e in parts]).T
    return Evidence(float(values.sum()), float(np.linalg.norm(errors)), float(k.max()))
