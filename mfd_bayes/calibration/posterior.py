"""The posterior of one test, on unconstrained coordinates, and checks of what it predicts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.noise import Noise, find_noise
from mfd_bayes.calibration.priors import Prior, PriorFile, load_priors, priors_of_fit
from mfd_bayes.errors import FitError, whole_number
from mfd_bayes.friction.model import Model, columns_in_order, named_columns, named_vectors
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.trace import Trace, check_magnitude, check_trace
from mfd_bayes.store.cards import card, counted

Array = NDArray[np.float64]

AT_ONCE = 1 << 24  # points times samples whose forces are computed at once: some 400 MB


@dataclass(frozen=True)
class Pivot:
    """Friction at the record's usual speed, sampled in place of kinetic friction.

    A slow test tells F_s, a fast one F_c; F_c (1 + c e), with c the mean of exp(−(v/v_s)²)
    over the motion and e the excess of static friction, is what either knows best. The
    logarithms of both differ by log(1 + c e), which depends on e alone: the Jacobian is 1.
    """

    kinetic: int  # columns of q
    excess: int
    share: float  # c
    prior: Prior  # of the excess

    def shift(self, points: Array) -> Array:
        """Difference between the sampled coordinate and log F_c, log(1 + c e), (n,)."""
        shift: Array = np.log1p(self.share * self.prior.value(points[:, self.excess]))
        return shift


@dataclass(frozen=True, init=False, eq=False)
class Posterior:
    """Density of the parameters of one test, given its record (model.md section 5).

    Parameters
    ----------
    trace : Trace
        With a force.
    priors : str or PriorFile
        A name such as "brfd", a path, or priors already read.
    noise : str
        A name in `noise.NOISES`: "ou", "iid", "student_t" or "staged".
    model : Model or str, optional
        The three-stage model when left out.
    start : {"sample", "mask"}
        The place in the gap at the first sample is unknown: it is sampled, or the samples up to
        the first slip are left out of the likelihood.

    Attributes
    ----------
    names : tuple of str
        The quantity of each column of q. Each column is the coordinate of the quantity's prior,
        except kinetic friction where there is a `Pivot`.
    pivots : tuple of Pivot
    first : int
        Samples before this one are left out of the likelihood.

    Raises
    ------
    FitError
        When the trace has no force, or a name is unknown.
    PriorError
        When a parameter has no prior.
    """

    trace: Trace
    model: Model
    noise: Noise
    priors: Mapping[str, Prior]
    names: tuple[str, ...]
    pivots: tuple[Pivot, ...]
    first: int

    def __init__(
        self,
        trace: Trace,
        priors: str | PriorFile = "mfd",
        noise: str = "ou",
        model: Model | str = "three_stage",
        *,
        start: str = "sample",
    ) -> None:
        if check_trace("trace", trace, FitError).force is None:
            raise FitError("a posterior needs a trace with a measured force")
        chosen = find_model(model) if isinstance(model, str) else model
        if not isinstance(chosen, Model):
            raise FitError(f"model must be a name or a model such as LuGre(), got {chosen!r}")
        if start not in ("sample", "mask"):
            raise FitError(f"unknown start {start!r}: expected 'sample' or 'mask'")
        file = priors if isinstance(priors, PriorFile) else load_priors(str(priors), model=chosen)
        kind = find_noise(noise)
        own = priors_of_fit(file, chosen, kind, sampled_start=start == "sample")
        names = tuple(n for n, p in own.items() if not p.fixed and n not in chosen.keeps_prior)
        vars(self).update(trace=trace, model=chosen, noise=kind, priors=own, names=names)
        vars(self).update(
            pivots=_pivots(trace, names, own) if chosen.standard_names else (),
            first=first_slip(trace, file, chosen) if start == "mask" else 0,
        )
        if chosen.own:  # a user's model that cannot be used is refused before it is sampled
            typical = {name: np.array([prior.typical]) for name, prior in own.items()}
            chosen.force(chosen.theta(typical), trace)

    def _repr_html_(self) -> str:
        trace = self.trace
        facts = [
            ("model", self.model.name),
            ("noise", self.noise.name),
            ("record", f"{counted(trace.samples, 'sample')} over {np.ptp(trace.time):.4g} s"),
            ("sampled", f"{self.dim} quantities: {', '.join(self.names)}"),
        ]
        return card("Posterior of one test", facts)

    @property
    def dim(self) -> int:
        """Number of sampled coordinates."""
        return len(self.names)

    @cached_property
    def _defaults(self) -> dict[str, float]:
        """Values of what is not part of q; γ1 and start of every model, but γ1 of a user's own."""
        fixed = {name: p.figures["value"] for name, p in self.priors.items() if p.fixed}
        formal = {"gamma1": 1.0} if self.model.standard_names else {}
        return formal | {"start": 0.5} | fixed

    def log_prob(self, q: ArrayLike) -> Array:
        """Log posterior density of q, unnormalised, (n, dim) -> (n,)."""
        points = self._check(q)
        density = self.log_prior(points)
        inside = np.isfinite(density)
        density[inside] += self._log_likelihood(points[inside])
        if np.any(np.isnan(density)):
            raise FitError("the log posterior is not a number: please report this as a bug")
        return density

    def log_prior(self, q: ArrayLike) -> Array:
        """Log prior density of q with its Jacobian, (n, dim) -> (n,)."""
        own = self.to_own(self._check(q))
        density = np.zeros(len(own))
        for name, column in zip(self.names, own.T, strict=True):
            density += self.priors[name].log_density(column)
        return density

    def log_likelihood(self, q: ArrayLike) -> Array:
        """Log likelihood of q, (n, dim) -> (n,); −inf where the force is beyond all range.

        It is −inf too where the prior has no density, since a value there may be none of a damper.
        """
        points = self._check(q)
        density = np.full(len(points), -np.inf)
        inside = np.isfinite(self.log_prior(points))
        density[inside] = self._log_likelihood(points[inside])
        return density

    def _log_likelihood(self, points: Array) -> Array:
        """As `log_likelihood`; many points of a long record some at a time, to bound the memory."""
        if len(points) == 0:
            return np.empty(0)
        parts = min(-(-len(points) * self.trace.samples // AT_ONCE), len(points))
        if parts > 1:
            some = np.array_split(points, parts)
            return np.concatenate([self._log_likelihood(part) for part in some])
        values, kept = self.values(points), slice(self.first, None)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            residual, travel = self._residual(values)[:, kept], self.travel(values)
            travel = None if travel is None else travel[:, kept]
            density = self.noise.log_density(residual, self.trace.time[kept], values, travel)
        return np.where(np.isnan(density), -np.inf, density)

    def residual(self, q: ArrayLike, scales: Mapping[str, Array] | None = None) -> Array:
        """What the model leaves over, F_obs − F0 − F, (n, T), kip; scales as in `Model.force`."""
        return self._residual(self.values(q), scales)

    def _residual(
        self, values: Mapping[str, Array], scales: Mapping[str, Array] | None = None
    ) -> Array:
        left = np.asarray(self.trace.force) - self.force(values, scales=scales)
        left -= values["offset"][:, None]
        return left

    def force(
        self,
        values: Mapping[str, Array],
        trace: Trace | None = None,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of the model without the load cell's offset, (n, T), kip."""
        return self.model.force_unbounded(*self._motion(values, trace), scales=scales)

    def travel(self, values: Mapping[str, Array], trace: Trace | None = None) -> Array | None:
        """Travel since the last slip, (n, T), in; None where the noise does not need it."""
        if not self.noise.needs_travel:
            return None
        return self.model.travel(*self._motion(values, trace))

    def _motion(
        self, values: Mapping[str, Array], trace: Trace | None
    ) -> tuple[Array, Trace, Array]:
        """Parameters, motion and place in the gap, as the model takes them."""
        motion = self.trace if trace is None else check_trace("trace", trace, FitError)
        return self.theta(values), motion, named_columns(values, ("start",))["start"]

    def values(self, q: ArrayLike) -> dict[str, Array]:
        """Values of all quantities of q by name, (n,) each, internal units.

        γ1 is 1 here: it does not matter to the force.
        """
        own = self.to_own(self._check(q))
        values = {name: np.full(len(own), value) for name, value in self._defaults.items()}
        columns = zip(self.names, own.T, strict=True)
        return values | {name: self.priors[name].value(column) for name, column in columns}

    def derived(self, q: ArrayLike) -> Array:
        """Friction forces that follow from several coordinates, (n, m), kip."""
        theta = self.theta(self.values(q))
        several = {self.names[pivot.kinetic] for pivot in self.pivots}
        several |= set(self.model.composed(self.names))
        return theta[:, [k for k, n in enumerate(self.model.parameters) if n in several]]

    def coordinates(self, values: Mapping[str, Array]) -> Array:
        """Coordinates q of values by name, (n, dim), the inverse of `values`."""
        columns = named_vectors(values, self.names)
        own = [self.priors[name].coordinate(value) for name, value in columns.items()]
        return self.from_own(np.stack(own, axis=1))

    def to_own(self, points: Array) -> Array:
        """Coordinates of the priors themselves, of those that are sampled, (n, dim)."""
        own = points.copy()
        for pivot in self.pivots:
            own[:, pivot.kinetic] -= pivot.shift(points)
        return own

    def from_own(self, own: Array) -> Array:
        """The coordinates that are sampled, of those of the priors, (n, dim)."""
        points = own.copy()
        for pivot in self.pivots:
            points[:, pivot.kinetic] += pivot.shift(own)
        return points

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters of the model in its own order, (n, p)."""
        return self.model.theta(values)

    def draw_prior(self, rng: np.random.Generator, n: int) -> dict[str, Array]:
        """Independent draws of all quantities from the prior, by name, (n,) each."""
        if not isinstance(rng, np.random.Generator | np.random.RandomState):
            raise FitError(f"rng must be a generator, as np.random.default_rng(1), got {rng!r}")
        whole_number("the number of draws", n, 0, FitError)
        defaults = {k: np.full(n, v) for k, v in self._defaults.items()}
        return defaults | {name: prior.draw(rng, n) for name, prior in self.priors.items()}

    def _check(self, q: ArrayLike) -> Array:
        points = columns_in_order("q", q, self.names)
        if points.ndim != 2 or points.shape[1] != self.dim:
            raise FitError(f"q must have shape (n, {self.dim}), got {points.shape}")
        if np.any(np.isnan(points)):
            raise FitError("q holds NaN")
        return points


def _pivots(trace: Trace, names: tuple[str, ...], priors: Mapping[str, Prior]) -> tuple[Pivot, ...]:
    """Pivots of the directions in which F_c, on its log scale, and its excess are sampled."""
    if "v_s" not in priors:
        return ()
    velocity = trace.velocity
    moving = np.abs(velocity) > 0.01 * np.max(np.abs(velocity))
    stribeck = np.exp(-((velocity / priors["v_s"].typical) ** 2))
    pivots = []
    for side, sign in (("fwd", 1.0), ("bwd", -1.0)):
        kinetic, excess = f"Fc_{side}", f"static_excess_{side}"
        there = moving & (sign * velocity > 0)
        if {kinetic, excess} <= set(names) and priors[kinetic].on_half_line and np.any(there):
            columns = names.index(kinetic), names.index(excess)
            pivots.append(Pivot(*columns, float(np.mean(stribeck[there])), priors[excess]))
    return tuple(pivots)


def first_slip(trace: Trace, file: PriorFile, model: Model) -> int:
    """Sample from which the device has surely slipped: after a stretch of two prior gaps."""
    gap = file.gap if model.standard_names or model.has_gap else None
    if gap is None and not model.has_gap:
        return 0
    if gap is None:
        raise FitError(
            f"start = 'mask' needs the width of the gap: {file.path.name} has no priors of d2 and "
            "d3, and none of gap"
        )
    for begin, end in itertools.pairwise([0, *trace.turning_points.tolist()]):
        if abs(trace.displacement[end] - trace.displacement[begin]) >= 2.0 * gap:
            return int(end)
    raise FitError(
        "start = 'mask' needs a record that goes on after a stroke of twice the prior's gap: what "
        "comes before is not fitted"
    )


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
    kind: str = ""
    size: float = float("nan")


def replicate(
    posterior: Posterior, values: Mapping[str, Array], rng: np.random.Generator, n: int = 1000
) -> Replicas:
    """Replicated records."""
    total = len(values["offset"])
    pick = np.linspace(0, total - 1, min(n, total)).astype(np.intp)
    taken = {name: column[pick] for name, column in values.items()}
    with np.errstate(over="ignore", invalid="ignore"):  # refused just below
        force = posterior.force(taken) + taken["offset"][:, None]
        noise = posterior.noise.draw(rng, posterior.trace.time, taken, posterior.travel(taken))
    check_magnitude("the replicated force", force + noise)
    return Replicas(force, force + noise, taken)


def check_predictive(
    posterior: Posterior, replicas: Replicas, gap: float | None
) -> tuple[PredictiveCheck, ...]:
    """Posterior predictive p-values of the test statistics, P(T(replica) ≥ T(record))."""
    kept = slice(posterior.first, None)
    force, replica = replicas.force[:, kept], replicas.observed[:, kept]
    record = np.broadcast_to(np.asarray(posterior.trace.force)[kept], force.shape)
    half = 0.5 * float(np.ptp(record[0]))
    rests = record - force, replica - force
    lags = _lag_one(rests[0]), _lag_one(rests[1])
    found = [
        _check("residual rms, kip", "residual", _rms(rests[0]), _rms(rests[1])),
        _check("lag-one residual correlation", "correlation", *lags, scale=1.0),
    ]
    if gap is not None:
        at = _mid_gap(posterior.trace, gap) - posterior.first
        at = at[at >= 0]
        if at.size:
            sides = _rms(record[:, at]), _rms(replica[:, at])
            found.append(_check("force at mid-gap, kip", "mid_gap", *sides, scale=half))
    return tuple(found)


def _check(
    name: str, kind: str, observed: Array, replicated: Array, scale: float | None = None
) -> PredictiveCheck:
    """Check of a statistic; `scale` is what its size is a share of, by default the observed."""
    ties = np.mean(replicated == observed)
    p_value = float(np.mean(replicated > observed) + 0.5 * ties)
    seen, expected = float(observed.mean()), float(replicated.mean())
    whole = max(abs(seen) if scale is None else scale, 1e-12)
    return PredictiveCheck(name, seen, expected, p_value, kind, (expected - seen) / whole)


def derive_from_parameters(
    model: Model,
    values: Mapping[str, Array],
    pressure: float = float("nan"),
    area: float | None = None,
) -> dict[str, Array]:
    """Gap width, in, and self-energizing factors C = F_c/(p A) by name, (n,) each.

    Those that are unknown, as without a pressure (ksi) or an area of the actuator (in²), are left
    out.
    """
    width = model.gap_width(values)
    derived = {} if width is None else {"gap_width": width}
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
