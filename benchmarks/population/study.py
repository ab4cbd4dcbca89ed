"""Synthetic campaigns drawn from the prior of a population, their inference, and ranks of truths.

The truths follow section 6 of model.md and the docstring of `Layout`. Of its code only the
numbers of the prior are used (centre, spread, scales, reference), not its laws, effects or layout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mfd_bayes.population.pilot import Pilot, fit_pilot
from mfd_bayes.population.sampling import JointDraws, JointProblem, sample_joint
from mfd_bayes.population.sharing import share
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.population.working import WorkingLikelihood, working_likelihood
from numpy.typing import NDArray

from benchmarks.sbc.study import narrow_priors
from mfd_bayes.calibration.effort import EFFORTS, Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.design import WIDER, Layout, lay_out
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

LEVELS = (0.7, 1.0, 1.0, 1.4)  # ksi: two tests at the middle one
UNSEEN = 1.7  # ksi
LAWS = {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine", "noise_sd": "power"}
FOLLOWERS = {"Fc": ("Fc_fwd", "Fc_bwd"), "sigma0": ("sigma0",), "noise_sd": ("noise_sd",)}
"""Quantities that follow the actuation, by what names their scatter group."""
RIGHT, WRONG = "whole", "points"
"""Inference from the tests' likelihoods; and the control, with means as if known exactly."""


@dataclass(frozen=True, eq=False)
class Study:
    """What the campaigns of a study share.

    Attributes
    ----------
    priors : PriorFile
        Of the truths and of the inference alike.
    motion : Trace
    single, joint : Effort
        Of a test's calibration and of the population.
    draws : int
        L, taken of each posterior; ranks go from 0 to L.
    seed : int
    """

    priors: PriorFile
    motion: Trace
    single: Effort
    joint: Effort
    draws: int
    seed: int


@dataclass(frozen=True, eq=False)
class Campaign:
    """Synthetic tests and the hyperparameters they were drawn with.

    Attributes
    ----------
    tests : tuple of Posterior
    layout : Layout
    truth : mapping of str to float
        By the names of what is ranked.
    """

    tests: tuple[Posterior, ...]
    layout: Layout
    truth: Mapping[str, float]


def full_study(seed: int) -> Study:
    """All 17 parameters, two and a half cycles and small ones inside the gap, 320 samples."""
    time = np.arange(320) / 32.0
    fade = 1.0 / (1.0 + np.exp((time - 6.6) / 0.15))
    large = 0.5 * np.sin(2 * np.pi * 0.4 * time)
    small = 0.05 * np.sin(2 * np.pi * 1.2 * time)
    motion = Trace.from_arrays(time, large * fade + small * (1.0 - fade))
    joint = replace(EFFORTS["thorough"], ess=1500)
    return Study(narrow_priors(), motion, EFFORTS["standard"], joint, draws=63, seed=seed)


def small_study(seed: int) -> Study:
    """Eight parameters and two cycles in 96 samples: a test takes a second."""
    time = np.arange(96) / 16.0
    motion = Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.3 * time))
    sampled = ("sigma0", "Fc_fwd", "Fc_bwd", "k3", "d2", "start", "offset", "noise_sd")
    priors = narrow_priors((*sampled, "noise_time"), noise_time=0.2)
    single = replace(EFFORTS["quick"], ess=150, limit=1600, ensembles=2)
    joint = replace(EFFORTS["quick"], ess=190, r_hat=1.03)
    return Study(priors, motion, single, joint, draws=63, seed=seed)


def synthesize(study: Study, index: int) -> Campaign:
    """Campaign of hyperparameters, tests, and records drawn from the prior."""
    rng = np.random.default_rng([study.seed, index, 0])
    blanks = [_blank(study, level) for level in LEVELS]
    settings = [setting_of(blank.trace) for blank in blanks]
    known = [name for name in blanks[0].names if name != "noise_time"]  # the pilot learns it
    layout = lay_out(study.priors, known, settings, LAWS)
    names = list(layout.names)
    level = layout.centre + layout.spread * rng.standard_normal(len(names))
    differs = ~np.array(layout.sparse)
    scatter = differs * layout.scatter_sd * np.abs(rng.standard_normal(len(names)))
    truth = {f"scatter {name}": scatter[k] for k, name in enumerate(names) if differs[k]}
    at = np.array([*LEVELS, UNSEEN])
    means = np.tile(level, (at.size, 1))
    means += _laws(rng, at / layout.reference, names, truth)
    means += _deviations(rng, at, layout, truth)
    q = means + scatter * rng.standard_normal(means.shape)
    values = layout.coordinates.values(q)
    median = {n: float(v[0]) for n, v in layout.coordinates.values(level[None]).items()}
    for side in ("fwd", "bwd"):
        truth[f"K_c_{side}"] = median[f"Fc_{side}"] / layout.reference
        truth[f"level Fc_{side}"] = level[names.index(f"Fc_{side}")]
    truth["alpha_sigma0"] = median["sigma0"] * truth["share sigma0"] / layout.reference
    truth["level offset"] = level[names.index("offset")]
    for name in ("Fc_fwd", "sigma0", "offset"):
        truth[f"first test's {name}"] = values[name][0]
    truth["new test's Fc_fwd"] = values["Fc_fwd"][-1]
    tests = []
    for j, blank in enumerate(blanks):
        force = _measured(blank, {name: v[j : j + 1] for name, v in values.items()}, rng)
        tests.append(Posterior(replace(blank.trace, force=force[0]), study.priors))
    new = _blank(study, UNSEEN)
    force = _measured(new, {name: v[-1:] for name, v in values.items()}, rng)
    truth |= {name: value[0] for name, value in _seen_in(new, force).items()}
    return Campaign(tuple(tests), layout, {name: float(v) for name, v in truth.items()})


def _measured(blank: Posterior, shared: Mapping[str, Array], rng: np.random.Generator) -> Array:
    """Force of a test with its offset and noise, (1, T); what is not shared is from its prior."""
    own = blank.draw_prior(rng, 1) | shared
    force = blank.force(own) + own["offset"][:, None]
    return np.asarray(force + blank.noise.draw(rng, blank.trace.time, own))


def _seen_in(test: Posterior, force: Array) -> dict[str, Array]:
    """Energy of the first full cycle, and force in the middle of the gap, of forces (n, T)."""
    x = test.trace.displacement
    peaks = 1 + np.flatnonzero(np.diff(np.sign(np.diff(x))))
    cycle = slice(peaks[0], peaks[2] + 1)
    energy = np.trapezoid(force[:, cycle], x[cycle], axis=1)
    gap = sum(
        float(np.median(test.priors[name].draw(np.random.default_rng(0), 4000)))
        for name in ("d2", "d3")
        if name in test.priors
    )
    middle = peaks[0] + np.argmax(np.abs(x[peaks[0] :] - x[peaks[0]]) >= 0.5 * gap)
    return {"new test's energy": energy, "new test's force in the gap": force[:, middle]}


def _blank(study: Study, level: float) -> Posterior:
    motion = study.motion
    trace = Trace.from_arrays(motion.time, motion.displacement, level)
    return Posterior(replace(trace, force=np.zeros(trace.samples)), study.priors)


def _laws(
    rng: np.random.Generator, relative: Array, names: Sequence[str], truth: dict[str, float]
) -> Array:
    """Logarithms of the laws' ratios to the reference, (J, d)."""
    found = np.zeros((relative.size, len(names)))
    for name in ("Fc_fwd", "Fc_bwd"):
        found[:, names.index(name)] = np.log(relative)
    share = truth["share sigma0"] = rng.random()
    found[:, names.index("sigma0")] = np.log(share * relative + 1.0 - share)
    exponent = truth["exponent noise_sd"] = rng.normal(1.0, 0.5)
    found[:, names.index("noise_sd")] = exponent * np.log(relative)
    return found


def deviation_root(at: Array) -> Array:
    """Cholesky factor of the covariance of levels' deviations from a law, in units of their sd.

    Matérn 3/2 over the logarithm of the actuation; in inverse proportion to it, from half to twice.
    """
    r = np.sqrt(3.0) * np.abs(np.log(at[:, None] / at)) / np.log(2.0)
    reference = np.exp(np.mean(np.log(np.unique(LEVELS))))
    sizes = np.clip(reference / at, 0.5, 2.0)
    covariance = sizes[:, None] * sizes * (1.0 + r) * np.exp(-r)
    return np.asarray(np.linalg.cholesky(covariance + 1e-12 * np.eye(at.size)))


def _deviations(
    rng: np.random.Generator, at: Array, layout: Layout, truth: dict[str, float]
) -> Array:
    """Smooth deviations from the laws, one Gaussian process for each follower, (J, d)."""
    names = list(layout.names)
    found = np.zeros((at.size, len(names)))
    root = deviation_root(at)
    for group, members in FOLLOWERS.items():
        scale = WIDER * layout.scatter_sd[names.index(members[0])]
        sd = truth[f"deviation {group}"] = scale * abs(rng.standard_normal())
        for name in members:
            found[:, names.index(name)] = sd * root @ rng.standard_normal(at.size)
    return found


def calibrate(study: Study, campaign: Campaign, index: int) -> list[Draws]:
    """Draws of every test by itself."""
    seeds = [(study.seed, index, 1, j) for j in range(len(campaign.tests))]
    return [sample(t, study.single, s) for t, s in zip(campaign.tests, seeds, strict=True)]


def draw_jointly(
    study: Study, campaign: Campaign, first: tuple[Layout, Pilot], index: int, way: str = RIGHT
) -> JointDraws:
    """Population of a `first_fit`, as the package infers it, or wrongly as the control."""
    layout, pilot = first
    tests = [test if way == RIGHT else _as_points(test) for test in pilot.tests]
    rng = np.random.default_rng([study.seed, index, 2])
    problem = JointProblem(layout, tests, campaign.tests[0].priors, "ksi", pilot.residual)
    return sample_joint(problem, study.joint, rng)


def first_fit(study: Study, campaign: Campaign, draws: Sequence[Draws]) -> tuple[Layout, Pilot]:
    """The layout with what the tests leave common, and their likelihoods."""
    working = [working_likelihood(campaign.layout, test, study.priors) for test in campaign.tests]
    starts = [_median(one, drawn) for one, drawn in zip(working, draws, strict=True)]
    pilot = fit_pilot(working, starts)
    return share(campaign.layout, pilot.tests), pilot


def _median(likelihood: WorkingLikelihood, draws: Draws) -> Array:
    """Medians of a test's draws in the prior units of its likelihood, (D,)."""
    layout, priors = likelihood.layout, likelihood.posterior.priors
    values = {name: np.array([np.median(v)]) for name, v in draws.values.items()}
    parts = [layout.coordinates.of(values)]
    parts += [priors[name].coordinate(values[name])[:, None] for name in likelihood.own]
    return np.asarray((np.concatenate(parts, axis=1)[0] - likelihood.middle) / likelihood.scale)


def _as_points(test: TestLikelihood) -> TestLikelihood:
    """The posterior's mean under a N(0, 1) prior taken for a measurement without error."""
    mean = np.linalg.solve(test.precision + np.eye(test.mean.size), test.precision @ test.mean)
    certain = replace(test, mean=mean, covariance=1e-4 * np.eye(mean.size))
    return certain.approximated()


def drawn_values(inference: JointDraws, rng: np.random.Generator) -> dict[str, Array]:
    """Draws by the names of the truths, (chain, draw) each."""
    population = inference.population
    layout = population.layout
    shape = population.h.shape[:2]
    differs = [name for k, name in enumerate(layout.names) if not layout.sparse[k]]
    found = {f"scatter {name}": population.scatters[name] for name in differs}
    found |= {name: population.slopes[name] for name in ("K_c_fwd", "K_c_bwd", "alpha_sigma0")}
    found["share sigma0"] = population.shapes("sigma0")[0]
    found["exponent noise_sd"] = population.shapes("noise_sd")[1]
    for name in ("Fc_fwd", "Fc_bwd", "offset"):
        found[f"level {name}"] = population.levels[..., layout.names.index(name)]
    for group, members in FOLLOWERS.items():
        label = f"level_{layout.groups[layout.member[layout.names.index(members[0])]]}"
        found[f"deviation {group}"] = population.effect_sds[label]
    first = inference.tests[0].reshape(-1, inference.tests[0].shape[-1])[:, : len(layout.names)]
    tested = layout.coordinates.values(layout.centre + layout.spread * first)
    for name in ("Fc_fwd", "sigma0", "offset"):
        found[f"first test's {name}"] = tested[name].reshape(shape)
    found["new test's Fc_fwd"] = _new_test(population, rng).reshape(shape)
    return found


def coordinates_of(inference: JointDraws) -> dict[str, Array]:
    """Everything that is inferred by name, tests in shared coordinates, (chain, draw) each."""
    population = inference.population
    layout = population.layout
    names = layout.names
    found = {f"level {name}": population.levels[..., k] for k, name in enumerate(names)}
    drawn = drawn_values(inference, np.random.default_rng(0))
    kept = ("scatter", "deviation", "share", "exponent")
    found |= {name: value for name, value in drawn.items() if name.startswith(kept)}
    for j, test in enumerate(inference.tests):
        q = layout.centre + layout.spread * test[..., : len(names)]
        found |= {f"test {j + 1}: {name}": q[..., k] for k, name in enumerate(names)}
    return found


def _new_test(population: Population, rng: np.random.Generator) -> Array:
    setting: Setting = replace(population.layout.settings[0], actuation=UNSEEN)
    return population.draw_test(setting, np.arange(population.size), rng)["Fc_fwd"]


def ranks_of(study: Study, campaign: Campaign, inference: JointDraws, index: int) -> dict[str, int]:
    """How many of L draws, taken evenly over chains and walkers, lie below each truth."""
    drawn = drawn_values(inference, np.random.default_rng([study.seed, index, 3]))
    ranks = {}
    for name, values in drawn.items():
        flat = values.reshape(-1)
        pick = np.linspace(0, flat.size - 1, study.draws).astype(np.intp)
        ranks[name] = int(np.sum(flat[pick] < campaign.truth[name]))
    new, test = _blank(study, UNSEEN), campaign.tests[0]
    forecast = Forecast("observation", draws=study.draws, seed=index)
    band = Predictor(inference.population, test.model, test.noise).predict(new.trace, forecast)
    for name, seen in _seen_in(new, band.draws).items():
        ranks[name] = int(np.sum(seen < campaign.truth[name]))
    return ranks
