"""Whether the noise model decides a test's parameters: fits of the same test under other noises.

Such a fit is near the first one, whose draws say where to look: a few climbs and some thousand
weighted draws do. Only where the weights cannot be trusted are walkers sent.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.modes import Mode, climb, distinct, find_modes, prior_scale
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import (
    Adaptive,
    Proposal,
    WeightedDraws,
    around_modes,
    fit_mixture,
)
from mfd_bayes.errors import FitError, MfdError

if TYPE_CHECKING:
    from mfd_bayes.calibration.sampling import Draws

Array = NDArray[np.float64]
Bounds = tuple[float, float, float]

HALF = 0.5  # share of its 95 % interval by which a quantity may move
QUANTILES = (0.025, 0.5, 0.975)
FORMAL = frozenset({"gamma1", "gamma2", "start"})  # quantities that say nothing about the damper
DRAWS, ROUNDS = 1000, 12  # draws of each proposal; most proposals before walkers are sent
FRESH = 2000  # draws of the last of several proposals, which are kept
LARGEST_K, ENOUGH = 0.7, 200.0  # Pareto k, effective draws, from which weights are trusted
STARTS = 3  # draws of the first fit from which modes are climbed to
SEARCHED = 6  # points from which modes are searched before walkers are sent
TRIED = 64  # prior draws of what the first fit does not have, of which each start takes the best
# sampling where weights fail: enough for a median and an interval, not for their digits
WALK = Effort(
    name="second fit", ess=50, limit=400, r_hat=1.1, length=2.0, ensembles=2, kept=1200, starts=1
)
APART = 1.2  # R̂ of these walkers above which they do not tell where the posterior is
AT_ONCE, BY_WEIGHTS, BY_WALKERS = "one proposal", "several proposals", "walkers"


@dataclass(frozen=True)
class OtherFit:
    """A test's parameters under another noise."""

    noise: str
    how: str = ""  # as `SecondFit` has it; "" where it failed
    k: float = float("nan")  # Pareto k of its weights
    size: float = 0.0  # effective number of draws
    quantities: Mapping[str, Bounds] = field(default_factory=dict)  # 2.5 %, 50 %, 97.5 %
    seconds: float = 0.0  # processor time
    error: str = ""  # why there is no fit, if there is none


@dataclass(frozen=True, eq=False)
class SecondFit:
    """Weighted draws of a second fit."""

    q: Array  # (n, dim)
    weights: Array  # (n,), which sum to 1
    how: str  # AT_ONCE, BY_WEIGHTS or BY_WALKERS
    k: float  # Pareto k of the weights; of walkers, that of the weights that failed
    size: float  # effective number of draws


def moves(own: Sequence[float], other: Sequence[float]) -> bool:
    """Whether another noise moves a quantity: 2.5 %, 50 % and 97.5 % quantile under each.

    Its median moves by more than `HALF` of its 95 % interval, or the intervals do not overlap.
    """
    (low, middle, high), (below, there, above) = own, other
    return abs(there - middle) > HALF * (high - low) or below > high or above < low


def other_noises(noise: str) -> tuple[str, ...]:
    """Noises under which a test with this noise is fitted again."""
    ordered = dict.fromkeys(("ou", "staged", "iid", *NOISES))
    return tuple(name for name in ordered if name != noise and name in NOISES)


def fit_other(
    noise: str,
    first: Posterior,
    make: Callable[[], Posterior],
    draws: Draws,
    seed: Sequence[int],
) -> OtherFit:
    """Parameters of a test under another noise; a fit that fails is a result too."""
    began = time.process_time()
    rng = np.random.default_rng((*seed, 17, *noise.encode()))
    shared = [name for name in first.names if name not in first.noise.parameters]
    try:
        second = make()
        fit = fit_again(second, {n: draws.values[n].reshape(-1) for n in shared}, rng)
        quantities = quantiles_of(second, second.values(fit.q), fit.weights)
    except (MfdError, np.linalg.LinAlgError) as error:
        return OtherFit(noise, error=str(error), seconds=time.process_time() - began)
    seconds = time.process_time() - began
    return OtherFit(noise, fit.how, fit.k, fit.size, quantities, seconds)


def quantiles_of(
    posterior: Posterior, values: Mapping[str, Array], weights: Array | None = None
) -> dict[str, Bounds]:
    """2.5 %, 50 % and 97.5 % quantile of all that tells of the damper, and of the gap."""
    model = posterior.model
    formal = {*posterior.noise.parameters, "start"} | (set() if model.own else FORMAL)
    columns = dict(zip(model.parameters, posterior.theta(values).T, strict=True)) | dict(values)
    if (gap := model.gap(values)) is not None:
        columns["gap"] = gap
    weighted: dict[str, Any] = {"weights": weights, "method": "inverted_cdf"}
    options = {} if weights is None else weighted
    return {
        name: tuple(np.quantile(column, QUANTILES, **options).tolist())
        for name, column in columns.items()
        if name not in formal and np.ptp(column) > 0.0
    }


def fit_again(
    posterior: Posterior, draws: Mapping[str, Array], rng: np.random.Generator
) -> SecondFit:
    """Weighted draws of a posterior that is near another one."""
    near = _modes_near(posterior, draws, rng)
    anchors = around_modes(near)
    begin = _completed(posterior, _some(draws, DRAWS, rng), anchors.draw(rng, DRAWS))
    first = Proposal((0.75, 0.25), (fit_mixture(begin, rng), anchors))
    fit = Adaptive(posterior.log_prob, first, rng, DRAWS)
    for rounds in range(1, ROUNDS + 1):
        fit.run()
        if not (fit.k <= LARGEST_K and fit.size >= ENOUGH):
            continue
        if rounds == 1:
            return SecondFit(fit.q, fit.weights, AT_ONCE, fit.k, fit.size)
        fresh = WeightedDraws.of(posterior.log_prob, fit.proposals[-1], rng, FRESH)
        if fresh.k <= LARGEST_K and fresh.size >= ENOUGH:
            return SecondFit(fresh.q, fresh.weights, BY_WEIGHTS, fresh.k, fresh.size)
    from mfd_bayes.calibration.sampling import sample_density  # emcee takes long to import

    modes = distinct([*near, *find_modes(posterior, rng, starts=SEARCHED)])
    chains = sample_density(posterior.log_prob, modes, WALK, rng)
    size, r_hat = chains.convergence.worst_ess, chains.convergence.worst_r_hat
    if not (r_hat <= APART and size >= WALK.ess):
        raise FitError("neither weighted draws nor walkers settled")
    flat = chains.q.reshape(-1, posterior.dim)
    return SecondFit(flat, np.full(len(flat), 1.0 / len(flat)), BY_WALKERS, fit.k, size)


def _modes_near(
    posterior: Posterior, draws: Mapping[str, Array], rng: np.random.Generator
) -> list[Mode]:
    """Modes that are climbed to from some of the draws."""
    sd = prior_scale(posterior, rng)[1]
    tried = posterior.coordinates(posterior.draw_prior(rng, TRIED))
    size = len(next(iter(draws.values())))
    q = _completed(posterior, draws, np.zeros((size, posterior.dim)))
    known = [k for k, name in enumerate(posterior.names) if name in draws]
    # axes are those of the draws, and a tenth of the prior's sd of the rest
    covariance = np.diag((0.1 * sd) ** 2)
    covariance[np.ix_(known, known)] = np.cov(q[:, known].T) + np.diag((1e-4 * sd[known]) ** 2)
    axes = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    modes: list[Mode] = []
    for values in np.transpose(list(_some(draws, STARTS, rng).values())):
        start = {name: np.full(TRIED, at) for name, at in zip(draws, values, strict=True)}
        points = _completed(posterior, start, tried)
        heights = posterior.log_prob(points)
        if np.any(np.isfinite(heights)):
            best = points[np.argmax(heights)]
            modes = distinct([*modes, climb(posterior.log_prob, best, axes, sd, modes)])
    if not modes:
        raise FitError("no density around the first fit")
    return modes


def _some(draws: Mapping[str, Array], size: int, rng: np.random.Generator) -> dict[str, Array]:
    """Some of the draws, with replacement."""
    pick = rng.choice(len(next(iter(draws.values()))), size=size)
    return {name: column[pick] for name, column in draws.items()}


def _completed(posterior: Posterior, known: Mapping[str, Array], rest: Array) -> Array:
    """Coordinates with the known quantities, and with those of `rest` for the others, (n, dim)."""
    own = posterior.to_own(rest)
    for column, name in enumerate(posterior.names):
        if name in known:
            own[:, column] = posterior.priors[name].coordinate(known[name])
    return posterior.from_own(own)
