"""The population of tests: levels, laws and test-to-test scatter, from the tests' stored draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.map_fit import climb
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.calibration.sampling import Effort, sample_density
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.laws import LAWS, PAPER

Array = NDArray[np.float64]

LEAST_INFORMATION = 1e-3
"""Precision, in prior units, below which a test is taken to say nothing about a direction."""


@dataclass(frozen=True, eq=False)
class TestSummary:
    """What one test says of the pooled coordinates, in prior units.

    Its likelihood is taken as Gaussian in the coordinates q, with `mean` (d,) and
    `covariance` (d, d); the interim prior is divided out of the draws' moments.
    """

    __test__ = False  # not a test case of pytest's

    actuation: float
    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Pooling:
    """What the hyperparameters are, and how they are laid out.

    Attributes
    ----------
    names : tuple of str
        The pooled quantities, d of them.
    centre, spread : (d,)
        Mean and sd of their coordinates under the test prior, which is that of the levels.
    laws : mapping of str to str
        Law of each quantity that follows the actuation.
    groups : tuple of (str, ...)
        Scatter groups.
    member : (d,) int
        Group of each quantity.
    scatter_sd : (G,)
        Half-normal scale of each group's scatter.
    reference : float, ksi or kip
        Actuation p0 to which levels belong.
    """

    names: tuple[str, ...]
    centre: Array
    spread: Array
    laws: Mapping[str, str]
    groups: tuple[str, ...]
    member: NDArray[np.intp]
    scatter_sd: Array
    reference: float

    @property
    def shaped(self) -> tuple[str, ...]:
        """Quantities whose law has a shape."""
        return tuple(n for n in self.names if LAWS[self.laws.get(n, "constant")].shape)


@dataclass(frozen=True, eq=False)
class Population:
    """Draws of the hyperparameters, (chain, draw) first.

    Attributes
    ----------
    pooling : Pooling
    levels : (chain, draw, d)
        Coordinates of the medians at the reference actuation.
    shapes : mapping of str to (chain, draw)
        Coordinates of the laws' shapes, by quantity.
    scatter : (chain, draw, G)
        Standard deviation of the coordinates between tests, by group.
    priors : mapping of str to Prior
    actuation_unit : str
    walkers : int
        A chain's draws are ordered by walker.
    convergence : Convergence
    """

    pooling: Pooling
    levels: Array
    shapes: Mapping[str, Array]
    scatter: Array
    priors: Mapping[str, Prior]
    actuation_unit: str
    walkers: int
    convergence: Convergence

    def ratio(self, name: str, actuation: Array) -> Array:
        """Law's value at each actuation over that at the reference, (chain, draw, m)."""
        law = LAWS[self.pooling.laws.get(name, "constant")]
        shape = self.shapes.get(name, np.zeros(self.levels.shape[:2]))
        return law.ratio(np.asarray(actuation) / self.pooling.reference, shape[..., None])

    def median(self, name: str, actuation: Array) -> Array:
        """Median over tests of a quantity at each actuation, (chain, draw, m)."""
        level = self.levels[..., self.pooling.names.index(name)]
        return self.priors[name].value(level)[..., None] * self.ratio(name, actuation)

    @property
    def slopes(self) -> dict[str, Array]:
        """The paper's constants, as far as the laws are the paper's, (chain, draw) each.

        K_c and K_s in kip per unit of actuation, `alpha_sigma0` in kip/in per unit of
        actuation, `sigma0_0` in kip/in.
        """
        p0 = self.pooling.reference
        one = np.array([p0])
        found: dict[str, Array] = {}
        for side in ("fwd", "bwd"):
            if self.pooling.laws.get(f"Fc_{side}") != "proportional":
                continue
            kinetic = self.median(f"Fc_{side}", one)[..., 0] / p0
            found[f"K_c_{side}"] = kinetic
            excess = self.median(f"static_excess_{side}", one)[..., 0]
            found[f"K_s_{side}"] = kinetic * (1.0 + excess)
        if "sigma0" in self.pooling.names:
            stiffness = self.median("sigma0", np.array([0.0, p0]))
            if self.pooling.laws.get("sigma0") in ("affine", "proportional"):
                found["alpha_sigma0"] = (stiffness[..., 1] - stiffness[..., 0]) / p0
            if self.pooling.laws.get("sigma0") == "affine":
                found["sigma0_0"] = stiffness[..., 0]
        return found

    @property
    def scatters(self) -> dict[str, Array]:
        """Test-to-test scatter of each group, (chain, draw); sd of the logarithm, or kip."""
        return {g: self.scatter[..., i] for i, g in enumerate(self.pooling.groups)}

    @property
    def law_weights(self) -> dict[str, dict[str, float]]:
        """Weight of each law that was considered, by quantity."""
        return {name: {law: 1.0} for name, law in self.pooling.laws.items()}


def pool(
    priors: PriorFile,
    names: Sequence[str],
    actuations: Sequence[float],
    laws: Mapping[str, str] | None = None,
) -> Pooling:
    """Layout of the population of tests.

    Raises
    ------
    PriorError
        When a quantity to be pooled has no scatter prior.
    FitError
        When a law needs what there is not: a positive quantity, or positive actuations.
    """
    pooled = tuple(n for n in names if n not in ("start", "noise_dof"))
    chosen = {n: law for n, law in (PAPER | dict(laws or {})).items() if n in pooled}
    for name in chosen:
        prior = priors.parameters[name]
        if prior.lower != 0.0 or np.isfinite(prior.upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")
    levels = np.asarray(actuations, dtype=np.float64)
    if not np.all(levels > 0):
        raise FitError("every calibrated test needs an actuation above zero for the pressure laws")
    groups, member = _group(priors, pooled)
    rng = np.random.default_rng(0)
    draws = [priors.parameters[n].coordinate(priors.parameters[n].draw(rng, 4000)) for n in pooled]
    return Pooling(
        names=pooled,
        centre=np.array([d.mean() for d in draws]),
        spread=np.array([d.std() for d in draws]),
        laws=chosen,
        groups=groups,
        member=member,
        scatter_sd=np.array([priors.scatter[g].sd for g in groups]),
        reference=float(np.exp(np.mean(np.log(levels)))),
    )


def _group(priors: PriorFile, names: tuple[str, ...]) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    home = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    lost = [name for name in names if name not in home]
    if lost:
        raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {lost[0]}")
    groups = tuple(dict.fromkeys(home[name] for name in names))
    return groups, np.array([groups.index(home[name]) for name in names], dtype=np.intp)


def summarize(pooling: Pooling, actuation: float, coordinates: Array) -> TestSummary:
    """Gaussian summary of one test's likelihood.

    Parameters
    ----------
    pooling : Pooling
    actuation : float
    coordinates : (draws, d)
        Draws of the pooled coordinates from the test's posterior.
    """
    standard = (coordinates - pooling.centre) / pooling.spread
    mean = standard.mean(axis=0)
    covariance = np.atleast_2d(np.cov(standard, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)
    information = 1.0 / variances - 1.0  # the interim prior's precision is 1
    informed = information > LEAST_INFORMATION
    precision = np.where(informed, information, LEAST_INFORMATION)
    along = axes.T @ mean
    centre = np.where(informed, along / variances / precision, along)
    return TestSummary(
        actuation=actuation,
        mean=axes @ centre,
        covariance=(axes / precision) @ axes.T,
    )


class Marginal:
    """Density of scatter and shapes, with tests and levels integrated out in closed form.

    Given the scatter T and the shapes, test j's summary is N(level + o_j, C_j + T) and the
    levels are N(0, 1) in prior units, so that both integrals are Gaussian.
    """

    def __init__(self, pooling: Pooling, tests: Sequence[TestSummary]) -> None:
        self.pooling = pooling
        self.means = np.array([test.mean for test in tests])  # (J, d)
        self.covariances = np.array([test.covariance for test in tests])  # (J, d, d)
        self.ratios = np.array([test.actuation for test in tests]) / pooling.reference

    def log_prob(self, h: Array) -> Array:
        """Log density of h = (log scatter, shapes), (n, G + shapes) -> (n,)."""
        inside = np.all(np.abs(h) < 30.0, axis=1)
        density = np.full(len(h), -np.inf)
        if np.any(inside):
            density[inside] = self.log_prior(h[inside]) + self._integral(h[inside])
        return density

    def log_prior(self, h: Array) -> Array:
        """Half-normal scatter, with the Jacobian of its logarithm, and the laws' shapes."""
        groups = len(self.pooling.groups)
        log_scatter = h[:, :groups]
        density = log_scatter - 0.5 * (np.exp(log_scatter) / self.pooling.scatter_sd) ** 2
        total: Array = density.sum(axis=1)
        for i, name in enumerate(self.pooling.shaped):
            total = total + LAWS[self.pooling.laws[name]].log_prior(h[:, groups + i])
        return total

    def _integral(self, h: Array) -> Array:
        precision, pull, log_terms = self._levels(h)
        mean = np.linalg.solve(precision, pull[..., None])[..., 0]
        log_det = np.linalg.slogdet(precision)[1]
        gain = np.einsum("nd,nd->n", pull, mean)
        total: Array = log_terms + 0.5 * gain - 0.5 * log_det
        return total

    def _levels(self, h: Array) -> tuple[Array, Array, Array]:
        """Precision (n, d, d) and pull (n, d) of the levels, and what is left of the density."""
        scatter = np.exp(h[:, self.pooling.member]) / self.pooling.spread
        d = scatter.shape[1]
        total = np.repeat(self.covariances[None], len(h), axis=0)  # (n, J, d, d)
        total[..., range(d), range(d)] += (scatter**2)[:, None]
        inverse = np.linalg.inv(total)
        log_det = np.linalg.slogdet(total)[1].sum(axis=1)
        residual = self.means - self.offsets(h)
        pulled = np.einsum("njde,nje->njd", inverse, residual)
        square = np.einsum("njd,njd->n", pulled, residual)
        precision = np.eye(d) + inverse.sum(axis=1)
        return precision, pulled.sum(axis=1), -0.5 * (log_det + square)

    def offsets(self, h: Array) -> Array:
        """Laws' log ratios at the tests' actuations, in prior units, (n, J, d)."""
        pooling = self.pooling
        offsets = np.zeros((len(h), len(self.ratios), len(pooling.names)))
        shapes = {n: h[:, len(pooling.groups) + i] for i, n in enumerate(pooling.shaped)}
        for name, law in pooling.laws.items():
            k = pooling.names.index(name)
            shape = shapes.get(name, np.zeros(len(h)))[:, None]
            offsets[..., k] = np.log(LAWS[law].ratio(self.ratios, shape)) / pooling.spread[k]
        return offsets

    def draw_levels(self, h: Array, rng: np.random.Generator) -> Array:
        """One draw of the levels for each h, (n, d), prior units."""
        precision, pull, _ = self._levels(h)
        mean = np.linalg.solve(precision, pull[..., None])[..., 0]
        factor = np.linalg.cholesky(precision)
        noise = rng.standard_normal(mean.shape)
        swing = np.linalg.solve(np.swapaxes(factor, 1, 2), noise[..., None])[..., 0]
        draws: Array = mean + swing
        return draws


def infer(
    pooling: Pooling,
    tests: Sequence[TestSummary],
    priors: Mapping[str, Prior],
    actuation_unit: str,
    effort: Effort,
    rng: np.random.Generator,
) -> Population:
    """Draws of levels, shapes and scatter, given the tests' summaries."""
    marginal = Marginal(pooling, tests)
    groups = len(pooling.groups)
    begin = np.concatenate([np.log(0.5 * pooling.scatter_sd), np.ones(len(pooling.shaped))])
    mode = climb(marginal.log_prob, begin, np.ones(len(begin)))
    chains = sample_density(marginal.log_prob, (mode,), effort, rng)
    shape = chains.q.shape[:2]
    flat = chains.q.reshape(-1, len(begin))
    levels = np.concatenate(
        [marginal.draw_levels(part, rng) for part in np.array_split(flat, max(1, len(flat) // 500))]
    )
    return Population(
        pooling=pooling,
        levels=(pooling.centre + pooling.spread * levels).reshape(*shape, -1),
        shapes={n: chains.q[..., groups + i] for i, n in enumerate(pooling.shaped)},
        scatter=np.exp(chains.q[..., :groups]),
        priors=priors,
        actuation_unit=actuation_unit,
        walkers=chains.walkers,
        convergence=chains.convergence,
    )
