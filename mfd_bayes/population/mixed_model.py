"""Linear mixed model of the tests, and scores of laws and covariates by it.

Each test is known by a Gaussian likelihood (a two-stage model).

The coordinates of test j are x_j = A_j z + law(h)_j + d_j with d_j ~ N(0, diag τ²), and its
likelihood is N(y_j, P_j⁻¹). Given the variance parameters and the shapes of the laws, together h,
all is Gaussian and is integrated in closed form: first the deviations d_j, then the coefficients z
(levels, slopes on covariates, effects). The few h are drawn by importance sampling from the
marginal likelihood times their prior.

Scores say how well a law or a covariate predicts tests that were left out. Each quantity is scored
by itself, with the Gaussians of the tests given the quantities that all tests share. A law has
scatter here, but not the level effects that predictions allow it, which would excuse any law.
Scatter and shapes are integrated by importance sampling with a fixed seed: the scores are always
the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.population.design import (
    COMPARE,
    EXPONENT,
    LAW_NAMES,
    LAWS,
    LEVELS,
    TESTS,
    Design,
    levels_of,
    shape_prior,
    varies,
)
from mfd_bayes.population.law_scores import LARGEST_K, DependenceScore, LawScore

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LARGEST = 12.0  # largest size of a coordinate of h
FAINTEST = -1000.0  # least log prior density of one
COVARIATES = ("velocity", "amplitude")  # that a quantity may follow besides the actuation
# probability that a quantity of a test is an outlier, and the scatter of outliers over others'
OUTLIER, WIDER = 0.01, 10.0
# points of an importance sample of h, the share of them in its effective number that is enough, and
# most rounds: of the first sample, and of those of other Gaussian likelihoods near it
POINTS, ENOUGH, ADAPTATIONS, ADAPTED = 3000, 1.0 / 3.0, 6, 2
# degrees of freedom of the points, and their scale over that of the density that they are for
FREEDOM, SCALE = 7, 1.1
FARTHEST = 7.0  # largest standard normal number of the mode of h
# of the random walk of each coordinate of h: its sd at first, the least and the largest, the share
# of moves that is to be accepted (Gelman, Roberts and Gilks, 1996), and how fast it is tuned to it
STEP, STEPS, ACCEPT_H, TUNING = 0.6, (0.02, 5.0), 0.44, 0.1
ROUNDS = 4  # largest number of rounds of expectation-maximisation of outliers


class Coefficients(NamedTuple):
    """Gaussian of the coefficients z given rows of h: mean (n, Z), Cholesky factor of precision."""

    mean: Array
    factor: Array

    def draw(self, rng: np.random.Generator) -> Array:
        """A draw for each row, (n, Z)."""
        return self.of_numbers(rng.standard_normal(self.mean.shape))

    def of_numbers(self, e: Array) -> Array:
        """Coefficients (n, Z) of standard normal numbers e (n, Z)."""
        return self.mean + backward(self.factor, e)

    def numbers_of(self, z: Array) -> Array:
        """The inverse of `of_numbers`, (n, Z)."""
        return np.asarray(np.einsum("nji,nj->ni", self.factor, z - self.mean))

    def log_density(self, z: Array) -> Array:
        """Log density of z (n, Z) but for a constant, (n,)."""
        return np.asarray(-0.5 * np.sum(self.numbers_of(z) ** 2, axis=1))


class StudentTProposal(NamedTuple):
    """Multivariate t density with `FREEDOM` degrees of freedom, or one for each of n rows.

    `mean` is (dim,) or (n, dim), and `root` (dim, dim) or (n, dim, dim).
    """

    mean: Array
    root: Array

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Draws, (n, dim)."""
        y = rng.standard_normal((n, self.mean.shape[-1]))
        y /= np.sqrt(rng.chisquare(FREEDOM, (n, 1)) / FREEDOM)
        return np.asarray(self.mean + np.einsum("...ij,...j->...i", self.root, y))

    def log_density(self, g: Array) -> Array:
        """Log density of g (n, dim) but for a constant that does not depend on g, (n,)."""
        squares = np.sum(forward(self.root, g - self.mean) ** 2, axis=-1)
        log = np.log1p(squares / FREEDOM)
        return np.asarray(-0.5 * (FREEDOM + g.shape[-1]) * log)


class MixedModel:
    """Density of h, and Gaussians given h.

    h (n, dim) holds the logarithms of τ of the F free quantities (natural units), those of the
    effects' sd, and the coordinates of the laws' shapes, in this order. `choice` has the number of
    the law of each quantity that follows the actuation: one row (L,), or a row for each h, (n, L).

    The Gaussian likelihoods y (J, d), precision (J, d, d) are in prior units, the precision zero
    where a test tells nothing. The `weight` (J, F) of a free quantity of a test is the prior
    precision of its deviation over 1/τ².
    """

    def __init__(
        self, design: Design, y: Array, precision: Array, weight: Array | None = None
    ) -> None:
        self.design, self.y, self.p = design, y, precision
        self.free, effects = design.free, design.effects
        self.f, self.e = self.free.size, len(effects)
        self.dim = self.f + self.e + len(design.shapes)
        self.scale = np.concatenate([design.scatter_sd[self.free], [e.scale for e in effects]])
        self.weight = np.ones((len(y), self.f)) if weight is None else weight
        # columns of h that are moved side by side; the free quantities that know them, each of one
        # of the columns, and its number
        self.side_by_side = self._side_by_side()
        self.rows = np.stack([design.row(s) for s in design.settings])
        self.actuation = np.array([s.actuation for s in design.settings])
        # mean and covariance of the numbers of h by the choice of laws, once they were drawn
        self.adapted: dict[tuple[int, ...], tuple[Array, Array]] = {}
        cell_of_test = [design.cell_of(s) for s in design.settings]
        # whether each test is in the cell
        self.cells = [
            np.array([test_cell == cell for test_cell in cell_of_test]) for cell in design.cells
        ]
        covariance = design.level_covariance(design.cells, design.cells)
        level = np.linalg.inv(covariance + 1e-9 * np.eye(len(covariance)))
        self.effect_precision = [
            level if e.name == "level" else np.eye(len(e.homes)) for e in effects
        ]

    def _side_by_side(self) -> list[tuple[Index, Index, Index]]:
        """Columns of h by kind, in turn, with their free quantities and the owners of these."""
        free, shapes = self.free.tolist(), self.design.shapes
        kinds: dict[str, list[tuple[int, list[int]]]] = {
            "scatter": [(f, [f]) for f in range(self.f)]
        }
        for i, effect in enumerate(self.design.effects, self.f):
            members = [free.index(k) for k in effect.members]
            kinds.setdefault(effect.name, []).append((i, members))
        for i, (name, shape) in enumerate(shapes, self.f + self.e):
            k = self.design.names.index(name)
            if k in free:
                kinds.setdefault(shape, []).append((i, [free.index(k)]))
        return [
            (
                np.array([i for i, _ in pairs], dtype=np.intp),
                np.array([f for _, members in pairs for f in members], dtype=np.intp),
                np.repeat(np.arange(len(pairs)), [len(members) for _, members in pairs]),
            )
            for pairs in kinds.values()
            if pairs
        ]

    # --- parts of h -------------------------------------------------------------------------------

    def tau(self, h: Array) -> Array:
        """Scatter of the free quantities in prior units, (n, F)."""
        return np.exp(h[:, : self.f]) / self.design.spread[self.free]

    def sd(self, h: Array) -> Array:
        """The same of each test, with its weight, (n, J, F)."""
        return np.asarray(self.tau(h)[:, None] / np.sqrt(self.weight))

    def omega(self, h: Array) -> Array:
        """Sd of the effects, natural units, (n, E)."""
        return np.exp(h[:, self.f : self.f + self.e])

    def shapes(self, h: Array, choice: Index) -> tuple[Array, Array]:
        """Share and exponent of each law, (n, L) each."""
        return self.design.law_shapes(h[:, self.f + self.e :], choice)

    def offsets(self, h: Array, choice: Index) -> Array:
        """Laws at the tests, in prior units, (n, J, d)."""
        offsets = self.design.offsets(*self.shapes(h, choice), self.actuation)
        return np.where(self.design.informs, offsets, 0.0)

    def log_prior(self, h: Array) -> Array:
        """Log prior density of each coordinate of h, (n, dim), but for constants.

        Standard deviations are half-normal; the Jacobian of their logarithm is in it.
        """
        v, log = self.f + self.e, np.empty(h.shape)
        log[:, :v] = h[:, :v] - 0.5 * (np.exp(h[:, :v]) / self.scale) ** 2
        for i, (_, shape) in enumerate(self.design.shapes, v):
            log[:, i] = shape_prior(shape).log_density(h[:, i])
        return log

    def from_standard_normal(self, g: Array) -> Array:
        """Values of h for numbers g (n, dim): draws of its prior for standard normal numbers.

        Near such numbers the posterior is close to a Gaussian, which it is not near h.
        """
        h, v = np.empty(g.shape), self.f + self.e
        inside = special.ndtri(0.5 + 0.5 * special.ndtr(g[:, :v]))
        size = np.where(g[:, :v] < 0.0, inside, -special.ndtri(0.5 * special.ndtr(-g[:, :v])))
        h[:, :v] = np.log(np.maximum(size, 1e-9) * self.scale)
        for i, (_, shape) in enumerate(self.design.shapes):
            w = g[:, v + i]
            share = special.log_ndtr(w) - special.log_ndtr(-w)  # its logit
            h[:, v + i] = share if shape == "share" else EXPONENT[0] + EXPONENT[1] * w
        return np.clip(h, 1.0 - LARGEST, LARGEST - 1.0)

    def to_standard_normal(self, h: Array) -> Array:
        """Numbers g (n, dim) of values of h: the inverse of `from_standard_normal`."""
        g, v = np.empty(h.shape), self.f + self.e
        size = np.exp(h[:, :v]) / self.scale
        below = special.ndtri(np.maximum(2.0 * special.ndtr(size) - 1.0, 1e-300))
        above = -special.ndtri(np.maximum(2.0 * special.ndtr(-size), 1e-300))
        g[:, :v] = np.where(size < 1.0, below, above)
        for i, (_, shape) in enumerate(self.design.shapes):
            q = h[:, v + i]
            share = np.where(q < 0.0, 1.0, -1.0) * special.ndtri(special.expit(-np.abs(q)))
            g[:, v + i] = share if shape == "share" else (q - EXPONENT[0]) / EXPONENT[1]
        return g

    # --- Gaussians given h ------------------------------------------------------------------------

    def marginal(
        self, h: Array, choice: Index, tests: Sequence[int] | None = None
    ) -> tuple[Array, Coefficients]:
        """Log marginal likelihood of tests (all by default) given h, (n,), and z given these."""
        design, tau, omega = self.design, self.tau(h), self.omega(h)
        a, b = self.prior_precision(h), np.zeros((len(h), design.quantity.size))
        used = np.arange(len(self.y)) if tests is None else np.sort(np.asarray(tests, np.intp))
        precision, log_det = self._without_deviations(used, tau)
        residual = self.y[used] - self.offsets(h, choice)[:, used]
        pulled = (precision @ residual[..., None])[..., 0]
        total = -np.log(omega) @ np.array([design.columns(e).size for e in range(self.e)])
        total -= 0.5 * log_det.sum(axis=1) + used.size * np.log(tau).sum(axis=1)
        total += 0.5 * np.log(self.weight[used]).sum() - 0.5 * np.sum(
            residual * pulled, axis=(1, 2)
        )
        for cell in self.cells:  # its tests have the same columns
            js = np.flatnonzero(cell[used])
            active = np.flatnonzero(np.any(self.rows[used[js]], axis=0))
            q, row = design.quantity[active], self.rows[np.ix_(used[js], active)]
            b[:, active] += np.einsum("jm,njm->nm", row, pulled[:, js[:, None], q])
            grams = precision[:, js[:, None, None], q[:, None], q] * row[:, :, None] * row[:, None]
            a[:, active[:, None], active] += grams.sum(axis=1)
        factor = np.asarray(np.linalg.cholesky(a))
        u = forward(factor, b)
        total += 0.5 * np.sum(u**2, axis=1)
        total -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return total, Coefficients(backward(factor, u), factor)

    def log_tests(self, h: Array, z: Array, choice: Index) -> Array:
        """Log likelihood of each test given h and z, its deviations integrated out, (n, J)."""
        tau = self.tau(h)
        precision, log_det = self._without_deviations(np.arange(len(self.y)), tau)
        residual = self.y - self.offsets(h, choice) - self.design.linear(z, self.rows)
        squares = np.sum(residual * (precision @ residual[..., None])[..., 0], axis=-1)
        return np.asarray(-0.5 * (squares + log_det) - np.log(tau).sum(axis=1)[:, None])

    def prior_precision(self, h: Array) -> Array:
        """Precision of z before any test, (n, Z, Z)."""
        design, omega, z = self.design, self.omega(h), self.design.quantity.size
        a, columns = np.zeros((len(h), z, z)), np.arange(design.z_sd.size)
        a[:, columns, columns] = design.z_sd**-2.0
        for e, block in enumerate(self.effect_precision):
            for effect_columns in design.columns(e):
                a[:, effect_columns[:, None], effect_columns] = (
                    omega[:, e, None, None] ** -2.0 * block
                )
        return a

    def move_given_tests(
        self,
        h: Array,
        z: Array,
        x: Array,
        pooled: NDArray[np.bool_],
        choice: Index,
        step: Array,
        rng: np.random.Generator,
    ) -> tuple[Array, Array, Array]:
        """Move h and the free quantities' z by a Markov chain given the tests x (n, J, d).

        Random-walk Metropolis of h, with sds `step` (dim,) and z integrated out, then z from its
        Gaussian (collapsed Gibbs sampler: Liu, 1994). Given the tests, what belongs to different
        quantities is independent: scatters are moved side by side, and so are effects' sds, shares
        and exponents. `pooled` (J, F) are the quantities of tests that follow h and z. The steps
        are returned longer or shorter, as more or fewer moves than `ACCEPT_H` were accepted.
        """
        h, z, step, all_of_them = h.copy(), z.copy(), step.copy(), np.arange(self.f)
        log, prior = self._given_tests(h, x, pooled, choice, all_of_them)[0], self.log_prior(h)
        for columns, quantity, owner in self.side_by_side:
            moved = h.copy()
            moved[:, columns] += step[columns] * rng.standard_normal((len(h), columns.size))
            prior_moved = self.log_prior(moved)
            possible = (np.abs(moved) < LARGEST) & (prior_moved > FAINTEST)
            moved = np.where(possible, moved, h)  # beyond these limits h stays
            prior_moved = np.where(possible, prior_moved, prior)
            log_moved = self._given_tests(moved, x, pooled, choice, quantity)[0]
            ratio = (prior_moved - prior)[:, columns]
            ratio += (log_moved - log[:, quantity]) @ np.eye(columns.size)[owner]
            accepted = np.log(rng.random(ratio.shape)) < ratio
            h[:, columns] = np.where(accepted, moved[:, columns], h[:, columns])
            prior[:, columns] = np.where(accepted, prior_moved[:, columns], prior[:, columns])
            log[:, quantity] = np.where(accepted[:, owner], log_moved, log[:, quantity])
            step[columns] = tuned(step[columns], accepted.mean(axis=0), ACCEPT_H, STEPS)
        _, coefficients = self._given_tests(h, x, pooled, choice, all_of_them)
        for k, of_quantity in zip(self.free, coefficients, strict=True):
            z[:, self.design.quantity == k] = of_quantity.draw(rng)
        return h, z, step

    def _given_tests(
        self,
        h: Array,
        x: Array,
        pooled: NDArray[np.bool_],
        choice: Index,
        quantities: Index,
    ) -> tuple[Array, list[Coefficients]]:
        """Log marginal likelihood (n, q) of q free quantities of the tests, and z given these."""
        logs, coefficients = [], []
        prior, tau = self.prior_precision(h), self.tau(h)
        residual = (x - self.offsets(h, choice))[..., self.free]
        for f in quantities:
            columns = np.flatnonzero(self.design.quantity == self.free[f])
            precision = pooled[:, f] * self.weight[:, f] / tau[:, [f]] ** 2
            weighted = self.rows[:, columns].T * precision[:, None]
            inner = prior[:, columns[:, None], columns] + weighted @ self.rows[:, columns]
            factor = np.asarray(np.linalg.cholesky(inner), dtype=np.float64)
            u = forward(factor, np.einsum("nmj,nj->nm", weighted, residual[..., f]))
            effects = self.design.effect[columns]
            log = -np.count_nonzero(pooled[:, f]) * h[:, f]
            log -= h[:, self.f + effects[effects >= 0]].sum(axis=1)
            log -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
            log += 0.5 * np.sum(u**2, axis=1)
            logs.append(log - 0.5 * np.sum(precision * residual[..., f] ** 2, axis=1))
            coefficients.append(Coefficients(backward(factor, u), factor))
        return np.reshape(logs, (-1, len(h))).T, coefficients

    def _inner(self, js: Index, tau: Array) -> Array:
        """Precision of the deviations of tests js given the rest, (n, m, F, F)."""
        prior = self.weight[js] / tau[:, None] ** 2
        p = self.p[js][:, self.free][:, :, self.free]
        return p + prior[..., None] * np.eye(self.f)

    def _without_deviations(self, js: Index, tau: Array) -> tuple[Array, Array]:
        """Precision of A z + law of tests js, (n, m, d, d), and log determinants of `_inner`."""
        p, inner = self.p[js], self._inner(js, tau)
        across = np.broadcast_to(p[:, self.free], (len(tau), *p[:, self.free].shape))
        precision = p - p[:, :, self.free] @ np.linalg.solve(inner, across)
        return precision, np.asarray(np.linalg.slogdet(inner)[1])

    def deviations(self, h: Array, choice: Index, z: Array) -> tuple[Array, Array]:
        """Mean of the deviations given the rest, (n, J, F), and factors of their precision."""
        residual = self.y - self.offsets(h, choice) - self.design.linear(z, self.rows)
        pulled = np.einsum("jfa,nja->njf", self.p[:, self.free], residual)
        inner = self._inner(np.arange(len(self.y)), self.tau(h))
        return forward(inner, pulled), np.asarray(np.linalg.cholesky(inner))

    # --- sampling ---------------------------------------------------------------------------------

    def log_numbers(self, g: Array, choice: Index) -> Array:
        """Log posterior density of the numbers g (n, dim), (n,)."""
        densities = []
        for block in np.array_split(g, max(len(g) // 64, 1)):
            log = self.marginal(self.from_standard_normal(block), choice)[0] - 0.5 * np.sum(
                block**2, axis=1
            )
            densities.append(np.nan_to_num(log, nan=-1e9, neginf=-1e9))
        return np.concatenate(densities)

    def mode(self, choice: Index) -> Array:
        """Mode of the numbers by BFGS, its gradient by central differences, (dim,)."""
        from scipy import optimize  # which takes long to import

        if not self.dim:
            return np.zeros(0)
        step = 1e-4 * np.eye(self.dim)

        def loss(g: Array) -> tuple[float, Array]:
            f = -self.log_numbers(np.concatenate([g[None], g + step, g - step]), choice)
            ahead, back = np.split(f[1:], 2)
            return float(f[0]), (ahead - back) / 2e-4

        bounds, start = [(-FARTHEST, FARTHEST)] * self.dim, np.zeros(self.dim)
        return optimize.minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x

    def laplace(self, choice: Index) -> tuple[Array, Array]:
        """Laplace's Gaussian of the numbers: mode (dim,), and a root of the covariance."""
        mode, step = self.mode(choice), 0.05
        unit = step * np.eye(self.dim)
        i, k = np.triu_indices(self.dim)
        signs = [(a, b) for a in (1, -1) for b in (1, -1)]
        points = np.concatenate([mode + a * unit[i] + b * unit[k] for a, b in signs])
        f = self.log_numbers(points, choice).reshape(4, -1)
        hessian = np.zeros((self.dim, self.dim))
        hessian[i, k] = hessian[k, i] = (f[0] - f[1] - f[2] + f[3]) / (4.0 * step**2)
        values, vectors = np.linalg.eigh(-hessian)
        return mode, vectors / np.sqrt(np.maximum(values, 0.5))

    def importance_sample(
        self, choice: Index, rng: np.random.Generator, n: int = POINTS
    ) -> tuple[StudentTProposal, Array, Array]:
        """Student t near the posterior of the numbers; points of it (n, dim), log weights (n,).

        Its mean and covariance are adapted to the weighted points until these are worth enough
        (adaptive importance sampling: Oh and Berger, 1992), from those of the call before under
        the same laws, if there was any.
        """
        laws, rounds = tuple(choice.tolist()), ADAPTED
        if laws not in self.adapted:
            mode, root = self.laplace(choice) if self.dim else (np.zeros(0), np.zeros((0, 0)))
            self.adapted[laws], rounds = (mode, root @ root.T), ADAPTATIONS
        mean, covariance = self.adapted[laws]
        for _ in range(rounds):
            density = StudentTProposal(mean, SCALE * np.asarray(np.linalg.cholesky(covariance)))
            g = density.draw(rng, n)
            log = self.log_numbers(g, choice) - density.log_density(g)
            weight = special.softmax(log)
            size = 1.0 / np.sum(weight**2)
            if size >= ENOUGH * n:
                break
            before = 2.0 * self.dim  # points that what is known already counts for
            centre = weight @ g
            spread = (g - centre).T @ ((g - centre) * weight[:, None])
            mean = (size * centre + before * mean) / (size + before)
            covariance = np.asarray((size * spread + before * covariance) / (size + before))
        self.adapted[laws] = mean, covariance
        return density, g, log

    def find_outliers(self, choice: Index) -> None:
        """Set the weights of quantities of tests: contaminated normal scatter by EM.

        A hundredth of them scatter ten times as much as the others (Tukey, 1960), so that one wrong
        record hardly widens what is expected of others.
        """
        for _ in range(ROUNDS):
            h = self.from_standard_normal(self.mode(choice)[None])
            mean, factor = self.deviations(h, choice, self.marginal(h, choice)[1].mean)
            variance = np.linalg.inv(factor @ np.swapaxes(factor, -1, -2))
            squares = mean[0] ** 2 + np.diagonal(variance[0], axis1=1, axis2=2)
            squares = squares * self.design.spread[self.free] ** 2
            weighted = self.weight * squares
            other_tests = weighted.sum(axis=0) - weighted + 0.25 * self.scale[: self.f] ** 2
            ratio = squares / (other_tests / len(squares))
            odds = OUTLIER / WIDER * np.exp(np.minimum(0.5 * ratio * (1.0 - WIDER**-2), 700.0))
            weight = np.where(odds / (odds + 1.0 - OUTLIER) > 0.5, WIDER**-2, 1.0)
            if np.array_equal(weight, self.weight):
                return
            self.weight = weight


def tuned(
    step: Array | float, share: Array | float, target: float, limits: tuple[float, float]
) -> Array:
    """Step sizes, longer where more than the target share of moves was accepted."""
    return np.clip(step * np.exp(TUNING * (share - target)), *limits)


def forward(a: Array, b: Array) -> Array:
    """a⁻¹ b of matrices (..., m, m) and vectors (..., m)."""
    return np.asarray(np.linalg.solve(a, b[..., None])[..., 0])


def backward(factor: Array, u: Array) -> Array:
    """factor⁻ᵀ u."""
    return forward(np.swapaxes(factor, -1, -2), u)


# --- scores ---------------------------------------------------------------------------------------

QUADRATURE = 1024  # points at which scatter and shapes are integrated
FOLDS = 10  # most parts of the tests that are left out in turn to score a covariate


@dataclass(frozen=True, eq=False)
class TestGaussians:
    """Gaussian likelihoods of the tests' free quantities given the common ones."""

    design: Design
    mean: Array  # (J, d): in prior units; those of common quantities are not used
    variance: Array

    __test__ = False  # pytest is not to collect it

    @classmethod
    def given_common(cls, design: Design, y: Array, precision: Array, mode: Array) -> TestGaussians:
        """From likelihoods (J, d), (J, d, d), with the common quantities at a mode (d,)."""
        free_indices, common = design.free, np.flatnonzero(design.common)
        inner = precision[:, free_indices][:, :, free_indices] + 1e-6 * np.eye(free_indices.size)
        distance = (y[:, common] - mode[common])[..., None]
        shift = np.linalg.solve(inner, precision[:, free_indices][:, :, common] @ distance)[..., 0]
        mean, variance = y.copy(), np.ones_like(y)
        mean[:, free_indices] += shift
        variance[:, free_indices] = np.diagonal(np.linalg.inv(inner), axis1=1, axis2=2)
        return cls(design, mean, variance)

    def densities(
        self,
        name: str,
        law: str,
        folds: Sequence[Sequence[int]],
        follows: Sequence[str] | None = None,
        *,
        leveled: bool = False,
    ) -> tuple[Array, Array]:
        """Log densities of a quantity's tests, all and without each fold, under a law by itself.

        They are (n, 1 + folds), with log weights that make their points h (n, dim) stand for the
        prior. `follows` are covariates instead of the design's.
        """
        k = [self.design.names.index(name)]
        follows = self.design.dependence.get(name, ()) if follows is None else follows
        design = replace(
            self.design,
            names=(name,),
            spread=self.design.spread[k],
            laws={name: law},
            dependence={name: tuple(follows)} if follows else {},
            scatter_sd=self.design.scatter_sd[k],
            common=np.zeros(1, dtype=bool),
            leveled=leveled,
        )
        y, variance, informs = self.mean[:, k], self.variance[:, k[0]], design.informs[:, 0]
        precision = np.where(informs, 1.0 / variance, 0.0)
        mixed = MixedModel(design, y, precision[:, None, None])
        choice = np.array([LAW_NAMES.index(law)])
        # half of the points are of the prior, and half of Laplace's Gaussian, half as wide again
        mode, root = mixed.laplace(choice)
        root, dim = 1.5 * root, mixed.dim
        from scipy.stats import qmc  # which takes long to import

        u = np.clip(qmc.Sobol(max(dim, 1), seed=0).random(QUADRATURE)[:, :dim], 1e-9, 1.0 - 1e-9)
        g = special.ndtri(u)
        g[QUADRATURE // 2 :] = mode + g[QUADRATURE // 2 :] @ root.T
        log_t = -0.5 * np.sum(np.linalg.solve(root, (g - mode).T) ** 2, axis=0)
        log_t -= np.linalg.slogdet(root)[1]
        prior = -0.5 * np.sum(g**2, axis=1)
        h, weight = mixed.from_standard_normal(g), prior - np.logaddexp(prior, log_t) + np.log(2.0)
        all_tests = set(range(len(y)))
        training_sets = [sorted(all_tests - set(fold)) for fold in ((), *folds)]
        log = np.stack(
            [weight + mixed.marginal(h, choice, tests)[0] for tests in training_sets], axis=1
        )
        # where the law has no value the quantity has the prior of a test by itself, N(0, 1)
        total = 1.0 + variance
        single = -0.5 * (y[:, 0] ** 2 / total + np.log(total / variance))
        single[informs] = 0.0
        return log + np.array([single[tests].sum() for tests in training_sets]), h

    def scores(
        self,
        name: str,
        law: str,
        folds: Sequence[Sequence[int]],
        follows: Sequence[str] | None = None,
    ) -> tuple[Array, float]:
        """Log predictive density of each fold given the others, (folds,), and Pareto k."""
        log = self.densities(name, law, folds, follows)[0]
        sums = special.logsumexp(log, axis=0)
        return sums[0] - sums[1:], max(psis(column)[1] for column in log.T)


def compare_laws(tests: TestGaussians) -> tuple[LawScore, ...]:
    """Score of every law for each quantity that follows the actuation, each level left out in turn.

    Empty where tests are at fewer than `LEVELS` levels. With tests at zero actuation, laws that
    have no value there have no weight.
    """
    design = tests.design
    folds = levels_of(design.settings)
    if len(folds) < LEVELS:
        return ()
    scores = []
    allowed = [law in design.considered(COMPARE) for law in LAWS]
    for name in design.laws:
        pairs = [tests.scores(name, law, folds) for law in LAWS]
        trusted = np.array([not k > LARGEST_K for _, k in pairs]) & allowed
        weights = np.zeros(len(LAWS))
        if np.any(trusted):
            weights[trusted] = stack(np.array([terms for terms, _ in pairs])[trusted].T)
        for law, (terms, k), weight in zip(LAWS, pairs, weights, strict=True):
            total, se, elpd_of_fold = float(terms.sum()), _error(terms), tuple(terms.tolist())
            scores.append(LawScore(name, law, total, se, float(weight), elpd_of_fold, float(k)))
    return tuple(scores)


def extrapolation_weights(tests: TestGaussians, names: Sequence[str], laws: Sequence[str]) -> Array:
    """Weights of laws by how well they predict the lowest and the highest level, (laws,).

    Stacking of the two folds, for some quantities together, with a prior worth one fold: two
    levels do not rule a law out. With fewer than `LEVELS` levels, equal weights.
    """
    loaded = [j for j, s in enumerate(tests.design.settings) if s.actuation > 0]
    levels = levels_of([tests.design.settings[j] for j in loaded])
    if len(levels) < LEVELS or not names:
        return np.full(len(laws), 1.0 / len(laws))
    ends = [[loaded[j] for j in levels[end]] for end in (0, -1)]
    terms = [np.concatenate([tests.scores(n, law, ends)[0] for n in names]) for law in laws]
    return stack(np.array(terms).T, prior=1.0)


def compare_dependence(tests: TestGaussians) -> tuple[DependenceScore, ...]:
    """Scores of dependences on speed or stroke, parts of the tests left out in turn.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or where no covariate varies.
    """
    design = tests.design
    varied = [c for c in COVARIATES if varies(design.settings, c)]
    count = len(design.settings)
    if count < TESTS or not varied:
        return ()
    n_folds = min(count, FOLDS)
    folds = [range(i, count, n_folds) for i in range(n_folds)]
    scores = []
    for name, law in design.laws.items():
        law = "power" if law == COMPARE else law
        terms = {c: tests.scores(name, law, folds, [c] if c else [])[0] for c in ("", *varied)}
        for c, values in terms.items():
            better = values - terms[""]
            total, difference = float(values.sum()), float(better.sum())
            scores.append(DependenceScore(name, c, total, difference, _error(better)))
    return tuple(scores)


def free_exponents(tests: TestGaussians) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    Levels may deviate from the law as in predictions: the exponent is known no better than the
    number of levels allows. Empty where no law is proportional, or at fewer than `LEVELS` levels
    above zero.
    """
    design = tests.design
    if len(levels_of([s for s in design.settings if s.actuation > 0])) < LEVELS:
        return {}
    exponents = {}
    for name in (n for n, law in design.laws.items() if law == "proportional"):
        log, h = tests.densities(name, "power", [], leveled=True)
        order = np.argsort(h[:, -1])  # the exponent
        mass = np.cumsum(special.softmax(log[:, 0])[order])
        low, middle, high = np.interp([0.025, 0.5, 0.975], mass, h[order, -1])
        exponents[name] = (float(low), float(middle), float(high))
    return exponents


def stack(scores: Array, prior: float = 0.0) -> Array:
    """Stacking weights: those of the mixture that predicts best (Yao et al., 2018), (laws,)."""
    from scipy import optimize  # which takes long to import

    laws = scores.shape[1]
    level = np.exp(scores - scores.max(axis=1, keepdims=True))

    def loss(q: Array) -> float:
        gain = np.log(level @ special.softmax(q)).sum() + prior * special.log_softmax(q).mean()
        return -float(gain)

    starts = [np.zeros(laws), *(3.0 * np.eye(laws))]
    best = min((optimize.minimize(loss, start) for start in starts), key=lambda fit: fit.fun)
    weights = special.softmax(best.x)
    rounded = np.where(weights < 0.01, 0.0, weights)
    return np.asarray(rounded / rounded.sum())


def _error(terms: Array) -> float:
    """Standard error of the sum of terms."""
    return float(np.sqrt(len(terms)) * terms.std(ddof=1)) if len(terms) > 1 else 0.0
