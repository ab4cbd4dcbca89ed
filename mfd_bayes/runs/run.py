"""A finished calibration, opened from its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.result import Extras, TestResult
from mfd_bayes.errors import FitError
from mfd_bayes.planning.candidate import Limits
from mfd_bayes.planning.goal import Goal
from mfd_bayes.planning.study import Advice, Effort
from mfd_bayes.population.bands import Band, Forecast, check_flag
from mfd_bayes.population.given import Forecaster, predict_given
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import THIS_TEST, planned_setting
from mfd_bayes.population.starts import Ending
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.runs import asked
from mfd_bayes.runs.folder import POPULATION, check_stored
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.named import Named
from mfd_bayes.runs.order import NO_GAP, Order, StoredPooled
from mfd_bayes.runs.reading import reading
from mfd_bayes.runs.steps import RunSteps
from mfd_bayes.runs.systems import System, named_system
from mfd_bayes.runs.tested import Departure, Span, departures, range_of
from mfd_bayes.runs.wanted import Candidates, next_test, wish_of, with_remarks

if TYPE_CHECKING:
    from mfd_bayes.response.result import Response


@dataclass(frozen=True, eq=False)
class Run(RunSteps):
    """A run folder.

    Attributes
    ----------
    tests : mapping of str to TestResult
        Calibrated tests; it cannot be changed.
    held_out : mapping of str to Trace
        Tests with role "validate"; likewise.
    units : {"", "us", "si"}
        What its sentences are in; "" for the units of the records.
    """

    folder: Path
    manifest: Manifest
    priors: PriorFile
    tests: Mapping[str, TestResult]
    held_out: Mapping[str, Trace]
    extras: Extras | None = field(default=None, repr=False)
    units: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "tests", Named("calibrated test", self.tests))
        object.__setattr__(self, "held_out", Named("held-out test", self.held_out))

    @cached_property
    def population(self) -> Population:
        """Laws and scatter across tests."""
        from mfd_bayes.population.storage import load_population

        with reading(self.folder, self.manifest):
            path = check_stored(self.folder, POPULATION, self.manifest.files or {})
            return load_population(path, self.priors)

    @cached_property
    def offset(self) -> float:
        """Median over the calibrated tests of the median offset of the force, kip."""
        return float(np.median([test.intervals["offset"][0] for test in self.tests.values()]))

    @property
    def hashed(self) -> bool:
        """Whether the manifest has hashes of the stored files, so that changes are seen."""
        return bool(self.manifest.files)

    def rewrite(self, **parts: Any) -> Run:
        """The run with changed keys in its manifest; the manifest is written."""
        manifest = self.manifest.changed(**parts)
        manifest.write(self.folder)
        return replace(self, manifest=manifest)

    @property
    def actuation_unit(self) -> str:
        """The unit of actuation, "ksi" or "kip"."""
        return self.manifest.settings.actuation_unit

    @cached_property
    def system(self) -> System:
        """System of units that most records were measured in, or of `units`."""
        traces = [*(test.trace for test in self.tests.values()), *self.held_out.values()]
        return named_system(self.units, self.manifest.system_of(traces))

    @cached_property
    def tested(self) -> tuple[Span, ...]:
        """Smallest and largest stroke, speed, frequency and actuation of the calibrated tests."""
        return range_of((test.trace for test in self.tests.values()), self.actuation_unit)

    def departures(self, trace: Trace, test: str = "") -> tuple[Departure, ...]:
        """Where a motion leaves what was tested, in all tests or in one calibrated test."""
        check_trace("trace", trace, FitError)
        tested = range_of([self.tests[test].trace], self.actuation_unit) if test else self.tested
        return departures(tested, trace, self.actuation_unit)

    def session(self, name: str) -> str:
        """Session of a test, "" where the campaign declares none."""
        return Named("test", self.manifest.settings.tests)[name].session

    @cached_property
    def order(self) -> Order:
        """Which tests follow each other without a reset, and where they end."""
        pooled = StoredPooled(self.folder, self.manifest, self.population, tuple(self.tests))
        return Order(self.manifest, self.tests, self.held_out, self._predictor(), pooled)

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
        test: str = "",
        whole: bool = False,
        explain: bool = False,
        given: tuple[float, float] | None = None,
        after: str | Ending = "",
    ) -> Band:
        """Band of the force under any motion and actuation, tested or new.

        Parameters
        ----------
        trace : Trace
            With its actuation, in `actuation_unit`.
        kind : {"new_test", "device", "observation", "this_test"}
            What the band is about. "device": the mean property, with the uncertainty of the laws
            and of the level's effect. "new_test": this device tested again, also with test-to-test
            scatter. "observation": a measurement of it, also with the record's offset and noise.
            "this_test", instead of these: what is known of one calibrated test.
        probability : float
            Probability of the equal-tailed band at each sample.
        draws : int
        seed : int
        session : str
            Session of the test, where the campaign declares sessions.
        test : str
            Id of the calibrated test, for the kind `this_test`.
        whole : bool
            Whether to compute `Band.whole` at once.
        explain : bool
            Whether to compute `Band.shares` at once.
        given : (float, float), s, optional
            Window of the record in which the trace's force is known: the band of all the record,
            given that part, for the kinds `new_test` and `observation`.
        after : str, optional
            Id of the test made directly before, the device not reset: its end is the start.

        Returns
        -------
        Band
            lower, median, upper (T,) and draws (n, T), kip.

        Raises
        ------
        FitError
            When the trace has no actuation, an option is of another type or unknown, or the trace
            has no force in the given window.
        """
        check_trace("trace", trace, FitError)
        check_flag("explain", explain)
        if given is not None:
            asked.check_given(test, after)
        forecast = Forecast(kind, probability, draws, seed, session, whole, bool(explain))
        predictor = self._predictor()
        forecast = self.order.begun(forecast, trace, after) if after else forecast
        if given is not None:
            band = predict_given(predictor, trace, forecast, given)
        elif kind == THIS_TEST or test:
            band = self._repeated(trace, forecast, test)
        else:
            band = predictor.predict(trace, forecast)
        left = self.departures(trace, test)
        remarks = asked.remarks_of(left, self.manifest, self.system, widened=not test)
        remarks += (NO_GAP,) if after and forecast.before is None else ()
        remarks += (*asked.new_session(self.manifest, session), *forecast.remarks, *band.remarks)
        return replace(band, remarks=remarks, extras=self.extras)

    def respond(
        self,
        building: Any,
        grounds: Any,
        draws: int = 300,
        seed: int = 1,
        *,
        kind: str = "new_test",
        tolerance: float = 0.01,
        jobs: int = 1,
        observe: Callable[[Any], None] = lambda step: None,
    ) -> Response:
        """Response of a building with this device as its dampers; see `respond_of_run`."""
        from mfd_bayes.runs.response import respond_of_run

        how: dict[str, Any] = {"draws": draws, "seed": seed, "kind": kind, "tolerance": tolerance}
        return respond_of_run(self._source(), building, grounds, jobs=jobs, observe=observe, **how)

    def follow(
        self,
        actuation: float,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        amplitude: float | None = None,
        velocity: float | None = None,
        draws: int = 1000,
        seed: int = 0,
        session: str = "",
        refresh: bool = True,
    ) -> Forecaster:
        """Forecaster of a test that is about to run: its bands learn from the force as it comes.

        Parameters
        ----------
        actuation : float, ksi or kip
            As planned; that of the samples may differ, but for a test without any.
        kind : {"new_test", "observation"}
        probability : float
        amplitude : float, in, optional
            Half the stroke as planned; the typical one of the tests when left out.
        velocity : float, in/s, optional
            Peak speed as planned, likewise.
        draws : int
            Draws that are stepped along; the time of an update is in proportion.
        seed : int
        session : str
        refresh : bool
            Whether a band may take some seconds to sample the draws anew.

        Raises
        ------
        FitError
            When an option is of another type or unknown, or the model has no steps.
        """
        tested = self.population.design.settings
        planned = {"amplitude": amplitude, "velocity": velocity}
        setting = planned_setting(tested, actuation, session, planned)
        forecast = Forecast(kind, probability, draws, seed, session)
        found = Forecaster(self._predictor(), setting, forecast, refresh=refresh)
        found.complete = self._following(setting)
        return found

    def next_test(
        self,
        goal: str | Goal | None = None,
        candidates: Candidates | None = None,
        *,
        limits: str | Limits | None = None,
        draws: int = 2000,
        seed: int = 0,
    ) -> Advice:
        """Table of tests that could be made next, and of what each is expected to tell.

        Parameters
        ----------
        goal : str or Goal, optional
            "energy at 1000 psi, 0.5 Hz, 1 in"; by default the campaign file's, or "band".
        candidates : str or Candidate, or several, optional
            "500|1350 psi, 0.5 Hz, 1 in"; by default a grid from the campaign's range.
        limits : str or Limits, optional
            Of the actuator, "10 in/s, 6 in, 20 kip".

        Raises
        ------
        CampaignError
            When an option is of another type or not understood, or the limits leave no candidate.
        """
        wanted = wish_of(self.folder, self.manifest, goal, candidates, limits)
        found = next_test(self.population, self.tests, self.manifest, wanted, Effort(draws, seed))
        return with_remarks(found, self.tested, self.system) if wanted.candidates else found
