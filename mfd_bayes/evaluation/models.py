"""Comparison of models: runs of one campaign under several models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.calibration.task import Task
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.evaluation.cycles import find_cycles
from mfd_bayes.evaluation.loo import (
    LARGEST_K,
    CrossValidation,
    cross_validate,
    difference,
    join,
)
from mfd_bayes.friction import models
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.scores import Comparison, ComparisonRow

Array = NDArray[np.float64]

CLEAR = 2.0
"""Number of standard errors from which one model counts as better than another."""

FEW = 10
"""Number of tests, or of cycles of one test, below which a standard error is rough."""

TARGET = "The comparison is about another cycle of the same tests, not about another test."

ALL = "all"
_DRAWS = 400  # for the median of the force


@dataclass(frozen=True, eq=False)
class _Score:
    """Scores of a model on one or several tests."""

    validation: CrossValidation
    squares: float  # sum of squares of the force minus its predicted median, kip²
    spread: float  # sum of squares of the force about its mean, kip²
    short: tuple[str, ...]  # tests whose sampling missed its targets


@dataclass(frozen=True)
class Candidate:
    """What is compared with others: a model and a noise; None is the campaign's own.

    `name` is that of its run's folder.
    """

    name: str
    model: str | None = None
    noise: str | None = None


def candidates(names: Sequence[str], noises: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """Every model with every noise; without noises two or more models, with the campaign's noise.

    Raises
    ------
    CampaignError
        When a name is unknown or there twice, or there are fewer than two to compare.
    """
    if not noises:
        return tuple(Candidate(name, model=name) for name in check_models(names))
    known = tuple(NOISES)
    if [name for name in noises if name not in known] or len(set(noises)) < len(noises):
        got = ", ".join(map(repr, noises))
        raise CampaignError(
            f"--noises must name noises of {', '.join(known)}, each once, got {got}"
        )
    chosen = tuple(name for name in known if name in noises)
    if len(noises) < 2 and len(names) < 2:
        raise CampaignError(
            f"there is nothing to compare: --noises must name two or more of {', '.join(known)}, "
            f"got {noises[0]!r} alone, or --models two or more models"
        )
    several = check_models(names) if len(names) > 1 else tuple(names)
    if unknown := [name for name in several if name not in models.MODELS]:
        raise CampaignError(
            f"--models must be of {', '.join(models.MODELS)}, got {', '.join(map(repr, unknown))}"
        )
    if len(several) < 2:
        own = next(iter(several), None)
        return tuple(Candidate(noise, own, noise) for noise in chosen)
    return tuple(Candidate(f"{m}_{noise}", m, noise) for m in several for noise in chosen)


def check_models(names: Sequence[str]) -> tuple[str, ...]:
    """Names of two or more models, in the program's order.

    Raises
    ------
    CampaignError
        When one is unknown or named twice, or there are fewer than two.
    """
    known = models.MODELS
    wrong = [name for name in names if name not in known]
    if wrong or len(set(names)) < max(len(names), 2):
        got = ", ".join(map(repr, names)) or "nothing"
        raise CampaignError(
            f"--models must name two or more of {', '.join(models.MODELS)}, got {got}"
        )
    return tuple(name for name in known if name in names)


def check_cycles(task: Task) -> None:
    """Refuse a test with too few cycles to leave one out.

    Raises
    ------
    FitError
        When its record has too few cycles.
    """
    try:
        find_cycles(task.trace, task.posterior().first)
    except FitError as error:
        raise FitError(f"test {task.id!r} cannot be compared: {error}") from error


def compare_runs(runs: Mapping[str, Run]) -> Comparison:
    """Comparison of runs of one campaign, by model.

    Only tests that every model was calibrated to are compared.

    Raises
    ------
    FitError
        When no test was calibrated under every model, or a record has too few cycles.
    """
    some = next(iter(runs.values()))
    shared = [name for name in some.tests if all(name in run.tests for run in runs.values())]
    if not shared:
        raise FitError("there is nothing to compare: no test could be calibrated under every model")
    scores = {
        model: {name: _score(run.tests[name], run.manifest.effort) for name in shared}
        for model, run in runs.items()
    }
    rows: list[ComparisonRow] = []
    for name in shared:
        rows += _rows(name, {model: found[name] for model, found in scores.items()})
    total = {model: _together(list(found.values())) for model, found in scores.items()}
    overall = _rows(ALL, total)
    pair = overall[0].model, overall[1].model
    parts = [_favour(total, pair, len(shared)), TARGET, _trust(total, pair)]
    lost = sorted({name for run in runs.values() for name in run.tests} - set(shared))
    if lost:
        parts.append(f"Left out, since not every model could be calibrated: {', '.join(lost)}.")
    return Comparison((*rows, *overall), " ".join(parts))


def _score(test: TestResult, effort: Effort) -> _Score:
    stored, trace = test.stored, test.trace
    rng = np.random.default_rng(stored.facts["seed"])
    values, sizes = stored.values(), stored.draws.sizes
    validation = cross_validate(
        test.posterior, values, sizes["chain"], stored.facts["walkers"], rng
    )
    pick = np.linspace(0, values["offset"].size - 1, _DRAWS).astype(np.intp)
    taken = {name: column[pick] for name, column in values.items()}
    force = test.posterior.force(taken) + taken["offset"][:, None]
    kept = slice(test.posterior.first, None)
    observed = np.asarray(trace.force)[kept]
    missed = observed - np.median(force, axis=0)[kept]
    short = () if _converged(test, stored.facts, effort) else (test.id,)
    squares, spread = float(missed @ missed), float(observed.size * observed.var())
    return _Score(validation, squares, spread, short)


def _together(scores: list[_Score]) -> _Score:
    return _Score(
        join(score.validation for score in scores),
        sum(score.squares for score in scores),
        sum(score.spread for score in scores),
        tuple(name for score in scores for name in score.short),
    )


def _rows(subject: str, scores: Mapping[str, _Score]) -> list[ComparisonRow]:
    """Row of every model, best first."""
    order = sorted(scores, key=lambda model: -scores[model].validation.total)
    best = scores[order[0]].validation
    rows = []
    for model in order:
        found = scores[model].validation
        apart, error = difference(found, best)
        rows.append(
            ComparisonRow(
                subject=subject,
                model=model,
                cycles=found.cycles,
                elpd=found.total,
                elpd_se=found.error,
                p_loo=found.p_loo,
                worst_k=float(found.psis_k.max()),
                bad=float(found.redone.mean()),
                unsettled=float(found.bad.mean()),
                difference=apart,
                difference_se=error,
                rrse=float(np.sqrt(scores[model].squares / scores[model].spread)),
            )
        )
    return rows


def _favour(total: Mapping[str, _Score], pair: tuple[str, str], tests: int) -> str:
    """Sentence on which of the best two models the records favour, if any."""
    best, second = pair
    one, other = total[best].validation, total[second].validation
    apart, error = difference(one, other)
    errors = apart / error if error > 0 else np.inf
    cycles = f"{one.cycles} cycles"
    where = f"{tests} tests of {cycles} in all" if tests > 1 else f"{cycles} of 1 test"
    by = f"elpd higher by {apart:.4g}, {errors:.1f} standard errors over {where}"
    if errors >= CLEAR:
        text = f"The records favour {best} over {second}: {by}"
    else:
        text = f"The records cannot decide between {best} and {second}: {by}"
    few = (tests if tests > 1 else one.cycles) < FEW
    return text + (" (a rough estimate of the error, from so few)." if few else ".")


def _trust(total: Mapping[str, _Score], pair: tuple[str, str]) -> str:
    """Sentence on whether the diagnostics of the best two models support their difference."""
    redone = [_redone(model, total[model].validation) for model in pair]
    doubts = [doubt for model in pair for doubt in _doubts(model, total[model])]
    text = ""
    if any(redone):
        text = (
            f"Pareto k of PSIS exceeds {LARGEST_K:g} in {' and '.join(filter(None, redone))}; "
            "for these cycles the score was computed in a second way too, from the evidence with "
            "and without the cycle, and the one with the smaller k counts. "
        )
    if not doubts:
        return text + "The diagnostics of this comparison are good."
    text += f"Do not rely on this result as it is: {'; '.join(doubts)}"
    one, other = (total[model].validation for model in pair)
    good = ~(one.bad | other.bad)
    if 1 < good.sum() < good.size:
        apart, error = difference(one.part(good), other.part(good))
        text += (
            f"; over the other {good.sum()} cycles elpd differs by {apart:.4g}, "
            f"{apart / error if error > 0 else np.inf:.1f} standard errors"
        )
    return text + "."


def _redone(model: str, found: CrossValidation) -> str:
    """Number of cycles for which PSIS failed, as text; "" where there is none."""
    if not np.any(found.redone):
        return ""
    share = f"{found.redone.sum()} of {found.cycles} cycles of {model}"
    return f"{share} (worst {found.psis_k.max():.2f})"


def _doubts(model: str, score: _Score) -> list[str]:
    """Reasons not to trust the figures of a model."""
    doubts, bad = [], score.validation.bad
    if np.any(bad):
        doubts.append(f"k stays above {LARGEST_K:g} in {bad.sum()} cycles of {model}")
    if score.short:
        doubts.append(f"the sampling of {model} fell short in {', '.join(score.short)}")
    return doubts


def _converged(test: TestResult, facts: Mapping[str, Any], effort: Effort) -> bool:
    """Whether the sampling of a test reached the targets of an effort."""
    for name in test.posterior.names:
        r_hat, bulk, tail = facts["convergence"].get(name) or (None, None, None)
        if r_hat is None or r_hat > effort.r_hat or min(bulk or 0, tail or 0) < effort.ess:
            return False
    return True
