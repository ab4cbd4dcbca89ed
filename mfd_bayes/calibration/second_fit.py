"""A second fit of the same record, near a first one: cheap, by importance sampling.

What a posterior becomes when something about it is changed, such as its noise. The first fit's
draws and modes say where to look, so that a few modes and some thousand weighted draws do; only
where the weights cannot be trusted are walkers sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis, tempering
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.map_fit import (
    Mode,
    ascend,
    find_modes,
    is_near,
    is_same,
    laplace_covariance,
    prior_scale,
)
from mfd_bayes.calibration.mixture import Either, Proposal, learn
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.starts import around_modes
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

DRAWS = 2000
"""Draws of each proposal."""

ROUNDS = 8
"""Largest number of proposals before walkers are sent."""

LARGEST_K = 0.7
"""Pareto k above which importance weights cannot be trusted."""

ENOUGH = 200.0
"""Effective number of weighted draws from which no further proposal is needed."""

SHARE = 0.1
"""Effective number of draws, as a share of all, from which the next proposal is learned."""

PARTS = 4
"""Student-t components of a proposal, besides its wide one."""

STARTS = 3
"""Draws of the first fit from which modes are climbed to."""

SEARCHED = 6
"""Points from which modes are searched before walkers are sent: the first fit's may be minor."""

TRIED = 64
"""Prior draws of what the first fit does not have, of which each start takes the best."""

WALK = Effort(
    name="second fit", ess=50, limit=250, r_hat=1.1, length=2.0, ensembles=2, kept=1200, starts=1
)
"""Sampling where weights fail: enough for a median and an interval, not for their digits."""

APART = 1.2
"""R̂ of these walkers above which they do not tell where the posterior is."""

AT_ONCE, BY_WEIGHTS, BY_WALKERS = "one proposal", "several proposals", "walkers"


@dataclass(frozen=True, eq=False)
class SecondFit:
    """Weighted draws of a second fit.

    Attributes
    ----------
    q : (n, dim)
        Unconstrained coordinates.
    weights : (n,)
        They sum to 1.
    how : {"one proposal", "several proposals", "walkers"}
        Whether a proposal learned from the first fit's draws and the second one's modes was
        enough, or more were learned from weighted draws, or walkers had to be sent.
    k : float
        Pareto k of the weights; of walkers, that of the weights that failed.
    size : float
        Effective number of draws.
    """

    q: Array
    weights: Array
    how: str
    k: float
    size: float


def fit_again(
    posterior: Posterior, draws: Mapping[str, Array], rng: np.random.Generator
) -> SecondFit:
    """Weighted draws of a posterior that is near another one.

    Parameters
    ----------
    posterior : Posterior
        The second one; it may have quantities that the first has not.
    draws : mapping of str to (n,)
        Draws of the first one, without what has another meaning in the second.

    Raises
    ------
    FitError
        When there is no density around the draws, or walkers did not settle.
    """
    modes = _modes_near(posterior, draws, rng)
    anchors = around_modes(modes, 1.0)
    random = np.random.RandomState(int(rng.integers(2**32)))
    begin = _completed(posterior, _some(draws, DRAWS, rng), anchors.draw(random, DRAWS))
    found = _weighted(posterior.log_prob, begin, anchors, rng)
    return found if found.k <= LARGEST_K else _walked(posterior, modes, found.k, rng)


def _walked(
    posterior: Posterior, near: Sequence[Mode], k: float, rng: np.random.Generator
) -> SecondFit:
    """Draws of walkers, all with the same weight; from modes anywhere, not only near the draws."""
    from mfd_bayes.calibration.ensembles import sample_density  # emcee takes long to import

    modes = list(near)
    for mode in find_modes(posterior, rng, starts=SEARCHED):
        if not any(is_same(mode, other) for other in modes):
            modes.append(mode)
    modes.sort(key=lambda mode: -mode.log_prob)
    chains = sample_density(posterior.log_prob, modes, WALK, rng)
    if not chains.convergence.worst_r_hat <= APART:
        raise FitError("neither weighted draws nor walkers settled")
    flat = chains.q.reshape(-1, posterior.dim)
    weights = np.full(len(flat), 1.0 / len(flat))
    return SecondFit(flat, weights, BY_WALKERS, k, chains.convergence.worst_ess)


def _modes_near(
    posterior: Posterior, draws: Mapping[str, Array], rng: np.random.Generator
) -> tuple[Mode, ...]:
    """Modes that are climbed to from some of the draws, best first."""
    sd = prior_scale(posterior, rng)[1]
    tried = posterior.coordinates(posterior.draw_prior(rng, TRIED))
    axes = _axes(posterior, draws, sd)
    modes: list[Mode] = []
    for values in np.transpose(list(_some(draws, STARTS, rng).values())):
        start = {name: np.full(TRIED, at) for name, at in zip(draws, values, strict=True)}
        points = _completed(posterior, start, tried)
        heights = posterior.log_prob(points)
        if not np.any(np.isfinite(heights)):
            continue
        q, near = ascend(posterior.log_prob, points[np.argmax(heights)], axes, modes)
        if near is not None:
            continue
        height = float(posterior.log_prob(q[None])[0])
        if not any(is_near(q, height, mode) for mode in modes):
            modes.append(Mode(q, height, laplace_covariance(posterior.log_prob, q, sd)))
    if not modes:
        raise FitError("no density around the first fit")
    return tuple(sorted(modes, key=lambda mode: -mode.log_prob))


def _some(draws: Mapping[str, Array], size: int, rng: np.random.Generator) -> dict[str, Array]:
    """Some of the draws, with replacement."""
    pick = rng.choice(len(next(iter(draws.values()))), size=size)
    return {name: column[pick] for name, column in draws.items()}


def _axes(posterior: Posterior, draws: Mapping[str, Array], sd: Array) -> Array:
    """Axes along which a mode is climbed to: those of the draws, of the rest a tenth of the sd."""
    size = len(next(iter(draws.values())))
    q = _completed(posterior, draws, np.zeros((size, posterior.dim)))
    known = [k for k, name in enumerate(posterior.names) if name in draws]
    covariance = np.diag((0.1 * sd) ** 2)
    covariance[np.ix_(known, known)] = np.cov(q[:, known].T) + np.diag((1e-4 * sd[known]) ** 2)
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _completed(posterior: Posterior, known: Mapping[str, Array], rest: Array) -> Array:
    """Coordinates with the known quantities, and with those of `rest` for the others, (n, dim)."""
    own = posterior.to_own(rest)
    for column, name in enumerate(posterior.names):
        if name in known:
            own[:, column] = posterior.priors[name].coordinate(known[name])
    return posterior.from_own(own)


def _weighted(
    density: Density, begin: Array, anchors: Proposal, rng: np.random.Generator
) -> SecondFit:
    """Weighted draws of several proposals, the first of them learned from `begin`.

    Adaptive multiple importance sampling (Cornuet, Marin, Mira and Robert, 2012): each draw is
    weighted by the density over the mean of all proposals, and the next proposal is learned from
    all draws, with tempered weights (Koblents and Míguez, 2015).
    """
    random = np.random.RandomState(int(rng.integers(2**32)))
    parts: list[Proposal] = []
    q, heights, source = np.empty((0, begin.shape[1])), np.empty(0), begin
    while True:
        parts.append(learn(source, PARTS, rng, anchors))
        fresh = parts[-1].draw(random, DRAWS)
        q, heights = np.concatenate([q, fresh]), np.append(heights, density(fresh))
        together = Either(np.full(len(parts), 1.0 / len(parts)), parts)
        ratios = heights - together.log_density(q)
        if not np.any(np.isfinite(ratios)):
            raise FitError("no density around the first fit")
        smooth, k = psis(ratios)
        weights = np.exp(smooth)
        size = float(1.0 / np.sum(weights**2))
        if len(parts) == ROUNDS or (k <= LARGEST_K and size >= ENOUGH):
            how = AT_ONCE if len(parts) == 1 else BY_WEIGHTS
            return SecondFit(q, weights / weights.sum(), how, k, size)
        shares = special.softmax(tempering(ratios, SHARE) * (ratios - ratios.max()))
        source = q[rng.choice(len(q), size=DRAWS, p=shares)]
