"""What was left out, predicted from the rest: tests of a campaign, and cycles of a record.

Of a campaign, each part is predicted from all others: the tests' stored posteriors are used; only
the population is inferred again without the part that is held out.

To compare models, whole cycles are left out, since neighbouring samples of a record depend on each
other (Vehtari, Gelman and Gabry 2017, with the log density of a cycle given all others). Where the
importance weights of a cycle cannot be trusted, its density is computed from the evidence with and
without it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import Effort, measure_draws, psis, replicate, tempering
from mfd_bayes.calibration.posterior import NOISES, Posterior
from mfd_bayes.calibration.proposal import Evidence, fit_mixture, join_evidence
from mfd_bayes.calibration.result import Task, TestResult
from mfd_bayes.errors import CampaignError, FitError, MfdError, StoreError
from mfd_bayes.evaluation.views import LeftOutView, Row, score, score_record
from mfd_bayes.friction import models
from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.local import Workplace, run_jobs
from mfd_bayes.population.bands import Forecast, Predictor, holds_whole
from mfd_bayes.population.design import Setting, levels_of, setting_of, with_zeros
from mfd_bayes.population.inference import infer_population
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import (
    CROSSVALIDATION,
    MANIFEST,
    CampaignCrossValidation,
    Comparison,
    ComparisonRow,
    PartKind,
    Prediction,
    check_stored,
)
from mfd_bayes.runs.run import Run, TestSequence, open_run
from mfd_bayes.runs.unit_system import US
from mfd_bayes.store.files import AtLeastOne, Part, check, read_json, write_json

Array = NDArray[np.float64]

DRAWS = 800  # number of draws of each scored band
FOLDER = CROSSVALIDATION


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

    def needs(self, out: Path) -> tuple[str, ...]:
        """Files of a finished run that `open_run` reads."""
        stored = (out / "tests").glob("*/*.nc")
        records = [p for p in stored if p.name in ("posterior.nc", "record.nc")]
        return MANIFEST, "priors.toml", *sorted(p.relative_to(out).as_posix() for p in records)

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Predict the part, and store its scores."""
        began = time.perf_counter()
        observe(Step(self.id, "gathering the others"))
        try:
            # a model of its own is that of the campaign, which has just been calibrated
            result = leave_out(open_run(out, trust=True), self, observe)
        except StoreError:
            raise
        except MfdError as error:
            observe(Step(self.id, State.FAILED, message=str(error)))
            return Outcome(self.id, State.FAILED, time.perf_counter() - began, str(error))
        predictions = [asdict(prediction) for prediction in result]
        write_json(out / FOLDER / self.file, {"key": asdict(self), "predictions": predictions})
        observe(Step(self.id, State.DONE))
        return Outcome(self.id, State.DONE, time.perf_counter() - began)

    def stored(self, out: Path) -> bool:
        """Whether its scores are stored, for exactly this fold."""
        path = out / FOLDER / self.file
        key = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}
        try:
            stored = check(_StoredPredictions, read_json(path), path)
        except StoreError:  # there is none, or it is damaged
            return False
        tests = tuple(prediction.test for prediction in stored.predictions)
        return stored.key == key and tests == self.left_out  # JSON has lists for tuples


def fold_id(part: str) -> str:
    """Name of the job that predicts a part from all others."""
    return f"without {part}"


def part_kind(by: str) -> PartKind:
    """The kind of parts to leave out, by name, checked."""
    for kind in get_args(PartKind):
        if kind == by:
            return kind  # type: ignore[no-any-return]
    raise CampaignError(f"--by must be one of {', '.join(get_args(PartKind))}, got {by!r}")


def parts_of(
    settings: Mapping[str, Setting], by: PartKind, actuation_unit: str, where: Path
) -> dict[str, tuple[str, ...]]:
    """Calibrated tests of each part, by the part's name, from the setting of each test by id.

    Refuses fewer than two parts, and one with all the tests that have an actuation; `where` is the
    campaign or run that the message names.
    """
    settings = dict(zip(settings, with_zeros([*settings.values()]), strict=True))
    names = list(settings)
    parts: dict[str, tuple[str, ...]] = {name: (name,) for name in names} if by == "test" else {}
    if by == "level":
        for fold in levels_of(list(settings.values())):
            scale, unit = US.of_actuation(actuation_unit)
            level = scale * settings[names[fold[0]]].actuation
            parts[f"{level:.4g} {unit}"] = tuple(names[j] for j in fold)
    elif by == "session":
        sessions = dict.fromkeys(setting.session for setting in settings.values())
        if not any(sessions):
            raise CampaignError(
                f"cross-validation by session needs sessions: no calibrated test of {where} has "
                'one, such as session = "Monday" in its [[test]]'
            )
        parts = {
            f"session {session}" if session else "no session": tuple(
                name for name in names if settings[name].session == session
            )
            for session in sessions
        }
    if len(parts) < 2:
        raise CampaignError(
            f"cross-validation by {by} needs at least two {by}s; the calibrated tests of {where} "
            "make up only one"
        )
    for part, tests in parts.items():
        if not any(settings[name].actuation > 0 for name in names if name not in tests):
            raise CampaignError(
                f"cross-validation by {by} cannot leave out {part}: no other calibrated test of "
                f"{where} has an actuation above zero"
            )
    return parts


def folds_of(run: Run, by: PartKind, effort: str) -> tuple[Fold, ...]:
    """A fold for every part of a run."""
    settings = {name: setting_of(test.trace, run.session(name)) for name, test in run.tests.items()}
    parts = parts_of(settings, by, run.actuation_unit, run.folder)
    digest = run.manifest.keys[CROSSVALIDATION]
    fold = partial(Fold, effort=effort, seed=run.manifest.seed, rests_on=digest)
    return tuple(
        fold(
            part=part,
            file=f"{by}_{number}.json",
            left_out=tests,
            kept=tuple(name for name in run.tests if name not in tests),
        )
        for number, (part, tests) in enumerate(parts.items(), start=1)
    )


def leave_out(
    run: Run, fold: Fold, observe: Callable[[Step], Any] = lambda _: None
) -> tuple[Prediction, ...]:
    """Predictions of the tests of one part, from all others."""
    others = {name: run.tests[name] for name in fold.kept}
    inference = infer_population(
        others,
        run.priors,
        run.manifest.settings.inference(fold.effort, (fold.seed, 2)),
        lambda progress: observe(Step(fold.id, "sampling", progress)),
    )

    def pooled(name: str) -> dict[str, Array]:
        """Quantities of one of the other tests as pooled with them, by name, (n,) each."""
        values = inference.values(list(others).index(name))
        return {quantity: draws.reshape(-1) for quantity, draws in values.items()}

    predictions = []
    motions = {**run.held_out, **{name: run.tests[name].trace for name in fold.left_out}}
    for name in fold.left_out:
        test = run.tests[name]
        posterior, force = test.posterior, np.asarray(test.trace.force)
        predictor = Predictor(inference.population, posterior.model, posterior.noise)
        forecast = Forecast("observation", draws=DRAWS, seed=fold.seed, **run.place(name))
        order = TestSequence(run.manifest, others, motions, predictor, pooled)
        forecast = replace(forecast, before=order.before(name, test.trace, forecast))
        band = predictor.predict(test.trace, forecast)
        fitted = replicate(posterior, test.stored.values(), np.random.default_rng(0), DRAWS)
        scores = score(band.draws, force), score(fitted.observed, force)
        whole = holds_whole(band.draws, force)
        predictions.append(Prediction(fold.part, name, *scores, whole))
    return tuple(predictions)


def read_predictions(out: Path, folds: Sequence[Fold]) -> Iterator[Prediction]:
    """Stored predictions of folds."""
    for fold in folds:
        path = check_stored(out, f"{FOLDER}/{fold.file}", {})
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
    out = run.folder
    todo = [fold for fold in folds if not fold.stored(out)]
    for fold in folds:
        if fold not in todo:
            observe(Step(fold.id, State.KEPT))
    with closing(run_jobs(todo, out, workplace, observe)) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                raise CampaignError(f"cannot predict {outcome.id}: {outcome.error}")
    return tuple(read_predictions(out, folds))


# --- the scores in a report


def left_out_view(scores: CampaignCrossValidation | None) -> LeftOutView | None:
    """Scores of a cross-validation that the manifest holds; None without one."""
    if scores is None:
        return None
    rows: list[Row] = []
    for prediction in scores.predictions:
        own, fitted = prediction.score, prediction.fitted
        rows.append(
            {"part": prediction.part, "test": prediction.test}
            | score_record(own)
            | {"fitted_width": fitted.width, "fitted_crps": fitted.crps}
            | {"width_ratio": own.width / fitted.width if fitted.width > 0 else np.nan}
            | {"crps_ratio": own.crps / fitted.crps if fitted.crps > 0 else np.nan}
            | {"whole_95": np.nan if prediction.whole is None else float(prediction.whole)}
        )
    names = [name for name in rows[0] if name not in ("part", "test")]
    mean = {name: float(np.mean([row[name] for row in rows])) for name in names}
    others = "the others" if scores.by == "test" else f"those of the other {scores.by}s"
    held = [row["whole_95"] for row in rows]
    whole = (
        " The 95 % bands of whole histories hold the whole force of "
        f"{sum(held):.0f} of {len(held)} tests."
    )
    sentence = (
        f"Of {len(rows)} tests, each predicted from {others}, the 95 % bands hold "
        f"{100 * mean['coverage_95']:.1f} % of the force, the 50 % bands "
        f"{100 * mean['coverage_50']:.1f} %; they are on average {mean['width_ratio']:.1f} times "
        f"as wide as those of the fitted tests.{whole if np.all(np.isfinite(held)) else ''}"
    )
    return LeftOutView(scores.by, tuple(rows), {"part": "", "test": "mean"} | mean, sentence)


# === models compared by leaving out one cycle at a time

FEWEST_CYCLES = 3  # least number of cycles of a record from which one can be left out
LARGEST_K = 0.7  # Pareto k above which the importance weights of a cycle cannot be trusted
CLEAR = 2.0  # number of standard errors from which one model counts as better than another
FEW = 10  # number of tests, or of cycles of one test, below which a standard error is rough
ALL = "all"

EVIDENCE_DRAWS, MOST_ROUNDS = 4000, 16
"""Draws from each proposal of an evidence, and the largest number of proposals."""

LEAST_ESS, GOOD_K = 0.1, 0.6
"""Share of effective draws from which the next proposal is learned; Pareto k that is enough."""

_PIECE = 1 << 19  # size of the arrays of one piece, in numbers
_DRAWS = 400  # for the median of the force


# --- what is compared


@dataclass(frozen=True)
class Candidate:
    """A model and a noise to compare, None for the campaign's own, in a run folder `name`."""

    name: str
    model: str | None = None
    noise: str | None = None


def candidates(names: Sequence[str], noises: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """Every model with every noise; without noises two or more models with the campaign's own."""
    files = [name for name in dict.fromkeys(names) if models.file_of(name)]
    # a model in a file has the folder of its class
    folders = {name: name for name in models.model_names()}
    folders |= {name: name.rpartition(":")[2] for name in files}
    if twice := [f for f in folders.values() if [*folders.values()].count(f) > 1]:
        raise CampaignError(
            f"--models names two models {twice[0]!r}: each needs another class name"
        )
    kinds = _chosen("--models", names, [*folders], 0 if noises else 2) or (None,)
    fewest = 1 if len(names) > 1 else 2
    chosen = _chosen("--noises", noises, [*NOISES], fewest) if noises else (None,)
    return tuple(
        Candidate("_".join(filter(None, (folders[m] if m and len(kinds) > 1 else "", n))), m, n)
        for m in kinds
        for n in chosen
    )


def _chosen(
    option: str, names: Sequence[str], allowed: Sequence[str], least: int
) -> tuple[str, ...]:
    """Names of an option, each once, in the order of those that are allowed."""
    if not set(names) <= set(allowed) or len(set(names)) < max(len(names), least):
        got = ", ".join(map(repr, names)) or "nothing"
        many = "two or more" if least > 1 else option.lstrip("-")
        raise CampaignError(
            f"{option} must name {many} of {', '.join(allowed)}, each once, got {got}"
        )
    return tuple(name for name in allowed if name in names)


def check_cycles(task: Task) -> None:
    """Refuse a test with too few cycles to leave one out."""
    try:
        find_cycles(task.trace, task.posterior().first)
    except FitError as error:
        raise FitError(f"test {task.id!r} cannot be compared: {error}") from error


# --- the comparison of runs


@dataclass(frozen=True, eq=False)
class Validation:
    """Leave-one-cycle-out figures of a model."""

    # A row for each cycle: `test`; `elpd`, the expected log predictive density log p(y_c |
    # y_-c); `lppd`, the same under the posterior with the cycle included; `psis_k`, the
    # Pareto k of PSIS; `k`, that of the weights behind `elpd`
    cycles: pd.DataFrame
    # kip², sum of squares of the force minus its predicted median, and about its mean
    squares: float
    spread: float
    short: tuple[str, ...]  # tests whose sampling missed its targets
    evidence: Evidence

    @property
    def trusted(self) -> pd.Series[bool]:
        """Whether the figures of each cycle can be trusted."""
        return self.cycles["k"] <= LARGEST_K

    @property
    def redone(self) -> pd.Series[bool]:
        """Whether PSIS failed for each cycle."""
        return ~(self.cycles["psis_k"] <= LARGEST_K)


def compare_runs(runs: Mapping[str, Run]) -> Comparison:
    """Comparison of runs of one campaign, by model, on the tests that all were calibrated to."""
    tests = [run.tests.keys() for run in runs.values()]
    shared = [name for name in tests[0] if all(name in names for names in tests)]
    if not shared:
        raise FitError("there is nothing to compare: no test could be calibrated under every model")
    scores = {
        model: {name: validate(run.tests[name], run.manifest.effort) for name in shared}
        for model, run in runs.items()
    }
    return comparison_of(scores, sorted(set().union(*tests).difference(shared)))


def comparison_of(
    scores: Mapping[str, Mapping[str, Validation]], lost: Sequence[str] = ()
) -> Comparison:
    """Comparison of the figures of the same tests by model; `lost` tests are named."""
    tests = list(next(iter(scores.values())))
    total = {model: _joined([*of_tests.values()]) for model, of_tests in scores.items()}
    rows = [r for n in tests for r in _rows(n, {m: of[n] for m, of in scores.items()})]
    overall = _rows(ALL, total)
    best, second = overall[0].model, overall[1].model
    sentences = [
        _favour(total, best, second, len(tests)),
        "The comparison is about another cycle of the same tests, not about another test.",
        _trust(total, best, second),
        _evidence_sentence({model: score.evidence for model, score in total.items()}),
    ]
    if lost:
        sentences.append(f"Left out, since not every model could be calibrated: {', '.join(lost)}.")
    return Comparison((*rows, *overall), " ".join(sentences))


def _joined(parts: Sequence[Validation]) -> Validation:
    """Figures of a model over several tests."""
    return Validation(
        cycles=pd.concat([part.cycles for part in parts], ignore_index=True),
        squares=sum(part.squares for part in parts),
        spread=sum(part.spread for part in parts),
        short=tuple(name for part in parts for name in part.short),
        evidence=join_evidence([part.evidence for part in parts]),
    )


def validate(test: TestResult, effort: Effort) -> Validation:
    """Leave-one-cycle-out figures of a calibrated test, and its error in sample."""
    stored, posterior, facts = test.stored, test.posterior, test.stored.facts
    rng, values = np.random.default_rng(facts["seed"]), stored.values()
    chains = stored.draws.sizes["chain"]
    cycles = cross_validate(posterior, values, chains, facts["walkers"], rng)
    pick = np.linspace(0, values["offset"].size - 1, _DRAWS).astype(np.intp)
    taken = {name: column[pick] for name, column in values.items()}
    force = posterior.force(taken) + taken["offset"][:, None]
    observed = np.asarray(test.trace.force)[posterior.first :]
    missed = observed - np.median(force, axis=0)[posterior.first :]
    figures = (facts["convergence"].get(name) or (None, 0, 0) for name in posterior.names)
    converged = all(
        r_hat is not None and r_hat <= effort.r_hat and min(bulk or 0, tail or 0) >= effort.ess
        for r_hat, bulk, tail in figures
    )
    return Validation(
        cycles.assign(test=test.id),
        squares=float(missed @ missed),
        spread=float(observed.size * observed.var()),
        short=() if converged else (test.id,),
        evidence=test.log_evidence(),
    )


def _rows(subject: str, scores: Mapping[str, Validation]) -> list[ComparisonRow]:
    """Row of every model, best first."""
    order = sorted(scores, key=lambda model: -scores[model].cycles["elpd"].sum())
    rows = []
    for model in order:
        score, cycles = scores[model], scores[model].cycles
        less, error = difference(cycles, scores[order[0]].cycles)
        rows.append(
            ComparisonRow(
                subject=subject,
                model=model,
                cycles=len(cycles),
                elpd=float(cycles["elpd"].sum()),
                elpd_se=standard_error(cycles["elpd"], cycles["test"]),
                p_loo=float((cycles["lppd"] - cycles["elpd"]).sum()),
                worst_k=float(cycles["psis_k"].max()),
                bad=float(score.redone.mean()),
                unsettled=float(1.0 - score.trusted.mean()),
                difference=less,
                difference_se=error,
                rrse=float(np.sqrt(score.squares / score.spread)),
                log_evidence=score.evidence.value,
                log_evidence_se=score.evidence.error,
                evidence_k=score.evidence.pareto_k,
                evidence_trusted=score.evidence.trusted,
            )
        )
    return rows


def _favour(total: Mapping[str, Validation], best: str, second: str, tests: int) -> str:
    """Sentence on which of the best two models the records favour, if any."""
    more, error = difference(total[best].cycles, total[second].cycles)
    errors, count = more / error if error > 0 else np.inf, len(total[best].cycles)
    where = f"{tests} tests of {count} cycles in all" if tests > 1 else f"{count} cycles of 1 test"
    verb = f"favour {best} over" if errors >= CLEAR else f"cannot decide between {best} and"
    few = (tests if tests > 1 else count) < FEW
    return (
        f"The records {verb} {second}: elpd higher by {more:.4g}, {errors:.1f} standard "
        f"errors over {where}{' (a rough estimate of the error, from so few)' if few else ''}."
    )


def _evidence_sentence(evidence: Mapping[str, Evidence]) -> str:
    """Sentence on the two models of largest log evidence, and on what it depends on."""
    best, second = sorted(evidence, key=lambda model: -evidence[model].value)[:2]
    more = evidence[best].value - evidence[second].value
    error = float(np.hypot(evidence[best].error, evidence[second].error))
    text = (
        f"Log evidence of {best} is higher than that of {second} by {more:.4g} ± {error:.2g}. It "
        "depends on the priors: a prior of one parameter that is twice as wide lowers it by up to "
        "0.7 in each test."
    )
    if rough := [model for model in evidence if not evidence[model].trusted]:
        text += f" Do not trust the log evidence of {', '.join(rough)}: k or error is too large."
    return text


def _trust(total: Mapping[str, Validation], best: str, second: str) -> str:
    """Sentence on whether the diagnostics of the best two models support their difference."""
    redone, caveats = [], []
    for model in (best, second):
        score = total[model]
        if failed := int(score.redone.sum()):
            worst = score.cycles["psis_k"].max()
            redone.append(f"{failed} of {len(score.cycles)} cycles of {model} (worst {worst:.2f})")
        if bad := int((~score.trusted).sum()):
            caveats.append(f"k stays above {LARGEST_K:g} in {bad} cycles of {model}")
        if score.short:
            caveats.append(f"the sampling of {model} fell short in {', '.join(score.short)}")
    text = ""
    if redone:
        text = (
            f"Pareto k of PSIS exceeds {LARGEST_K:g} in {' and '.join(redone)}; for these cycles "
            "the score was computed in a second way too, from the evidence with and without the "
            "cycle, and the one with the smaller k counts. "
        )
    if caveats:
        return f"{text}Do not rely on this result as it is: {'; '.join(caveats)}."
    return f"{text}The diagnostics of this comparison are good."


def difference(cycles: pd.DataFrame, others: pd.DataFrame) -> tuple[float, float]:
    """Elpd of a model minus that of another, and its standard error, paired over cycles."""
    more = cycles["elpd"] - others["elpd"]
    return float(more.sum()), standard_error(more, cycles["test"])


def standard_error(figures: Any, test: Any) -> float:
    """Standard error of a sum over cycles (C,), of tests (C,); NaN for fewer than two cycles.

    The cycles of one test resemble each other, so that tests count, not cycles: with J tests and
    the sum s_j of the cycles of test j, less the mean over all cycles, it is
    √(J/(J − 1) Σ s_j²), but never less than if all cycles were independent, √(C var). Of one test
    only the latter is known.
    """
    figures = np.asarray(figures)
    if figures.size < 2:
        return float("nan")
    alone = float(np.sqrt(figures.size * np.var(figures, ddof=1)))
    sums = pd.Series(figures - figures.mean()).groupby(np.asarray(test)).sum()
    return max(alone, float(np.sqrt(sums.size / max(sums.size - 1, 1) * np.sum(sums**2))))


# --- leave-one-cycle-out


def cross_validate(
    posterior: Posterior,
    values: Mapping[str, Array],
    chains: int,
    walkers: int,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """`Validation.cycles` from posterior draws of all quantities, (chain · draw,) each.

    Where PSIS weights cannot be trusted because a cycle is too informative, p(y_c | y_-c) =
    p(y)/p(y_-c) is computed from both evidences.
    """
    edges = find_cycles(posterior.trace, posterior.first)
    given = cycle_log_likelihood(posterior, values, edges)[0]
    scores = []
    for column in given.T:
        ess = measure_draws(column.reshape(chains, -1), walkers).ess_bulk[0]
        scores.append(psis_loo(column, float(np.clip(ess / column.size, 1e-3, 1.0))))
    elpd, lppd, psis_k = np.transpose(scores)
    k, failed = psis_k.copy(), np.flatnonzero(~(psis_k <= LARGEST_K)).tolist()
    if failed:
        draws = posterior.coordinates(values)
        whole, whole_k = log_evidence(posterior.log_prob, draws, np.zeros(len(draws)), rng)
    for at in failed:

        def without(q: Array, at: int = at) -> Array:
            """Log posterior density of q without the cycle, p(θ) p(y_-c | θ)."""
            log_density = posterior.log_prior(q)
            inside = np.isfinite(log_density)
            with np.errstate(over="ignore", invalid="ignore"):
                of_cycles, of_all = cycle_log_likelihood(
                    posterior, posterior.values(q[inside]), edges
                )
                log_density[inside] += of_all - of_cycles[:, at]
            return np.where(np.isnan(log_density), -np.inf, log_density)

        evidence, rest_k = log_evidence(without, draws, -given[:, at], rng)
        if max(whole_k, rest_k) < k[at]:
            elpd[at], k[at] = whole - evidence, max(whole_k, rest_k)
    return pd.DataFrame({"elpd": elpd, "lppd": lppd, "psis_k": psis_k, "k": k})


def psis_loo(log_likelihood: Array, efficiency: float = 1.0) -> tuple[float, float, float]:
    """Elpd, lppd and Pareto k of one cycle, from its log density under each draw, (n,).

    The posterior without the cycle is the full one divided by p(y_c | y_-c, θ): the draws are
    weighted by the inverse of that.
    """
    log_weights, k = psis(-log_likelihood, efficiency)
    elpd = np.logaddexp.reduce(log_weights + log_likelihood)
    lppd = np.logaddexp.reduce(log_likelihood) - np.log(log_likelihood.size)
    return float(elpd), float(lppd), k


def log_evidence(
    density: Callable[[Array], Array],
    draws: Array,
    log_weights: Array,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Log of the integral of a density, and the Pareto k of its importance weights.

    Population Monte Carlo (Cappé et al., 2004) with tempered weights (Koblents and Míguez,
    2015): a proposal is learned from weighted draws, new draws from it are weighted, and so on
    until k is small. `density` is a log density, unnormalised, (n, dim) -> (n,); `draws` (n, dim)
    are from one that is not too different, `log_weights` (n,) the log of their ratio.
    """
    best = (-np.inf, np.inf)
    for _ in range(MOST_ROUNDS):
        # while few draws have all the weight, a power of the weights is used
        weights = special.softmax(
            tempering(log_weights, LEAST_ESS) * (log_weights - log_weights.max())
        )
        proposal = fit_mixture(draws, rng, weights)
        draws = proposal.draw(rng, EVIDENCE_DRAWS)
        log_weights = density(draws) - proposal.log_density(draws)
        if not np.any(np.isfinite(log_weights)):
            break
        k = psis(log_weights)[1]
        if k < best[1]:
            best = float(np.logaddexp.reduce(log_weights)) - np.log(EVIDENCE_DRAWS), k
        if k <= GOOD_K:
            break
    return best


# --- the density of a cycle given all others


def find_cycles(trace: Trace, first: int = 0) -> NDArray[np.intp]:
    """First sample of each cycle of a record, and the end of the record, (C + 1,).

    A cycle ends at every second turn of the whole motion, as in a harmonic record. In an irregular
    record small loops are joined until they last half the mean period 2π sd(x)/sd(v): a shorter
    block would be predicted too easily from its neighbours. A short rest at the end joins the last
    cycle. The cycles follow from the motion alone: they are the same for every model. Samples
    before `first` are in no cycle.
    """
    time = trace.time
    shortest = np.pi * trace.displacement[first:].std() / trace.velocity[first:].std()
    edges, turns = [first], 0
    for turn in trace.cycle_turns[trace.cycle_turns > first].tolist():
        turns += 1
        if turns >= 2 and time[turn] - time[edges[-1]] >= shortest:
            edges.append(turn)
            turns = 0
    if len(edges) > 1 and time[-1] - time[edges[-1]] < shortest:
        edges.pop()
    if len(edges) < FEWEST_CYCLES:
        raise FitError(
            f"leaving out one cycle needs a record with at least {FEWEST_CYCLES} cycles, "
            f"got {len(edges)}"
        )
    return np.array([*edges, trace.samples], dtype=np.intp)


def cycle_log_likelihood(
    posterior: Posterior, values: Mapping[str, Array], cycles: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Log density of every cycle given all others, and of all together.

    log p(y_c | y_-c, θ), (n, C), and log p(y | θ), (n,), for draws of all quantities, (n,) each,
    and `cycles` from `find_cycles` with the posterior's `first`.
    """
    kept, size = slice(cycles[0], None), max(1, _PIECE // posterior.trace.samples)
    pieces = []
    for begin in range(0, values["offset"].size, size):
        some = {name: column[begin : begin + size] for name, column in values.items()}
        residual = np.asarray(posterior.trace.force) - some["offset"][:, None]
        residual -= posterior.force(some)
        travel = posterior.travel(some)
        decay, scale = posterior.noise.memory(
            posterior.trace.time[kept], some, None if travel is None else travel[:, kept]
        )
        dof = some["noise_dof"] if "noise_dof" in posterior.noise.parameters else None
        starts = cycles[:-1] - cycles[0]
        pieces.append(conditional_density(residual[:, kept], decay, scale, starts, dof))
    given, whole = zip(*pieces, strict=True)
    return np.concatenate(given), np.concatenate(whole)


def conditional_density(
    residual: Array, decay: Array, scale: Array, starts: NDArray[np.intp], dof: Array | None = None
) -> tuple[Array, Array]:
    """Log density of every block of a Markov chain given all others, (n, C), and of all, (n,).

    With a the first sample of a block and b the first sample after it,

        p(y_c | y_-c) = Π_{n=a}^{b} p(e_n | e_{n−1}) / p(e_b | e_{a−1}),

    where the last density bridges the gap: its φ is the product of all φ from a to b. That
    is exact for Gaussian noise. A sum of Student-t innovations has no closed form: there a
    Student-t with the same degrees of freedom `dof` (n,) and the sum's mean and variance is used.
    `residual` is (n, T), kip; `decay` and `scale` are from `Noise.memory`, (n, T); `starts` are
    the first samples of the blocks, (C,), beginning with 0.
    """
    standard = residual / scale
    before = np.zeros_like(standard)
    before[:, 1:] = standard[:, :-1]
    link = _transition(standard, before, decay, dof)
    density = np.add.reduceat(link - np.log(scale), starts, axis=1)
    whole = density.sum(axis=1)
    behind = starts[1:]
    hole = np.add.reduceat(decay, starts, axis=1)[:, :-1] + decay[:, behind]
    bridge = _transition(standard[:, behind], before[:, starts[:-1]], hole, dof)
    density[:, :-1] += link[:, behind] - bridge
    return np.asarray(density), np.asarray(whole)


def _transition(after: Array, before: Array, decay: Array, dof: Array | None) -> Array:
    """Log density of standardised noise given its previous value, with φ = exp(−decay)."""
    shrink = -np.expm1(-2.0 * decay)
    squares = (after - np.exp(-decay) * before) ** 2 / shrink
    if dof is None:
        return np.asarray(-0.5 * (squares + np.log(2 * np.pi * shrink)))
    nu = dof[:, None]
    peak = special.gammaln((nu + 1) / 2) - special.gammaln(nu / 2) - 0.5 * np.log(nu * np.pi)
    return np.asarray(peak - 0.5 * (nu + 1) * np.log1p(squares / nu) - 0.5 * np.log(shrink))
