"""Where in its gap each test ended, for the test that follows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import units
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.friction.model import Model
from mfd_bayes.population.bands import THIS_TEST, PredictionOptions, Predictor
from mfd_bayes.population.population import FinalState, Population, save_population
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import POPULATION, check_stored, pooled_of
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.store.netcdf import load_arrays, save_arrays

if TYPE_CHECKING:
    from mfd_bayes.population.inference import Inference

Array = NDArray[np.float64]

LOG_LIKELIHOOD = "log_likelihood"
"""Of a test in the joint posterior, (chain, draw), beside its pooled quantities."""

NO_GAP = "after is without effect: the model of the run has no gap in which a motion could begin"


@dataclass(frozen=True, eq=False)
class TestSequence:
    """The tests of a run in their order."""

    __test__ = False

    manifest: Manifest
    tests: Mapping[str, TestResult]
    motions: Mapping[str, Trace]
    predictor: Predictor
    pooled: Callable[[str], Mapping[str, Array]] = lambda _: {}

    def values(self, name: str) -> Mapping[str, Array]:
        """Draws of all quantities of a test with a posterior, (m,) each, with its start.

        As pooled with the others: a short motion by itself says little of the gap. What is not
        pooled has the median of the test's own posterior; where nothing is, its draws are taken.
        """
        test, pooled = self.tests[name], self.pooled(name)
        if not pooled or ("start" in test.posterior.names and "start" not in pooled):
            return test.stored.values()
        size = len(next(iter(pooled.values())))
        medians = {k: np.full(size, median) for k, (median, *_) in test.intervals.items()}
        return {**medians, **pooled}

    def before(self, test: str, trace: Trace, forecast: PredictionOptions) -> FinalState | None:
        """Where a test of the campaign begins; None where nothing is known of that."""
        return self.ending(self.manifest.settings.tests[test].after, trace, forecast, test)

    def begun(
        self, forecast: PredictionOptions, trace: Trace, predecessor: str | FinalState
    ) -> PredictionOptions:
        """The forecast of a motion that follows a test, or begins where one ended."""
        if isinstance(predecessor, FinalState):
            return replace(forecast, before=predecessor)
        names = [*self.tests, *self.motions]
        if predecessor not in names:
            raise FitError(
                f"after must be the id of a test of the run, one of {', '.join(names)}, got "
                f"{predecessor!r}"
            )
        return replace(forecast, before=self.ending(predecessor, trace, forecast))

    def ending(
        self, predecessor: str, trace: Trace, forecast: PredictionOptions, test: str = ""
    ) -> FinalState | None:
        """Where a motion begins that follows a test; None where nothing is known of that.

        From the last displacement of the test to the first of the motion the device is moved
        slowly, by way of what the windows leave out.
        """
        if not predecessor or not self.predictor.model.has_gap:
            return None
        chain, order = [predecessor], self.manifest.settings.order
        while chain[-1] in self.motions and order.get(chain[-1], predecessor) not in chain:
            chain.append(order[chain[-1]])  # back to one with a posterior, or that follows none
        end: FinalState | None = None
        for name, following in zip(reversed(chain), [*reversed(chain[:-1]), ""], strict=True):
            end = self._ended(name, replace(forecast, before=end))
            if end is None:
                continue
            last_trace = self.tests[name].trace if name in self.tests else self.motions[name]
            next_trace = self.motions[following] if following else trace
            way = self._between(name, following or test)
            way = last_trace.displacement[-1], *way, next_trace.displacement[0]
            end = end.moved(self.predictor.model, way)
        return end

    def _between(self, name: str, following: str) -> tuple[float, ...]:
        """Ends and turns of the records between the windows of two tests, in.

        Of two windows in one file it is what lies between them. "" is a new motion.
        """
        tail = self.manifest.tests[name].after
        if not following:
            return tail
        lead, tests = self.manifest.tests[following].before, self.manifest.settings.tests
        return lead if tests[name].file == tests[following].file else (*tail, *lead)

    def _ended(self, name: str, forecast: PredictionOptions) -> FinalState | None:
        """Where a test ended: by its posterior, or as it is predicted after the one before."""
        model = self.predictor.model
        if name in self.tests:
            values = self.values(name)
            total = len(values["start"])
            pick = np.linspace(0, total - 1, min(forecast.draws, total)).astype(np.intp)
            samples = {quantity: draws[pick] for quantity, draws in values.items()}
            return FinalState.of(model, name, self.tests[name].trace, samples)
        if name not in self.motions:
            return None  # it could not be calibrated
        kind = "new_test" if forecast.kind == THIS_TEST else forecast.kind
        settings, trace = self.manifest.settings, self.motions[name]
        test_forecast = replace(
            forecast,
            kind=kind,
            session=settings.sessions[name],
            device=settings.devices[name],
            conditions=settings.conditions[name],
        )
        draw = self.predictor.draw(trace, test_forecast, np.random.default_rng((forecast.seed, 2)))
        values = self.predictor.values(draw)
        return replace(
            FinalState.of(model, name, trace, values, draw.scales or None), predicted=True
        )


def save_inference(folder: Path, inference: Inference, names: Iterable[str], model: Model) -> None:
    """Write the population, and each test's quantities and log likelihood in it."""
    for j, name in enumerate(names):
        arrays = inference.values(j) | {LOG_LIKELIHOOD: inference.log_likelihood[..., j]}
        save_arrays(folder / pooled_of(name), arrays, {"test": name}, units(model))
    save_population(folder / POPULATION, inference.population)


def stored_log_likelihood(folder: Path, manifest: Manifest, name: str) -> Array | None:
    """Log likelihood of a test in each draw of the population, (chain, draw).

    None of an earlier version, which has stored none.
    """
    if not (folder / (file := pooled_of(name))).is_file():
        return None
    arrays, _ = load_arrays(check_stored(folder, file, manifest.files))
    return arrays.get(LOG_LIKELIHOOD)


def stored_pooled(
    folder: Path, manifest: Manifest, population: Population, name: str
) -> Mapping[str, Array]:
    """Pooled quantities of a test that a run folder holds, (n,) each; empty where none are."""
    file = pooled_of(name)
    if not (folder / file).is_file():
        return {}
    path = check_stored(folder, file, manifest.files)
    values, _ = load_arrays(path)
    names = population.design.coordinates.names
    if any(k not in values or values[k].shape != population.shape for k in names):
        raise StoreError(f"{path} is damaged: it does not hold the draws of its population")
    return {k: np.ravel(values[k]).astype(np.float64) for k in names}
