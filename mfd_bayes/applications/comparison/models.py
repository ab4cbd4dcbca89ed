"""Models and noises compared by cycles that are left out, and by their evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.cycles import cycle_log_likelihood, find_cycles
from mfd_bayes.calibration.diagnostics import Interval, intervals_of, measure_draws, psis, tempering
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import units
from mfd_bayes.calibration.proposal import Evidence, fit_mixture, join_evidence
from mfd_bayes.calibration.result import Task, TestResult
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.friction import models
from mfd_bayes.runs.manifest import ComparedEstimate, Comparison, ComparisonRow
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

# === models compared by leaving out one cycle at a time

LARGEST_K = 0.7  # Pareto k above which the importance weights of a cycle cannot be trusted
CLEAR = 2.0  # number of standard errors from which one model counts as better than another
FEW = 10  # number of tests, or of cycles of one test, below which a standard error is rough
ALL = "all"

EVIDENCE_DRAWS, MOST_ROUNDS = 4000, 16
"""Draws from each proposal of an evidence, and the largest number of proposals."""

LEAST_ESS, GOOD_K = 0.1, 0.6
"""Share of effective draws from which the next proposal is learned; Pareto k that is enough."""
_DRAWS = 400  # for the median of the force


# --- what is compared


@dataclass(frozen=True)
class ModelChoice:
    """A model and a noise to compare, None for the campaign's own, in a run folder `name`."""

    name: str
    model: str | None
    noise: str | None


def candidates(names: Sequence[str], noises: Sequence[str]) -> tuple[ModelChoice, ...]:
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
    noise_names = _chosen("--noises", noises, [*NOISES], fewest) if noises else (None,)
    return tuple(
        ModelChoice("_".join(filter(None, (folders[m] if m and len(kinds) > 1 else "", n))), m, n)
        for m in kinds
        for n in noise_names
    )


def _chosen(
    option: str, names: Sequence[str], allowed: Sequence[str], fewest: int
) -> tuple[str, ...]:
    """Names of an option, each once, in the order of those that are allowed."""
    if not set(names) <= set(allowed) or len(set(names)) < max(len(names), fewest):
        got = ", ".join(map(repr, names)) or "nothing"
        amount = "two or more" if fewest > 1 else option.lstrip("-")
        raise CampaignError(
            f"{option} must name {amount} of {', '.join(allowed)}, each once, got {got}"
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
    # unit, and median and 95 % interval, of what the choice of a model may decide
    estimates: Mapping[str, tuple[str, Interval]] = field(default_factory=dict)

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
    scores: Mapping[str, Mapping[str, Validation]], lost: Sequence[str]
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
    estimates = [
        ComparedEstimate(test, name, unit, model, lower, median, upper)
        for test in tests
        for name in dict.fromkeys(
            n for of_tests in scores.values() for n in of_tests[test].estimates
        )
        for model in (row.model for row in overall)
        if name in (of_model := scores[model][test].estimates)
        for unit, (median, lower, upper) in [of_model[name]]
    ]
    return Comparison((*rows, *overall), " ".join(sentences), tuple(estimates))


def _joined(validations: Sequence[Validation]) -> Validation:
    """Figures of a model over several tests."""
    return Validation(
        cycles=pd.concat([validation.cycles for validation in validations], ignore_index=True),
        squares=sum(validation.squares for validation in validations),
        spread=sum(validation.spread for validation in validations),
        short=tuple(name for validation in validations for name in validation.short),
        evidence=join_evidence([validation.evidence for validation in validations]),
    )


def validate(test: TestResult, effort: Effort) -> Validation:
    """Leave-one-cycle-out figures of a calibrated test, and its error in sample."""
    stored, posterior, facts = test.stored, test.posterior, test.stored.facts
    rng, values = np.random.default_rng(facts["seed"]), stored.values()
    chains = stored.draws.sizes["chain"]
    cycles = cross_validate(posterior, values, chains, facts["walkers"], rng)
    pick = np.linspace(0, values["offset"].size - 1, _DRAWS).astype(np.intp)
    sample = {name: column[pick] for name, column in values.items()}
    force = posterior.force(sample) + sample["offset"][:, None]
    observed = np.asarray(test.trace.force)[posterior.first :]
    missed = observed - np.median(force, axis=0)[posterior.first :]
    figures = (facts["convergence"].get(name) or (None, 0, 0) for name in posterior.names)
    converged = all(
        r_hat is not None and r_hat <= effort.r_hat and min(bulk or 0, tail or 0) >= effort.ess
        for r_hat, bulk, tail in figures
    )
    model, gap = posterior.model, posterior.model.gap(values)
    names = [name for name in (*model.slip_forces, "k3") if name in values]
    columns = {name: values[name] for name in names} | ({} if gap is None else {"gap": gap})
    unit_of = {"gap": "in"} | units(model)
    return Validation(
        cycles.assign(test=test.id),
        squares=float(missed @ missed),
        spread=float(observed.size * observed.var()),
        short=() if converged else (test.id,),
        evidence=test.log_evidence(),
        estimates={name: (unit_of[name], ends) for name, ends in intervals_of(columns).items()},
    )


def _rows(subject: str, scores: Mapping[str, Validation]) -> list[ComparisonRow]:
    """Row of every model, best first."""
    order = sorted(scores, key=lambda model: -scores[model].cycles["elpd"].sum())
    rows = []
    for model in order:
        score, cycles = scores[model], scores[model].cycles
        elpd_diff, error = difference(cycles, scores[order[0]].cycles)
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
                difference=elpd_diff,
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
    elpd_diff, error = difference(total[best].cycles, total[second].cycles)
    errors, count = elpd_diff / error if error > 0 else np.inf, len(total[best].cycles)
    extent = f"{tests} tests of {count} cycles in all" if tests > 1 else f"{count} cycles of 1 test"
    verb = f"favour {best} over" if errors >= CLEAR else f"cannot decide between {best} and"
    rough = (tests if tests > 1 else count) < FEW
    return (
        f"The records {verb} {second}: elpd higher by {elpd_diff:.4g}, {errors:.1f} standard "
        f"errors over {extent}{' (a rough estimate of the error, from so few)' if rough else ''}."
    )


def _evidence_sentence(evidence: Mapping[str, Evidence]) -> str:
    """Sentence on the two models of largest log evidence, and on what it depends on."""
    best, second = sorted(evidence, key=lambda model: -evidence[model].value)[:2]
    gain = evidence[best].value - evidence[second].value
    error = float(np.hypot(evidence[best].error, evidence[second].error))
    text = (
        f"Log evidence of {best} is higher than that of {second} by {gain:.4g} ± {error:.2g}. It "
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


def difference(cycles: pd.DataFrame, reference: pd.DataFrame) -> tuple[float, float]:
    """Elpd of a model minus that of another, and its standard error, paired over cycles."""
    elpd_diff = cycles["elpd"] - reference["elpd"]
    return float(elpd_diff.sum()), standard_error(elpd_diff, cycles["test"])


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
    independent = float(np.sqrt(figures.size * np.var(figures, ddof=1)))
    sums = pd.Series(figures - figures.mean()).groupby(np.asarray(test)).sum()
    return max(independent, float(np.sqrt(sums.size / max(sums.size - 1, 1) * np.sum(sums**2))))


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
    log_lik = cycle_log_likelihood(posterior, values, edges)[0]
    scores = []
    for column in log_lik.T:
        ess = measure_draws(column.reshape(chains, -1), walkers).ess_bulk[0]
        scores.append(psis_loo(column, float(np.clip(ess / column.size, 1e-3, 1.0))))
    elpd, lppd, psis_k = np.transpose(scores)
    k, failed = psis_k.copy(), np.flatnonzero(~(psis_k <= LARGEST_K)).tolist()
    if failed:
        draws = posterior.coordinates(values)
        full, full_k = log_evidence(posterior.log_prob, draws, np.zeros(len(draws)), rng)
    for cycle in failed:

        def without(q: Array, cycle: int = cycle) -> Array:
            """Log posterior density of q without the cycle, p(θ) p(y_-c | θ)."""
            log_density = posterior.log_prior(q)
            finite = np.isfinite(log_density)
            with np.errstate(over="ignore", invalid="ignore"):
                of_cycles, of_all = cycle_log_likelihood(
                    posterior, posterior.values(q[finite]), edges
                )
                log_density[finite] += of_all - of_cycles[:, cycle]
            return np.where(np.isnan(log_density), -np.inf, log_density)

        evidence, rest_k = log_evidence(without, draws, -log_lik[:, cycle], rng)
        if max(full_k, rest_k) < k[cycle]:
            elpd[cycle], k[cycle] = full - evidence, max(full_k, rest_k)
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
    density: Callable[[Array], Array], draws: Array, log_weights: Array, rng: np.random.Generator
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
