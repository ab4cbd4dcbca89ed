"""Linear mixed model of the tests, each known by a Gaussian likelihood (a two-stage model).

The coordinates of test j are x_j = A_j z + law(h)_j + d_j with d_j ~ N(0, diag τ²), and its
likelihood is N(y_j, P_j⁻¹). Given the variance parameters and the shapes of the laws, together h,
all is Gaussian and is integrated in closed form: first the deviations d_j, then the coefficients z
(levels, slopes on covariates, effects). The few h are drawn by importance sampling from the
marginal likelihood times their prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special
from scipy.stats import qmc

from mfd_bayes.population.design import Design
from mfd_bayes.population.laws import EXPONENT, log_shape_prior

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LARGEST = 12.0
"""Largest size of a coordinate of h."""

ODD, WIDER = 0.01, 10.0
"""Probability that a quantity of a test stands apart from the others, and its scatter over
theirs."""

POINTS, ENOUGH, ADAPTATIONS = 3000, 1000, 6
"""Points of an importance sample of h, the effective number that is enough, and most rounds."""

FREEDOM, SCALE = 7, 1.1
"""Degrees of freedom of the points, and their scale over that of the density that they are for."""

FARTHEST = 7.0
"""Largest standard normal number of the mode of h."""

ROUNDS = 4
"""Largest number of rounds of expectation-maximisation of what stands apart."""


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Gaussian of the coefficients z given rows of h: mean (n, Z), Cholesky factor of precision."""

    mean: Array
    factor: Array

    def draw(self, rng: np.random.Generator) -> Array:
        """A draw for each row, (n, Z)."""
        return self.mean + _back(self.factor, rng.standard_normal(self.mean.shape))


class MixedModel:
    """Density of h, and Gaussians given h.

    h holds the logarithms of τ of the F free quantities (natural units), those of the effects' sd,
    and the coordinates of the laws' shapes, in this order.

    Parameters
    ----------
    design : Design
    y, precision : (J, d), (J, d, d)
        Gaussian likelihoods in prior units; zero precision where a test tells nothing.
    """

    def __init__(self, design: Design, y: Array, precision: Array) -> None:
        self.design, self.y, self.p = design, y, precision
        self.free, effects = design.free, design.effects
        self.f, self.e = self.free.size, len(effects)
        self.dim = self.f + self.e + len(design.shapes)
        self.spread = design.spread
        self.scale = np.concatenate([design.scatter_sd[self.free], [e.scale for e in effects]])
        self.weight = np.ones((len(y), self.f))
        self.rows = np.stack([design.row(s) for s in design.settings])
        self.actuation = np.array([s.actuation for s in design.settings])
        cells: dict[tuple[str, float], list[int]] = {}
        for j, setting in enumerate(design.settings):
            cells.setdefault(design.cell_of(setting), []).append(j)
        self.cells = [np.array(tests) for tests in cells.values()]
        covariance = design.level_covariance(design.cells, design.cells)
        self.level_precision = np.linalg.inv(covariance + 1e-9 * np.eye(len(covariance)))

    # --- parts of h ---------------------------------------------------------------------------

    def tau(self, h: Array) -> Array:
        """Scatter of the free quantities in prior units, (n, F)."""
        return np.asarray(np.exp(h[:, : self.f]) / self.spread[self.free])

    def omega(self, h: Array) -> Array:
        """Sd of the effects, natural units, (n, E)."""
        return np.asarray(np.exp(h[:, self.f : self.f + self.e]))

    def offsets(self, h: Array, choice: Index) -> Array:
        """Laws at the tests, in prior units, (n, J, d)."""
        shapes = self.design.law_shapes(h[:, self.f + self.e :], choice)
        found = self.design.offsets(*shapes, self.actuation)
        return np.where(self.design.informs, found, 0.0)

    def log_prior(self, h: Array) -> Array:
        """Log prior density of h without constants, (n,): half-normal sds, with their Jacobian."""
        v = self.f + self.e
        total = np.sum(h[:, :v] - 0.5 * (np.exp(h[:, :v]) / self.scale) ** 2, axis=1)
        for i, (_, shape) in enumerate(self.design.shapes):
            total += log_shape_prior(shape, h[:, v + i])
        return np.asarray(total)

    def of_numbers(self, g: Array) -> Array:
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

    # --- Gaussians given h ------------------------------------------------------------------------

    def _prior_precision(self, omega: Array) -> Array:
        """Prior precision of z, (n, Z, Z)."""
        design = self.design
        z = design.quantity.size
        found = np.zeros((len(omega), z, z))
        plain = np.flatnonzero(design.effect < 0)
        found[:, plain, plain] = design.z_sd[plain] ** -2.0
        for e, effect in enumerate(design.effects):
            block = self.level_precision if effect.name == "level" else np.eye(len(design.sessions))
            own = np.flatnonzero(design.effect == e).reshape(len(effect.members), -1)
            for columns in own:
                at = np.ix_(np.arange(len(omega)), columns, columns)
                found[at] = omega[:, e, None, None] ** -2.0 * block
        return found

    def marginal(
        self, h: Array, choice: Index, tests: Sequence[int] | None = None
    ) -> tuple[Array, Coefficients]:
        """Log marginal likelihood of tests (all by default) given h, (n,), and z given these."""
        design, tau, omega = self.design, self.tau(h), self.omega(h)
        used = set(range(len(self.y)) if tests is None else tests)
        offsets, n = self.offsets(h, choice), len(h)
        a = self._prior_precision(omega)
        counts = np.array([np.count_nonzero(design.effect == e) for e in range(self.e)])
        total = -np.log(omega) @ counts
        b = np.zeros((n, design.quantity.size))
        for cell in self.cells:
            js = np.array([j for j in cell.tolist() if j in used], dtype=np.intp)
            if not js.size:
                continue
            active = np.flatnonzero(np.any(self.rows[js], axis=0))
            q, row = design.quantity[active], self.rows[np.ix_(js, active)]
            known, log_density = self._deviations_out(js, tau)
            left = self.y[js] - offsets[:, js]
            pulled = np.einsum("njab,njb->nja", known, left)
            total += log_density - 0.5 * np.einsum("nja,nja->n", left, pulled)
            b[:, active] += np.einsum("jm,njm->nm", row, pulled[:, :, q])
            grams = known[:, :, q[:, None], q]
            at = np.ix_(np.arange(n), active, active)
            a[at] += np.einsum("jml,njml->nml", row[:, :, None] * row[:, None], grams)
        factor = np.asarray(np.linalg.cholesky(a))
        u = _forward(factor, b)
        total += 0.5 * np.sum(u**2, axis=1)
        total -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return total, Coefficients(_back(factor, u), factor)

    def _deviations_out(self, js: Index, tau: Array) -> tuple[Array, Array]:
        """Precision of A z + law without the deviations of tests js, (n, m, d, d), and its log."""
        p, free = self.p[js], self.free
        inner = self._inner(js, tau)
        across = np.broadcast_to(p[:, free], (len(tau), *p[:, free].shape))
        known = p - p[:, :, free] @ np.linalg.solve(inner, across)
        log = -0.5 * np.linalg.slogdet(inner)[1].sum(axis=1) - js.size * np.log(tau).sum(axis=1)
        return known, log + 0.5 * np.log(self.weight[js]).sum()

    def _inner(self, js: Index, tau: Array) -> Array:
        """Precision of the deviations of tests js given the rest, (n, m, F, F)."""
        prior = self.weight[js] / tau[:, None] ** 2
        return np.asarray(
            self.p[js][:, self.free][:, :, self.free] + prior[..., None] * np.eye(self.f)
        )

    def deviations(self, h: Array, choice: Index, z: Array) -> tuple[Array, Array]:
        """Mean of the deviations given the rest, (n, J, F), and factors of their precision."""
        left = self.y - self.offsets(h, choice) - self.fixed(z)
        pulled = np.einsum("jfa,nja->njf", self.p[:, self.free], left)
        inner = self._inner(np.arange(len(self.y)), self.tau(h))
        mean = np.asarray(np.linalg.solve(inner, pulled[..., None])[..., 0])
        return mean, np.asarray(np.linalg.cholesky(inner))

    def fixed(self, z: Array) -> Array:
        """Levels, covariates and effects of the tests, A z, (n, J, d)."""
        found = np.zeros((len(z), *self.y.shape))
        for k in range(self.y.shape[1]):
            own = self.design.quantity == k
            found[..., k] = z[:, own] @ self.rows[:, own].T
        return found

    # --- sampling ---------------------------------------------------------------------------------

    def log_prob(self, h: Array, choice: Index, tests: Sequence[int] | None = None) -> Array:
        """Log posterior density of h given tests, (n,); choice is one row or a row for each."""
        h = np.atleast_2d(h)
        inside = np.all(np.abs(h) < LARGEST, axis=1)
        found = np.full(len(h), -np.inf)
        if np.any(inside):
            rows = np.broadcast_to(choice, (len(h), choice.shape[-1]))[inside]
            found[inside] = self.log_prior(h[inside]) + self.marginal(h[inside], rows, tests)[0]
        return np.where(np.isnan(found), -np.inf, found)

    def _log_numbers(self, g: Array, choice: Index) -> Array:
        """Log posterior density of the numbers g (n, dim), (n,)."""
        found = []
        for part in np.array_split(g, max(len(g) // 64, 1)):
            rows = np.broadcast_to(choice, (len(part), choice.shape[-1]))
            log = self.marginal(self.of_numbers(part), rows)[0] - 0.5 * np.sum(part**2, axis=1)
            found.append(np.nan_to_num(log, nan=-1e9, neginf=-1e9))
        return np.concatenate(found)

    def _mode(self, choice: Index) -> Array:
        """Mode of the numbers by BFGS, its gradient by central differences, (dim,)."""
        step = 1e-4 * np.eye(self.dim)

        def loss(g: Array) -> tuple[float, Array]:
            f = -self._log_numbers(np.concatenate([g[None], g + step, g - step]), choice)
            up, down = np.split(f[1:], 2)
            return float(f[0]), (up - down) / 2e-4

        bounds, start = [(-FARTHEST, FARTHEST)] * self.dim, np.zeros(self.dim)
        found = optimize.minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        return np.asarray(found.x)

    def mode(self, choice: Index) -> Array:
        """The h at the mode of its numbers, (dim,)."""
        return self.of_numbers(self._mode(choice)[None])[0] if self.dim else np.zeros(0)

    def gaussian(self, choice: Index) -> tuple[Array, Array]:
        """Mode of the numbers, (dim,), and a root of the covariance there, (dim, dim) (Laplace)."""
        mode, step = self._mode(choice), 0.05
        unit = step * np.eye(self.dim)
        i, k = np.triu_indices(self.dim)
        signs = [(a, b) for a in (1, -1) for b in (1, -1)]
        points = np.concatenate([mode + a * unit[i] + b * unit[k] for a, b in signs])
        f = self._log_numbers(points, choice).reshape(4, -1)
        hessian = np.zeros((self.dim, self.dim))
        hessian[i, k] = hessian[k, i] = (f[0] - f[1] - f[2] + f[3]) / (4.0 * step**2)
        values, vectors = np.linalg.eigh(-hessian)
        return mode, vectors / np.sqrt(np.maximum(values, 0.5))

    def laplace(self, choice: Index, rng: np.random.Generator, n: int) -> Array:
        """Draws of h from that Gaussian, (n, dim)."""
        mode, root = self.gaussian(choice)
        return self.of_numbers(mode + rng.standard_normal((n, self.dim)) @ root.T)

    def near_and_far(self, choice: Index, n: int) -> tuple[Array, Array]:
        """Points of h, (n, dim), and log weights that make them stand for the prior, (n,).

        Half of them are of the prior, and half of Laplace's Gaussian, half as wide again.
        """
        mode, root = self.gaussian(choice)
        root = 1.5 * root
        u = np.clip(qmc.Sobol(max(self.dim, 1), seed=0).random(n)[:, : self.dim], 1e-9, 1.0 - 1e-9)
        g = special.ndtri(u)
        g[n // 2 :] = mode + g[n // 2 :] @ root.T
        numbers = np.linalg.solve(root, (g - mode).T)
        log = -0.5 * np.sum(numbers**2, axis=0) - np.linalg.slogdet(root)[1]
        prior = -0.5 * np.sum(g**2, axis=1)
        return self.of_numbers(g), prior - np.logaddexp(prior, log) + np.log(2.0)

    def sample(self, choice: Index, rng: np.random.Generator, n: int) -> Array:
        """Draws of h, (n, dim), by importance resampling; choice is one row (L,).

        The numbers are of a multivariate t near the mode. Its mean and covariance are adapted to
        the weighted points until these are worth enough (adaptive importance sampling: Oh and
        Berger, 1992).
        """
        if not self.dim:
            return np.zeros((n, 0))
        mean, root = self.gaussian(choice)
        covariance: Array = root @ root.T
        for _ in range(ADAPTATIONS):
            root = np.asarray(np.linalg.cholesky(covariance))
            y = rng.standard_normal((POINTS, self.dim))
            y /= np.sqrt(rng.chisquare(FREEDOM, (POINTS, 1)) / FREEDOM)
            g = mean + SCALE * y @ root.T
            log = 0.5 * (FREEDOM + self.dim) * np.log1p(np.sum(y**2, axis=1) / FREEDOM)
            weight = special.softmax(self._log_numbers(g, choice) + log)
            size = 1.0 / np.sum(weight**2)
            if size >= ENOUGH:
                break
            before = 2.0 * self.dim  # points that what is known already counts for
            centre = weight @ g
            spread = (g - centre).T @ ((g - centre) * weight[:, None])
            mean = (size * centre + before * mean) / (size + before)
            covariance = np.asarray((size * spread + before * covariance) / (size + before))
        # systematic resampling
        place = np.searchsorted(np.cumsum(weight), (rng.random() + np.arange(n)) / n)
        return self.of_numbers(g[np.minimum(place, POINTS - 1)])

    def set_apart(self, choice: Index) -> None:
        """Weights of quantities of tests that stand apart: contaminated normal scatter by EM.

        A hundredth of them scatter ten times as much as the others (Tukey, 1960), so that one wrong
        record hardly widens what is expected of others.
        """
        for _ in range(ROUNDS):
            h = self.mode(choice)[None]
            rows = np.broadcast_to(choice, (1, choice.shape[-1]))
            z = self.marginal(h, rows)[1].mean
            mean, factor = self.deviations(h, rows, z)
            variance = np.linalg.inv(factor @ np.swapaxes(factor, -1, -2))
            squares = mean[0] ** 2 + np.diagonal(variance[0], axis1=1, axis2=2)
            squares = squares * self.spread[self.free] ** 2
            inside = self.weight * squares
            others = inside.sum(axis=0) - inside + 0.25 * self.scale[: self.f] ** 2
            ratio = squares / (others / len(squares))
            odds = ODD / WIDER * np.exp(np.minimum(0.5 * ratio * (1.0 - WIDER**-2), 700.0))
            weight = np.where(odds / (odds + 1.0 - ODD) > 0.5, WIDER**-2, 1.0)
            if np.array_equal(weight, self.weight):
                return
            self.weight = weight


def _forward(factor: Array, b: Array) -> Array:
    """factor⁻¹ b of lower factors (..., m, m) and vectors (..., m)."""
    return np.asarray(np.linalg.solve(factor, b[..., None])[..., 0])


def _back(factor: Array, u: Array) -> Array:
    """factor⁻ᵀ u."""
    return np.asarray(np.linalg.solve(np.swapaxes(factor, -1, -2), u[..., None])[..., 0])


def without(y: Array, precision: Array, own: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Gaussian likelihood (D,), (D, D) with some coordinates integrated over N(0, 1).

    Their precision is then zero.
    """
    kept, rest = np.flatnonzero(~own), np.flatnonzero(own)
    pull = precision @ y
    gain = np.linalg.solve(
        precision[np.ix_(rest, rest)] + np.eye(rest.size), precision[np.ix_(rest, kept)]
    ).T
    reduced = precision[np.ix_(kept, kept)] - gain @ precision[np.ix_(rest, kept)]
    found, mean = np.zeros_like(precision), np.zeros_like(y)
    found[np.ix_(kept, kept)] = 0.5 * (reduced + reduced.T)
    mean[kept] = np.linalg.solve(reduced, pull[kept] - gain @ pull[rest])
    return mean, found
