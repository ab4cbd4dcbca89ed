"""Modes of a posterior, proposals that are learned from its draws, and its log evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import measure_draws, psis
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Density = Callable[[Array], Array]  # log density of points (n, dim), (n,)

# least squares: most steps; least relative gain of a good step; refused steps that end a start
STEPS, TOLERANCE, REFUSED = 100, 1e-6, 8
MOST = 4_000_000  # most numbers of residuals that are computed together
LOWEST = -1e15  # log density where there is none, for what takes differences
DISTINCT = 0.05  # least distance of two least-squares results, in prior standard deviations
HOPELESS = 400.0  # least-squares results are dropped whose log posterior is so far below the best


@dataclass(frozen=True, eq=False)
class Mode:
    """A local maximum of the log posterior."""

    q: Array  # (dim,)
    log_prob: float
    covariance: Array  # (dim, dim): inverse curvature at the mode, made positive definite

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation to the log mass of the mode."""
        _, log_det = np.linalg.slogdet(self.covariance)
        return self.log_prob + 0.5 * (len(self.q) * float(np.log(2 * np.pi)) + float(log_det))

    def is_near(self, q: Array, log_prob: float) -> bool:
        """Whether a point is near by this mode's covariance, and about as high."""
        offset = q - self.q
        close = offset @ np.linalg.solve(self.covariance, offset) < 4.0 * len(offset)
        return bool(close and abs(log_prob - self.log_prob) < 5.0)


def find_modes(
    posterior: Posterior, rng: np.random.Generator, *, starts: int = 24
) -> tuple[Mode, ...]:
    """Distinct modes, best first.

    From many prior draws, those that fit well and differ most are chosen; least squares on
    residual and prior starts from each, then BFGS on the log posterior from each distinct result.
    """
    of_prior = posterior.coordinates(posterior.sample_prior(2000, rng))
    mean, sd = of_prior.mean(axis=0), of_prior.std(axis=0)
    begin = _starting_points(posterior, of_prior[:500], starts)
    fits = _fit_residuals(posterior, begin, mean, sd)
    heights = posterior.log_prob(fits)
    ends: list[Array] = []
    for i in np.argsort(-heights):
        if heights[i] > heights.max() - HOPELESS and all(
            np.max(np.abs(fits[i] - end) / sd) > DISTINCT for end in ends
        ):
            ends.append(fits[i])
    return climb(posterior, ends, sd)


def climb(posterior: Posterior, points: Iterable[Array], sd: Array) -> tuple[Mode, ...]:
    """Distinct modes that are climbed from points (dim,), best first; `sd` are the prior's."""
    modes: list[Mode] = []
    for point in points:
        mode = maximize(posterior.log_prob, point, sd)
        if not any(previous.is_near(mode.q, mode.log_prob) for previous in modes):
            modes.append(mode)
    return tuple(sorted(modes, key=lambda mode: -mode.log_prob))


def _starting_points(posterior: Posterior, draws: Array, starts: int) -> Array:
    """Prior draws whose loops fit well and that are far from each other, (starts, dim)."""
    draws = draws[np.isfinite(posterior.log_prior(draws))]
    if len(draws) == 0:
        raise FitError("the prior has no mass at any start: widen the priors of this device")
    misfit = np.mean(posterior.residual(draws)[:, posterior.first :] ** 2, axis=1)
    candidates = draws[np.argsort(misfit)[: max(starts, len(draws) // 5)]]
    scaled = candidates / draws.std(axis=0)
    indices, distance = [0], np.full(len(candidates), np.inf)
    while len(indices) < min(starts, len(candidates)):
        distance = np.minimum(distance, np.linalg.norm(scaled - scaled[indices[-1]], axis=1))
        indices.append(int(np.argmax(distance)))
    return candidates[indices]


def _fit_residuals(posterior: Posterior, begin: Array, mean: Array, sd: Array) -> Array:
    """Fits with independent noise and a Gaussian prior, and their noise, (m, dim)."""
    moves = np.array([not name.startswith("noise") for name in posterior.names])
    force = np.asarray(posterior.trace.force)[posterior.first :]
    # neighbouring samples are correlated: they count as 200
    scale = np.sqrt(min(1.0, 200.0 / force.size)) / (0.1 * float(np.std(force)) + 1e-12)

    def residual(points: Array, _: Rows) -> Array:
        q = np.tile(begin[0], (len(points), 1))
        q[:, moves] = mean[moves] + sd[moves] * points
        return np.asarray(posterior.residual(q)[:, posterior.first :] * scale)

    scaled = np.clip((begin[:, moves] - mean[moves]) / sd[moves], -5.0, 5.0)
    q = begin.copy()
    q[:, moves] = mean[moves] + sd[moves] * least_squares(residual, scaled, 8.0)
    return np.array([_read_noise(posterior, point) for point in q])


def _read_noise(posterior: Posterior, q: Array) -> Array:
    """The coordinates with noise_sd and noise_time set from the residual, (dim,)."""
    residual = posterior.residual(q[None])[0, posterior.first :]
    values = posterior.values(q[None])
    sd = float(np.std(residual)) + 1e-12
    values["noise_sd"] = np.array([sd])
    if "noise_time" in values:
        lag_one = float(np.mean(residual[1:] * residual[:-1])) / sd**2
        step = float(np.median(np.diff(posterior.trace.time)))
        values["noise_time"] = np.array([-step / np.log(np.clip(lag_one, 0.05, 0.98))])
    noisy = [name.startswith("noise_") and name != "noise_dof" for name in posterior.names]
    return np.where(noisy, posterior.coordinates(values)[0], q)


def maximize(density: Density, begin: Array, sd: Array) -> Mode:
    """Mode that BFGS reaches from a point, (dim,); `sd` (dim,) are the prior's."""
    from scipy.optimize import minimize  # which takes long to import

    dim, step = len(begin), 1e-4
    stencil = step * np.concatenate([np.zeros((1, dim)), np.eye(dim), -np.eye(dim)])

    def loss(w: Array) -> tuple[float, Array]:
        """Loss and its slope by central differences, in one batch."""
        centre, *neighbours = -np.maximum(density(begin + sd * (w + stencil)), LOWEST)
        higher, lower = np.reshape(neighbours, (2, dim))
        return float(centre), (higher - lower) / (2 * step)

    fit = minimize(
        loss, np.zeros(dim), jac=True, method="BFGS", options={"maxiter": 150, "gtol": 1e-2}
    )
    q = begin + sd * fit.x
    return Mode(q, float(density(q[None])[0]), laplace_covariance(density, q, sd))


def laplace_covariance(density: Density, q: Array, sd: Array) -> Array:
    """Inverse of the negative Hessian of a log density at q, (dim, dim).

    The Hessian's eigenvalues, in prior units, are limited so that each standard deviation is
    between 1e-4 and 4 times the prior's, and the result is positive definite.
    """
    dim, step = len(q), 3e-3
    shifts = step * sd * np.concatenate([np.eye(dim), -np.eye(dim)])
    i, j = np.triu_indices(2 * dim)
    heights = np.empty((2 * dim, 2 * dim))
    heights[i, j] = heights[j, i] = np.maximum(density(q + shifts[i] + shifts[j]), LOWEST)
    values = heights.reshape(2, dim, 2, dim)
    slopes = values[:, :, 0] - values[:, :, 1]
    curvature = -(slopes[0] - slopes[1]) / (2 * step) ** 2
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    covariance: Array = (vectors / np.clip(values, 1.0 / 16.0, 1e8)) @ vectors.T
    return covariance * sd * sd[:, None]


def least_squares(residual: Callable[[Array, Rows], Array], begin: Array, reach: float) -> Array:
    """Points (m, d) with the least sum of squares of residuals and coordinates, one a start.

    `residual` takes points (n, d) and the numbers of their starts (n,), and gives (n, T); no
    coordinate goes beyond ± `reach`.
    Damped Gauss-Newton steps (Levenberg, Marquardt) of all starts at once: a force costs half as
    much a vector where many are computed together.
    """

    def misfit(x: Array, starts: Rows) -> Array:
        residuals = residual(x, starts)
        squares = np.einsum("nt,nt->n", residuals, residuals) + np.sum(x**2, axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    (m, d), step = begin.shape, 1e-4
    points = np.clip(begin, -reach, reach)
    squares, damping = misfit(points, np.arange(m)), np.full(m, 10.0)
    refused = np.zeros(m, dtype=np.intp)
    normal, slope = np.tile(np.eye(d), (m, 1, 1)), np.zeros((m, d))  # JᵀJ + 1 and Jᵀr + x
    moved = going = np.arange(m)
    for _ in range(STEPS):
        size = 1
        while moved.size:
            rows, moved = moved[:size], moved[size:]
            shifted = np.repeat(points[rows, None], d + 1, axis=1)
            shifted[:, range(1, d + 1), range(d)] += step
            residuals = residual(shifted.reshape(-1, d), np.repeat(rows, d + 1))
            residuals = residuals.reshape(rows.size, d + 1, -1)
            with np.errstate(invalid="ignore"):
                slopes = (residuals[:, 1:] - residuals[:, :1]) / step
                slopes[~np.isfinite(slopes).all(axis=2)] = 0.0  # a slope that is no number: stay
                base = np.nan_to_num(residuals[:, 0], posinf=0.0, neginf=0.0)
            normal[rows] = slopes @ slopes.swapaxes(1, 2) + np.eye(d)
            slope[rows] = (slopes @ base[..., None])[..., 0] + points[rows]
            size = max(1, MOST // (residuals.shape[2] * (d + 1)))
        x, pull = points[going], slope[going]
        stays = ((x >= reach) & (pull < 0.0)) | ((x <= -reach) & (pull > 0.0))
        system = np.where(stays[:, :, None] | stays[:, None, :], 0.0, normal[going])
        diagonal = np.einsum("nii->ni", normal[going]) * (1.0 + damping[going, None])
        system[:, range(d), range(d)] = np.where(stays, 1.0, diagonal)
        step_of = -np.linalg.solve(system, np.where(stays, 0.0, pull)[..., None])[..., 0]
        ahead = np.clip(x + step_of, -reach, reach)
        trial = misfit(ahead, going)
        gain = squares[going] - trial
        better = gain > 0.0
        small = better & (gain < TOLERANCE * squares[going]) & (damping[going] < 0.01)
        moved = going[better]
        points[moved], squares[moved] = ahead[better], trial[better]
        damping[going] = np.clip(damping[going] * np.where(better, 0.1, 5.0), 1e-9, 1e9)
        refused[going] = np.where(better, 0, refused[going] + 1)
        going = going[~small & (refused[going] < REFUSED)]
        moved = np.intersect1d(moved, going)
        if not going.size:
            break
    return points


# --- Student-t mixtures ---------------------------------------------------------------------------

SHRINKAGE = 2.0  # draws a dimension that a component's scale is shrunk by to that of all
PARTS = 12  # largest number of components of a fit, besides the wide one
ITERATIONS = 20  # steps of expectation-maximisation
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
        terms = constants[:, None] - 0.5 * (dof + dim) * np.log1p(squares / dof)
        return np.asarray(np.logaddexp.reduce(terms, axis=0) + slope)

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws, (n, dim)."""
        component = rng.choice(self.weights.size, size=n, p=self.weights)
        normal = rng.standard_normal((n, self.means.shape[1]))
        normal /= np.sqrt(rng.chisquare(self.dof[component]) / self.dof[component])[:, None]
        draws: Array = self.means[component] + np.einsum(
            "nij,nj->ni", self.factors[component], normal
        )
        return draws if self.warp is None else self.warp.original(draws)


@dataclass(frozen=True, eq=False)
class Proposal:
    """Density with a share of each of several parts; the shares sum to 1."""

    shares: Sequence[float]
    parts: Sequence[Mixture | Proposal]

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        densities = np.stack([component.log_density(q) for component in self.parts])
        return np.asarray(np.logaddexp.reduce(densities + np.log(self.shares)[:, None], axis=0))

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws, (n, dim)."""
        counts = rng.multinomial(n, self.shares)
        draws = [component.draw(rng, k) for component, k in zip(self.parts, counts, strict=True)]
        order: NDArray[np.intp] = rng.permutation(n)
        return np.concatenate(draws)[order]


def fit_mixture(
    draws: Array,
    rng: np.random.Generator,
    weights: Array | None = None,
    *,
    components: int = PARTS,
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
    components = max(1, min(components, int(size) // (4 * dim)))
    means = standard[rng.choice(n, components, replace=False, p=weights)]
    covariances = np.tile(0.7 * np.eye(dim), (components, 1, 1))
    shares, prior = np.full(components, 1.0 / components), SHRINKAGE * dim
    for _ in range(ITERATIONS if components > 1 else 1):
        factors = np.linalg.cholesky(covariances)
        inverses = np.linalg.inv(factors).transpose(0, 2, 1)
        deviations = (standard - means[:, None]) @ inverses
        squares = np.einsum("kni,kni->kn", deviations, deviations)
        logs = -0.5 * (squares if warped else (dof + dim) * np.log1p(squares / dof))
        logs -= np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)[:, None]
        members = special.softmax(logs + np.log(shares)[:, None], axis=0) * counts
        mass = members.sum(axis=1) + 1e-9
        means = (members @ standard) / mass[:, None]
        deviations = (standard - means[:, None]) * np.sqrt(members)[..., None]
        scatter = deviations.transpose(0, 2, 1) @ deviations
        pooled = 0.5 * np.eye(dim) if warped else scatter.sum(axis=0) / size + 1e-9 * np.eye(dim)
        scatter += prior * pooled
        covariances = scatter / (mass + prior)[:, None, None]
        shares = mass / mass.sum()
    spreads = np.concatenate([1.1 * factor @ covariances @ factor.T, 1.5 * overall[None]])
    return Mixture(
        np.append((1.0 - wide) * shares, wide),
        np.vstack([middle + means @ factor.T, middle]),
        np.linalg.cholesky(spreads),
        np.append(np.full(components, dof), 8.0),
    )


def fit_proposal(
    draws: Array, components: int, rng: np.random.Generator, anchors: Mixture | Proposal
) -> Proposal:
    """Proposal that resembles walkers' draws (n, dim), with a share of anchors.

    Each coordinate is first warped separately to approximate normality. The wide component and
    the anchors, such as a mixture around the modes, reach what the draws have not visited.
    """
    if len(draws) > LEARNED:
        draws = draws[rng.choice(len(draws), LEARNED, replace=False)]
    warp = Warp.of(draws)
    fitted = fit_mixture(warp.normal(draws)[0], rng, components=components, warped=True)
    return Proposal((1.0 - ANCHORED, ANCHORED), (replace(fitted, warp=warp), anchors))


def laplace_mixture(modes: Sequence[Mode], power: float = 1.0) -> Mixture:
    """Laplace's approximation to a power of the density, at every mode that may matter.

    Laplace's masses are rough, so each mode's weight is the cube root of its mass. Modes whose
    log mass is more than 20 below the best are left out.
    """
    best = max(mode.log_evidence for mode in modes)
    major = [mode for mode in modes if mode.log_evidence > best - 20.0]
    weights = np.exp([(mode.log_evidence - best) / 3.0 for mode in major])
    covariances = np.array([mode.covariance / power for mode in major])
    return Mixture(
        weights / weights.sum(),
        np.array([mode.q for mode in major]),
        np.asarray(np.linalg.cholesky(covariances)),
        np.full(len(major), 6.0),
    )


def nearest_modes(modes: Sequence[Mode], q: Array) -> NDArray[np.intp]:
    """Mode whose Laplace approximation is densest at each of the draws (chain, draw, dim)."""
    flat = q.reshape(-1, q.shape[-1])
    heights = [laplace_mixture([mode]).log_density(flat) for mode in modes]
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
    evens, odds = slice(0, None, 2), slice(1, None, 2)
    estimates = [
        _bridge(density, q[fitted], q[target], log_prob[target], walkers, rng)
        for fitted, target in ((evens, odds), (odds, evens))
    ]
    values, errors = np.array([(estimate.value, estimate.error) for estimate in estimates]).T
    # the two may differ by more than their errors say, where a mixture misses something
    error = max(0.5 * float(np.hypot(*errors)), 0.5 * float(np.ptp(values)))
    return Evidence(float(values.mean()), error, max(estimate.pareto_k for estimate in estimates))


def _bridge(
    density: Density,
    fitted: Array,
    target: Array,
    log_prob: Array,
    walkers: int,
    rng: np.random.Generator,
) -> Evidence:
    """Log evidence from the draws that are kept, with a proposal fitted to the others."""
    dim = fitted.shape[-1]
    flat = fitted.reshape(-1, dim)
    proposal = fit_proposal(flat, PARTS, rng, fit_mixture(flat, rng))
    proposed = proposal.draw(rng, PROPOSED)
    proposed_ratio = density(proposed) - proposal.log_density(proposed)
    target_ratio = log_prob - proposal.log_density(target.reshape(-1, dim)).reshape(log_prob.shape)
    k = psis(proposed_ratio)[1]
    sizes = np.array([_size(target_ratio, walkers), PROPOSED])
    logs = np.log(sizes / sizes.sum())
    value = float(special.logsumexp(proposed_ratio) - np.log(PROPOSED))
    for _ in range(1000):
        previous = value
        top = proposed_ratio - np.logaddexp(logs[0] + proposed_ratio, logs[1] + value)
        bottom = -np.logaddexp(logs[0] + target_ratio, logs[1] + value)
        value = float(special.logsumexp(top) - special.logsumexp(bottom))
        value += float(np.log(target_ratio.size / PROPOSED))
        if abs(value - previous) < 1e-8:
            break
    # relative variances of both means (Frühwirth-Schnatter, 2004)
    top, bottom = np.exp(top - top.max()), np.exp(bottom - bottom.max())
    variance = (top.std() / top.mean()) ** 2 / PROPOSED
    variance += (bottom.std() / bottom.mean()) ** 2 / _size(bottom, walkers)
    return Evidence(value, float(np.sqrt(variance)), k)


def _size(values: Array, walkers: int) -> float:
    """Effective number of draws of a quantity (chain, draw)."""
    return max(float(measure_draws(values, walkers).ess_bulk[0]), 1.0)


def join_evidence(evidences: Sequence[Evidence]) -> Evidence:
    """Log evidence of several tests that are fitted separately: the sum."""
    values, errors, k = np.array([(e.value, e.error, e.pareto_k) for e in evidences]).T
    return Evidence(float(values.sum()), float(np.linalg.norm(errors)), float(k.max()))
