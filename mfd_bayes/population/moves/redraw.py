"""New scatter and level of one quantity, and new values of all tests, independent of the old ones.

The log density along every test's line is computed at a few nodes; its difference from the
Gaussian's becomes a polynomial. Scatter and level are sampled with every t integrated out
(Gauss–Hermite), then every t is drawn from its conditional density, and everything is accepted or
rejected together by the exact density. Where a polynomial does not fit, proposals are rejected,
so that many tests need smooth lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.moves.lines import Lines, ScatterLevel, Tuning

Array = NDArray[np.float64]

INNER = 25
"""Steps of scatter and level with the tests integrated out."""

NODES = np.array([-3.0, -2.1, -1.3, -0.45, 0.45, 1.3, 2.1, 3.0])
"""Where the log density along a line is computed, in sds."""

DEEP = 20.0
"""Log densities further below the largest one are cut off."""

_TO_COEFFICIENTS = np.linalg.inv(np.vander(NODES, increasing=True))
_PLACES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_LOG_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
_GRID = np.linspace(-5.0, 5.0, 41)
"""Corners of the piecewise linear density from which t is drawn, in sds of its Gaussian."""
_STEP = _GRID[1] - _GRID[0]


def redraw(
    joint: Joint, chains: Chains, rng: np.random.Generator, tuning: Tuning, k: int
) -> Accepted:
    """New scatter and level of quantity k, and new values of all tests."""
    lines = Lines.through(joint, chains, tuning, k)
    profile = Profile.along(lines, tuning)
    start, n = lines.here, len(chains.h)
    new = start
    began = density = profile.log_marginal(start) + lines.log_prior(start)
    for _ in range(INNER):
        proposed = tuning.step(k, new, rng)
        proposed_density = profile.log_marginal(proposed) + lines.log_prior(proposed)
        yes = np.log(rng.random(n)) < proposed_density - density
        density = np.where(yes, proposed_density, density)
        new = ScatterLevel(*(np.where(yes, *both) for both in zip(proposed, new, strict=True)))
    t, forward = profile.draw(new, rng)
    ratio = lines.log_prior(new) - lines.log_prior(start) - (density - began)
    ratio += np.sum(profile.log_density(chains.values(k), start) - forward, axis=1)
    yes = lines.accept(new, t, ratio, np.log(rng.random(n)))
    return [(f"redraw {joint.layout.names[k]}", yes)]


@dataclass(frozen=True, eq=False)
class Profile:
    """Approximate log densities along all lines: a Gaussian plus a polynomial.

    Attributes
    ----------
    lines : Lines
    middle, width : (n, J), (J,)
        Centre and unit of length of the nodes.
    coefficients : (n, J, len(NODES))
        Of ascending powers of (t − middle)/width.
    """

    lines: Lines
    middle: Array
    width: Array
    coefficients: Array

    @classmethod
    def along(cls, lines: Lines, tuning: Tuning) -> Profile:
        """Profile of the lines, from the tests' likelihoods at the nodes."""
        k = lines.k
        prior = tuning.wide[k] ** -2.0
        precision = lines.information + prior
        middle = (lines.pull + prior * (lines.base + tuning.level[k])) / precision
        width = precision**-0.5
        excess = np.empty((*middle.shape, len(NODES)))
        for visit, likelihood in lines.visit(lambda j: middle[:, j] + width[j] * NODES[:, None]):
            j = visit.j
            density = lines.log_prior_of_others(j, visit.x) + likelihood
            density += 0.5 * lines.information[j] * visit.t**2 - lines.pull[:, j] * visit.t
            excess[:, j] = density.T
        known = np.isfinite(excess)
        top = np.max(np.where(known, excess, -np.inf), axis=2, keepdims=True)
        with np.errstate(invalid="ignore"):  # where there is no density at any node
            excess = np.where(known, np.maximum(excess - top, -DEEP), -DEEP)
        return cls(lines, middle, width, excess @ _TO_COEFFICIENTS.T)

    def _polynomial(self, which: slice, centre: Array, sd: Array, places: Array) -> Array:
        """Polynomials of some tests at centre + sd · places, constant beyond the nodes."""
        scaled = (sd / self.width[which])[..., None] * places
        scaled += ((centre - self.middle[:, which]) / self.width[which])[..., None]
        np.clip(scaled, NODES[0], NODES[-1], out=scaled)
        powers = np.moveaxis(self.coefficients[:, which], -1, 0)
        total = np.repeat(powers[-1][..., None], scaled.shape[-1], axis=-1)
        for coefficient in powers[-2::-1]:
            total *= scaled
            total += coefficient[..., None]
        return np.asarray(total)

    def log_marginal(self, at: ScatterLevel) -> Array:
        """Log density of scatter and level with every t integrated out, without prior, (n,)."""
        centre, sd, weight = self.lines.gaussian(at)
        excess = self._polynomial(slice(None), centre, sd, _PLACES)
        weight += np.log(np.exp(excess + _LOG_WEIGHTS).sum(axis=-1))
        return np.asarray(weight.sum(axis=1))

    def _conditional(self, j: int, centre: Array, sd: Array) -> tuple[Array, Array]:
        """Density of (t − centre)/sd at the corners of the grid, and the mass of its cells."""
        one = slice(j, j + 1)
        log_density = self._polynomial(one, centre[:, one], sd[:, one], _GRID)[:, 0]
        log_density -= 0.5 * _GRID**2
        density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        cells = 0.5 * (density[:, 1:] + density[:, :-1]) * _STEP
        total = cells.sum(axis=1, keepdims=True)
        return density / total, cells / total

    def draw(self, at: ScatterLevel, rng: np.random.Generator) -> tuple[Array, Array]:
        """Values of all tests given scatter and level, and their log densities, (n, J) each."""
        centre, sd, _ = self.lines.gaussian(at)
        rows = np.arange(len(centre))
        t, log_density = np.empty_like(centre), np.empty_like(centre)
        for j in range(centre.shape[1]):
            density, cells = self._conditional(j, centre, sd)
            ends = np.cumsum(cells, axis=1)
            share = rng.random(len(rows)) * ends[:, -1]
            cell = np.minimum((ends < share[:, None]).sum(axis=1), len(_GRID) - 2)
            left, right = density[rows, cell], density[rows, cell + 1]
            area = np.maximum(share - ends[rows, cell] + cells[rows, cell], 0.0)
            # the root of left u + (right − left) u²/(2 step) = area that is free of cancellation
            root = np.sqrt(np.maximum(left**2 + 2.0 * (right - left) / _STEP * area, 0.0))
            inside = np.clip(2.0 * area / np.maximum(left + root, 1e-300), 0.0, _STEP)
            t[:, j] = centre[:, j] + sd[:, j] * (_GRID[cell] + inside)
            drawn = np.log(left + (right - left) * inside / _STEP)
            log_density[:, j] = drawn - np.log(sd[:, j])
        return t, log_density

    def log_density(self, t: Array, at: ScatterLevel) -> Array:
        """Log density of `draw` at values t, (n, J); −inf outside its grid."""
        centre, sd, _ = self.lines.gaussian(at)
        rows, log_density = np.arange(len(t)), np.empty_like(t)
        for j in range(t.shape[1]):
            density, _ = self._conditional(j, centre, sd)
            place = (t[:, j] - centre[:, j]) / sd[:, j]
            at_cell = np.clip((place - _GRID[0]) / _STEP, 0.0, len(_GRID) - 1.0 - 1e-9)
            cell = at_cell.astype(np.intp)
            left, right = density[rows, cell], density[rows, cell + 1]
            with np.errstate(divide="ignore"):  # densities too small for a number
                found = np.log(left + (right - left) * (at_cell - cell))
            log_density[:, j] = found - np.log(sd[:, j])
            log_density[np.abs(place) > _GRID[-1], j] = -np.inf
        return log_density
