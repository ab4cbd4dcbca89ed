"""A finished run: its tests, its population, and predictions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mfd_bayes.calibration.priors import PriorFile, load_priors
from mfd_bayes.errors import CampaignError, FitError, NotThereError, StoreError, path_of
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import file_of, find_model
from mfd_bayes.jobs.job import JobState
from mfd_bayes.messages import counted
from mfd_bayes.population.design import CONDITIONS, planned_setting, same_level
from mfd_bayes.population.peaks import NO_EXCESS, SIDES, PeakExcess, Peaks, largest_speed
from mfd_bayes.records.cycles import MeasuredCycles
from mfd_bayes.records.record import NO_ACTUATION
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.runs.findings import Fitness
from mfd_bayes.runs.folder import (
    MODEL,
    POPULATION,
    PRIORS,
    check_links,
    check_stored,
    posterior_of,
    record_of,
)
from mfd_bayes.runs.manifest import Manifest, is_calibrated_model, read_manifest
from mfd_bayes.runs.tested_range import (
    Extrapolation,
    Range,
    extrapolations,
    kind_sentence,
    range_of,
    reach_of,
)
from mfd_bayes.runs.unit_system import UnitSystem, named_system
from mfd_bayes.store.cards import grid
from mfd_bayes.store.netcdf import load_trace
from mfd_bayes.units import actuation_kind, parse_actuation

if TYPE_CHECKING:  # what predicts is loaded when something is predicted
    from mfd_bayes.calibration.result import PlottingBackend, TestResult
    from mfd_bayes.population.bands import Band, PredictionOptions, Predictor
    from mfd_bayes.population.conditioning import OnlinePredictor
    from mfd_bayes.population.population import FinalState, Population
    from mfd_bayes.runs.test_sequence import TestSequence

PEAK_DRAWS = 100  # of each test's force, by which the excess of measured peaks is learned


Item = TypeVar("Item")


class LazyMapping(Mapping[str, Item]):
    """Items of a run by name, in their order; each is read when it is first asked for."""

    def __init__(self, label: str, names: Iterable[str], read: Callable[[str], Item]) -> None:
        self._what, self._names, self._read = label, tuple(names), read
        self._items: dict[str, Item] = {}

    def __getitem__(self, name: str) -> Item:
        """The item of a name; a NotThereError, which is a KeyError, when there is none."""
        if name not in self._names:
            names = ", ".join(self._names) or "none"
            raise NotThereError(f"the run has no {self._what} {name!r}: there are {names}")
        if name not in self._items:
            self._items[name] = self._read(name)
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        """Names, in their order."""
        return iter(self._names)

    def __len__(self) -> int:
        """Number of items."""
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        """Whether there is an item of a name; it is not read."""
        return name in self._names


def open_run(folder: str | Path, *, trust: bool = False) -> Run:
    """Finished calibration of a run folder; posteriors and records are read when asked for.

    Parameters
    ----------
    folder : str or Path
    trust : bool
        Whether the run's own `model.py` is run although no calibration of yours on this machine
        has run it. Read it first: it can do all that you can.

    Raises
    ------
    StoreError
        When the folder is no finished run, a file in it is not what the run wrote, or another
        process changes it meanwhile; or it has a model of its own, which is not trusted.
    """
    from mfd_bayes.reporting.notebook import Notebook

    folder = path_of("folder", folder, StoreError)
    check_links(folder)
    manifest = read_manifest(folder)
    model = model_of(folder, manifest, trust=trust)
    stored = check_stored(folder, PRIORS, manifest.files).name
    priors = load_priors(stored, folder, model, of_others=True)
    backend = Notebook(manifest.system)
    calibrated = [name for name in manifest.fitted if manifest.tests[name].status == JobState.DONE]
    held_out = [name for name in manifest.tests if name not in manifest.fitted]
    if not calibrated:
        raise StoreError(f"the run in {folder} has no calibrated test")
    for name in (*map(posterior_of, calibrated), *map(record_of, held_out)):
        if not (folder / name).is_file():
            raise StoreError(f"{folder / name} is missing from the run")
    read_test = partial(_read_test, folder, manifest, priors, model, backend)
    tests = LazyMapping("calibrated test", calibrated, read_test)
    traces = LazyMapping("held-out test", held_out, partial(_read_trace, folder, manifest))
    return Run(folder, manifest, priors, tests, traces, backend, trust=trust)


def model_of(folder: Path, manifest: Manifest, *, trust: bool) -> Model:
    """Model of a run; of a user's own, the run folder's copy of its file is run.

    A file that no calibration of this user has run is refused, but for `trust`.
    """
    name = manifest.settings.model
    if not file_of(name):
        return find_model(name)
    if MODEL not in manifest.files:
        raise StoreError(f"the run in {folder} does not say which {MODEL} it has stored")
    path = check_stored(folder, MODEL, manifest.files)
    if not (trust or is_calibrated_model(path)):
        raise StoreError(
            f"the run in {folder} would execute its own {MODEL}, which no calibration of yours on "
            "this machine has run: read that file, then give --trust-model, or "
            "open_run(…, trust=True) in Python"
        )
    return find_model(f"{MODEL}:{name.rpartition(':')[2]}", folder)


def _read_test(
    folder: Path,
    manifest: Manifest,
    priors: PriorFile,
    model: Model,
    backend: PlottingBackend | None,
    name: str,
) -> TestResult:
    from mfd_bayes.calibration.result import load_result

    file = posterior_of(name)
    result = load_result(name, check_stored(folder, file, manifest.files), priors, model)
    return replace(result, sha256=manifest.files.get(file, ""), _backend=backend)


def _read_trace(folder: Path, manifest: Manifest, name: str) -> Trace:
    return load_trace(check_stored(folder, record_of(name), manifest.files))[0]


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder.

    Attributes
    ----------
    tests : mapping of str to TestResult
        Calibrated tests; it cannot be changed.
    held_out : mapping of str to Trace
        Tests with role "validate"; likewise.
    units : {"", "us", "si"}
        What its sentences are in; "" for the units of the records.
    conditions : mapping of str to float
        Of tests that are predicted, where a call says no others, as in `predict`.
    trust : bool
        Whether a model of the run's own is run, whoever wrote it.
    """

    folder: Path
    manifest: Manifest
    priors: PriorFile
    tests: Mapping[str, TestResult]
    held_out: Mapping[str, Trace]
    _backend: PlottingBackend | None = field(default=None, repr=False)
    units: str = ""
    conditions: Mapping[str, float] = field(default_factory=dict)
    trust: bool = field(default=False, repr=False)

    @cached_property
    def model(self) -> Model:
        """Force model of its tests."""
        return model_of(self.folder, self.manifest, trust=self.trust)

    @cached_property
    def population(self) -> Population:
        """Laws and scatter across tests."""
        from mfd_bayes.population.population import load_population

        path = check_stored(self.folder, POPULATION, self.manifest.files)
        return load_population(path, self.priors, self.model)

    def with_population(self, population: Population) -> Run:
        """The run with another population than the stored one."""
        run = replace(self)
        vars(run)["population"] = population  # in place of the cached one
        return run

    @cached_property
    def actuation_unit(self) -> str:
        """The internal unit of actuation, such as "ksi" or "kip"."""
        return self.manifest.settings.actuation_unit

    @cached_property
    def system(self) -> UnitSystem:
        """System of units that most records were measured in, or of `units`."""
        return named_system(self.units, self.manifest.system)

    @cached_property
    def tested(self) -> tuple[Range, ...]:
        """Smallest and largest stroke, speed, frequency and actuation of the calibrated tests."""
        tests = (self.manifest.tests[name].conditions for name in self.tests)
        actuated = self.manifest.axes.actuated
        spans = range_of(tests, self.actuation_unit)
        return tuple(span for span in spans if actuated or span.name != "actuation")

    def extrapolations(self, trace: Trace, test: str = "") -> tuple[Extrapolation, ...]:
        """Where a motion leaves what was tested, in all tests or in one calibrated test."""
        check_trace(trace, FitError)
        unit = self.actuation_unit
        tested = self.tested
        if test:
            entries = LazyMapping("test", self.manifest.tests, self.manifest.tests.__getitem__)
            tested = range_of([entries[test].conditions], unit)
        return extrapolations(tested, reach_of(trace, unit))

    def session(self, name: str) -> str:
        """Session of a test, "" where the campaign declares none; NotThereError without it."""
        sessions = self.manifest.settings.sessions
        return LazyMapping("test", sessions, sessions.__getitem__)[name]

    @cached_property
    def devices(self) -> tuple[str, ...]:
        """Devices of the calibrated tests, each once; "" of tests that declare none."""
        devices = self.manifest.settings.devices
        return tuple(dict.fromkeys(devices[name] for name in self.tests))

    @cached_property
    def predictor(self) -> Predictor:
        """What predicts forces of the device."""
        from mfd_bayes.calibration.noises import find_noise
        from mfd_bayes.population.bands import Predictor

        noise = find_noise(self.manifest.settings.campaign.noise)
        return Predictor(self.population, self.model, noise)

    @cached_property
    def _sequence(self) -> TestSequence:
        """Which tests follow each other without a reset, and where they end."""
        from mfd_bayes.runs.test_sequence import TestSequence, stored_pooled

        pooled = partial(stored_pooled, self.folder, self.manifest, self.population)
        return TestSequence(self.manifest, self.tests, self.held_out, self.predictor, pooled)

    @cached_property
    def peaks(self) -> Peaks:
        """What measured peaks have above computed ones, as the report has stored it, or learned."""
        if stored := self.manifest.peak_excess:
            return {side: PeakExcess(**figures) for side, figures in stored.items()}
        return self._learned_peaks()

    def with_peaks(self) -> Run:
        """The run with what its own tests say of peaks, which an earlier report may not have."""
        learned = {side: asdict(excess) for side, excess in self._learned_peaks().items()}
        return replace(self, manifest=self.manifest.changed(peak_excess=learned))

    def _learned_peaks(self) -> Peaks:
        """Excess of the tests' measured peaks over those of the population for the same tests.

        These are the forces that new tests are drawn from, to which it is applied. A test's own
        posterior may have another static friction than the device, and is not taken.
        """
        from mfd_bayes.population.bands import THIS_TEST, PredictionOptions

        speeds, excesses, computed = [], [], []
        for name, test in self.tests.items():
            motion, values = replace(test.trace, force=None), self._sequence.values(name)
            forecast = PredictionOptions(
                THIS_TEST, draws=PEAK_DRAWS, **prediction_conditions(self, name)
            )
            force = self.predictor.repeat(motion, forecast, values).draws
            cycles = MeasuredCycles.from_content(self.manifest.tests[name].measured)
            offset = float(np.median(values["offset"]))
            measured = np.array([cycles.largest_fwd - offset, cycles.largest_bwd + offset])
            largest = [np.max(sign * force, axis=1).mean() for sign in SIDES.values()]
            speeds.append(largest_speed(motion))
            excesses.append(measured - largest)
            computed.append(largest)
        sides = zip(SIDES, np.transpose(excesses), np.transpose(computed), strict=False)
        return dict(NO_EXCESS) | {
            side: PeakExcess.of(excess, np.array(speeds), peak) for side, excess, peak in sides
        }

    @property
    def use(self) -> str:
        """What the run may be used for, in the words of `Fitness`; "" where it was not judged."""
        return self.manifest.verdicts.get("campaign", "")

    @property
    def verdict(self) -> str:
        """Sentence of the verdict in the run's own units."""
        return self.manifest.verdicts.get("sentence", "")

    @property
    def caution(self) -> str:
        """What the run may be used for, with the reason; "" where it is usable or not judged."""
        if self.use not in (Fitness.NOT_USABLE, Fitness.WITH_CARE):
            return ""
        return f"the run of this device is {self.use}: {self.verdict}"

    def __repr__(self) -> str:
        tests = counted(len(self.tests), "calibrated test")
        return (
            f"Run({str(self.folder)!r}: {self.manifest.title}; {tests}, {len(self.held_out)} held "
            f"out; {self.manifest.settings.model}, {self.manifest.effort.name}; "
            f"{self.use or 'not yet judged'})"
        )

    def _repr_html_(self) -> str:
        verdicts = self.manifest.verdicts
        rows = ((name, verdicts.get(name, "")) for name in self.tests)
        title = f"{self.manifest.title}: {counted(len(self.tests), 'calibrated test')}"
        return grid(title, ("test", "may be used"), rows, self.verdict)

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
        device: str = "",
        conditions: Mapping[str, float] | None = None,
        test: str = "",
        simultaneous: bool = False,
        condition_on: tuple[float, float] | None = None,
        after: str | FinalState = "",
    ) -> Band:
        """Band of the force under any motion and actuation, tested or new.

        Parameters
        ----------
        trace : Trace
            With its actuation, in `actuation_unit`, if the tests have one.
        kind : {"new_test", "mean", "observation", "this_test"}
            What the band is about. "mean": the mean property, with the uncertainty of the laws
            and of the level's effect. "new_test": this device tested again, also with test-to-test
            scatter. "observation": a measurement of it, also with the record's offset and noise.
            "this_test", instead of these: what is known of one calibrated test.
        probability : float
            Probability of the equal-tailed band at each sample.
        draws : int
        seed : int
        session : str
            Session of the test, where the campaign declares sessions.
        device : str
            Device of the test, where the campaign declares devices; by default a new one.
        conditions : mapping of str to float, optional
            Of the test, where quantities follow them: "date" in decimal years, "cycles",
            "temperature" in °C.
        test : str
            Id of the calibrated test, for the kind `this_test`.
        simultaneous : bool
            Whether its table and picture show `Band.simultaneous` too.
        condition_on : (float, float), s, optional
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
        from mfd_bayes.population.bands import THIS_TEST, PredictionOptions
        from mfd_bayes.runs.test_sequence import NO_GAP

        check_trace(trace, FitError)
        if not self.manifest.axes.actuated:
            trace = replace(trace, actuation=actuation_level(self, NO_ACTUATION))
        if condition_on is not None and (test or after):
            conflict = f"a calibrated test ({test!r})" if test else f"after ({after!r})"
            raise FitError(
                f"condition_on cannot be combined with {conflict}: the part it names is of one new "
                "test, and shows itself where in its gap the device stands"
            )
        forecast = PredictionOptions(
            *(kind, probability, draws, seed, session, simultaneous),
            device=device,
            conditions={**self.conditions, **(conditions or {})},
        )
        if after:
            forecast = self._sequence.begun(forecast, trace, after)
        if condition_on is not None:
            from mfd_bayes.population.conditioning import predict_given

            band = predict_given(self.predictor, trace, forecast, condition_on)
        elif kind == THIS_TEST or test:
            band = self._repeat(trace, forecast, test)
        else:
            band = self.predictor.predict(trace, forecast)
        remarks = [
            extrapolation.sentence(self.system, widened=not test)
            for extrapolation in self.extrapolations(trace, test)
        ]
        tests = [self.manifest.tests[name].conditions for name in ([test] if test else self.tests)]
        remarks += [kind] if (kind := kind_sentence(tests, trace)) and condition_on is None else []
        remarks += self._remarks(session, device, CONDITIONS if test else forecast.conditions)
        remarks += [NO_GAP] if after and forecast.before is None else []
        remarks += [*forecast.remarks, *band.remarks]
        return replace(band, remarks=tuple(remarks), _backend=self._backend)

    def _remarks(self, session: str, device: str, conditions: Collection[str]) -> list[str]:
        """Remarks of every band: an unusable run, what no test has, and what is not said."""
        remarks = []
        followed = {
            c for covariates in self.population.design.dependence.values() for c in covariates
        }
        for name in CONDITIONS:
            if name in followed and name not in conditions:
                default = "the mean" if name == "temperature" else "the latest"
                remarks.append(f"the {name} is not said: it is taken as {default} of the tests")
        if self.use == Fitness.NOT_USABLE:
            remarks.append(f"the run is not usable as it is: {self.verdict}")
        sessions = dict.fromkeys(self.manifest.settings.sessions.values())
        if session and session not in sessions:
            names = ", ".join(repr(name) for name in sessions if name)
            has = f"the run has {names}" if names else "the campaign declares no sessions"
            remarks.append(
                f"session {session!r} is taken for a new one, whose tests may differ: {has}"
            )
        if device and device not in self.devices:
            names = ", ".join(repr(name) for name in self.devices if name) or "without a name"
            several = f"the run has {len(self.devices)} devices, {names}"
            single = (
                f"all its tests are of one device, {names}, and how devices differ is not known"
            )
            has = several if len(self.devices) > 1 else single
            remarks.append(f"device {device!r} is taken for a new one: {has}")
        return remarks

    def _repeat(self, trace: Trace, forecast: PredictionOptions, name: str) -> Band:
        """Band of what is known of one calibrated test."""
        from mfd_bayes.population.bands import THIS_TEST

        if forecast.kind != THIS_TEST:
            raise FitError(f"a test ({name!r}) is for the kind this_test, not for {forecast.kind}")
        if name not in self.tests:
            held_out = ", which was held out" if name in self.held_out else ""
            raise FitError(
                f"the kind this_test needs the id of a calibrated test: one of "
                f"{', '.join(self.tests)}, got {name!r}{held_out}"
            )
        test, session = self.tests[name], self.session(name)
        levels = test.trace.reference_actuation, trace.reference_actuation
        if np.isfinite(levels[1]) and not same_level(*levels):
            test_level, new_level = (
                self.system.words([level], self.actuation_unit, actuation=True) for level in levels
            )
            raise FitError(
                f"test {name!r} was made at {test_level}, and the kind this_test knows nothing of "
                f"{new_level}: take the kind new_test"
            )
        if forecast.session and forecast.session != session:
            raise FitError(
                f"session {forecast.session!r} is for a new test: the kind this_test takes that of "
                f"its test, {session!r}"
            )
        forecast = replace(forecast, session=session)
        return self.predictor.repeat(trace, forecast, test.stored.values())

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
        device: str = "",
        conditions: Mapping[str, float] | None = None,
        refresh: bool = True,
    ) -> OnlinePredictor:
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
            As in `predict`.
        device : str
            Likewise.
        conditions : mapping of str to float, optional
            Likewise.
        refresh : bool
            Whether a band may take some seconds to sample the draws anew.

        Raises
        ------
        FitError
            When an option is of another type or unknown, or the model has no steps.
        """
        from mfd_bayes.population.bands import PredictionOptions
        from mfd_bayes.population.conditioning import OnlinePredictor

        planned = {"amplitude": amplitude, "velocity": velocity}
        conditions = {**self.conditions, **(conditions or {})}
        setting = planned_setting(self.population.design.settings, actuation, session, planned)
        covariates = {**setting.covariates, **conditions}
        setting = replace(setting, device=device, covariates=covariates)
        forecast = PredictionOptions(kind, probability, draws, seed, session)
        forecaster = OnlinePredictor(self.predictor, setting, forecast, refresh=refresh)
        unit = self.actuation_unit
        plan = {
            "stroke": 2.0 * setting.covariates["amplitude"],
            "speed": setting.covariates["velocity"],
            "actuation": setting.actuation,
        }
        exceedances = extrapolations(self.tested, range_of([plan], unit))
        reported = {extrapolation.reached.name for extrapolation in exceedances}
        remarks = [
            extrapolation.sentence(self.system, widened=True) for extrapolation in exceedances
        ]
        remarks += self._remarks(session, device, conditions)

        def complete(band: Band, motion: Trace) -> Band:
            """The band with its remarks; a motion that has begun is no smaller than planned."""
            reached = [
                span
                for span in reach_of(motion, unit)
                if span.name not in reported
                and (span.name not in ("stroke", "speed") or span.highest > plan[span.name])
            ]
            sentences = [d.sentence(self.system) for d in extrapolations(self.tested, reached)]
            return replace(
                band, remarks=(*sentences, *remarks, *band.remarks), _backend=self._backend
            )

        forecaster.complete = complete
        return forecaster


def rewrite_manifest(run: Run, **updates: Any) -> Run:
    """The run with changed keys in its manifest; the manifest is written."""
    manifest = run.manifest.changed(**updates)
    manifest.write(run.folder)
    return replace(run, manifest=manifest)


def actuation_level(run: Run, text: str) -> float:
    """Level of an actuation such as "1000 psi", in `actuation_unit`, as the tests had it."""
    level, unit = parse_actuation(text, of="--actuation")
    if unit != run.actuation_unit:
        kind = actuation_kind(run.actuation_unit)
        raise CampaignError(f"--actuation {text!r} must be {kind}, as in the campaign")
    return level


def prediction_conditions(run: Run, name: str) -> dict[str, Any]:
    """Session, device and conditions of a test, as `Run.predict` takes them."""
    settings = run.manifest.settings
    return {
        "session": run.session(name),
        "device": settings.devices[name],
        "conditions": settings.conditions[name],
    }


def sequence_of(run: Run) -> TestSequence:
    """Which tests of a run follow each other without a reset, and where they end."""
    return run._sequence
