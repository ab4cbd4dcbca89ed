"""The population of a set of calibrated tests: their laws, and their joint posterior.

The tests are fitted together (`joint_fit`), laws are weighed by how well they predict levels that
are left out, and the exact joint posterior of population and tests is sampled under them
(`exact_sampler`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special
from threadpoolctl import threadpool_limits

from mfd_bayes.calibration.diagnostics import Convergence, intervals_of
from mfd_bayes.calibration.effort import Effort, find_effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, PriorFile
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.local import several_processes
from mfd_bayes.population.design import (
    COMPARE,
    CONDITIONS,
    LAW_NAMES,
    LEVELS,
    TESTS,
    Design,
    TestConditions,
    design_of,
    levels_of,
    setting_of,
    usual_shapes,
    varies,
)
from mfd_bayes.population.exact_sampler import CHAINS, ExactSampler, PopulationDraws
from mfd_bayes.population.joint_fit import (
    STEADY,
    Array,
    Index,
    JointFit,
    TestLikelihood,
    fit_jointly,
)
from mfd_bayes.population.law_scores import DependenceScore, LawScore
from mfd_bayes.population.mixed_model import (
    STEP,
    MixedModel,
    StudentTProposal,
    TestGaussians,
    compare_dependence,
    compare_laws,
    extrapolation_weights,
    free_exponents,
)
from mfd_bayes.population.population import (
    InitialGapPrior,
    LawDraws,
    Population,
    place_left,
    without_load,
)
from mfd_bayes.records.trace import Trace

# draws under all laws together, for actuations beyond the tested levels, and steps of their chains
ALTERNATIVES, SETTLING = 400, 30
# largest number of sweeps of the exact sampler
SWEEPS = {"quick": 800, "standard": 4000, "thorough": 20000}
# chains of each group: a quarter of them gave too few draws to fit the tests' Gaussians to
WALKERS = 16
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)


@dataclass(frozen=True)
class InferenceSettings:
    """How a population is inferred."""

    laws: Mapping[str, str]  # of each quantity that follows the actuation, or "compare"
    actuation_unit: str
    effort: str | Effort
    seed: Sequence[int]
    dependence: Mapping[str, Sequence[str]] = field(default_factory=dict)  # covariates
    sessions: Mapping[str, str] = field(default_factory=dict)  # of each test; none if missing
    jobs: int = 1  # processes that compute the tests' likelihoods; the draws are the same
    devices: Mapping[str, str] = field(default_factory=dict)  # likewise
    # date, count of cycles and temperature of each test, where they are known
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def setting(self, name: str, trace: Trace) -> TestConditions:
        """Setting of a test."""
        session, device = self.sessions.get(name, ""), self.devices.get(name, "")
        return setting_of(trace, session, device, self.conditions.get(name, {}))


@dataclass(frozen=True, eq=False)
class Inference:
    """What is inferred from a set of tests."""

    population: Population
    tests: Array  # (chain, draw, J, D): coordinates of the tests
    log_likelihood: Array  # (chain, draw, J): of each test given the population
    scores: tuple[LawScore, ...]  # of every law, for each quantity that follows the actuation
    # quantiles of each proportional law's exponent, estimated as in a power law
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]
    sweeps: int
    accepted: tuple[float, float]  # shares of accepted moves of tests and of the population

    def values(self, j: int) -> dict[str, Array]:
        """Quantities of test j with the others, by name, (chain, draw)."""
        x = self.tests[:, :, j]
        values = self.population.design.coordinates.values(x.reshape(-1, x.shape[-1]))
        return {name: value.reshape(x.shape[:2]) for name, value in values.items()}


def infer_population(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: InferenceSettings,
    report: Callable[[Progress], None] = lambda _: None,
) -> Inference:
    """Population of calibrated tests; `report` gets the progress of the sampling."""
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
    coordinates, d = design.coordinates, len(design.names)

    # Gaussians of the tests near the joint mode; what a test has to itself is integrated out
    medians = [test.intervals or intervals_of(test.stored.values()) for test in tests.values()]
    start = [
        coordinates.of({k: np.array([v[0]]) for k, v in medians_of_test.items()})
        for medians_of_test in medians
    ]
    unpooled = np.ones((len(likelihoods), len(coordinates.names)), dtype=bool)
    unpooled[:, :d] = ~design.informs
    common = np.zeros(len(coordinates.names), dtype=bool)
    common[:d] = design.common
    with several_processes(
        [likelihood.linearised for likelihood in likelihoods], settings.jobs
    ) as evaluate:
        begin = np.clip(np.concatenate(start), -6.0, 6.0)
        fit = fit_jointly(likelihoods, begin, common, evaluate)
    mixed = MixedModel(design, *gaussians_of(fit, unpooled, d))

    # weights of the laws, by levels that are left out
    levels = np.median(fit.mean, axis=0)[:d]
    gaussians = TestGaussians.given_common(design, mixed.y, mixed.p, levels)
    scores = compare_laws(gaussians)
    weights = {name: _weights(design, name, scores) for name in design.laws}

    # chains of the exact posterior, each under laws drawn by their weights
    choice = _choices(design, weights, CHAINS * WALKERS)
    mixed.find_outliers(choice[0])
    kinds, kind = np.unique(choice, axis=0, return_inverse=True)

    def approximate(fit: JointFit) -> tuple[MixedModel, StudentTProposal]:
        mixed_model = MixedModel(design, *gaussians_of(fit, unpooled, d), mixed.weight)
        mixed_model.adapted = mixed.adapted  # the next fit is near the last one
        proposals = [mixed_model.importance_sample(laws, rng)[0] for laws in kinds]
        means, roots = (np.stack(values)[kind.ravel()] for values in zip(*proposals, strict=True))
        return mixed_model, StudentTProposal(means, roots)

    began, limit = time.perf_counter(), SWEEPS.get(effort.name, SWEEPS["standard"])

    def tell(sweeps: int, convergence: Convergence) -> None:
        seconds = time.perf_counter() - began
        share = convergence.share(effort.r_hat, effort.ess)
        worst = convergence.worst_r_hat, convergence.worst_ess
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    with several_processes(
        [likelihood.log_likelihood for likelihood in fit.tests], settings.jobs
    ) as evaluate:
        sampler = ExactSampler(fit, approximate, unpooled, choice, rng, evaluate)
        draws = sampler.run(effort.r_hat, effort.ess, limit, effort.kept // 4, tell)

    # the population: δ is drawn from its Gaussian, and levels and tests follow it (delta method)
    knots = rng.standard_normal((*draws.h.shape[:2], len(fit.knot_root))) @ fit.knot_root.T
    moved = np.einsum("jik,cnk->cnji", fit.response, knots)
    knots += fit.residual.mean
    levels = np.zeros_like(draws.z)
    levels[..., :d] = moved[..., :d].mean(axis=2)
    shape, v = draws.h.shape[:2], mixed.f + mixed.e
    laws = np.repeat(choice.reshape(CHAINS, WALKERS, -1), shape[1] // WALKERS, axis=1)
    shapes = mixed.shapes(
        draws.h.reshape(-1, mixed.dim), laws.reshape(draws.h[..., 0].size, len(design.laws))
    )
    share, exponent = (values.reshape(laws.shape) for values in shapes)
    posterior = likelihoods[0].posterior
    slips = [n for n in design.laws if n not in {"sigma0"} & posterior.model.standard_names]
    alternatives, alternative_weight = _alternatives(
        *(sampler.mixed, ~unpooled[:, mixed.free], slips, weights, gaussians),
        *(draws, levels, knots, rng),
    )
    draws = draws._replace(x=draws.x + moved, z=draws.z + levels)
    prior_of = dict(posterior.priors)
    if posterior.model.has_gap and "start" in priors.parameters:
        prior_of.setdefault("start", priors.parameters["start"])
    population = Population(
        design=design,
        draws=LawDraws(draws.h[..., :v], draws.z, share, exponent, knots),
        choice=laws,
        law_weights=weights,
        alternatives=alternatives,
        alternative_weight=alternative_weight,
        residual=fit.residual,
        starts=_starts(prior_of.get("start"), likelihoods, draws.x),
        priors=prior_of,
        actuation_unit=settings.actuation_unit,
        walkers=WALKERS,
        convergence=draws.convergence,
    )
    exponents, dependence = free_exponents(gaussians), compare_dependence(gaussians)
    return Inference(
        *(population, draws.x, draws.log_likelihood, scores, exponents, dependence),
        *(draws.sweeps, draws.accepted),
    )


def _likelihoods(
    tests: Mapping[str, TestResult], priors: PriorFile, settings: InferenceSettings
) -> tuple[Design, list[TestLikelihood]]:
    """Design of the population, and likelihoods of the tests without discrepancy."""
    first_posterior = next(iter(tests.values())).posterior
    model = first_posterior.model
    settings_of_tests = [settings.setting(name, test.trace) for name, test in tests.items()]
    noise = set(first_posterior.noise.parameters) - {"noise_sd"}
    names = [name for name in first_posterior.names if name not in noise]
    slips = [name for name in model.slip_forces if name in names]
    # slip forces follow the stroke, if it varies: no friction model here knows of it
    stroke = len(settings_of_tests) >= TESTS and varies(settings_of_tests, "amplitude")
    dependence: dict[str, Sequence[str]] = dict.fromkeys(slips, ("amplitude",)) if stroke else {}
    for name, covariates in settings.dependence.items():
        default = () if {*covariates} - {*CONDITIONS} else dependence.get(name, ())
        dependence[name] = (*default, *covariates)
    design = design_of(priors, names, settings_of_tests, settings.laws, dependence, model)
    changing = [actuation_varies(design, model, test.trace) for test in tests.values()]
    if any(changing):
        # a test need not follow the law that others tell: it has shapes to itself
        shapes = [f"{s}_{n}" for n in slips for s in ("share", "exponent")]
        coordinate_names = [*names, *shapes]
        design = design_of(
            priors, coordinate_names, settings_of_tests, settings.laws, dependence, model
        )
    followed = {n: n for n in design.laws if n in model.parameters}
    followed |= {n: o for n, o in model.shared_laws.items() if o in followed}
    laws = {n: (o, *usual_shapes(design.laws[o])) for n, o in followed.items()}
    likelihoods = []
    for test, changes in zip(tests.values(), changing, strict=True):
        initial, trace = "discard" if test.posterior.first else "sample", test.trace
        posterior = Posterior(trace, priors, "iid", model, initial=initial)
        relative = np.asarray(trace.actuation) / trace.reference_actuation if changes else None
        likelihoods.append(TestLikelihood(posterior, design.coordinates, relative, laws))
    return design, likelihoods


def actuation_varies(design: Design, model: Model, trace: Trace) -> bool:
    """Whether a test's actuation changes, and its law is not strictly proportional."""
    mean = trace.reference_actuation
    if not trace.varying or not mean > 0 or np.std(trace.actuation) < STEADY * mean:
        return False
    laws = [design.laws.get(name, "proportional") for name in model.slip_forces]
    return any(law != "proportional" for law in laws)


def gaussians_of(fit: JointFit, unpooled: NDArray[np.bool_], d: int) -> tuple[Array, Array]:
    """Gaussian likelihoods of the d shared coordinates, (J, d) and (J, d, d).

    What is unpooled is integrated over N(0, 1), and has no precision.
    """
    y, precision = np.zeros((len(unpooled), d)), np.zeros((len(unpooled), d, d))
    for j, (mean, p, is_unpooled) in enumerate(zip(fit.mean, fit.precision, unpooled, strict=True)):
        pooled, local = np.flatnonzero(~is_unpooled), np.flatnonzero(is_unpooled)
        across, pull = p[np.ix_(local, pooled)], p @ mean
        gain = np.linalg.solve(p[np.ix_(local, local)] + np.eye(local.size), across).T
        reduced = p[np.ix_(pooled, pooled)] - gain @ across
        y[j, pooled] = np.linalg.solve(reduced, pull[pooled] - gain @ pull[local])
        precision[j][np.ix_(pooled, pooled)] = 0.5 * (reduced + reduced.T)
    return y, precision


def _weights(design: Design, name: str, scores: Sequence[LawScore]) -> dict[str, float]:
    """Weights of the laws of a quantity; compared ones have those of their scores."""
    laws = design.considered(design.laws[name])
    if len(laws) == 1:
        return {laws[0]: 1.0}
    weight_of = {s.law: float(s.weight) for s in scores if s.quantity == name}
    return weight_of if any(weight_of.values()) else dict.fromkeys(laws, 1.0 / len(laws))


def _choices(design: Design, weights: Mapping[str, Mapping[str, float]], n: int) -> Index:
    """Numbers of the laws of n chains in proportion to the weights, (n, L); no random numbers."""
    choice = np.zeros((n, len(design.laws)), dtype=np.intp)
    for column, name in enumerate(design.laws):
        edges = np.cumsum([weights[name].get(law, 0.0) for law in LAW_NAMES])
        # a low-discrepancy sequence for each quantity, so that their laws are independent
        points = (0.5 + np.arange(n) * np.sqrt(_PRIMES[column % len(_PRIMES)])) % 1.0
        choice[:, column] = np.searchsorted(edges / edges[-1], points, side="right")
    return choice


def _alternatives(
    mixed: MixedModel,
    pooled: NDArray[np.bool_],
    slips: Sequence[str],
    weights: Mapping[str, Mapping[str, float]],
    gaussians: TestGaussians,
    draws: PopulationDraws,
    moved: Array,
    knots: Array,
    rng: np.random.Generator,
) -> tuple[LawDraws, Array]:
    """Draws under all laws, for actuations beyond the tested levels, and their weights.

    The tests are those of `draws`, whose levels a discrepancy with these `knots` has `moved`. h and
    z are drawn with Gaussian likelihoods, and then moved to what the tests say.
    """
    design, d = mixed.design, len(mixed.design.names)
    several_levels = len(levels_of([s for s in design.settings if s.actuation > 0])) >= LEVELS
    considered = design.considered(COMPARE) if several_levels else ("affine", "power")
    named = [design.laws[n] for n in slips if design.laws[n] != COMPARE]
    laws = {
        law: replace(design, laws={**design.laws, **dict.fromkeys(slips, law)})
        for law in dict.fromkeys([*named, *considered])
    }
    # a test without actuation informs some laws alone, so that these have other effects of levels
    sizes = {law: design_of_law.quantity.size for law, design_of_law in laws.items()}
    size = design.quantity.size if design.quantity.size in sizes.values() else max(sizes.values())
    usable = [law for law in laws if sizes[law] == size]
    common = np.flatnonzero(design.common)
    rows = [a.reshape(-1, *a.shape[2:]) for a in (draws.x, draws.z, moved, knots)]
    of_laws, weight = [], []
    for law, w in zip(usable, extrapolation_weights(gaussians, slips, usable), strict=True):
        if w == 0.0:
            continue
        design_of_law = laws[law]
        mixed_model = MixedModel(design_of_law, mixed.y, mixed.p, mixed.weight)
        choice = _choices(design_of_law, {**weights, **{n: {law: 1.0} for n in slips}}, 1)[0]
        n = max(int(np.ceil(ALTERNATIVES * w)), 20)
        _, g, log = mixed_model.importance_sample(choice, rng, 2 * ALTERNATIVES)
        h = mixed_model.from_standard_normal(rng.choice(g, n, p=special.softmax(log)))
        blocks = np.array_split(h, max(n // 32, 1))  # to bound the memory
        z = np.concatenate([mixed_model.marginal(block, choice)[1].draw(rng) for block in blocks])
        index = rng.choice(len(rows[0]), n)
        x, z_of_draw, moved_of_draw, knots_of_draw = (a[index] for a in rows)
        z[:, common] = z_of_draw[:, common]
        step = np.full(mixed_model.dim, STEP)
        for _ in range(SETTLING):
            h, z, step = mixed_model.move_given_tests(h, z, x[..., :d], pooled, choice, step, rng)
        z[:, :d] += moved_of_draw[:, :d]
        shapes = mixed_model.shapes(h, choice)
        of_laws.append((h[:, : mixed_model.f + mixed_model.e], z, *shapes, knots_of_draw))
        weight.append(np.full(n, w / n))
    return LawDraws(*map(np.concatenate, zip(*of_laws, strict=True))), np.concatenate(weight)


def _starts(
    prior: Prior | None, likelihoods: Sequence[TestLikelihood], x: Array
) -> InitialGapPrior:
    """Density of starts, learned from where the tests began, of draws (chain, draw, J, D)."""
    starts, unloaded = [], []
    if prior is None or prior.fixed or "start" not in likelihoods[0].coordinates.names:
        return InitialGapPrior.of(prior)
    uniform = (prior.family, prior.lower, prior.upper) == ("uniform", 0.0, 1.0)
    for j, likelihood in enumerate(likelihoods):
        model, draws = likelihood.posterior.model, x[:, :, j].reshape(-1, x.shape[-1])
        values = likelihood.values(draws)
        scales = likelihood.scales(np.median(draws, axis=0)[None])
        starts.append(place_left(model, values, likelihood.posterior.trace, scales or None))
        unloaded.append(without_load(model, values) if uniform else None)
    ends = [end for end in starts if end is not None]
    places = np.array(ends) if len(ends) == len(starts) else None
    beginnings = likelihoods[0].coordinates.value("start", x)
    return InitialGapPrior.learned(beginnings.reshape(-1, len(likelihoods)), places, unloaded)
