"""What draws tell: their convergence, weights, predicted records, and what the data said."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import units
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]

FEWEST_STEPS = 8  # of fewer steps of a chain, R̂ and effective sample size cannot be told
# of the effective sample size asked for: enough for tails that the table of the laws does not show
TAIL_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Convergence:
    """R̂ and effective sample sizes of every coordinate, (dim,) each."""

    r_hat: Array
    ess_bulk: Array
    ess_tail: Array
    tail_share: Array | float = 1.0  # of what is asked of the bulk: enough for the tail, (dim,)

    @property
    def worst_r_hat(self) -> float:
        """Largest R̂."""
        return float(np.max(self.r_hat))

    @property
    def worst_ess(self) -> float:
        """Smallest effective sample size: of a bulk, or of a tail divided by its share."""
        return float(min(self.ess_bulk.min(), np.min(self.ess_tail / self.tail_share)))

    def figures(self, k: int = 0) -> dict[str, float]:
        """R̂ and both effective sample sizes of one coordinate, by their names in tables."""
        return {n: float(getattr(self, n)[k]) for n in ("r_hat", "ess_bulk", "ess_tail")}

    def reached(self, r_hat: float, ess: float) -> bool:
        """Whether every coordinate meets both limits."""
        return self.worst_r_hat <= r_hat and self.worst_ess >= ess

    def share(self, r_hat: float, ess: float) -> float:
        """Approximate share of the steps needed for both limits that is done, from 0 to 1.

        The effective sample size is taken as proportional to the steps, and R̂ - 1 to 1/steps.
        """
        excess = self.worst_r_hat - 1.0
        agreed = (r_hat - 1.0) / excess if excess > 0.0 else 1.0
        return float(min(1.0, agreed, self.worst_ess / ess))


def autocorrelation_time(chains: Array) -> Array:
    """Integrated autocorrelation time of chains (ensemble, step, walker, dim), steps, (dim,).

    Walkers are centred on the mean over all ensembles and steps, not on their own mean, so
    that a walker that hardly moves counts as fully correlated. The sum stops
    where the lag exceeds five times its value (Sokal's window).
    """
    steps = chains.shape[1]
    size = 2 ** int(np.ceil(np.log2(2 * steps)))
    times = np.empty(chains.shape[-1])
    for k in range(times.size):
        centred = chains[..., k] - chains[..., k].mean()
        spectrum = np.abs(np.fft.rfft(centred, n=size, axis=1)) ** 2
        products = np.fft.irfft(spectrum.mean(axis=(0, 2)), n=size)[:steps]
        correlation = products / np.arange(steps, 0, -1)
        if correlation[0] <= 0:
            times[k] = np.inf
            continue
        sums = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
        converged = np.arange(steps) >= 5.0 * sums
        times[k] = sums[np.argmax(converged)] if np.any(converged) else max(sums[-1], steps / 5.0)
    return times


def measure(chains: Array, tail_share: Array | float = 1.0) -> Convergence:
    """Convergence of ensembles, of chains (ensemble, step, walker, dim).

    R̂ compares ensembles and their halves in time, since the walkers of one ensemble are not
    independent chains. The effective sample size follows each walker along its steps. A quantity
    that never moves has no R̂: NaN. `tail_share` is that of `Convergence`.
    """
    ensembles, steps, walkers, dim = chains.shape
    by_time = chains.reshape(ensembles, steps * walkers, dim)
    by_walker = np.swapaxes(chains, 1, 2).reshape(ensembles * walkers, steps, dim)
    if steps < FEWEST_STEPS:
        nothing = np.zeros(dim)
        return Convergence(np.full(dim, np.inf), nothing, nothing, tail_share)
    with np.errstate(divide="ignore", invalid="ignore"):  # draws that never move have no variance
        return Convergence(
            r_hat=np.array([_r_hat(by_time[..., k]) for k in range(dim)]),
            ess_bulk=np.array([_ess(by_walker[..., k], "bulk") for k in range(dim)]),
            ess_tail=np.array([_ess(by_walker[..., k], "tail") for k in range(dim)]),
            tail_share=tail_share,
        )


def measure_draws(draws: Array, walkers: int) -> Convergence:
    """Convergence of one quantity's stored draws (chain, draw), which are ordered by walker."""
    return measure(draws.reshape(len(draws), walkers, -1, 1).swapaxes(1, 2))


def effective_size(draws: Array) -> float:
    """Bulk effective sample size of one quantity's stored draws (chain, draw); 0 if too few."""
    return _ess(draws, "bulk") if draws.shape[1] >= FEWEST_STEPS else 0.0


def array_stats() -> Any:
    """ArviZ's statistics of arrays, imported where they are needed, as this takes long."""
    from arviz_stats.base.array import array_stats as functions

    return functions


def _r_hat(draws: Array) -> float:
    """Rank-normalised split R̂ of draws (chain, draw)."""
    return float(array_stats().rhat(draws, chain_axis=0, draw_axis=1, method="rank"))


def _ess(draws: Array, kind: str) -> float:
    """Effective sample size of draws (chain, draw), of the "bulk", or of the "tail" beyond 90 %."""
    tails = {"prob": (0.05, 0.95)} if kind == "tail" else {}
    return float(array_stats().ess(draws, chain_axis=0, draw_axis=1, method=kind, **tails))


def psis(log_ratios: Array, efficiency: float = 1.0) -> tuple[Array, float]:
    """Normalised Pareto-smoothed log weights, (n,), and Pareto k, by ArviZ; ∞ without a fit.

    Vehtari, Simpson, Gelman, Yao and Gabry (2024). Above k = 0.7 the weights cannot be trusted.
    `efficiency` is the effective sample size over n.
    """
    ratios = log_ratios - log_ratios.max()
    if np.all(ratios == 0.0):  # equal weights have no tail to fit
        return ratios - np.log(ratios.size), -np.inf
    log_weights, k = ratios, np.inf
    if ratios.size >= 25:  # ArviZ refuses to fit fewer than 5 draws in the tail
        # a tail that underflows has the fit NaN; one whose values are all the same is refused
        with np.errstate(all="ignore"), suppress(ValueError):
            smoothed, shape = array_stats().psislw(-ratios, r_eff=efficiency)
            if not (np.isnan(shape) or np.any(np.isnan(smoothed))):
                log_weights, k = smoothed, float(shape)
    return log_weights - np.logaddexp.reduce(log_weights), k


def systematic(log_weights: Array, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Numbers of n draws by their log weights, by systematic resampling."""
    edges = np.cumsum(np.exp(log_weights - log_weights.max()))
    places = (rng.random() + np.arange(n)) / n * edges[-1]
    return np.asarray(np.minimum(np.searchsorted(edges, places), len(edges) - 1))


def tempering(log_weights: Array, share: float) -> float:
    """Power of weights, at most 1, at which the effective size is a share of their number."""
    from scipy import optimize  # which takes long to import

    floor, ratios = np.log(share * log_weights.size), log_weights - log_weights.max()
    ratios = np.maximum(ratios, -1e6)  # that of −∞ would stay so at any power

    def excess(power: float) -> float:
        scaled = power * ratios
        size = 2.0 * scipy.special.logsumexp(scaled) - scipy.special.logsumexp(2.0 * scaled)
        return float(size - floor)

    if excess(1.0) >= 0.0:
        return 1.0
    return float(optimize.brentq(excess, 1e-6, 1.0, xtol=1e-4))


def contraction(prior_sd: Array, draws: Array) -> Array:
    """Share of the prior's variance that the data removed, 1 − var_post/var_prior, (dim,)."""
    return np.asarray(1.0 - draws.var(axis=0) / prior_sd**2)


def log_if_positive(*samples: Array) -> tuple[Array, ...]:
    """Logarithms of all samples if all are positive, else the samples unchanged."""
    if all(np.all(sample > 0) for sample in samples):
        return tuple(np.log(sample) for sample in samples)
    return samples


Interval = tuple[float, float, float]  # 50, 2.5 and 97.5 % quantiles of the draws of a quantity


def intervals_of(values: Mapping[str, Array]) -> dict[str, Interval]:
    """Median and equal-tailed 95 % interval of quantities, from draws of any shape."""
    probabilities = [0.5, 0.025, 0.975]
    return {name: tuple(np.quantile(x, probabilities).tolist()) for name, x in values.items()}


def interval_rows(
    intervals: Mapping[str, Interval], model: Model | None = None
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table: name, unit, median and 95 % interval of quantities, as text."""
    unit_of = units(model)
    rows = [(n, unit_of.get(n, ""), *(f"{x:.4g}" for x in three)) for n, three in intervals.items()]
    return ("quantity", "unit", "median", "2.5 %", "97.5 %"), rows


# --- posterior predictive records and checks ------------------------------------------------------

COVERAGES = (0.5, 0.9, 0.95)


@dataclass(frozen=True, eq=False)
class Replicas:
    """Records that the posterior predicts for the motion of its own test."""

    force: Array  # (n, T), kip: model force and offset, for posterior draws
    observed: Array  # (n, T), kip: the same with noise
    values: Mapping[str, Array]  # (n,): the posterior draws that were used


@dataclass(frozen=True)
class PredictiveCheck:
    """A test statistic: observed value, mean and p-value under the posterior predictive.

    `kind` is what it measures, as `campaign.tolerances` names it, and `size` by how much the model
    misses it: expected minus observed, as a share of what is measured.
    """

    name: str
    observed: float
    expected: float
    p_value: float
    kind: str
    size: float


def replicate(
    posterior: Posterior, values: Mapping[str, Array], rng: np.random.Generator, n: int = 1000
) -> Replicas:
    """Replicated records."""
    total = len(values["offset"])
    pick = np.linspace(0, total - 1, min(n, total)).astype(np.intp)
    draws = {name: column[pick] for name, column in values.items()}
    with np.errstate(over="ignore", invalid="ignore"):  # refused just below
        force = posterior.force(draws) + draws["offset"][:, None]
        noise = posterior.noise.draw(rng, posterior.trace.time, draws, posterior.travel(draws))
    check_magnitude("the replicated force", force + noise)
    return Replicas(force, force + noise, draws)


def check_predictive(
    posterior: Posterior, replicas: Replicas, gap: float | None
) -> tuple[PredictiveCheck, ...]:
    """Posterior predictive p-values of the test statistics, P(T(replica) ≥ T(record))."""
    rows = slice(posterior.first, None)
    force, replica = replicas.force[:, rows], replicas.observed[:, rows]
    record = np.broadcast_to(np.asarray(posterior.trace.force)[rows], force.shape)
    half = 0.5 * float(np.ptp(record[0]))
    rests = record - force, replica - force
    lags = _lag_one(rests[0]), _lag_one(rests[1])
    checks = [
        _check("residual rms, kip", "residual", _rms(rests[0]), _rms(rests[1])),
        _check("lag-one residual correlation", "correlation", *lags, scale=1.0),
    ]
    if gap is not None:
        samples = _mid_gap(posterior.trace, gap) - posterior.first
        samples = samples[samples >= 0]
        if samples.size:
            sides = _rms(record[:, samples]), _rms(replica[:, samples])
            checks.append(_check("force at mid-gap, kip", "mid_gap", *sides, scale=half))
    return tuple(checks)


def _check(
    name: str, kind: str, observed: Array, replicated: Array, scale: float | None = None
) -> PredictiveCheck:
    """Check of a statistic; `scale` is what its size is a share of, by default the observed."""
    ties = np.mean(replicated == observed)
    p_value = float(np.mean(replicated > observed) + 0.5 * ties)
    measured, expected = float(observed.mean()), float(replicated.mean())
    reference = max(abs(measured) if scale is None else scale, 1e-12)
    return PredictiveCheck(
        name, measured, expected, p_value, kind, (expected - measured) / reference
    )


def derive_from_parameters(
    model: Model,
    values: Mapping[str, Array],
    pressure: float = float("nan"),
    area: float | None = None,
) -> dict[str, Array]:
    """Travel from slip to slip, in, and self-energizing factors C = F_c/(p A) by name, (n,) each.

    Those that are unknown, as without a pressure (ksi) or an area of the actuator (in²), are left
    out.
    """
    width = model.slip_to_slip(values)
    derived = {} if width is None else {"slip_to_slip": width}
    if area is not None and pressure > 0.0:
        sides = zip(("C_fwd", "C_bwd"), model.slip_forces, strict=False)
        derived |= {name: values[force] / (pressure * area) for name, force in sides}
    return derived


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def _lag_one(values: Array) -> Array:
    centred = values - values.mean(axis=1, keepdims=True)
    products = np.sum(centred[:, 1:] * centred[:, :-1], axis=1)
    correlation: Array = products / np.maximum(np.sum(centred**2, axis=1), 1e-300)
    return correlation


def _mid_gap(trace: Trace, gap: float) -> NDArray[np.intp]:
    """Samples nearest to half the gap after each turning point that is followed by a crossing."""
    ends = [*trace.turning_points.tolist(), trace.samples - 1]
    samples = []
    for begin, end in itertools.pairwise(ends):
        travel = np.abs(trace.displacement[begin : end + 1] - trace.displacement[begin])
        if travel.max() >= gap:
            samples.append(begin + int(np.argmax(travel >= 0.5 * gap)))
    return np.array(samples, dtype=np.intp)


# --- what the data of one test say about its parameters -------------------------------------------

TRADE_OFF = 0.7  # absolute rank correlation from which two parameters trade off


@dataclass(frozen=True, eq=False)
class Directions:
    """Combinations of parameters, ordered by how much the data say about them.

    The curvature of the log likelihood is that along each direction in prior units: the precision
    that the data add, as a multiple of the prior's.
    """

    names: tuple[str, ...]
    curvature: Array  # (dim,), largest first
    axes: Array  # (dim, dim), unit vectors in prior units, one column for each direction
    limit: float = 1.0  # from which a direction is informed; more where there are few draws

    @property
    def informed(self) -> int:
        """Number of directions about which the data say more than the prior."""
        return int(np.sum(self.curvature > self.limit))

    def carriers(self, direction: int) -> tuple[str, ...]:
        """Parameters that contribute most to a direction, strongest first, at most three."""
        share = self.axes[:, direction] ** 2
        return tuple(self.names[i] for i in np.argsort(-share)[:3] if share[i] >= 0.1)


@dataclass(frozen=True)
class Pair:
    """Two parameters that trade off, and the rank correlation of their draws."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data of a test say about its sampled parameters."""

    directions: Directions
    pairs: tuple[Pair, ...]  # strongest first


def find_directions(
    names: tuple[str, ...], prior_sd: Array, draws: Array, size: float = np.inf
) -> Directions:
    """Directions that the data inform, from the covariance of posterior draws.

    With prior covariance C0 = diag(prior_sd²) and posterior covariance C, the likelihood's
    curvature in prior units is H = C0^½ C⁻¹ C0^½ − I, and its eigenvectors are the directions
    that the data inform (Spantini et al., SIAM J. Sci. Comput. 37, 2015; Cui et al., Inverse
    Problems 30, 2014). That is exact for a linear model with Gaussian prior and noise.
    Otherwise it holds for the Gaussian with the posterior's covariance: it describes the whole
    posterior, where derivatives at a mode describe one point. A negative eigenvalue means a
    posterior wider than its prior.
    """
    covariance = np.atleast_2d(np.cov(draws / prior_sd, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)  # smallest first: best known first
    curvature = 1.0 / np.maximum(variances, np.finfo(float).tiny) - 1.0
    limit = least_curvature(len(names), min(size, len(draws)))
    return Directions(names, np.asarray(curvature), np.asarray(axes), limit)


def least_curvature(dim: int, size: float) -> float:
    """Curvature that a sample must show before a direction counts as informed.

    The smallest eigenvalue of the covariance of few draws is too small. With γ = dim/n, and a true
    variance of 1 in all directions but one, of λ there, a sample shows λ (1 − γ/(1 − λ)) if λ is
    below 1 − √γ, and cannot tell it from the Marchenko–Pastur edge (1 − √γ)² of the others if not
    (Baik and Silverstein, J. Multivar. Anal. 97, 2006). Here λ = ½, a curvature of 1. Chance
    moves the edge by about n^(−2/3) (Tracy and Widom): twice that is kept clear of it.
    """
    share = dim / max(size, 1e-9)
    if share >= 1.0:
        return np.inf
    edge = (1.0 - np.sqrt(share)) ** 2
    step = (1.0 - np.sqrt(share)) ** (4.0 / 3.0) * share ** (-1.0 / 6.0) * size ** (-2.0 / 3.0)
    clear = max(edge - 2.0 * step, 0.0)
    eigenvalue = 0.5 * (1.0 - 2.0 * share) if share < 0.25 else edge
    smallest = min(eigenvalue, clear)
    return float(1.0 / smallest - 1.0) if smallest > 0.0 else np.inf


def find_pairs(names: tuple[str, ...], draws: Array) -> tuple[Pair, ...]:
    """Pairs whose posterior draws (n, dim) have a rank correlation of ±0.7 or beyond."""
    from scipy.stats import rankdata  # which takes long to import

    with np.errstate(invalid="ignore"):  # draws that never move have no correlation
        correlation = np.atleast_2d(np.corrcoef(rankdata(draws, axis=0), rowvar=False))
    pairs = [
        Pair(names[i], names[j], float(correlation[i, j]))
        for i, j in itertools.combinations(range(len(names)), 2)
        if abs(correlation[i, j]) >= TRADE_OFF
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))
