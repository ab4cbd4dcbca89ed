"""The population of a set of calibrated tests: laws compared, then everything inferred at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import find_effort
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
from mfd_bayes.population.predict import setting_of
from mfd_bayes.population.sampling import JointDraws, JointProblem, most_sweeps, sample_joint
from mfd_bayes.population.test_likelihood import likelihood_of


@dataclass(frozen=True, eq=False)
class Inference:
    """What a set of tests says together.

    Attributes
    ----------
    draws : JointDraws
    scores : tuple of LawScore
        Every law's, for each quantity that follows the actuation.
    exponents : mapping of str to (float, float, float)
        Quantiles of each proportional law's exponent, were it free.
    dependence : tuple of DependenceScore
        Of speed and stroke, for each quantity that follows the actuation.
    """

    draws: JointDraws
    scores: tuple[LawScore, ...]
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]


def infer_population(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: Mapping[str, Any],
    effort: str,
    seed: Sequence[int],
    report: Callable[[Progress], None] = lambda _: None,
    *,
    jobs: int = 1,
) -> Inference:
    """Population of calibrated tests.

    Parameters
    ----------
    tests : mapping of str to TestResult
    priors : PriorFile
    settings : mapping
        Those of the run's manifest: laws, dependence, actuation_unit, and each test's session.
    effort : str
    seed : sequence of int
    report : callable, optional
        Told now and then where the sampling stands.
    jobs : int
        Processes that compute the tests' likelihoods; the draws are the same.

    Raises
    ------
    MfdError
        When a law, a prior or an actuation does not allow it.
    """
    some = next(iter(tests.values())).posterior
    under = [
        setting_of(test.trace, settings["tests"][name].get("session", ""))
        for name, test in tests.items()
    ]
    layout = lay_out(priors, some.names, under, settings["laws"], settings.get("dependence"))
    likelihoods = [likelihood_of(layout, t.posterior, t.stored.values()) for t in tests.values()]
    scores = compare_laws(layout, likelihoods)
    weights = dict(layout.weights)
    for name, law in layout.laws.items():
        if law == COMPARE and scores:
            weights[name] = {s.law: s.weight for s in scores if s.quantity == name}
    chosen = find_effort(effort)
    began, limit = time.perf_counter(), most_sweeps(chosen)

    def tell(sweeps: int, found: Convergence) -> None:
        seconds = time.perf_counter() - began
        worst = found.worst_r_hat, found.worst_ess
        share = found.share(chosen.r_hat, chosen.ess)
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    with several_processes([test.log_likelihood for test in likelihoods], jobs) as evaluate:
        problem = JointProblem(
            replace(layout, weights=weights), likelihoods, some.priors, settings["actuation_unit"]
        )
        draws = sample_joint(problem, chosen, np.random.default_rng(list(seed)), tell, evaluate)
    exponents = free_exponents(layout, likelihoods)
    return Inference(draws, scores, exponents, compare_dependence(layout, likelihoods))
