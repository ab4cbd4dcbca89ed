"""The population of a set of calibrated tests: laws are compared, then everything is sampled."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.likelihoods import several_processes
from mfd_bayes.population.law_scores import (
    DependenceScore,
    LawScore,
    compare_dependence,
    compare_laws,
    free_exponents,
)
from mfd_bayes.population.laws import COMPARE
from mfd_bayes.population.layout import lay_out
from mfd_bayes.population.sampling import JointDraws, JointProblem, most_sweeps, sample_joint
from mfd_bayes.population.setting import setting_of
from mfd_bayes.population.test_likelihood import likelihood_of


@dataclass(frozen=True)
class InferenceSettings:
    """How a population is inferred.

    Attributes
    ----------
    laws : mapping of str to str
        Law of each quantity that follows the actuation, or "compare".
    dependence : mapping of str to sequence of str
        Covariates that quantities follow.
    actuation_unit : str
    sessions : mapping of str to str
        Session of each test; none where it is missing.
    effort : str
    seed : sequence of int
    jobs : int
        Processes that compute the tests' likelihoods; the draws are the same.
    """

    laws: Mapping[str, str]
    actuation_unit: str
    effort: str
    seed: Sequence[int]
    dependence: Mapping[str, Sequence[str]] = field(default_factory=dict)
    sessions: Mapping[str, str] = field(default_factory=dict)
    jobs: int = 1


@dataclass(frozen=True, eq=False)
class Inference:
    """What is inferred from a set of tests.

    Attributes
    ----------
    draws : JointDraws
    scores : tuple of LawScore
        Every law's, for each quantity that follows the actuation.
    exponents : mapping of str to (float, float, float)
        Quantiles of each proportional law's exponent, were it free.
    dependence : tuple of DependenceScore
        On speed and stroke, for each quantity that follows the actuation.
    """

    draws: JointDraws
    scores: tuple[LawScore, ...]
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]


def infer_population(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: InferenceSettings,
    report: Callable[[Progress], None] = lambda _: None,
) -> Inference:
    """Population of calibrated tests.

    Parameters
    ----------
    tests : mapping of str to TestResult
    priors : PriorFile
    settings : InferenceSettings
    report : callable, optional
        Called now and then with the progress of the sampling.

    Raises
    ------
    MfdError
        When a law, a prior or an actuation does not allow it.
    """
    some = next(iter(tests.values())).posterior
    under = [setting_of(t.trace, settings.sessions.get(name, "")) for name, t in tests.items()]
    layout = lay_out(priors, some.names, under, settings.laws, settings.dependence)
    likelihoods = [likelihood_of(layout, t.posterior, t.stored.values()) for t in tests.values()]
    scores = compare_laws(layout, likelihoods)
    weights = dict(layout.weights)
    for name, law in layout.laws.items():
        if law == COMPARE and scores:
            found = {s.law: s.weight for s in scores if s.quantity == name}
            weights[name] = found if any(found.values()) else weights[name]
    problem = JointProblem(
        replace(layout, weights=weights), likelihoods, some.priors, settings.actuation_unit
    )
    effort, rng = find_effort(settings.effort), np.random.default_rng(list(settings.seed))
    with several_processes([t.log_likelihood for t in likelihoods], settings.jobs) as evaluate:
        draws = sample_joint(problem, effort, rng, _reporter(effort, report), evaluate)
    exponents = free_exponents(layout, likelihoods)
    return Inference(draws, scores, exponents, compare_dependence(layout, likelihoods))


def _reporter(
    effort: Effort, report: Callable[[Progress], None]
) -> Callable[[int, Convergence], None]:
    """Turns sweeps and convergence into progress."""
    began, limit = time.perf_counter(), most_sweeps(effort)

    def tell(sweeps: int, found: Convergence) -> None:
        seconds = time.perf_counter() - began
        worst = found.worst_r_hat, found.worst_ess
        share = found.share(effort.r_hat, effort.ess)
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    return tell
