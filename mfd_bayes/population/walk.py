"""Draws of a test that are stepped along its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.given import values_of
from mfd_bayes.population.given_likelihood import GivenLikelihood, Sums
from mfd_bayes.population.pace import Counting
from mfd_bayes.population.predict import Predictor
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.unshared import scales_of, stays
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Walk:
    """Draws of the test, n of them, on their way along the motion.

    Attributes
    ----------
    labels, points : (n,), (n, D)
        As in `TestPrior`.
    values : mapping of str to (n,)
    state : State, or None
        Of the model, at the last sample; None before the first.
    sums : Sums, or None
        Of all samples so far.
    begun : (n,)
        Log likelihood of what the draws were sampled with, which does not weigh them again.
    """

    labels: Index
    points: Array
    values: Mapping[str, Array]
    state: Any
    sums: Sums | None
    begun: Array


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps draws along a motion, and sums up what the force says of them.

    Attributes
    ----------
    predictor : Predictor
    prior : TestPrior
    counting : Counting
    """

    predictor: Predictor
    prior: TestPrior
    counting: Counting

    @property
    def level(self) -> float:
        """Actuation to which the draws' parameters belong, ksi or kip."""
        return self.prior.around.level

    def begin(self, labels: Index, points: Array) -> Walk:
        """Draws before the first sample."""
        values = values_of(self.predictor, self.prior, labels, points)
        return Walk(labels, points, values, None, None, np.zeros(len(labels)))

    def _at_rest(self, walk: Walk, direction: int) -> Any:
        """State of draws before a first motion in this direction."""
        model = self.predictor.model
        return model.start(  # type: ignore[attr-defined]
            model.theta(walk.values),
            walk.values["start"],
            direction=direction,
            reference_actuation=self.level or None,
        )

    def along(self, walk: Walk, trace: Trace, new: Index) -> Walk:
        """Draws after some new samples of the thinned record, with their sums."""
        force, state = self.stepped(walk, trace, new)
        counted = self.counting.counted(trace, np.isin(np.arange(trace.samples), new))
        counted = self.counting.first(counted) if walk.sums is None else counted
        slip = slip_force_of(self.predictor.model, walk.values) / self.counting.residual.slip_force
        left = np.asarray(trace.force)[new] - force - walk.values["offset"][:, None]
        left -= np.outer(slip, counted.functions @ self.counting.residual.mean)
        sums = Sums.of(left, counted)
        return replace(walk, state=state, sums=sums if walk.sums is None else walk.sums + sums)

    def stepped(self, walk: Walk, trace: Trace, new: Index) -> tuple[Array, Any]:
        """Forces at samples of a trace (n, m), kip, and the state after them."""
        model, state = self.predictor.model, walk.state
        if state is None:
            state = self._at_rest(walk, trace.path.direction)
        scales = self._scales(trace, new, walk)
        before = np.diff(trace.time, prepend=trace.time[0])
        force = np.empty((len(walk.labels), new.size))
        for i, at in enumerate(new.tolist()):
            given = {name: factors[:, i] for name, factors in scales.items()} or None
            sample = trace.displacement[at], trace.velocity[at], before[at]
            force[:, i], state = model.step(  # type: ignore[attr-defined]
                state, *(float(value) for value in sample), scales=given
            )
        return force, state

    def _scales(self, trace: Trace, new: Index, walk: Walk) -> dict[str, Array]:
        """Factors of what follows the actuation, (n, m) each; none where it is as planned."""
        actuation = np.broadcast_to(np.asarray(trace.actuation), trace.time.shape)[new]
        if stays(actuation, self.level):
            return {}
        index, deviation = self.prior.index[walk.labels], self.prior.deviation(walk.points)
        return scales_of(self.predictor.model, actuation, index, deviation)

    def log_likelihood(self, walk: Walk) -> Array:
        """Log likelihood of draws from their sums, (n,)."""
        if walk.sums is None:
            return np.zeros(len(walk.labels))
        slip = slip_force_of(self.predictor.model, walk.values)
        return GivenLikelihood(self.counting.residual)(walk.sums, slip, walk.values["noise_sd"])
