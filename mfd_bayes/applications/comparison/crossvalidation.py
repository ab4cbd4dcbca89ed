"""Each part of a campaign predicted from all the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import replicate
from mfd_bayes.errors import CampaignError, MfdError, StoreError
from mfd_bayes.evaluation.scores import log_score, score
from mfd_bayes.jobs.job import JobState, Outcome, Step, Workplace
from mfd_bayes.jobs.local import run_jobs
from mfd_bayes.population.bands import PredictionOptions, Predictor, holds_whole
from mfd_bayes.population.design import TestConditions, levels_of, setting_of, with_zeros
from mfd_bayes.population.inference import infer_population
from mfd_bayes.runs.folder import CROSSVALIDATION, MANIFEST, PartKind, check_stored
from mfd_bayes.runs.manifest import Prediction
from mfd_bayes.runs.run import Run, open_run, prediction_conditions
from mfd_bayes.runs.test_sequence import TestSequence
from mfd_bayes.runs.unit_system import US
from mfd_bayes.store.files import AtLeastOne, Part, check, read_json, write_json

Array = NDArray[np.float64]

DRAWS = 800  # number of draws of each scored band
FOLDER = CROSSVALIDATION
SAME_MOTION = 0.1  # amplitudes, and speeds, that differ by less than this share are the same


@dataclass(frozen=True)
class Fold:
    """A part to be left out, as the job of one process."""

    part: str
    file: str  # file of its scores, under OUT/crossvalidation
    # ids of tests
    left_out: tuple[str, ...]
    kept: tuple[str, ...]
    effort: str
    seed: int
    rests_on: str = ""
    """Digest of what the run's population rests on, so that those under other laws are too."""

    @property
    def id(self) -> str:
        """Its name as a job."""
        return fold_id(self.part)

    @property
    def makes(self) -> tuple[str, ...]:
        """Files that it writes: its scores."""
        return (f"{FOLDER}/{self.file}",)

    def needs(self, folder: Path) -> tuple[str, ...]:
        """Files of a finished run that `open_run` reads."""
        stored = (folder / "tests").glob("*/*.nc")
        records = [p for p in stored if p.name in ("posterior.nc", "record.nc")]
        return MANIFEST, "priors.toml", *sorted(p.relative_to(folder).as_posix() for p in records)

    def run(self, folder: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Predict the part, and store its scores."""
        began = time.perf_counter()
        observe(Step(self.id, "gathering the others"))
        try:
            # a model of its own is that of the campaign, which has just been calibrated
            result = leave_out(open_run(folder, trust=True), self, observe)
        except StoreError:
            raise
        except MfdError as error:
            observe(Step(self.id, JobState.FAILED, message=str(error)))
            return Outcome(self.id, JobState.FAILED, time.perf_counter() - began, str(error))
        predictions = [asdict(prediction) for prediction in result]
        write_json(folder / FOLDER / self.file, {"key": asdict(self), "predictions": predictions})
        observe(Step(self.id, JobState.DONE))
        return Outcome(self.id, JobState.DONE, time.perf_counter() - began)

    def stored(self, folder: Path) -> bool:
        """Whether its scores are stored, for exactly this fold."""
        path = folder / FOLDER / self.file
        key = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}
        try:
            stored = check(_StoredPredictions, read_json(path), path)
        except StoreError:  # there is none, or it is damaged
            return False
        tests = tuple(prediction.test for prediction in stored.predictions)
        return stored.key == key and tests == self.left_out  # JSON has lists for tuples


def fold_id(name: str) -> str:
    """Name of the job that predicts a part from all others."""
    return f"without {name}"


def part_kind(text: str) -> PartKind:
    """The kind of parts to leave out, by name, checked."""
    for kind in get_args(PartKind):
        if kind == text:
            return kind  # type: ignore[no-any-return]
    raise CampaignError(f"--by must be one of {', '.join(get_args(PartKind))}, got {text!r}")


def parts_of(
    settings: Mapping[str, TestConditions], key: PartKind, actuation_unit: str, path: Path
) -> dict[str, tuple[str, ...]]:
    """Calibrated tests of each part, by the part's name, from the setting of each test by id.

    Refuses fewer than two parts, and one with all the tests that have an actuation; `path` is the
    campaign or run that the message names.
    """
    settings = dict(zip(settings, with_zeros([*settings.values()]), strict=True))
    names = list(settings)
    groups: dict[str, tuple[str, ...]] = {name: (name,) for name in names} if key == "test" else {}
    if key == "level":
        for fold in levels_of(list(settings.values())):
            scale, unit = US.of_actuation(actuation_unit)
            level = scale * settings[names[fold[0]]].actuation
            groups[f"{level:.4g} {unit}"] = tuple(names[j] for j in fold)
    elif key == "session":
        sessions = dict.fromkeys(setting.session for setting in settings.values())
        if not any(sessions):
            raise CampaignError(
                f"cross-validation by session needs sessions: no calibrated test of {path} has "
                'one, such as session = "Monday" in its [[test]]'
            )
        groups = {
            f"session {session}" if session else "no session": tuple(
                name for name in names if settings[name].session == session
            )
            for session in sessions
        }
    if key == "motion":
        groups = {f"the motion of {tests[0]}": tests for tests in _motions_of(settings)}
    if len(groups) < 2:
        raise CampaignError(
            f"cross-validation by {key} needs at least two {key}s; the calibrated tests of {path} "
            "make up only one"
        )
    for label, tests in groups.items():
        if not any(settings[name].actuation > 0 for name in names if name not in tests):
            raise CampaignError(
                f"cross-validation by {key} cannot leave out {label}: no other calibrated test of "
                f"{path} has an actuation above zero"
            )
    return groups


def _motions_of(settings: Mapping[str, TestConditions]) -> list[tuple[str, ...]]:
    """Tests of each kind of motion: about the same amplitude, speed and share of full strokes."""
    kinds: list[tuple[str, ...]] = []
    for name, setting in settings.items():
        motion = [*setting.covariates.values()]
        for i, tests in enumerate(kinds):
            if np.allclose([*settings[tests[0]].covariates.values()], motion, SAME_MOTION, 0.0):
                kinds[i] = (*tests, name)
                break
        else:
            kinds.append((name,))
    return kinds


def folds_of(run: Run, kind: PartKind, effort: str) -> tuple[Fold, ...]:
    """A fold for every part of a run."""
    settings = {name: setting_of(test.trace, run.session(name)) for name, test in run.tests.items()}
    groups = parts_of(settings, kind, run.actuation_unit, run.folder)
    digest = run.manifest.keys[CROSSVALIDATION]
    fold = partial(Fold, effort=effort, seed=run.manifest.seed, rests_on=digest)
    return tuple(
        fold(
            part=label,
            file=f"{kind}_{number}.json",
            left_out=tests,
            kept=tuple(name for name in run.tests if name not in tests),
        )
        for number, (label, tests) in enumerate(groups.items(), start=1)
    )


def leave_out(
    run: Run, fold: Fold, observe: Callable[[Step], Any] = lambda _: None
) -> tuple[Prediction, ...]:
    """Predictions of the tests of one part, from all others."""
    training = {name: run.tests[name] for name in fold.kept}
    inference = infer_population(
        training,
        run.priors,
        run.manifest.settings.inference(fold.effort, (fold.seed, 2)),
        lambda progress: observe(Step(fold.id, "sampling", progress)),
    )

    def pooled(name: str) -> dict[str, Array]:
        """Quantities of one of the other tests as pooled with them, by name, (n,) each."""
        values = inference.values(list(training).index(name))
        return {quantity: draws.reshape(-1) for quantity, draws in values.items()}

    predictions = []
    motions = {**run.held_out, **{name: run.tests[name].trace for name in fold.left_out}}
    for name in fold.left_out:
        test = run.tests[name]
        posterior, force = test.posterior, np.asarray(test.trace.force)
        predictor = Predictor(inference.population, posterior.model, posterior.noise)
        forecast = PredictionOptions(
            "observation", draws=DRAWS, seed=fold.seed, **prediction_conditions(run, name)
        )
        order = TestSequence(run.manifest, training, motions, predictor, pooled)
        forecast = replace(forecast, before=order.before(name, test.trace, forecast))
        band = predictor.predict(test.trace, forecast)
        fitted = replicate(posterior, test.stored.values(), np.random.default_rng(0), DRAWS)
        scores = score(band.draws, force), score(fitted.observed, force)
        contained = holds_whole(band.draws, force)
        density = log_score(band.draws, force)
        predictions.append(Prediction(fold.part, name, *scores, contained, density))
    return tuple(predictions)


def read_predictions(folder: Path, folds: Sequence[Fold]) -> Iterator[Prediction]:
    """Stored predictions of folds."""
    for fold in folds:
        path = check_stored(folder, f"{FOLDER}/{fold.file}", {})
        predictions = check(_StoredPredictions, read_json(path), path).predictions
        stored = tuple(prediction.test for prediction in predictions)
        if stored != fold.left_out:
            raise StoreError(f"{path} holds predictions of {', '.join(stored)}, not of its part")
        yield from predictions


class _StoredPredictions(Part):
    key: dict[str, Any]
    predictions: AtLeastOne[Prediction]


def run_folds(
    run: Run, folds: Sequence[Fold], workplace: Workplace, observe: Callable[[Step], None]
) -> tuple[Prediction, ...]:
    """Predictions of every part, computed in parallel; stored ones are not computed again."""
    folder = run.folder
    todo = [fold for fold in folds if not fold.stored(folder)]
    for fold in folds:
        if fold not in todo:
            observe(Step(fold.id, JobState.KEPT))
    with closing(run_jobs(todo, folder, workplace, observe)) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                raise CampaignError(f"cannot predict {outcome.id}: {outcome.error}")
    return tuple(read_predictions(folder, folds))


# --- the scores in a report
