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
from mfd_bayes.population.layout import pool
from mfd_bayes.population.predict import setting_of
from mfd_bayes.population.sampling import Inference, infer, most_sweeps
from mfd_bayes.population.test_likelihood import evidence_of


@dataclass(frozen=True, eq=False)
class Pooled:
    """What a set of tests says together.

    Attributes
    ----------
    inference : Inference
    scores : tuple of LawScore
        Every law's, for each quantity that follows the actuation.
    exponents : mapping of str to (float, float, float)
        Quantiles of each proportional law's exponent, were it free.
    dependence : tuple of DependenceScore
        Of speed and stroke, for each quantity that follows the actuation.
    """

    inference: Inference
    scores: tuple[LawScore, ...]
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]


def pool_tests(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: Mapping[str, Any],
    effort: str,
    seed: Sequence[int],
    report: Callable[[Progress], None] = lambda _: None,
    *,
    jobs: int = 1,
) -> Pooled:
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
    pooling = pool(priors, some.names, under, settings["laws"], settings.get("dependence"))
    evidence = [evidence_of(pooling, t.posterior, t.stored.values()) for t in tests.values()]
    scores = compare_laws(pooling, evidence)
    weights = dict(pooling.weights)
    for name, law in pooling.laws.items():
        if law == COMPARE and scores:
            weights[name] = {s.law: s.weight for s in scores if s.quantity == name}
    chosen = find_effort(effort)
    began, limit = time.perf_counter(), most_sweeps(chosen)

    def tell(sweeps: int, found: Convergence) -> None:
        seconds = time.perf_counter() - began
        worst = found.worst_r_hat, found.worst_ess
        share = found.share(chosen.r_hat, chosen.ess)
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    with several_processes([test.log_likelihood for test in evidence], jobs) as evaluate:
        inference = infer(
            replace(pooling, weights=weights),
            evidence,
            some.priors,
            settings["actuation_unit"],
            chosen,
            np.random.default_rng(list(seed)),
            tell,
            evaluate,
        )
    exponents = free_exponents(pooling, evidence)
    return Pooled(inference, scores, exponents, compare_dependence(pooling, evidence))
