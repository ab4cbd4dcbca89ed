"""A finished calibration, opened from its folder, and several of them that predict together.

And the response of a building whose dampers are the device of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, pairwise
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import PriorFile, find_noise, load_priors
from mfd_bayes.calibration.result import Extras, TestResult, load_result
from mfd_bayes.campaign.campaign import GoalSettings, goal_settings
from mfd_bayes.errors import (
    MOST_DRAWS,
    BuildingError,
    CampaignError,
    FitError,
    NotThereError,
    StoreError,
    path_of,
    real_number,
    whole_number,
)
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import file_of, find_model
from mfd_bayes.jobs.job import State, Step
from mfd_bayes.planning.candidate import (
    MOST,
    NEW_DEVICE,
    Candidate,
    Goal,
    Limits,
    Parts,
    Shown,
    check_goal,
    check_session,
    grid_of,
    harmonic_of,
    parse_goal,
    parse_limits,
    parse_tests,
    typical_of,
)
from mfd_bayes.planning.study import Advice, advise
from mfd_bayes.population.bands import FEWEST, THIS_TEST, Band, Forecast, Predictor
from mfd_bayes.population.design import CONDITIONS, planned_setting, same_level
from mfd_bayes.population.given import Conditioned, Forecaster, predict_given
from mfd_bayes.population.peaks import NO_EXCESS, SIDES, PeakExcess, Peaks, largest_speed
from mfd_bayes.population.population import Ending, Population
from mfd_bayes.records.loops import MeasuredCycles
from mfd_bayes.records.record import NO_ACTUATION
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.response.analysis import Response, response_of, seen_peaks
from mfd_bayes.response.building import (
    FEWEST as FEWEST_DRAWS,
)
from mfd_bayes.response.building import (
    KINDS,
    Building,
    bound_dampers,
    draw_dampers,
    read_building,
)
from mfd_bayes.response.ground import Ground, parse_ground, read_ground
from mfd_bayes.runs.folder import (
    CAMPAIGN,
    MODEL,
    POPULATION,
    PRIORS,
    Manifest,
    Use,
    check_links,
    check_stored,
    is_calibrated_model,
    pooled_of,
    posterior_of,
    read_manifest,
    record_of,
)
from mfd_bayes.runs.tested_range import (
    MARGIN,
    Departure,
    Span,
    departures,
    kind_sentence,
    range_of,
    reach_of,
)
from mfd_bayes.runs.unit_system import System, named_system
from mfd_bayes.store.cards import counted, grid
from mfd_bayes.store.netcdf import load_arrays, load_trace
from mfd_bayes.units import actuation_kind, parse_actuation

Array = NDArray[np.float64]

PEAK_DRAWS = 100  # of each test's force, by which the excess of measured peaks is learned

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
        test = self.tests[name]
        own, pooled = test.stored.values(), self.pooled(name)
        if not pooled or ("start" in test.posterior.names and "start" not in pooled):
            return own
        size = len(next(iter(pooled.values())))
        return {**{k: np.full(size, np.median(v)) for k, v in own.items()}, **pooled}

    def before(self, test: str, trace: Trace, forecast: Forecast) -> Ending | None:
        """Where a test of the campaign begins; None where nothing is known of that."""
        return self.ending(self.manifest.settings.tests[test].after, trace, forecast, test)

    def begun(self, forecast: Forecast, trace: Trace, after: str | Ending) -> Forecast:
        """The forecast of a motion that follows a test, or begins where one ended."""
        if isinstance(after, Ending):
            return replace(forecast, before=after)
        names = [*self.tests, *self.motions]
        if after not in names:
            raise FitError(
                f"after must be the id of a test of the run, one of {', '.join(names)}, got "
                f"{after!r}"
            )
        return replace(forecast, before=self.ending(after, trace, forecast))

    def ending(self, after: str, trace: Trace, forecast: Forecast, test: str = "") -> Ending | None:
        """Where a motion begins that follows a test; None where nothing is known of that.

        From the last displacement of the test to the first of the motion the device is moved
        slowly, by way of what the fit windows leave out.
        """
        if not after or not self.predictor.model.has_gap:
            return None
        chain, order = [after], self.manifest.settings.order
        while chain[-1] in self.motions and order.get(chain[-1], after) not in chain:
            chain.append(order[chain[-1]])  # back to one with a posterior, or that follows none
        place: Ending | None = None
        for name, following in zip(reversed(chain), [*reversed(chain[:-1]), ""], strict=True):
            place = self._ended(name, replace(forecast, before=place))
            if place is None:
                continue
            last = self.tests[name].trace if name in self.tests else self.motions[name]
            first = self.motions[following] if following else trace
            way = self._between(name, following or test)
            way = last.displacement[-1], *way, first.displacement[0]
            place = place.moved(self.predictor.model, way)
        return place

    def _between(self, name: str, following: str) -> tuple[float, ...]:
        """Ends and turns of the records between the fit windows of two tests, in.

        Of two windows in one file it is what lies between them. "" is a new motion.
        """
        rest = self.manifest.tests[name].after
        if not following:
            return rest
        lead, tests = self.manifest.tests[following].before, self.manifest.settings.tests
        return lead if tests[name].file == tests[following].file else (*rest, *lead)

    def _ended(self, name: str, forecast: Forecast) -> Ending | None:
        """Where a test ended: by its posterior, or as it is predicted after the one before."""
        model = self.predictor.model
        if name in self.tests:
            values = self.values(name)
            total = len(values["start"])
            pick = np.linspace(0, total - 1, min(forecast.draws, total)).astype(np.intp)
            taken = {quantity: draws[pick] for quantity, draws in values.items()}
            return Ending.of(model, name, self.tests[name].trace, taken)
        if name not in self.motions:
            return None  # it could not be calibrated
        kind = "new_test" if forecast.kind == THIS_TEST else forecast.kind
        settings, trace = self.manifest.settings, self.motions[name]
        own = replace(
            forecast,
            kind=kind,
            session=settings.sessions[name],
            device=settings.devices[name],
            conditions=settings.conditions[name],
        )
        drawn = self.predictor.draw(trace, own, np.random.default_rng((forecast.seed, 2)))
        values = self.predictor.values(drawn)
        return replace(Ending.of(model, name, trace, values, drawn.scales or None), predicted=True)


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


Item = TypeVar("Item")

Candidates = str | Candidate | Iterable[str | Candidate]
"""Tests in words, or as they are."""

DISAGREEMENT = 0.5
"""Models disagree where their medians are apart by more than this share of half the band's width,
root mean square."""


class ByName(Mapping[str, Item]):
    """Items of a run by name, in their order; each is read when it is first asked for."""

    def __init__(self, what: str, names: Iterable[str], read: Callable[[str], Item]) -> None:
        self._what, self._names, self._read = what, tuple(names), read
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


def open_run(
    folder: str | Path,
    make_extras: Callable[[System], Extras] | None = None,
    *,
    trust: bool = False,
) -> Run:
    """Finished calibration of a run folder; posteriors and records are read when asked for.

    With `trust`, a model of the run's own is run, whoever wrote it.
    """
    folder = path_of("folder", folder, StoreError)
    check_links(folder)
    manifest = read_manifest(folder)
    model = model_of(folder, manifest, trust=trust)
    stored = check_stored(folder, PRIORS, manifest.files).name
    priors = load_priors(stored, folder, model, of_others=True)
    extras = None if make_extras is None else make_extras(manifest.system)
    done = [name for name in manifest.fitted if manifest.tests[name].status == State.DONE]
    held_out = [name for name in manifest.tests if name not in manifest.fitted]
    if not done:
        raise StoreError(f"the run in {folder} has no calibrated test")
    for name in (*map(posterior_of, done), *map(record_of, held_out)):
        if not (folder / name).is_file():
            raise StoreError(f"{folder / name} is missing from the run")
    read_test = partial(_read_test, folder, manifest, priors, model, extras)
    tests = ByName("calibrated test", done, read_test)
    traces = ByName("held-out test", held_out, partial(_read_trace, folder, manifest))
    return Run(folder, manifest, priors, tests, traces, extras, trust=trust)


def model_of(folder: Path, manifest: Manifest, *, trust: bool = False) -> Model:
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
    extras: Extras | None,
    name: str,
) -> TestResult:
    file = posterior_of(name)
    result = load_result(name, check_stored(folder, file, manifest.files), priors, model)
    return replace(result, sha256=manifest.files.get(file, ""), extras=extras)


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
    extras: Extras | None = field(default=None, repr=False)
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

    def rewrite(self, **parts: Any) -> Run:
        """The run with changed keys in its manifest; the manifest is written."""
        manifest = self.manifest.changed(**parts)
        manifest.write(self.folder)
        return replace(self, manifest=manifest)

    @cached_property
    def actuation_unit(self) -> str:
        """The internal unit of actuation, such as "ksi" or "kip"."""
        return self.manifest.settings.actuation_unit

    def level_of(self, text: str, *, of: str = "--actuation") -> float:
        """Level of an actuation such as "1000 psi", in `actuation_unit`, as the tests had it."""
        level, unit = parse_actuation(text, of=of)
        if unit != self.actuation_unit:
            kind = actuation_kind(self.actuation_unit)
            raise CampaignError(f"{of} {text!r} must be {kind}, as in the campaign")
        return level

    @cached_property
    def system(self) -> System:
        """System of units that most records were measured in, or of `units`."""
        return named_system(self.units, self.manifest.system)

    @cached_property
    def tested(self) -> tuple[Span, ...]:
        """Smallest and largest stroke, speed, frequency and actuation of the calibrated tests."""
        tests = (self.manifest.tests[name].conditions for name in self.tests)
        actuated = self.manifest.axes.actuated
        spans = range_of(tests, self.actuation_unit)
        return tuple(span for span in spans if actuated or span.name != "actuation")

    def departures(self, trace: Trace, test: str = "") -> tuple[Departure, ...]:
        """Where a motion leaves what was tested, in all tests or in one calibrated test."""
        check_trace("trace", trace, FitError)
        unit = self.actuation_unit
        tested = self.tested
        if test:
            entries = ByName("test", self.manifest.tests, self.manifest.tests.__getitem__)
            tested = range_of([entries[test].conditions], unit)
        return departures(tested, reach_of(trace, unit))

    def session(self, name: str) -> str:
        """Session of a test, "" where the campaign declares none; NotThereError without it."""
        sessions = self.manifest.settings.sessions
        return ByName("test", sessions, sessions.__getitem__)[name]

    @cached_property
    def devices(self) -> tuple[str, ...]:
        """Devices of the calibrated tests, each once; "" of tests that declare none."""
        devices = self.manifest.settings.devices
        return tuple(dict.fromkeys(devices[name] for name in self.tests))

    def place(self, name: str) -> dict[str, Any]:
        """Session, device and conditions of a test, as `predict` takes them."""
        settings = self.manifest.settings
        return {
            "session": self.session(name),
            "device": settings.devices[name],
            "conditions": settings.conditions[name],
        }

    @cached_property
    def predictor(self) -> Predictor:
        """What predicts forces of the device."""
        noise = find_noise(self.manifest.settings.campaign.noise)
        return Predictor(self.population, self.model, noise)

    @cached_property
    def sequence(self) -> TestSequence:
        """Which tests follow each other without a reset, and where they end."""
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
        speeds, excesses, computed = [], [], []
        for name, test in self.tests.items():
            motion, values = replace(test.trace, force=None), self.sequence.values(name)
            forecast = Forecast(THIS_TEST, draws=PEAK_DRAWS, **self.place(name))
            force = self.predictor.repeat(motion, forecast, values).draws
            cycles = MeasuredCycles.from_content(self.manifest.tests[name].measured)
            offset = float(np.median(values["offset"]))
            measured = np.array([cycles.largest_fwd - offset, cycles.largest_bwd + offset])
            largest = [np.max(sign * force, axis=1).mean() for sign in SIDES.values()]
            speeds.append(largest_speed(motion))
            excesses.append(measured - largest)
            computed.append(largest)
        each = zip(SIDES, np.transpose(excesses), np.transpose(computed), strict=False)
        return dict(NO_EXCESS) | {
            side: PeakExcess.of(excess, np.array(speeds), peak) for side, excess, peak in each
        }

    @property
    def use(self) -> str:
        """What the run may be used for, in the words of `Use`; "" where it was not judged."""
        return self.manifest.verdicts.get("campaign", "")

    @property
    def verdict(self) -> str:
        """Sentence of the verdict in the run's own units."""
        return self.manifest.verdicts.get("sentence", "")

    @property
    def caution(self) -> str:
        """What the run may be used for, with the reason; "" where it is usable or not judged."""
        if self.use not in (Use.NOT_USABLE, Use.WITH_CARE):
            return ""
        return f"the run of this device is {self.use}: {self.verdict}"

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
        whole: bool = False,
        given: tuple[float, float] | None = None,
        after: str | Ending = "",
    ) -> Band:
        """Band of the force under any motion and actuation, tested or new.

        Parameters
        ----------
        trace : Trace
            With its actuation, in `actuation_unit`, if the tests have one.
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
        device : str
            Device of the test, where the campaign declares devices; by default a new one.
        conditions : mapping of str to float, optional
            Of the test, where quantities follow them: "date" in decimal years, "cycles",
            "temperature" in °C.
        test : str
            Id of the calibrated test, for the kind `this_test`.
        whole : bool
            Whether its table and picture show `Band.whole` too.
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
        if not self.manifest.axes.actuated:
            trace = replace(trace, actuation=self.level_of(NO_ACTUATION))
        if given is not None and (test or after):
            other = f"a calibrated test ({test!r})" if test else f"after ({after!r})"
            raise FitError(
                f"given cannot be combined with {other}: the given part is of one new test, and "
                "shows itself where in its gap the device stands"
            )
        forecast = Forecast(
            *(kind, probability, draws, seed, session, whole),
            device=device,
            conditions={**self.conditions, **(conditions or {})},
        )
        if after:
            forecast = self.sequence.begun(forecast, trace, after)
        if given is not None:
            band = predict_given(self.predictor, trace, forecast, given)
        elif kind == THIS_TEST or test:
            band = self._repeat(trace, forecast, test)
        else:
            band = self.predictor.predict(trace, forecast)
        remarks = [
            departure.sentence(self.system, widened=not test)
            for departure in self.departures(trace, test)
        ]
        tests = [self.manifest.tests[name].conditions for name in ([test] if test else self.tests)]
        remarks += [kind] if (kind := kind_sentence(tests, trace)) and given is None else []
        remarks += self._remarks(session, device, CONDITIONS if test else forecast.conditions)
        remarks += [NO_GAP] if after and forecast.before is None else []
        remarks += [*forecast.remarks, *band.remarks]
        return replace(band, remarks=tuple(remarks), extras=self.extras)

    def _remarks(self, session: str, device: str, conditions: Collection[str]) -> list[str]:
        """Remarks of every band: an unusable run, what no test has, and what is not said."""
        remarks = []
        followed = {c for those in self.population.design.dependence.values() for c in those}
        for name in CONDITIONS:
            if name in followed and name not in conditions:
                usual = "the mean" if name == "temperature" else "the latest"
                remarks.append(f"the {name} is not said: it is taken as {usual} of the tests")
        if self.use == Use.NOT_USABLE:
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
            one = f"all its tests are of one device, {names}, and how devices differ is not known"
            has = several if len(self.devices) > 1 else one
            remarks.append(f"device {device!r} is taken for a new one: {has}")
        return remarks

    def _repeat(self, trace: Trace, forecast: Forecast, name: str) -> Band:
        """Band of what is known of one calibrated test."""
        if forecast.kind != THIS_TEST:
            raise FitError(f"a test ({name!r}) is for the kind this_test, not for {forecast.kind}")
        if name not in self.tests:
            held_out = ", which was held out" if name in self.held_out else ""
            raise FitError(
                f"the kind this_test needs the id of a calibrated test: one of "
                f"{', '.join(self.tests)}, got {name!r}{held_out}"
            )
        test, own = self.tests[name], self.session(name)
        levels = test.trace.reference_actuation, trace.reference_actuation
        if np.isfinite(levels[1]) and not same_level(*levels):
            made, other = (
                self.system.words([level], self.actuation_unit, actuation=True) for level in levels
            )
            raise FitError(
                f"test {name!r} was made at {made}, and the kind this_test knows nothing of "
                f"{other}: take the kind new_test"
            )
        if forecast.session and forecast.session != own:
            raise FitError(
                f"session {forecast.session!r} is for a new test: the kind this_test takes that of "
                f"its test, {own!r}"
            )
        forecast = replace(forecast, session=own)
        return self.predictor.repeat(trace, forecast, test.stored.values())

    def respond(
        self,
        building: Building | str | PathLike[str],
        grounds: Grounds,
        draws: int = 300,
        seed: int = 1,
        *,
        kind: str = "new_test",
        tolerance: float = 0.01,
        jobs: int = 1,
        observe: Callable[[Step], None] = lambda step: None,
    ) -> Response:
        """Response of a building with this device as its dampers.

        Parameters
        ----------
        building : Building or path
            As `read_building` reads it.
        grounds : Ground or path, or several
            Paths as `read_ground` reads them; "FILE:0.01s" gives the step of a file without one.
        draws : int
        seed : int
        kind : {"new_test", "device"}
            With each damper's scatter from test to test, or the mean property alone.
        tolerance : float
            Largest estimated error of a draw's drift, relative; steps are shortened until then.
        jobs : int
            Processes; the result does not depend on them.

        Returns
        -------
        Response
            `drift` (draw, ground, storey), in, and others.

        Raises
        ------
        BuildingError
            When the building or a ground motion cannot be used, or the actuation is of another
            kind than the run's.
        """
        if kind not in KINDS:
            raise BuildingError(f"unknown kind {kind!r}: expected one of {', '.join(KINDS)}")
        whole_number("draws", draws, FEWEST_DRAWS, BuildingError, MOST_DRAWS)
        whole_number("seed", seed, 0, BuildingError)
        whole_number("jobs", jobs, 0, BuildingError)
        tolerance = real_number("tolerance", tolerance, BuildingError, (0.0, 1.0), inside=True)
        built = building if isinstance(building, Building) else read_building(building)
        motions = grounds_of(grounds)
        for device in built.devices:
            where = f"the actuation of the damper at {device.name}"
            check_kind(where, device.unit, self.actuation_unit)
        model, bounds = self.predictor.model, {}
        dampers = draw_dampers(self.population, model, built, kind, draws, seed)
        if dampers.count and (model.slip_forces or model.laws):
            bounds = bound_dampers(self.population, model, built, dampers, seed)
        if not model.slip_forces:  # by which forces are judged to be in equilibrium
            typical = np.median([self.manifest.tests[name].peak_force for name in self.tests])
            dampers, *few = (
                replace(one, slip=np.full_like(one.slip, typical))
                for one in (dampers, *bounds.values())
            )
            bounds = dict(zip(bounds, few, strict=True))
        response = response_of(built, motions, dampers, tolerance, bounds, jobs, observe)
        response = seen_peaks(response, self.peaks, seed, scatter=kind == "new_test")
        remarks = [*chain.from_iterable(beyond_tests(self, response))]
        remarks += [self.caution] if self.caution else []
        remarks += _short_histories(built, motions)
        if dampers.count and self.population.design.dependence:
            remarks.append(
                "quantities that depend on speed, amplitude, date, cycles or temperature are taken "
                "at those of the typical, or the latest, test"
            )
        return replace(response, remarks=(*remarks, *response.faults))

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
        planned = {"amplitude": amplitude, "velocity": velocity}
        conditions = {**self.conditions, **(conditions or {})}
        setting = planned_setting(self.population.design.settings, actuation, session, planned)
        covariates = {**setting.covariates, **conditions}
        setting = replace(setting, device=device, covariates=covariates)
        forecast = Forecast(kind, probability, draws, seed, session)
        forecaster = Forecaster(self.predictor, setting, forecast, refresh=refresh)
        unit = self.actuation_unit
        plan = {
            "stroke": 2.0 * setting.covariates["amplitude"],
            "speed": setting.covariates["velocity"],
            "actuation": setting.actuation,
        }
        left = departures(self.tested, range_of([plan], unit))
        said = {departure.reached.name for departure in left}
        remarks = [departure.sentence(self.system, widened=True) for departure in left]
        remarks += self._remarks(session, device, conditions)

        def complete(band: Band, motion: Trace) -> Band:
            """The band with its remarks; a motion that has begun is no smaller than planned."""
            reached = [
                span
                for span in reach_of(motion, unit)
                if span.name not in said
                and (span.name not in ("stroke", "speed") or span.highest > plan[span.name])
            ]
            outside = [d.sentence(self.system) for d in departures(self.tested, reached)]
            return replace(band, remarks=(*outside, *remarks, *band.remarks), extras=self.extras)

        forecaster.complete = complete
        return forecaster

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
        settings = self._goal_settings(goal, candidates, limits)
        axes, design = self.system.axes, self.population.design
        shown = Shown(
            self.system.factor(self.actuation_unit),
            self.system.factor("in"),
            actuated=axes.actuated,
            timed=axes.timed,
        )
        # an actuation that is next to nothing is zero in the population
        done = tuple(
            replace(harmonic_of(test.trace, shown), actuation=setting.actuation)
            for test, setting in zip(self.tests.values(), design.settings, strict=True)
        )
        check_session(settings.goal.session, design.sessions)
        typical = [test for test in typical_of(done) if test.actuation > 0.0]
        # without an actuation of its own a test is one at each of the campaign's range
        tests = [
            parts.completed(level)
            for parts in settings.candidates
            for level in (typical if parts.actuation is None else typical[:1])
        ]
        if len(tests) > MOST:
            raise CampaignError(f"more than {MOST} tests, the most of one question")
        tests = tests or grid_of(done, shown)
        if self.population.several_devices:  # the one that was tested last, or one more
            among = NEW_DEVICE, design.settings[-1].device
            tests = [
                replace(c, device=d) for c in tests for d in ([c.device] if c.device else among)
            ]
        question = settings.goal, tests, settings.limits
        advice = advise(self.predictor, done, *question, draws=draws, seed=seed)
        if not settings.candidates:
            return advice
        reached = []
        for span in self.tested:
            values = [getattr(row.candidate, span.name) for row in advice]
            reached.append(replace(span, lowest=min(values), highest=max(values)))
        outside = departures(self.tested, reached)
        return replace(advice, remarks=tuple(d.sentence(self.system) for d in outside))

    def _goal_settings(
        self, goal: str | Goal | None, candidates: Candidates | None, limits: str | Limits | None
    ) -> GoalSettings:
        """What is given, checked, and for the rest what the campaign file says."""
        unit = self.actuation_unit
        table, laws = self.manifest.settings.goal, tuple(self.model.laws)
        stored = (*laws, table.of) if table else laws
        own = goal_settings(table, unit, self.folder / CAMPAIGN, stored)
        if isinstance(goal, str):
            goal = replace(parse_goal(goal, unit, of="goal", laws=laws), session=own.goal.session)
        elif isinstance(goal, Goal):
            check_goal(goal, of="goal", laws=laws)
        elif goal is not None:
            raise CampaignError(f"goal must be text such as 'band', or a Goal, got {goal!r}")
        if isinstance(limits, str):
            limits = parse_limits(limits, of="limits")
        elif not isinstance(limits, Limits | None):
            raise CampaignError(
                f"limits must be text such as '10 in/s, 6 in, 20 kip', or Limits, got {limits!r}"
            )
        if candidates is None:
            return GoalSettings(goal or own.goal, own.candidates, limits or own.limits)
        several = [candidates] if isinstance(candidates, str | Candidate) else candidates
        tests: list[Parts] = []
        for test in several if isinstance(several, Iterable) else [several]:
            if isinstance(test, Candidate):
                tests.append(Parts(**vars(test)))
            elif isinstance(test, str):
                tests += parse_tests(test, unit, of="candidates")
            else:
                raise CampaignError(
                    f"candidates must be tests in words or Candidates, one or several, got {test!r}"
                )
        tests = tests or parse_tests("", unit, of="candidates")
        return GoalSettings(goal or own.goal, tests, limits or own.limits)


@dataclass(frozen=True)
class ModelAverage:
    """Runs of the same tests with different models, which predict together.

    Every run gives the same share of the draws: tests of full cycles say little about which model
    is nearer in another motion, so none is preferred. Where the models agree the band is about as
    wide as theirs; where they differ it holds what each of them says.

    Attributes
    ----------
    runs : sequence of Run
        Two or more; kept as a tuple.

    Raises
    ------
    FitError
        When there are fewer than two runs, one is no run, two of them have the same model and
        noise, or not the same calibrated tests.
    """

    runs: Sequence[Run]

    def __post_init__(self) -> None:
        runs = tuple(self.runs) if isinstance(self.runs, Iterable) else (self.runs,)
        if len(runs) < 2 or not all(isinstance(run, Run) for run in runs):
            kinds = ", ".join(type(run).__name__ for run in runs) or "none"
            raise FitError(
                f"an average of models needs two or more runs, as open_run opens them, got {kinds}"
            )
        object.__setattr__(self, "runs", runs)
        for first, second in pairwise(runs):
            _check_same_records(first, second)
        twice = [name for name in self.models if self.models.count(name) > 1]
        if twice:
            raise FitError(
                f"two of the runs have the model {twice[0]}: an average of models needs others"
            )

    @property
    def models(self) -> tuple[str, ...]:
        """Model of each run, with its noise where two of them have the same model."""
        settings = [run.manifest.settings for run in self.runs]
        names = [own.model for own in settings]
        if len(set(names)) == len(names):
            return tuple(names)
        return tuple(f"{own.model} ({own.noise})" for own in settings)

    def predict(
        self,
        trace: Trace,
        kind: str = "new_test",
        probability: float = 0.95,
        *,
        draws: int = 500,
        seed: int = 0,
        session: str = "",
        whole: bool = False,
        given: tuple[float, float] | None = None,
        after: str = "",
    ) -> Band:
        """Band of the force under any motion and actuation, by all models together.

        Parameters
        ----------
        trace, kind, probability, seed, session, whole, given, after
            As in `Run.predict`; not of kind `this_test`.
        draws : int
            Of all models together, 10 or more for each.

        Returns
        -------
        Band
            lower, median, upper (T,) and draws (n, T), kip. The draws of the first run come first.
            `values` are empty, since each model has its own quantities.

        Raises
        ------
        FitError
            As `Run.predict` does, or when the kind is `this_test`.
        """
        if kind == THIS_TEST:
            raise FitError("an average of models predicts a new test, not the kind this_test")
        n = len(self.runs)
        whole_number(f"draws (of {n} runs together)", draws, FEWEST * n, FitError, MOST_DRAWS)
        options: dict[str, Any] = {"seed": seed, "session": session, "given": given, "after": after}
        bands = [
            run.predict(trace, kind, probability, draws=draws // n + (i < draws % n), **options)
            for i, run in enumerate(self.runs)
        ]
        forecast = Forecast(kind, probability, draws, seed, session, whole)
        together = np.concatenate([band.draws for band in bands])
        remarks = dict.fromkeys(remark for band in bands for remark in band.remarks)
        return replace(
            Band.of(trace.time, together, forecast, self._source(bands)),
            remarks=(*remarks, *_disagreement(bands)),
            given=_worst_given([band.given for band in bands if band.given]),
            extras=self.runs[0].extras,
        )

    def _source(self, bands: Sequence[Band]) -> str:
        """Where the parameters come from."""
        if len({band.source for band in bands}) == 1:
            return f"{_listed(self.models)} in equal parts, {bands[0].source}"
        each = [f"{name}, {b.source}" for name, b in zip(self.models, bands, strict=True)]
        return f"equal parts of {_listed(each)}"


def _check_same_records(first: Run, second: Run) -> None:
    """Refuse runs that were not calibrated with the same records."""
    where = f"{first.folder} and {second.folder}"
    if odd := sorted({*first.tests} ^ {*second.tests}):
        raise FitError(
            f"test {odd[0]!r} is calibrated in only one of {where}: an average of models needs "
            "runs of the same tests"
        )
    for name, test in first.tests.items():
        force, other = (np.asarray(each.trace.force) for each in (test, second.tests[name]))
        if not np.array_equal(force, other):
            raise FitError(
                f"the record of test {name!r} is not the same in {where}: an average of models "
                "needs runs of the same records"
            )


def _listed(words: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _disagreement(bands: Sequence[Band]) -> list[str]:
    """A remark where the models disagree."""
    medians = np.array([band.median for band in bands])
    distance = float(np.sqrt(np.mean(np.var(medians, axis=0)))) * 2.0
    half = float(np.mean([np.mean(band.upper - band.lower) for band in bands])) / 2.0
    if distance <= DISAGREEMENT * half:
        return []
    return [
        f"the models disagree: their medians are apart by {100.0 * distance / half:.0f} % of half "
        "the width of one model's band (root mean square), and tests do not yet tell which one is "
        "right here"
    ]


def _worst_given(parts: Sequence[Conditioned]) -> Conditioned | None:
    """How the worst of the models took the given part in, with the effective draws of all."""
    if not parts:
        return None
    worst = max(parts, key=lambda part: part.pareto_k)
    return replace(worst, effective=sum(part.effective for part in parts))


# --- a building whose dampers are the device of a run

Grounds = Iterable[Ground | str | PathLike[str]] | Ground | str | PathLike[str]


def grounds_of(
    grounds: Grounds, *, unit: str = "", scale: float = 1.0, meant: bool = False
) -> list[Ground]:
    """Ground motions of what is given; `unit`, `scale` and `meant` are as in `read_ground`."""
    motions = []
    for given in [grounds] if isinstance(grounds, Ground | str | PathLike) else grounds:
        if isinstance(given, Ground):
            motions.append(given)
            continue
        path_of("a ground motion", given, BuildingError)
        path, step, own = parse_ground(fspath(given), of="ground")
        ground = read_ground(path, step=step, unit=own or unit, scale=scale, meant=meant)
        motions.append(ground)
    if not motions:
        raise BuildingError("give at least one ground motion")
    return motions


def check_kind(where: str, unit: str, expected: str) -> None:
    """Refuse an actuation whose internal unit is of another kind than the tests had."""
    if unit != expected:
        raise BuildingError(f"{where} must be {actuation_kind(expected)}, as in the campaign")


def _short_histories(building: Building, grounds: Sequence[Ground]) -> list[str]:
    """Actuation histories that do not go on for as long as a ground motion, in sentences."""
    sentences = []
    for device in building.devices:
        if device.history is None:
            continue
        begin, end = device.history[0][[0, -1]].tolist()
        for ground in grounds:
            last = float(ground.time[-1])
            if begin > MARGIN * last or end < (1 - MARGIN) * last:
                sentences.append(
                    f"the actuation of the damper at {device.name} is known from {begin:.4g} s to "
                    f"{end:.4g} s, and the ground motion {ground.name} goes on to {last:.4g} s: "
                    "the first and the last actuation are taken to stay"
                )
    return sentences


def beyond_tests(run: Run, response: Response) -> list[list[str]]:
    """Where the dampers leave what was tested: sentences of each ground motion, then of all.

    The stroke is that of the damper which travels most, in the median draw.
    """

    def sentences(name: str, unit: str, low: float, high: float, of: str = "") -> list[str]:
        outside = departures(run.tested, [Span(name, unit, low, high)])
        return [f"{of}beyond the tests: {each.sentence(run.system)}" for each in outside]

    if not response.dampers.count:
        return [[]]
    beyond = []
    for g, ground in enumerate(response.grounds):
        travel = response.travel[response.usable(g), g]
        stroke = 2.0 * float(np.median(travel.max(axis=1))) if len(travel) else np.nan
        beyond.append(sentences("stroke", "in", stroke, stroke, f"{ground.name}: "))
    levels = np.concatenate(
        [
            [device.actuation] if device.history is None else device.history[1]
            for device in response.building.devices
        ]
    )
    return [*beyond, sentences("actuation", run.actuation_unit, levels.min(), levels.max())]
