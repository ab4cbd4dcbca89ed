"""A second fit of the same record, near a first one: cheap, by importance sampling.

What a posterior becomes when something about it is changed, such as its noise. The first fit's
draws and modes say where to look, so that a few modes and some thousand weighted draws do; only
where the weights cannot be trusted are walkers sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis, tempering
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.ensembles import sample_density
from mfd_bayes.calibration.map_fit import Mode, climb, is_same, prior_scale
from mfd_bayes.calibration.mixture import Proposal, learn
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.starts import around_modes
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

DRAWS = 3000
"""Draws of each proposal."""

ROUNDS = 6
"""Largest number of proposals before walkers are sent."""

LARGEST_K = 0.7
"""Pareto k above which importance weights cannot be trusted."""

LEAST = 100.0
"""Effective number of weighted draws that is enough for a median and an interval."""

SHARE = 0.1
"""Effective number of draws, as a share of all, from which the next proposal is learned."""

PARTS = 4
"""Student-t components of a proposal, besides its wide one."""

TRIED = 64
"""Prior draws of what the first fit does not have, of which each start takes the best."""

WALK = Effort(
    name="second fit", ess=50, limit=1200, r_hat=1.1, length=2.0, ensembles=2, kept=1200, starts=1
)
"""Sampling where weights fail: enough for a median and an interval, not for their digits."""

OF_DRAWS, BY_WEIGHTS, BY_WALKERS = "draws, weighted", "second fit", "second sampling"


@dataclass(frozen=True, eq=False)
class SecondFit:
    """Weighted draws of a second fit.

    Attributes
    ----------
    q : (n, dim)
        Unconstrained coordinates.
    weights : (n,)
        They sum to 1.
    how : {"draws, weighted", "second fit", "second sampling"}
        Whether a proposal learned from the first fit's draws was enough, or proposals learned
        anew, or walkers were needed.
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
    posterior: Posterior,
    draws: Mapping[str, Array],
    starts: Mapping[str, Array],
    rng: np.random.Generator,
) -> SecondFit:
    """Weighted draws of a posterior that is near another one.

    Parameters
    ----------
    posterior : Posterior
        The second one; it may have quantities that the first has not.
    draws : mapping of str to (n,)
        Draws of the first one, without what has another meaning in the second.
    starts : mapping of str to (m,)
        The same quantities at the points from which modes are searched.

    Raises
    ------
    FitError
        When there is no density around any start.
    """
    modes = _modes_near(posterior, starts, rng)
    anchors = around_modes(modes, 1.0)
    random = np.random.RandomState(int(rng.integers(2**32)))
    pick = rng.choice(len(next(iter(draws.values()))), size=DRAWS)
    some = {name: column[pick] for name, column in draws.items()}
    begin = _completed(posterior, some, anchors.draw(random, DRAWS))
    found = _weighted(posterior.log_prob, begin, anchors, rng)
    if found.k <= LARGEST_K and found.size >= LEAST:
        return found
    chains = sample_density(posterior.log_prob, modes, WALK, rng)
    flat = chains.q.reshape(-1, posterior.dim)
    size = chains.convergence.worst_ess
    return SecondFit(flat, np.full(len(flat), 1.0 / len(flat)), BY_WALKERS, found.k, size)


def _modes_near(
    posterior: Posterior, starts: Mapping[str, Array], rng: np.random.Generator
) -> tuple[Mode, ...]:
    """Modes that are climbed to from each start, best first."""
    sd = prior_scale(posterior, rng)[1]
    tried = posterior.coordinates(posterior.draw_prior(rng, TRIED))
    modes: list[Mode] = []
    for number in range(len(next(iter(starts.values())))):
        start = {name: np.full(TRIED, column[number]) for name, column in starts.items()}
        points = _completed(posterior, start, tried)
        heights = posterior.log_prob(points)
        if not np.any(np.isfinite(heights)):
            continue
        mode = climb(posterior.log_prob, points[np.argmax(heights)], sd)
        if not any(is_same(mode, other) for other in modes):
            modes.append(mode)
    if not modes:
        raise FitError("no density around the first fit")
    return tuple(sorted(modes, key=lambda mode: -mode.log_prob))


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
    """Weighted draws of the best of several proposals; the first is learned from `begin`.

    Population Monte Carlo (Cappé et al., 2004) with tempered weights (Koblents and Míguez, 2015).
    """
    random = np.random.RandomState(int(rng.integers(2**32)))
    best = SecondFit(begin, np.full(len(begin), 1.0 / len(begin)), OF_DRAWS, np.inf, 0.0)
    source = begin
    for number in range(ROUNDS):
        proposal = learn(source, PARTS, rng, anchors)
        q = proposal.draw(random, DRAWS)
        ratios = density(q) - proposal.log_density(q)
        if not np.any(np.isfinite(ratios)):
            break
        smooth, k = psis(ratios)
        weights = np.exp(smooth)
        size = float(1.0 / np.sum(weights**2))
        if k < best.k:
            how = BY_WEIGHTS if number else OF_DRAWS
            best = SecondFit(q, weights / weights.sum(), how, k, size)
        if k <= LARGEST_K and size >= LEAST:
            break
        shares = special.softmax(tempering(ratios, SHARE) * (ratios - ratios.max()))
        source = q[rng.choice(DRAWS, size=DRAWS, p=shares)]
    return best
