"""Scatter and level of one quantity, moved together with the tests' own values of it.

Where each test tells little of a quantity, the tests' values hold scatter and level fast and are
held by them, the faster the more tests there are. Both moves here let them go together. A test
moves along a line: its value t of the quantity changes, and its other coordinates follow as the
Gaussian near its likelihood has them follow.

*Transport.* A random step of scatter and level. Every t keeps its place in its Gaussian
conditional, which the step moves and widens.

*Redraw.* The log density along every line is found at a few nodes and a polynomial put through
what it has more than a Gaussian. Scatter and level are sampled with every t integrated out
(Gauss-Hermite), then every t is drawn afresh from its conditional, and all is taken or not with
the log densities where it came to lie. What a polynomial cannot follow makes it be refused, so
with very many tests this needs lines that are smooth.

Both leave the joint posterior as it is. Lines, nodes and Gaussians depend on nothing that a move
changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

if TYPE_CHECKING:
    from mfd_bayes.population.joint import Chains, Joint

Array = NDArray[np.float64]

FAR = 15.0
"""Hyperparameters are not further than this from 0: scatter of e⁻¹⁹ is beyond double precision."""

SIZES = (2.4, 1.2, 0.5)
"""Steps of scatter and level, in their sds."""

INNER = 25
"""Steps of scatter and level with the tests integrated out."""

NODES = np.array([-3.0, -2.1, -1.3, -0.45, 0.45, 1.3, 2.1, 3.0])
"""Where the density along a line is found, in sds."""

DEEP = 20.0
"""How far below its top a log density is followed."""

_TO_COEFFICIENTS = np.linalg.inv(np.vander(NODES, increasing=True))
_PLACES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_LOG_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
_GRID = np.linspace(-5.0, 5.0, 41)
"""Corners of the density that tests are drawn from, in sds of their Gaussian."""


@dataclass(frozen=True, eq=False)
class Tuning:
    """What the moves are aimed by. It has to stay as it is while chains are kept.

    Attributes
    ----------
    scatter, level : (d,)
        Usual scatter and level of each quantity, in prior units.
    scatter_step, level_step : (d,)
        Sds of the logarithm of the scatter, and of the level.
    wide : (d,)
        A large scatter, and what a level varies by.
    covariances : sequence of (D, D)
        Of each test's coordinates at the usual scatter.
    """

    scatter: Array
    level: Array
    scatter_step: Array
    level_step: Array
    wide: Array
    covariances: Sequence[Array]

    @property
    def missing(self) -> Array:
        """Share of each quantity's variance that a test leaves, mean over tests, (d,)."""
        d = len(self.scatter)
        left = np.mean([np.diag(covariance)[:d] for covariance in self.covariances], axis=0)
        return np.asarray(left / self.scatter**2)


def untuned(layout: Layout, tests: Sequence[TestLikelihood]) -> Tuning:
    """By the priors alone."""
    d = len(layout.names)
    scatter = 0.5 * layout.scatter_sd / layout.spread
    covariances = _conditional_covariances(tests, scatter)
    half, some = np.full(d, 0.5), np.full(d, 0.3)
    return Tuning(scatter, np.zeros(d), half, some, np.hypot(2.0 * scatter, 1.0), covariances)


def tune(layout: Layout, tests: Sequence[TestLikelihood], chains: Chains) -> Tuning:
    """By where chains are."""
    d = len(layout.names)
    scatters, levels = layout.scatter(chains.h), chains.latent[:, 0]
    scatter = np.exp(np.log(scatters).mean(axis=0))
    return Tuning(
        scatter,
        levels.mean(axis=0),
        chains.h[:, :d].std(axis=0),
        levels.std(axis=0),
        np.hypot(np.quantile(scatters, 0.8, axis=0), levels.std(axis=0)),
        _conditional_covariances(tests, scatter),
    )


def _conditional_covariances(tests: Sequence[TestLikelihood], scatter: Array) -> list[Array]:
    found = []
    for test in tests:
        precision = np.linalg.inv(test.covariance)
        about = np.ones(len(precision))
        about[: len(scatter)] = scatter**-2.0
        found.append(np.linalg.inv(precision + np.diag(about)))
    return found


@dataclass(frozen=True, eq=False)
class Visit:
    """Test j at values t of a quantity (…, n): its coordinates x (…, n, D)."""

    j: int
    t: Array
    x: Array


@dataclass(frozen=True, eq=False)
class Lines:
    """The tests' lines of one quantity, for n chains.

    Attributes
    ----------
    joint : Joint
    k : int
        The quantity.
    ways : sequence of (D,)
        What each test's coordinates change by as t changes by 1.
    information : (J,)
        Precision of t, but for its population.
    pull : (n, J)
        That times the centre of t.
    base : (n, J)
        Mean of t in the population, but for the level.
    means, scatter : (n, J, d), (n, d)
        Of the other quantities.
    """

    joint: Joint
    k: int
    ways: Sequence[Array]
    information: Array
    pull: Array
    base: Array
    means: Array
    scatter: Array

    @classmethod
    def through(cls, joint: Joint, chains: Chains, k: int) -> Lines:
        """Lines through the tests where the chains are."""
        tuning, d = joint.tuning, joint.d
        means = joint.means(chains.h, chains.latent, chains.choice)
        ways, information, pull = [], [], []
        for j, covariance in enumerate(tuning.covariances):
            way = covariance[:, k] / covariance[k, k]
            others = way[:d] * tuning.scatter**-2.0
            others[k] = 0.0
            known = joint.precisions[j] @ joint.tests[j].mean
            ways.append(way)
            information.append(1.0 / covariance[k, k] - tuning.scatter[k] ** -2.0)
            pull.append(way @ known + means[:, j] @ others)
        return cls(
            joint,
            k,
            ways,
            np.maximum(information, 1e-9),
            np.stack(pull, axis=1),
            means[:, :, k] - chains.latent[:, 0, k, None],
            means,
            joint.layout.scatter(chains.h),
        )

    def gaussian(self, log_scatter: Array, level: Array) -> tuple[Array, Array, Array]:
        """Centres and sds (n, J) of t given scatter and level (n,), and the tests' log weights."""
        scatter = np.exp(log_scatter) / self.joint.layout.spread[self.k]
        about = scatter[:, None] ** -2.0
        mean = self.base + level[:, None]
        precision = self.information + about
        centre = (self.pull + about * mean) / precision
        weight = 0.5 * (centre**2 * precision - mean**2 * about - np.log(precision))
        return centre, precision**-0.5, weight - np.log(scatter)[:, None]

    def of_population(self, t: Array, log_scatter: Array, level: Array) -> Array:
        """Log density of t (n, J) given scatter and level, without constants, (n, J)."""
        log_scale = log_scatter - np.log(self.joint.layout.spread[self.k])
        standard = (t - self.base - level[:, None]) * np.exp(-log_scale)[:, None]
        return np.asarray(-0.5 * standard**2 - log_scale[:, None])

    def prior(self, j: int, x: Array) -> Array:
        """Log prior density of a test's coordinates (…, n, D) but for that, (…, n)."""
        d = self.joint.d
        standard = (x[..., :d] - self.means[:, j]) / self.scatter
        standard[..., self.k] = 0.0
        own = self.joint.tests[j].log_own_prior(x.reshape(-1, x.shape[-1])[:, d:])
        density = own.reshape(x.shape[:-1])
        return np.asarray(density - 0.5 * np.einsum("...k,...k->...", standard, standard))

    def visit(
        self, chains: Chains, places: Callable[[int], Array]
    ) -> Iterator[tuple[Visit, Array]]:
        """Every test at values t of the quantity, (…, n), and its log likelihoods there."""

        def visits() -> Iterator[Visit]:
            for j, x in enumerate(chains.x):
                t = places(j)
                yield Visit(j, t, x + (t - x[:, self.k])[..., None] * self.ways[j])

        return self.joint.with_likelihoods(visits())


def transport(joint: Joint, chains: Chains, k: int) -> NDArray[np.bool_]:
    """A step of scatter and level of quantity k, in place; whether it was taken, (n,)."""
    lines, rng, n = Lines.through(joint, chains, k), joint.rng, len(chains.h)
    here = chains.h[:, k].copy(), chains.latent[:, 0, k].copy()
    there = _step(joint, k, *here)
    ratio = _prior(joint, chains, k, *there) - _prior(joint, chains, k, *here)
    before, old_sd, _ = lines.gaussian(*here)
    after, new_sd, _ = lines.gaussian(*there)
    old = _values(chains, k)
    new = after + new_sd / old_sd * (old - before)
    ratio += np.sum(np.log(new_sd / old_sd), axis=1)
    return _accept(lines, chains, there, new, ratio, np.log(rng.random(n)))


def redraw(joint: Joint, chains: Chains, k: int) -> NDArray[np.bool_]:
    """New scatter and level of quantity k and values of all tests, in place; whether, (n,)."""
    lines, rng, n = Lines.through(joint, chains, k), joint.rng, len(chains.h)
    profile = _Profile.of(lines, chains)
    start = chains.h[:, k].copy(), chains.latent[:, 0, k].copy()
    here = start
    began = told = profile.log_marginal(*here) + _prior(joint, chains, k, *here)
    for _ in range(INNER):
        there = _step(joint, k, *here)
        density = profile.log_marginal(*there) + _prior(joint, chains, k, *there)
        yes = np.log(rng.random(n)) < density - told
        told = np.where(yes, density, told)
        here = np.where(yes, there[0], here[0]), np.where(yes, there[1], here[1])
    old = _values(chains, k)
    new, forth = profile.draw(*here, rng)
    ratio = _prior(joint, chains, k, *here) - _prior(joint, chains, k, *start) - (told - began)
    ratio += np.sum(profile.log_density(old, *start) - forth, axis=1)
    return _accept(lines, chains, here, new, ratio, np.log(rng.random(n)))


def _values(chains: Chains, k: int) -> Array:
    """The tests' values of quantity k, (n, J)."""
    return np.stack([x[:, k] for x in chains.x], axis=1)


def _step(joint: Joint, k: int, log_scatter: Array, level: Array) -> tuple[Array, Array]:
    """Random steps of scatter, level, or both."""
    rng, n, tuning = joint.rng, len(level), joint.tuning
    size, what = rng.choice(SIZES, size=n), rng.integers(3, size=n)
    wider = (what != 0) * size * tuning.scatter_step[k] * rng.standard_normal(n)
    higher = (what != 1) * size * tuning.level_step[k] * rng.standard_normal(n)
    return log_scatter + wider, level + higher


def _prior(joint: Joint, chains: Chains, k: int, log_scatter: Array, level: Array) -> Array:
    """Log prior density of scatter and level of quantity k, the others as they are, (n,)."""
    h = chains.h.copy()
    h[:, k] = np.clip(log_scatter, -FAR, FAR)
    density = joint.layout.log_prior(h).sum(axis=1) - 0.5 * level**2
    return np.where(np.abs(log_scatter) < FAR, density, -np.inf)


def _accept(
    lines: Lines,
    chains: Chains,
    there: tuple[Array, Array],
    new: Array,
    ratio: Array,
    chance: Array,
) -> NDArray[np.bool_]:
    """Take chains to scatter and level there and tests' values new (n, J), or leave them.

    ratio has all of the acceptance ratio but the tests' log densities.
    """
    k = lines.k
    old = _values(chains, k)
    ratio = ratio + np.sum(lines.of_population(new, *there), axis=1)
    ratio -= np.sum(lines.of_population(old, chains.h[:, k], chains.latent[:, 0, k]), axis=1)
    visits = list(lines.visit(chains, lambda j: new[:, j]))
    for visit, likelihood in visits:
        j = visit.j
        ratio += lines.prior(j, visit.x) - lines.prior(j, chains.x[j])
        ratio += likelihood - chains.log_likelihood[j]
    yes: NDArray[np.bool_] = np.isfinite(ratio) & (chance < ratio)
    chains.h[yes, k], chains.latent[yes, 0, k] = there[0][yes], there[1][yes]
    for visit, likelihood in visits:
        chains.x[visit.j][yes] = visit.x[yes]
        chains.log_likelihood[visit.j][yes] = likelihood[yes]
    return yes


@dataclass(frozen=True, eq=False)
class _Profile:
    """Log densities along all lines: Gaussians and, in sds of their nodes, polynomials.

    Attributes
    ----------
    lines : Lines
    middle, width : (n, J), (J,)
        Where the nodes are.
    coefficients : (n, J, len(NODES))
        Of ascending powers.
    """

    lines: Lines
    middle: Array
    width: Array
    coefficients: Array

    @classmethod
    def of(cls, lines: Lines, chains: Chains) -> _Profile:
        tuning, k = lines.joint.tuning, lines.k
        about = tuning.wide[k] ** -2.0
        precision = lines.information + about
        middle = (lines.pull + about * (lines.base + tuning.level[k])) / precision
        width = precision**-0.5
        excess = np.empty((*middle.shape, len(NODES)))
        nodes = lines.visit(chains, lambda j: middle[:, j] + width[j] * NODES[:, None])
        for visit, likelihood in nodes:
            j = visit.j
            told = lines.prior(j, visit.x) + likelihood
            told += 0.5 * lines.information[j] * visit.t**2 - lines.pull[:, j] * visit.t
            excess[:, j] = told.T
        known = np.isfinite(excess)
        top = np.max(np.where(known, excess, -np.inf), axis=2, keepdims=True)
        with np.errstate(invalid="ignore"):  # where there is no density at any node
            excess = np.where(known, np.maximum(excess - top, -DEEP), -DEEP)
        return cls(lines, middle, width, excess @ _TO_COEFFICIENTS.T)

    def _polynomial(self, which: slice, centre: Array, sd: Array, places: Array) -> Array:
        """Polynomials of some tests at centre + sd * places, level beyond the nodes, (n, …, m)."""
        scaled = (sd / self.width[which])[..., None] * places
        scaled += ((centre - self.middle[:, which]) / self.width[which])[..., None]
        np.clip(scaled, NODES[0], NODES[-1], out=scaled)
        powers = np.moveaxis(self.coefficients[:, which], -1, 0)
        total = np.repeat(powers[-1][..., None], scaled.shape[-1], axis=-1)
        for coefficient in powers[-2::-1]:
            total *= scaled
            total += coefficient[..., None]
        return np.asarray(total)

    def log_marginal(self, log_scatter: Array, level: Array) -> Array:
        """Log density of scatter and level with every t integrated out, without prior, (n,)."""
        centre, sd, weight = self.lines.gaussian(log_scatter, level)
        excess = self._polynomial(slice(None), centre, sd, _PLACES)
        weight += np.log(np.exp(excess + _LOG_WEIGHTS).sum(axis=-1))
        return np.asarray(weight.sum(axis=1))

    def _conditional(self, j: int, centre: Array, sd: Array) -> tuple[Array, Array]:
        """Density of (t − centre)/sd at the corners of the grid, and its cells' shares."""
        one = slice(j, j + 1)
        log_density = self._polynomial(one, centre[:, one], sd[:, one], _GRID)[:, 0]
        log_density -= 0.5 * _GRID**2
        density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        cells = 0.5 * (density[:, 1:] + density[:, :-1]) * (_GRID[1] - _GRID[0])
        total = cells.sum(axis=1, keepdims=True)
        return density / total, cells / total

    def draw(
        self, log_scatter: Array, level: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Values of all tests given scatter and level, and their log densities, (n, J) each."""
        centre, sd, _ = self.lines.gaussian(log_scatter, level)
        rows, step = np.arange(len(centre)), _GRID[1] - _GRID[0]
        t, told = np.empty_like(centre), np.empty_like(centre)
        for j in range(centre.shape[1]):
            density, cells = self._conditional(j, centre, sd)
            ends = np.cumsum(cells, axis=1)
            share = rng.random(len(rows)) * ends[:, -1]
            cell = np.minimum((ends < share[:, None]).sum(axis=1), len(_GRID) - 2)
            left, right = density[rows, cell], density[rows, cell + 1]
            area = np.maximum(share - ends[rows, cell] + cells[rows, cell], 0.0)
            # of the roots of left u + (right − left) u²/(2 step) = area, free of cancellation
            root = np.sqrt(np.maximum(left**2 + 2.0 * (right - left) / step * area, 0.0))
            inside = np.clip(2.0 * area / np.maximum(left + root, 1e-300), 0.0, step)
            t[:, j] = centre[:, j] + sd[:, j] * (_GRID[cell] + inside)
            told[:, j] = np.log(left + (right - left) * inside / step) - np.log(sd[:, j])
        return t, told

    def log_density(self, t: Array, log_scatter: Array, level: Array) -> Array:
        """Log density of `draw` at values t, (n, J); −inf beyond its grid."""
        centre, sd, _ = self.lines.gaussian(log_scatter, level)
        rows, step = np.arange(len(t)), _GRID[1] - _GRID[0]
        told = np.empty_like(t)
        for j in range(t.shape[1]):
            density, _ = self._conditional(j, centre, sd)
            place = (t[:, j] - centre[:, j]) / sd[:, j]
            at = np.clip((place - _GRID[0]) / step, 0.0, len(_GRID) - 1.0 - 1e-9)
            cell = at.astype(np.intp)
            left, right = density[rows, cell], density[rows, cell + 1]
            with np.errstate(divide="ignore"):  # densities that are too small for a number
                told[:, j] = np.log(left + (right - left) * (at - cell)) - np.log(sd[:, j])
            told[np.abs(place) > _GRID[-1], j] = -np.inf
        return told
