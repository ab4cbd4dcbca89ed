"""The posterior density of one test."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.calibration.noises import Noise, find_noise
from mfd_bayes.calibration.priors import Array, Prior, PriorFile, load_priors, priors_of_fit
from mfd_bayes.errors import FitError, whole_number
from mfd_bayes.friction.model import BESIDE, Model, columns_in_order, named_columns, named_vectors
from mfd_bayes.friction.models import find_model
from mfd_bayes.messages import counted
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.store.cards import card

AT_ONCE = 1 << 24  # points times samples whose forces are computed at once: some 400 MB


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
    initial : {"sample", "discard"}
        The place in the gap at the first sample is unknown: it is sampled, or the samples up to
        the first slip are left out of the likelihood.

    Attributes
    ----------
    names : tuple of str
        The quantity of each column of q, which is the coordinate of the quantity's prior.
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
    first: int

    def __init__(
        self,
        trace: Trace,
        priors: str | PriorFile = "mfd",
        noise: str = "ou",
        model: Model | str = "three_stage",
        *,
        initial: str = "sample",
    ) -> None:
        if check_trace(trace, FitError).force is None:
            raise FitError("a posterior needs a trace with a measured force")
        force_model = find_model(model) if isinstance(model, str) else model
        if not isinstance(force_model, Model):
            raise FitError(f"model must be a name or a model such as LuGre(), got {force_model!r}")
        if initial not in ("sample", "discard"):
            raise FitError(f"unknown initial {initial!r}: expected 'sample' or 'discard'")
        file = (
            priors if isinstance(priors, PriorFile) else load_priors(str(priors), model=force_model)
        )
        kind = find_noise(noise)
        prior_of = priors_of_fit(file, force_model, kind, sampled_start=initial == "sample")
        names = tuple(
            n for n, p in prior_of.items() if not p.fixed and n not in force_model.nonidentifiable
        )
        start_index = first_slip(trace, file, force_model) if initial == "discard" else 0
        vars(self).update(
            trace=trace,
            model=force_model,
            noise=kind,
            priors=prior_of,
            names=names,
            first=start_index,
        )
        if force_model.own:  # a user's model that cannot be used is refused before it is sampled
            draw = self.sample_prior(1)
            values = {name: np.append(prior_of[name].median, draw[name]) for name in prior_of}
            shifted = values | {name: values[name] * (1.0 - BESIDE) for name in names}
            force_model.check_force(force_model.theta(values), force_model.theta(shifted), trace)

    def __repr__(self) -> str:
        return (
            f"Posterior({self.model.name}, {self.noise.name}; {self.trace.samples} samples; q: "
            f"{', '.join(self.names)})"
        )

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
        prior = self.log_prior(points)
        return prior + self._log_likelihood(points, prior)

    def log_prior(self, q: ArrayLike) -> Array:
        """Log prior density of q with its Jacobian, (n, dim) -> (n,)."""
        points = self._check(q)
        density = np.zeros(len(points))
        for name, column in zip(self.names, points.T, strict=True):
            density += self.priors[name].log_density(column)
        return density

    def log_likelihood(self, q: ArrayLike) -> Array:
        """Log likelihood of q, (n, dim) -> (n,); −inf where the force is beyond all range.

        It is −inf too where the prior has no density, since a value there may be none of a damper.
        """
        points = self._check(q)
        return self._log_likelihood(points, self.log_prior(points))

    def _log_likelihood(self, points: Array, log_prior: Array) -> Array:
        """As `log_likelihood`; many points of a long record some at a time, to bound the memory."""
        density, window = np.full(len(points), -np.inf), slice(self.first, None)
        finite = np.flatnonzero(np.isfinite(log_prior))
        batch = max(AT_ONCE // self.trace.samples, 1)
        for begin in range(0, finite.size, batch):
            rows = finite[begin : begin + batch]
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                values = self.values(points[rows])
                residual, travel = self.residual(points[rows])[:, window], self.travel(values)
                travel = None if travel is None else travel[:, window]
                density[rows] = self.noise.log_density(
                    residual, self.trace.time[window], values, travel
                )
        return np.where(np.isnan(density), -np.inf, density)

    def residual(self, q: ArrayLike, scales: Mapping[str, Array] | None = None) -> Array:
        """What the model leaves over, F_obs − F0 − F, (n, T), kip; scales as in `Model.force`."""
        values = self.values(q)
        residual = np.asarray(self.trace.force) - self.force(values, scales)
        residual -= values["offset"][:, None]
        return residual

    def force(
        self, values: Mapping[str, Array], scales: Mapping[str, Array] | None = None
    ) -> Array:
        """Force of the model without the load cell's offset, (n, T), kip."""
        theta, start = self.theta(values), named_columns(values, ("start",))["start"]
        return self.model.force_unbounded(theta, self.trace, start, scales=scales)

    def travel(self, values: Mapping[str, Array]) -> Array | None:
        """Travel since the last slip, (n, T), in; None where the noise does not need it."""
        if not self.noise.needs_travel:
            return None
        return self.model.travel(self.theta(values), self.trace, values["start"])

    def values(self, q: ArrayLike) -> dict[str, Array]:
        """Values of all quantities of q by name, (n,) each, internal units.

        γ1 is 1 here: it does not matter to the force.
        """
        points = self._check(q)
        values = {name: np.full(len(points), value) for name, value in self._defaults.items()}
        columns = zip(self.names, points.T, strict=True)
        return values | {name: self.priors[name].value(column) for name, column in columns}

    def derived(self, q: ArrayLike) -> Array:
        """Friction forces that follow from several coordinates, (n, m), kip."""
        theta, several = self.theta(self.values(q)), self.model.composed(self.names)
        return theta[:, [k for k, n in enumerate(self.model.parameters) if n in several]]

    def coordinates(self, values: Mapping[str, Array]) -> Array:
        """Coordinates q of values by name, (n, dim), the inverse of `values`."""
        columns = named_vectors(values, self.names)
        q = [self.priors[name].coordinate(value) for name, value in columns.items()]
        return np.stack(q, axis=1)

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters of the model in its own order, (n, p)."""
        return self.model.theta(values)

    def sample_prior(self, n: int, seed: int | np.random.Generator = 0) -> dict[str, Array]:
        """Independent draws of all quantities from the prior, by name, (n,) each.

        Parameters
        ----------
        n : int
        seed : int or numpy.random.Generator

        Raises
        ------
        FitError
            When `n` or `seed` is no whole number of 0 or more.
        """
        whole_number("the number of draws", n, 0, FitError)
        if not isinstance(seed, np.random.Generator):
            whole_number("seed", seed, 0, FitError)
        rng = np.random.default_rng(seed)
        defaults = {k: np.full(n, v) for k, v in self._defaults.items()}
        return defaults | {name: prior.draw(rng, n) for name, prior in self.priors.items()}

    def _check(self, q: ArrayLike) -> Array:
        points = columns_in_order("q", q, self.names)
        if points.ndim != 2 or points.shape[1] != self.dim:
            raise FitError(f"q must have shape (n, {self.dim}), got {points.shape}")
        if np.any(np.isnan(points)):
            raise FitError("q holds NaN")
        return points


def first_slip(trace: Trace, file: PriorFile, model: Model) -> int:
    """Sample from which the device has surely slipped: after a stretch of two prior gaps."""
    gap = file.gap if model.standard_names or model.has_gap else None
    if gap is None and not model.has_gap:
        return 0
    if gap is None:
        raise FitError(
            f"initial = 'discard' needs the width of the gap: {file.path.name} has no priors of d2 "
            "and d3, and none of gap"
        )
    for begin, end in itertools.pairwise([0, *trace.turning_points.tolist()]):
        if abs(trace.displacement[end] - trace.displacement[begin]) >= 2.0 * gap:
            return int(end)
    raise FitError(
        "initial = 'discard' needs a record that goes on after a stroke of twice the prior's gap: "
        "what comes before is not fitted"
    )
