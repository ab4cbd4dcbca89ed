"""A test that follows another without a reset: it begins where in the gap the other ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.model import Model
from mfd_bayes.population.population import Population
from mfd_bayes.population.starts import Standing
from mfd_bayes.population.unloaded import Unloaded
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SLOW = 1e3
"""Time that the device takes between two displacements, s: so long that it has no speed."""


@dataclass(frozen=True, eq=False)
class Ending:
    """Where the test before ended, as draws.

    Attributes
    ----------
    test : str
        Its id.
    theta : (m, p)
        Its parameters.
    place : (m,), 1
        Its place in the gap when the next test begins, as `Model.end` has it.
    predicted : bool
        Whether it was predicted itself, and not calibrated.
    """

    test: str
    theta: Array
    place: Array
    predicted: bool = False

    @property
    def words(self) -> str:
        """What a test that follows begins with."""
        how = ", which is predicted itself," if self.predicted else ""
        return f"begun where in its gap test {self.test}{how} ended"

    def starts(self, model: Model, theta: Array, trace: Trace, seed: int) -> Array:
        """Draws of the `start` of a motion that follows, with parameters theta (n, p), (n,)."""
        rng = np.random.default_rng((seed, 1))  # of its own: all other draws stay as they are
        pick = rng.choice(len(self.place), size=len(theta))
        return model.start_at(self.place[pick], trace, self.theta[pick], theta)

    def moved(self, model: Model, way: ArrayLike) -> Ending:
        """The same after a slow motion, straight from each displacement (M,), in, to the next."""
        x = np.asarray(way, dtype=np.float64)
        x = np.concatenate([x[:1], x[:1], x])  # a trace has three samples at least
        time = SLOW * np.arange(x.size)
        trace = Trace.from_arrays(time, x, velocity=np.zeros(x.size), hysteresis=0.0)
        place = model.end(self.theta, trace, model.start_at(self.place, trace))
        return Ending(self.test, self.theta, place, self.predicted)


def ending_of(
    model: Model,
    test: str,
    trace: Trace,
    values: Mapping[str, Array],
    scales: Mapping[str, Array] | None = None,
) -> Ending:
    """Ending of a test, of draws of its quantities by name, (m,) each.

    Parameters
    ----------
    model : Model
    test : str
    trace : Trace
        Its motion and actuation.
    values : mapping of str to (m,)
        With `start`.
    scales : mapping, optional
        As in `Model.force`; it was then predicted.
    """
    theta = model.theta(values)
    return Ending(test, theta, model.end(theta, trace, values["start"], scales=scales))


def left_by(
    model: Model, theta: Array, trace: Trace, scales: Mapping[str, Array] | None = None
) -> float | None:
    """Place, as a `start` of it, at which a motion leaves a device with theta (1, p).

    The device goes straight back to the first displacement of the motion. None for a model that
    has no gap, or does not say where a motion ends. `scales` are as in `Model.end`.
    """
    own = type(model).end
    if not model.has_gap or getattr(own, "__wrapped__", own) is Model.end:
        return None
    ended = Ending("", theta, model.end(theta, trace, scales=scales))
    ended = ended.moved(model, trace.displacement[[-1, 0]])
    return float(np.clip(model.start_at(ended.place, trace)[0], 0.0, 1.0))


def standing_of(
    population: Population, model: Model, values: Mapping[str, Array], trace: Trace | None = None
) -> Standing:
    """What is known of where tests with these quantities, by name, (n,) each, begin.

    The trace is their motion, where that is known.
    """
    others = {name: prior.typical for name, prior in population.priors.items()}
    known = {"gamma1": 1.0, **others}

    def left() -> float | None:
        if trace is None:
            return None
        middle = {**known, **{k: float(np.median(v)) for k, v in values.items()}}
        theta = model.theta({name: np.array([value]) for name, value in middle.items()})
        return left_by(model, theta, trace)

    def unloaded() -> Unloaded | None:
        n = len(next(iter(values.values())))
        part = model.unloaded({**{k: np.full(n, v) for k, v in known.items()}, **values})
        return None if part is None else Unloaded.checked(*part)

    return Standing(left, unloaded)


def pooled_values(population: Population, j: int, shared: Mapping[str, Array]) -> dict[str, Array]:
    """Quantities of calibrated test j as pooled with the others, by name, (n,) each.

    Parameters
    ----------
    population : Population
    j : int
    shared : mapping of str to (chain, draw)
        What tests share; the start in the gap is added, where it was inferred.
    """
    found = {name: np.ravel(values).astype(np.float64) for name, values in shared.items()}
    if population.starts is not None:
        found["start"] = population.starts[..., j].ravel()
    return found


def told(source: str, before: Ending | None) -> str:
    """Where the parameters of a prediction come from, and where it begins if that is known."""
    return source if before is None else f"{source}, {before.words}"
