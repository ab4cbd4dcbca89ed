"""Linear-Gaussian populations, with reference results by brute force, and one of given values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from mfd_bayes.population.test_likelihood import TestLikelihood
from numpy.typing import NDArray
from scipy import linalg, special

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.prior_files import PriorFile, load_priors
from mfd_bayes.population.design import Layout, lay_out
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting

Array = NDArray[np.float64]


@pytest.fixture(scope="session")
def priors() -> PriorFile:
    return load_priors("mfd")


def gaussian_test(mean: Array, covariance: Array) -> TestLikelihood:
    """A test with a Gaussian likelihood as a plain function."""
    precision = np.linalg.inv(covariance)

    def log_likelihood(x: Array) -> Array:
        away = x - mean
        return np.asarray(-0.5 * np.einsum("ni,ij,nj->n", away, precision, away))

    return TestLikelihood(log_likelihood, lambda own: np.zeros(len(own)), mean, covariance)


@dataclass(frozen=True, eq=False)
class Squares:
    """A Gaussian likelihood as a sum of squares, so that it may have a surrogate."""

    mean: Array
    root: Array

    def __call__(self, x: Array) -> Array:
        return self.by_squares(x, np.sum(self.standard(x) ** 2, axis=1))

    def standard(self, x: Array) -> Array:
        return np.asarray((x - self.mean) @ self.root)

    def by_squares(self, x: Array, squares: Array) -> Array:
        return -0.5 * squares


def squared(test: TestLikelihood) -> TestLikelihood:
    """The test with its Gaussian as a sum of squares."""
    return replace(test, log_likelihood=Squares(test.mean, test.root))


@dataclass(frozen=True, eq=False)
class Moments:
    """Means and sds of all quantities, and exact draws of h (log scatter, log effect sd), u, x."""

    mean: dict[str, Array]
    sd: dict[str, Array]
    h: Array
    u: Array
    x: Array


@dataclass(frozen=True, eq=False)
class Linear:
    """Tests with data y_j = x_j + e_j and x_j by `Layout`: power laws, Gaussian scatter.

    u holds the d levels, the effects of the first quantity at each actuation, and its exponent,
    all standardised to N(0, 1).
    """

    layout: Layout
    y: Array
    covariances: Array

    @property
    def actuations(self) -> Array:
        return np.array([s.actuation for s in self.layout.settings])

    def likelihoods(self) -> list[TestLikelihood]:
        return [gaussian_test(*told) for told in zip(self.y, self.covariances, strict=True)]

    def _design(self, omega: Array) -> tuple[Array, Array]:
        """Offsets (J, d), and design matrices from u to tests, by effect sd, (n, J, d, u)."""
        count, d = self.y.shape
        follows = bool(self.layout.laws)
        out = ~self.layout.informs  # these have their own prior, N(0, 1)
        cells, home = np.unique(self.actuations, return_inverse=True)
        parts = cells.size if self.layout.effects else 0
        design = np.zeros((len(omega), count, d, d + parts + follows))
        design[:, :, range(d), range(d)] = 1.0
        offsets = np.zeros((count, d))
        if follows:
            relative = np.where(out[:, 0], 1.0, self.actuations / self.layout.reference)
            folds = np.log(relative) / self.layout.spread[0]
            offsets[:, 0] = folds  # exponent 1 + u/2
            design[:, :, 0, -1] = 0.5 * folds
        if parts:
            distance = np.abs(np.log(cells[:, None] / cells))
            # Matérn of order 3/2 by Bessel's K, not by its closed form
            far = np.sqrt(3.0) * np.maximum(distance, 1e-9) / np.log(2.0)
            root = np.linalg.cholesky(np.sqrt(2 / np.pi) * far**1.5 * special.kv(1.5, far))
            scaled = omega / self.layout.spread[0]
            above = cells[cells > 0]
            with np.errstate(divide="ignore"):  # in inverse proportion, from half to twice
                sizes = np.clip(np.prod(above) ** (1.0 / above.size) / cells, 0.5, 2.0)
            root = sizes[:, None] * root
            design[:, :, 0, d : d + parts] = scaled[:, None, None] * root[home]
        design[:, out] = 0.0
        return offsets, design

    def conditional(self, h: Array) -> tuple[Array, Array, Array]:
        """Log density of y, joint mean and covariance of u and x (flattened), given log sds.

        `h` is (n, sds): log sds of the scatter, and of the effects if there are any. The density
        is (n,), the means are (n, m) and the covariances (n, m, m).
        """
        n, (count, d) = len(h), self.y.shape
        offsets, design = self._design(np.exp(h[:, -1]))
        a = design.reshape(n, count * d, -1)
        u = a.shape[2]
        noise = linalg.block_diag(*self.covariances)
        prior = a @ a.swapaxes(1, 2)
        each = np.arange(count * d)
        spread = np.tile((np.exp(h[:, :d]) / self.layout.spread) ** 2, (1, count))
        prior[:, each, each] += np.where(self.layout.informs.ravel(), spread, 1.0)
        everything = np.zeros((n, u + count * d, u + count * d))
        everything[:, range(u), range(u)] = 1.0
        everything[:, u:, :u], everything[:, :u, u:] = a, a.swapaxes(1, 2)
        everything[:, u:, u:] = prior
        with_y = everything[:, :, u:]
        away = (self.y - offsets).reshape(-1)
        root = np.linalg.cholesky(prior + noise)
        white = np.linalg.solve(root, np.broadcast_to(away[:, None], (n, away.size, 1)))[..., 0]
        density = -0.5 * (np.sum(white**2, axis=1) + away.size * np.log(2.0 * np.pi))
        density -= np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        gain = np.linalg.solve(prior + noise, with_y.swapaxes(1, 2)).swapaxes(1, 2)
        mean = gain @ away
        mean[:, u:] += offsets.reshape(-1)
        return density, mean, everything - gain @ with_y.swapaxes(1, 2)

    def solve(self, rng: np.random.Generator, n: int = 4096, points: int = 40) -> Moments:
        """Moments by a grid over log scatter and log effect sd, and n exact draws."""
        d = self.y.shape[1]
        effects = len(self.layout.effects)
        wider = 2.0 * self.layout.scatter_sd[:1].repeat(effects)  # levels deviate by more
        scales = np.append(self.layout.scatter_sd, wider)
        axis = np.linspace(-6.0, 1.5, points)  # of the log of an sd over its prior's scale
        grid = np.array(list(product(axis, repeat=d + effects))) + np.log(scales)
        weight, means, covariances = self.conditional(grid)
        size = np.exp(grid) / scales
        sparse = np.append(self.layout.sparse, np.zeros(effects)).astype(bool)
        weight += np.sum(grid - np.where(sparse, size, 0.5 * size**2), axis=1)
        weight = special.softmax(weight)
        variances = np.diagonal(covariances, axis1=1, axis2=2)
        mean = weight @ means
        var = weight @ (variances + means**2) - mean**2
        u = means.shape[1] - self.y.size
        sds = np.exp(grid)
        h_mean, u_mean, x_mean = weight @ sds, mean[:u], mean[u:].reshape(self.y.shape)
        h_sd = np.sqrt(weight @ sds**2 - h_mean**2)
        u_sd, x_sd = np.sqrt(var[:u]), np.sqrt(var[u:]).reshape(self.y.shape)
        picks = rng.choice(len(grid), size=n, p=weight)
        step = axis[1] - axis[0]
        h = grid[picks] + step * (rng.random((n, d + effects)) - 0.5)
        _, middle, spread = self.conditional(h)
        values, vectors = np.linalg.eigh(spread)
        root = vectors * np.sqrt(np.abs(values))[:, None, :]
        drawn = middle + np.einsum("nij,nj->ni", root, rng.standard_normal(middle.shape))
        return Moments(
            {"sd": h_mean, "u": u_mean, "x": x_mean},
            {"sd": h_sd, "u": u_sd, "x": x_sd},
            h,
            drawn[:, :u],
            drawn[:, u:].reshape(n, *self.y.shape),
        )


@pytest.fixture(scope="session", name="squared")
def _squared() -> Callable[[TestLikelihood], TestLikelihood]:
    return squared


@pytest.fixture(scope="session", name="gaussian_test")
def _gaussian_test() -> Callable[..., TestLikelihood]:
    return gaussian_test


@pytest.fixture(scope="session")
def make_linear(priors: PriorFile) -> Callable[..., Linear]:
    def make(
        actuations: Sequence[float],
        names: Sequence[str],
        *,
        level: float = 0.4,
        noise: float = 0.5,
        seed: int = 1,
    ) -> Linear:
        """A campaign in which the noise of every test, relative to the scatter, is not small."""
        laws = {"Fc_fwd": "power"} if "Fc_fwd" in names else {}
        settings = [Setting(p) for p in actuations]
        layout = replace(lay_out(priors, names, settings, laws), odd=0.0)
        rng = np.random.default_rng(seed)
        d, count = len(names), len(actuations)
        tau = 0.5 * layout.scatter_sd / layout.spread
        x = level * rng.choice([-1.0, 1.0], d) + tau * rng.standard_normal((count, d))
        if laws:
            relative = np.maximum(actuations, 0.02) / layout.reference
            x[:, 0] += 0.8 * np.log(relative) / layout.spread[0]
        covariances = []
        for _ in range(count):
            root = rng.standard_normal((d, d + 2))
            told = noise**2 * np.outer(tau, tau)
            covariances.append(told * (root @ root.T) / (d + 2))
        errors = [rng.multivariate_normal(np.zeros(d), c) for c in covariances]
        return Linear(layout, x + errors, np.array(covariances))

    return make


# --- a population with given values, not sampled

MEDIANS = {
    "sigma0": 30.0,
    "sigma1": 0.02,
    "sigma2": 0.015,
    "Fc_fwd": 1.3,
    "Fc_bwd": 1.6,
    "static_excess_fwd": 0.15,
    "static_excess_bwd": 0.1,
    "k2": 0.6,
    "k3": 20.0,
    "d2": 0.09,
    "d3": 0.07,
    "ell": 0.02,
    "v_s": 0.4,
    "offset": 0.03,
    "noise_sd": 0.05,
    "noise_time": 0.1,
}


@pytest.fixture(scope="session")
def medians() -> dict[str, float]:
    """Medians over tests of `make_population`, at 1 ksi."""
    return dict(MEDIANS)


@pytest.fixture(scope="session")
def make_population():
    """Function that makes a population."""
    return _make_population


def _make_population(
    laws=None,
    *,
    level_sd=0.01,
    scatter=0.1,
    effect=1e-6,
    sessions=None,
    also=None,
    medians=MEDIANS,
):
    """A population with medians, and also others, known to 1 % at 1 ksi, and 10 % scatter."""
    priors, medians = load_priors("mfd"), medians | (also or {})
    settings = [
        Setting(p, session, {"velocity": 3.1})
        for p, session in zip((0.5, 1.0, 2.0), sessions or [""] * 3, strict=True)
    ]
    layout = replace(lay_out(priors, tuple(medians), settings, laws), reference=1.0)
    rng = np.random.default_rng(1)
    d, shape = len(medians), (4, 100)
    cells = sum(len(e.cells) for e in layout.effects)
    level = layout.coordinates.of({n: np.array([v]) for n, v in medians.items()})[0]
    spread = np.where(np.array(layout.names) == "offset", min(scatter, 0.02), scatter)
    h = np.zeros((*shape, layout.dim))
    h[..., :d] = np.log(np.maximum(spread, 1e-9))
    h[..., d : d + len(layout.effects)] = np.log(effect)
    h[..., d + len(layout.effects) :] = 1.0  # shapes
    latent = np.zeros((*shape, 1 + cells, d))
    latent[:, :, 0] = level + level_sd * rng.normal(size=(*shape, d)) - layout.centre
    latent[:, :, 0] /= layout.spread
    priors_of = {name: priors.parameters[name] for name in (*medians, "start", "gamma1")}
    return Population(
        layout=layout,
        h=h,
        latent=latent,
        choice=layout.draw_choice(400).reshape(*shape, -1),
        together=np.broadcast_to(np.eye(d), (*shape, d, d)),
        priors=priors_of,
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(np.ones(1), np.ones(1), np.ones(1)),
    )
