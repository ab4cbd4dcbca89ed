"""The population of a set of calibrated tests, step by step."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import intervals_of
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.likelihoods import several_processes
from mfd_bayes.population.design import LEVELS, Design, design_of, usual_dependence
from mfd_bayes.population.exact import CHAINS, Draws, ExactSampler
from mfd_bayes.population.joint_fit import JointFit, TestLikelihood, fit_jointly
from mfd_bayes.population.law_scores import (
    DependenceScore,
    LawScore,
    TestGaussians,
    compare_dependence,
    compare_laws,
    extrapolation_weights,
    free_exponents,
)
from mfd_bayes.population.laws import COMPARE, LAW_NAMES, usual_shapes
from mfd_bayes.population.mixed_model import MixedModel, without
from mfd_bayes.population.population import LawDraws, Population
from mfd_bayes.population.settings import levels_of, setting_of
from mfd_bayes.population.starts import Starts, place_left, without_load
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STEADY = 0.02
"""Sd of an actuation, over its mean, below which slip forces are taken in proportion to it."""

ALTERNATIVES = 400
"""Draws under all laws together, for actuations beyond the tested levels."""

POOL = 4000
"""Draws of the variance parameters."""

SWEEPS = {"quick": 400, "standard": 2000, "thorough": 10000}
"""Largest number of sweeps of the exact sampler."""

MANY = 60
"""With more tests than this there are fewer chains: laws and variances are then known well."""

WALKERS, FEW_WALKERS = 8, 2
"""Chains of each group, and with many tests."""

_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)


@dataclass(frozen=True)
class InferenceSettings:
    """How a population is inferred.

    Attributes
    ----------
    laws : mapping of str to str
        Law of each quantity that follows the actuation, or "compare".
    actuation_unit : str
    effort : str
    seed : sequence of int
    dependence : mapping of str to sequence of str
        Covariates that quantities follow.
    sessions : mapping of str to str
        Session of each test; none where it is missing.
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
    population : Population
    tests : (chain, draw, J, D)
        Coordinates of the tests in prior units.
    scores : tuple of LawScore
        Every law's, for each quantity that follows the actuation.
    exponents : mapping of str to (float, float, float)
        Quantiles of each proportional law's exponent, estimated as in a power law.
    dependence : tuple of DependenceScore
    sweeps : int
    accepted : (float, float)
        Shares of accepted moves of tests and of the population.
    """

    population: Population
    tests: Array
    scores: tuple[LawScore, ...]
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]
    sweeps: int
    accepted: tuple[float, float]

    def values(self, j: int) -> dict[str, Array]:
        """Quantities of test j with the others, by name, (chain, draw)."""
        x = self.tests[:, :, j]
        found = self.population.design.coordinates.values(x.reshape(-1, x.shape[-1]))
        return {name: value.reshape(x.shape[:2]) for name, value in found.items()}


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
    rng, effort = np.random.default_rng(list(settings.seed)), find_effort(settings.effort)
    design, likelihoods = _likelihoods(tests, priors, settings)
    start = np.concatenate([_start(design, test) for test in tests.values()])
    own = _own(design)
    fit = _fit(likelihoods, start, design, settings.jobs)
    y, precision = _reduced(fit, own, len(design.names))
    mixed = MixedModel(design, y, precision)
    levels = np.median(fit.mean, axis=0)[: len(design.names)]
    gaussians = TestGaussians.given_common(design, y, precision, levels)
    scores = compare_laws(gaussians)
    weights = {name: _weights(design, name, scores) for name in design.laws}
    walkers = WALKERS if len(y) <= MANY else FEW_WALKERS
    choice = _choices(design, weights, CHAINS * walkers)
    mixed.set_apart(choice[0])
    pool = _pools(mixed, choice, rng)
    draws = _sampled(ExactSampler(mixed, fit, own, choice, pool, rng), settings, effort, report)
    shapes = draws.h.shape[:2]
    chosen = np.repeat(choice.reshape(CHAINS, walkers, -1), shapes[1] // walkers, axis=1)
    population = _population(
        mixed, fit, draws, chosen, weights, gaussians, rng, priors, settings.actuation_unit
    )
    population = replace(population, starts=_starts(likelihoods, draws, population))
    return Inference(
        population, draws.x, scores, free_exponents(gaussians), compare_dependence(gaussians),
        draws.sweeps, draws.accepted,
    )  # fmt: skip


def _likelihoods(
    tests: Mapping[str, TestResult], priors: PriorFile, settings: InferenceSettings
) -> tuple[Design, list[TestLikelihood]]:
    """Design of the population, and likelihoods of the tests without discrepancy."""
    some = next(iter(tests.values())).posterior
    under = [setting_of(t.trace, settings.sessions.get(name, "")) for name, t in tests.items()]
    noise = set(some.noise.parameters) - {"noise_sd"}
    names = [name for name in some.names if name not in noise]
    slips = [name for name in some.model.slip_forces if name in names]
    dependence: dict[str, Sequence[str]] = dict(usual_dependence(slips, under))
    dependence |= {name: tuple(those) for name, those in settings.dependence.items() if those}
    design = design_of(priors, names, under, settings.laws, dependence)
    changing = [swings(design, some.model, test.trace) for test in tests.values()]
    if any(changing):
        # a test need not follow the law that others tell: it has shapes to itself
        shapes = [f"{s}_{n}" for n in slips for s in ("share", "exponent")]
        design = design_of(priors, [*names, *shapes], under, settings.laws, dependence)
    found = []
    for test, changes in zip(tests.values(), changing, strict=True):
        start, trace = "mask" if test.posterior.first else "sample", test.trace
        posterior = Posterior(trace, priors, "iid", some.model, start=start)
        relative, laws = None, {}
        if changes:
            relative = np.asarray(trace.actuation) / trace.reference_actuation
            followed = {n: n for n in design.laws if n in some.model.parameters}
            followed |= {n: o for n, o in some.model.tied_laws.items() if o in followed}
            laws = {n: (o, *usual_shapes(design.laws[o])) for n, o in followed.items()}
        found.append(TestLikelihood(posterior, design.coordinates, relative, laws))
    return design, found


def swings(design: Design, model: Model, trace: Trace) -> bool:
    """Whether a test's actuation changes, and its law is not strictly proportional."""
    mean = trace.reference_actuation
    if not trace.varying or not mean > 0 or np.std(trace.actuation) < STEADY * mean:
        return False
    laws = [design.laws.get(name, "proportional") for name in model.slip_forces]
    return any(law != "proportional" for law in laws)


def _start(design: Design, test: TestResult) -> Array:
    """Medians of a test's posterior draws in prior units, (1, D)."""
    medians = test.intervals or intervals_of(test.stored.values())
    values = {name: np.array([median]) for name, (median, _, _) in medians.items()}
    return np.clip(design.coordinates.of(values), -6.0, 6.0)


def _own(design: Design) -> NDArray[np.bool_]:
    """Coordinates of the tests that do not follow the population, (J, D)."""
    own = np.zeros((len(design.settings), len(design.coordinates.names)), dtype=bool)
    own[:, len(design.names) :] = True
    own[:, : len(design.names)] = ~design.informs
    return own


def _fit(
    likelihoods: Sequence[TestLikelihood], start: Array, design: Design, jobs: int
) -> JointFit:
    """Joint fit, with slopes of the tests computed by several processes."""
    common = np.zeros(start.shape[1], dtype=bool)
    common[: len(design.names)] = design.common
    with several_processes([one.linearised for one in likelihoods], jobs) as evaluate:
        return fit_jointly(likelihoods, start, common, evaluate)


def _reduced(fit: JointFit, own: NDArray[np.bool_], d: int) -> tuple[Array, Array]:
    """Gaussians of the shared coordinates, (J, d), (J, d, d), the tests' own integrated out."""
    pairs = [without(*each) for each in zip(fit.mean, fit.precision, own, strict=True)]
    y, precision = (np.array(part) for part in zip(*pairs, strict=True))
    return y[:, :d], precision[:, :d, :d]


def _weights(design: Design, name: str, scores: Sequence[LawScore]) -> dict[str, float]:
    """Weights of the laws of a quantity; compared ones have those of their scores."""
    laws = design.considered(design.laws[name])
    if len(laws) == 1:
        return {laws[0]: 1.0}
    found = {s.law: float(s.weight) for s in scores if s.quantity == name}
    return found if any(found.values()) else dict.fromkeys(laws, 1.0 / len(laws))


def _choices(design: Design, weights: Mapping[str, Mapping[str, float]], n: int) -> Index:
    """Numbers of the laws of n chains in proportion to the weights, (n, L); no random numbers."""
    choice = np.zeros((n, len(design.laws)), dtype=np.intp)
    for column, (name, law) in enumerate(design.laws.items()):
        share = weights.get(name) or {"power" if law == COMPARE else law: 1.0}
        edges = np.cumsum([share.get(one, 0.0) for one in LAW_NAMES])
        # a low-discrepancy sequence for each quantity, so that their laws are independent
        place = (0.5 + np.arange(n) * np.sqrt(_PRIMES[column % len(_PRIMES)])) % 1.0
        choice[:, column] = np.searchsorted(edges / edges[-1], place, side="right")
    return choice


def _pools(mixed: MixedModel, choice: Index, rng: np.random.Generator) -> list[Array]:
    """Draws of h for each chain, of the laws that it has."""
    kinds, kind = np.unique(choice, axis=0, return_inverse=True)
    found = [mixed.sample(one, rng, POOL) for one in kinds]
    return [found[k] for k in kind.ravel()]


def _sampled(
    sampler: ExactSampler,
    settings: InferenceSettings,
    effort: Effort,
    report: Callable[[Progress], None],
) -> Draws:
    """Draws of the exact posterior."""
    began, limit = time.perf_counter(), SWEEPS.get(effort.name, 2000)

    def tell(sweeps: int, found: Convergence) -> None:
        seconds = time.perf_counter() - began
        share = found.share(effort.r_hat, effort.ess)
        worst = found.worst_r_hat, found.worst_ess
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    kept = effort.kept // 4
    functions = [test.log_likelihood for test in sampler.fit.tests]
    with several_processes(functions, settings.jobs) as evaluate:
        if evaluate is not None:
            sampler.evaluate = evaluate
        return sampler.run(effort.r_hat, effort.ess, limit, kept, tell)


def _population(
    mixed: MixedModel,
    fit: JointFit,
    draws: Draws,
    choice: Index,
    weights: Mapping[str, Mapping[str, float]],
    gaussians: TestGaussians,
    rng: np.random.Generator,
    priors: PriorFile,
    actuation_unit: str,
) -> Population:
    design, v = mixed.design, mixed.f + mixed.e
    flat = draws.h.reshape(-1, mixed.dim)
    share, exponent = design.law_shapes(flat[:, v:], choice.reshape(len(flat), -1))
    shape = (*draws.h.shape[:2], len(design.laws))
    posterior = fit.tests[0].posterior
    known = dict(posterior.priors)
    if posterior.model.has_gap and "start" in priors.parameters:
        known.setdefault("start", priors.parameters["start"])
    other, other_weight = _alternatives(mixed, weights, gaussians, rng)
    begun = None
    if "start" in design.coordinates.names:
        k = design.coordinates.names.index("start")
        q = design.coordinates.centre[k] + design.coordinates.spread[k] * draws.x[..., k]
        begun = known["start"].value(q.reshape(-1)).reshape(q.shape)
    return Population(
        design=design,
        draws=LawDraws(draws.h[..., :v], draws.z, share.reshape(shape), exponent.reshape(shape)),
        choice=choice,
        weights=weights,
        alternatives=other,
        alternative_weight=other_weight,
        residual=fit.residual,
        starts=Starts.of(known.get("start")),
        begun=begun,
        priors=known,
        actuation_unit=actuation_unit,
        walkers=draws.walkers,
        convergence=draws.convergence,
    )


def _alternatives(
    mixed: MixedModel,
    weights: Mapping[str, Mapping[str, float]],
    gaussians: TestGaussians,
    rng: np.random.Generator,
) -> tuple[LawDraws, Array]:
    """Draws under all laws, for actuations beyond the tested levels, and their weights."""
    design = mixed.design
    slips = [n for n in gaussians.design.laws if n != "sigma0"]
    many = len(levels_of([s for s in design.settings if s.actuation > 0])) >= LEVELS
    considered = design.considered(COMPARE) if many else ("affine", "power")
    named = {name: law for name, law in design.laws.items() if law != COMPARE}
    laws = list(dict.fromkeys([*(named[n] for n in slips if n in named), *considered]))
    share = extrapolation_weights(gaussians, slips, laws)
    found, weight = [], []
    for law, w in zip(laws, share, strict=True):
        if w == 0.0:
            continue
        other = MixedModel(design.under(dict.fromkeys(slips, law)), mixed.y, mixed.p)
        other.weight = mixed.weight
        choice = _choices(other.design, {**weights, **{n: {law: 1.0} for n in slips}}, 1)
        n, v = max(int(np.ceil(ALTERNATIVES * w)), 20), other.f + other.e
        h = other.laplace(choice[0], rng, n)
        rows = np.broadcast_to(choice, (n, choice.shape[1]))
        parts = [other.marginal(a, b)[1].draw(rng) for a, b in _some(h, rows)]
        shapes = other.design.law_shapes(h[:, v:], rows)
        found.append((h[:, :v], np.concatenate(parts), *shapes))
        weight.append(np.full(n, w / n))
    h, z, shares, exponents = (np.concatenate(part) for part in zip(*found, strict=True))
    return LawDraws(h, z, shares, exponents), np.concatenate(weight)


def _some(h: Array, rows: Index) -> list[tuple[Array, Index]]:
    """A few rows at a time, to bound the memory."""
    parts = np.array_split(np.arange(len(h)), max(len(h) // 32, 1))
    return [(h[part], rows[part]) for part in parts]


def _starts(likelihoods: Sequence[TestLikelihood], draws: Draws, population: Population) -> Starts:
    """Density of starts, learned from where the tests began."""
    begun, prior = population.begun, population.priors.get("start")
    if begun is None or prior is None or population.starts.fixed is not None:
        return population.starts
    left, free = [], []
    even = (prior.family, prior.lower, prior.upper) == ("uniform", 0.0, 1.0)
    for j, one in enumerate(likelihoods):
        model, x = one.posterior.model, draws.x[:, :, j].reshape(-1, draws.x.shape[-1])
        values = one.values(x)
        middle = {name: np.array([np.median(v)]) for name, v in values.items()}
        scales = one.scales(np.median(x, axis=0)[None])
        left.append(place_left(model, model.theta(middle), one.posterior.trace, scales or None))
        free.append(without_load(model, values) if even else None)
    known = [place for place in left if place is not None]
    places = np.array(known) if len(known) == len(left) else None
    return population.starts.learned(begun.reshape(-1, begun.shape[-1]), places, free)
