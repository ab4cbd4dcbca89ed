"""The population of a set of calibrated tests: laws are compared, then everything is sampled."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.calibration.shown import intervals_of
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.likelihoods import beside, several_processes
from mfd_bayes.population.apart import joined, set_apart
from mfd_bayes.population.law_scores import (
    TESTS,
    DependenceScore,
    LawScore,
    compare_dependence,
    compare_laws,
    free_exponents,
    varies,
)
from mfd_bayes.population.laws import COMPARE
from mfd_bayes.population.lay_out import lay_out
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.pilot import fit_pilot
from mfd_bayes.population.sampling import JointDraws, JointProblem, most_sweeps, sample_joint
from mfd_bayes.population.sequel import left_by
from mfd_bayes.population.setting import Setting, setting_of
from mfd_bayes.population.sharing import share
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.population.unloaded import Unloaded, chance_of
from mfd_bayes.population.working import WorkingLikelihood, working_likelihood

Array = NDArray[np.float64]


USUAL = ("amplitude",)
"""Covariates that slip forces follow by default: no friction model here knows of the stroke, and
all of them know of the speed."""


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
        Quantiles of each proportional law's exponent, estimated as in a power law.
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
    # BLAS adds up in another order with several threads, which small matrices do not need
    with threadpool_limits(1, user_api="blas"):
        return _inferred(tests, priors, settings, report)


def _inferred(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: InferenceSettings,
    report: Callable[[Progress], None],
) -> Inference:
    some = next(iter(tests.values())).posterior
    under = [setting_of(t.trace, settings.sessions.get(name, "")) for name, t in tests.items()]
    noise = set(some.noise.parameters) - {"noise_sd"}
    names = [name for name in some.names if name not in noise]
    dependence = usual_dependence(some.model, under, names)
    dependence |= {name: tuple(those) for name, those in settings.dependence.items() if those}
    layout = lay_out(priors, names, under, settings.laws, dependence)
    working = [working_likelihood(layout, test.posterior, priors) for test in tests.values()]
    starts = [_start(one, test) for one, test in zip(working, tests.values(), strict=True)]
    with several_processes([one.residual for one in working], settings.jobs) as evaluate:
        pilot = fit_pilot(working, starts, evaluate)
    likelihoods = pilot.tests
    layout = share(layout, likelihoods)
    with beside(settings.jobs, partial(_compare, layout, likelihoods)) as compared:
        weighed = layout
        if COMPARE in layout.laws.values():
            weighed = replace(layout, weights=_weights(layout, compared().scores))
        apart = set_apart(weighed, likelihoods)
        given = _priors_of(some, priors), settings.actuation_unit, pilot.residual
        draws = _sampled(JointProblem(weighed, apart, *given), settings, report)
        each = [joined(weighed, j, x) for j, x in enumerate(draws.tests)]
        begun, left = _starts(working, each), _left(working, each)
        free = _unloaded(working, each)
        population = replace(draws.population, starts=begun, left=left, unloaded=free)
        draws = replace(draws, population=population)
        found = compared()
    return Inference(draws, found.scores, found.exponents, found.dependence)


def _priors_of(posterior: Posterior, priors: PriorFile) -> dict[str, Prior]:
    """Priors of what tests have; of the start too where its samples are masked."""
    found = dict(posterior.priors)
    if posterior.model.has_gap and "start" in priors.parameters:
        found.setdefault("start", priors.parameters["start"])
    return found


@dataclass(frozen=True)
class _Compared:
    """What is compared besides the sampling; see `Inference`."""

    scores: tuple[LawScore, ...]
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]


def _compare(layout: Layout, likelihoods: Sequence[TestLikelihood]) -> _Compared:
    """Scores of laws and dependences, and free exponents."""
    with threadpool_limits(1, user_api="blas"):
        scores = compare_laws(layout, likelihoods)
        exponents = free_exponents(layout, likelihoods)
        return _Compared(scores, exponents, compare_dependence(layout, likelihoods))


def _weights(layout: Layout, scores: Sequence[LawScore]) -> dict[str, Mapping[str, float]]:
    """Weights of laws; those of compared ones by their scores, where these can be trusted."""
    weights = dict(layout.weights)
    for name, law in layout.laws.items():
        if law == COMPARE and scores:
            found = {s.law: s.weight for s in scores if s.quantity == name}
            weights[name] = found if any(found.values()) else weights[name]
    return weights


def _sampled(
    problem: JointProblem, settings: InferenceSettings, report: Callable[[Progress], None]
) -> JointDraws:
    """Draws of the population and its tests."""
    effort, rng = find_effort(settings.effort), np.random.default_rng(list(settings.seed))
    shared = len(problem.layout.names)
    densities = [test.density(shared) for test in problem.tests]
    with several_processes(densities, settings.jobs) as evaluate:
        return sample_joint(problem, effort, rng, _reporter(effort, report), evaluate)


def _start(likelihood: WorkingLikelihood, test: TestResult) -> Array:
    """Medians of a test's posterior draws, in the prior units of its working likelihood."""
    medians = test.intervals or intervals_of(test.stored.values())
    values = {name: np.array([median]) for name, (median, _, _) in medians.items()}
    layout = likelihood.layout
    coordinates = [layout.coordinates.of(values)]
    priors = likelihood.posterior.priors
    coordinates += [priors[name].coordinate(values[name])[:, None] for name in likelihood.own]
    q = np.concatenate(coordinates, axis=1)[0]
    x = np.zeros(likelihood.middle.size)  # shapes of a swing begin at the mean of their priors
    x[: q.size] = (q - likelihood.middle[: q.size]) / likelihood.scale[: q.size]
    return x


def _starts(working: Sequence[WorkingLikelihood], tests: Sequence[Array]) -> Array | None:
    """Places in the gap at which the tests began, (chain, draw, J); None where none is inferred."""
    if any("start" not in one.own for one in working):
        return None
    found = []
    for one, x in zip(working, tests, strict=True):
        k = len(one.layout.names) + one.own.index("start")
        prior = one.posterior.priors["start"]
        found.append(prior.value(one.middle[k] + one.scale[k] * x[..., k]))
    return np.stack(found, axis=-1)


def _left(working: Sequence[WorkingLikelihood], tests: Sequence[Array]) -> Array | None:
    """Places at which the tests' own motions leave the device, (J,), by their medians."""
    if any("start" not in one.own for one in working):
        return None
    found = []
    for one, x in zip(working, tests, strict=True):
        middle = np.median(x.reshape(-1, x.shape[-1]), axis=0)
        posterior = one.posterior
        theta = posterior.model.theta(posterior.values(one.points(middle[None])))
        scales = one.scales(middle[None])
        found.append(left_by(posterior.model, theta, posterior.trace, scales))
    known = [place for place in found if place is not None]
    return np.array(known) if len(known) == len(found) else None


def _unloaded(working: Sequence[WorkingLikelihood], tests: Sequence[Array]) -> float:
    """Probability that tests begin without load, from where the calibrated ones began.

    It is 0 where the model does not tell load from none, where the start is masked, and where its
    prior is not even from 0 to 1: then that prior says where tests begin.
    """
    found = []
    for one, x in zip(working, tests, strict=True):
        values = one.posterior.values(one.points(x.reshape(-1, x.shape[-1])))
        part, prior = one.posterior.model.unloaded(values), one.posterior.priors.get("start")
        if part is None or prior is None or not _even(prior):
            return 0.0
        found.append((values["start"], Unloaded.checked(*part)))
    return chance_of(found)


def _even(prior: Prior) -> bool:
    """Whether a prior of the start is uniform from 0 to 1."""
    return (prior.family, prior.lower, prior.upper) == ("uniform", 0.0, 1.0)


def usual_dependence(
    model: Model, settings: Sequence[Setting], names: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Covariates that slip forces follow unless a campaign says otherwise.

    They are those of `USUAL` that vary between at least `TESTS` tests; the prior keeps the
    dependence small.
    """
    if len(settings) < TESTS:
        return {}
    varied = tuple(c for c in USUAL if varies(settings, c))
    return {name: varied for name in model.slip_forces if name in names and varied}


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
