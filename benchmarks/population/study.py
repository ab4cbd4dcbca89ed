"""Synthetic campaigns drawn from the prior of a population, their inference, and ranks of truths.

The truths follow section 6 of model.md and the docstring of `Design`. Of its code only the numbers
of the prior are used (centre, spread, scales, reference), not its laws, effects or layout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import intervals_of
from mfd_bayes.calibration.effort import EFFORTS
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import PriorFile
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.population.bands import PredictionOptions, Predictor
from mfd_bayes.population.design import WIDER, Design, design_of, setting_of
from mfd_bayes.population.inference import Inference, InferenceSettings, infer_population
from mfd_bayes.records.trace import Trace
from tests.statistical.sbc_study import narrow_priors

Array = NDArray[np.float64]

LEVELS = (0.7, 1.0, 1.0, 1.4)  # ksi: two tests at the middle one
DRAWS = 63  # of each posterior
UNSEEN = 1.2  # ksi: between tested levels, where the named laws hold
LAWS = {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine", "noise_sd": "power"}
FOLLOWERS = {"Fc": ("Fc_fwd", "Fc_bwd"), "sigma0": ("sigma0",), "noise_sd": ("noise_sd",)}
"""Quantities that follow the actuation, by what names their scatter group."""
RIGHT, HALVED, DOUBLED = "inferred", "halved", "doubled"
"""Scatter as the package infers it; and the controls, which tell half or twice of it."""
FACTORS = {RIGHT: 1.0, HALVED: 0.5, DOUBLED: 2.0}
LEVELS_RANKED = ("sigma0", "d2", "k3", "offset", "noise_sd")
TEST_RANKED = ("Fc_fwd", "sigma0", "d2", "offset", "noise_sd")
"""Quantities whose levels, and whose values in the first test, are ranked."""


SINGLE = replace(EFFORTS["quick"], ess=150, limit=1600, ensembles=2)  # of a test by itself
JOINT = replace(EFFORTS["quick"], ess=190)


@dataclass(frozen=True, eq=False)
class Campaign:
    """Synthetic tests, and what they were drawn with by the names of what is ranked."""

    priors: PriorFile
    seed: tuple[int, int]  # of a series, and the number in it
    tests: tuple[Posterior, ...]
    design: Design
    truth: Mapping[str, float]


def synthesize(seed: int, index: int, noise_time: float) -> Campaign:
    """Campaign of hyperparameters, tests, and records drawn from the prior.

    Eight parameters and two cycles in 96 samples: a test takes a second.
    """
    sampled = ("sigma0", "Fc_fwd", "Fc_bwd", "k3", "d2", "start", "offset", "noise_sd")
    priors = narrow_priors((*sampled, "noise_time"), noise_time=noise_time)
    rng = np.random.default_rng([seed, index, 0])
    blanks = [_blank(priors, level) for level in LEVELS]
    settings = [setting_of(blank.trace) for blank in blanks]
    learned = [name for name in blanks[0].names if name != "noise_time"]  # the joint fit learns it
    design = design_of(priors, learned, settings, LAWS)
    names, d = list(design.names), len(design.names)
    centre = design.coordinates.centre[:d]
    level = centre + design.spread * rng.standard_normal(d)
    scatter = ~design.common * design.scatter_sd * np.abs(rng.standard_normal(d))
    truth = {f"scatter {names[k]}": scatter[k] for k in design.free}
    actuations = np.array([*LEVELS, UNSEEN])
    means = np.tile(level, (actuations.size, 1))
    means += _laws(rng, actuations / design.reference, names, truth)
    means += _deviations(rng, actuations, design, truth)
    q = means + scatter * rng.standard_normal(means.shape)
    values = _values(design, q)
    median = {n: float(v[0]) for n, v in _values(design, level[None]).items()}
    for side in ("fwd", "bwd"):
        truth[f"K_c_{side}"] = median[f"Fc_{side}"] / design.reference
    truth["alpha_sigma0"] = median["sigma0"] * truth["share sigma0"] / design.reference
    truth |= {f"level {name}": level[names.index(name)] for name in LEVELS_RANKED}
    truth |= {f"first test's {name}": values[name][0] for name in TEST_RANKED}
    truth |= {f"new test's {name}": values[name][-1] for name in ("Fc_fwd", "sigma0")}
    tests = []
    for j, blank in enumerate(blanks):
        force = _measured(blank, {name: v[j : j + 1] for name, v in values.items()}, rng)
        tests.append(Posterior(replace(blank.trace, force=force[0]), priors))
    unseen = _blank(priors, UNSEEN)
    force = _measured(unseen, {name: v[-1:] for name, v in values.items()}, rng)
    truth |= {name: value[0] for name, value in _seen_in(unseen, force).items()}
    true = {name: float(value) for name, value in truth.items()}
    return Campaign(priors, (seed, index), tuple(tests), design, true)


def _values(design: Design, q: Array) -> dict[str, Array]:
    """Shared quantities at coordinates q (n, d), by name."""
    d = len(design.names)
    x = np.zeros((len(q), len(design.coordinates.names)))
    x[:, :d] = (q - design.coordinates.centre[:d]) / design.spread
    values = design.coordinates.values(x)
    return {name: values[name] for name in design.names}


def _measured(blank: Posterior, shared: Mapping[str, Array], rng: np.random.Generator) -> Array:
    """Force of a test with its offset and noise, (1, T); what is not shared is from its prior."""
    values = blank.sample_prior(1, rng) | shared
    force = blank.force(values) + values["offset"][:, None]
    return np.asarray(force + blank.noise.draw(rng, blank.trace.time, values))


def _seen_in(test: Posterior, force: Array) -> dict[str, Array]:
    """Energy of the first full cycle, and two forces, of forces (n, T).

    One force is in the middle of the gap, the other at the turn after it.
    """
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
    return {
        "new test's energy": energy,
        "new test's force in the gap": force[:, middle],
        "new test's force at a turn": force[:, peaks[1]],
    }


def _blank(priors: PriorFile, level: float) -> Posterior:
    """A test at a level of the actuation, without force."""
    time = np.arange(96) / 16.0
    trace = Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.3 * time), level)
    return Posterior(replace(trace, force=np.zeros(trace.samples)), priors)


def _laws(rng, relative, names, truth):
    """Logarithms of the laws' ratios to the reference, (J, d)."""
    logs = np.zeros((relative.size, len(names)))
    for name in ("Fc_fwd", "Fc_bwd"):
        logs[:, names.index(name)] = np.log(relative)
    share = truth["share sigma0"] = rng.random()
    logs[:, names.index("sigma0")] = np.log(share * relative + 1.0 - share)
    exponent = truth["exponent noise_sd"] = rng.normal(1.0, 0.5)
    logs[:, names.index("noise_sd")] = exponent * np.log(relative)
    return logs


def _deviations(rng, actuations, design, truth):
    """Smooth deviations from the laws, one Gaussian process for each follower, (J, d).

    Matérn 3/2 over the logarithm of the actuation, of a size in inverse proportion to it, from half
    to twice.
    """
    r = np.sqrt(3.0) * np.abs(np.log(actuations[:, None] / actuations)) / np.log(2.0)
    sizes = np.clip(np.exp(np.mean(np.log(LEVELS))) / actuations, 0.5, 2.0)
    covariance = sizes[:, None] * sizes * (1.0 + r) * np.exp(-r)
    root = np.linalg.cholesky(covariance + 1e-9 * np.eye(actuations.size))
    names = list(design.names)
    deviations = np.zeros((actuations.size, len(names)))
    for group, members in FOLLOWERS.items():
        scale = WIDER * design.scatter_sd[names.index(members[0])]
        sd = truth[f"deviation {group}"] = scale * abs(rng.standard_normal())
        for name in members:
            deviations[:, names.index(name)] = sd * root @ rng.standard_normal(actuations.size)
    return deviations


def infer(campaign):
    """Draws of every test by itself, and the population of all as a user infers it."""
    draws, tests = [], {}
    for j, test in enumerate(campaign.tests):
        draws.append(sample(test, SINGLE, (*campaign.seed, 1, j)))
        intervals = intervals_of(draws[-1].values)
        tests[f"t{j}"] = TestResult(f"t{j}", test, Path(), intervals=intervals)
    settings = InferenceSettings(LAWS, "ksi", JOINT, (*campaign.seed, 2))
    return draws, infer_population(tests, campaign.priors, settings)


def drawn_values(inference: Inference) -> dict[str, Array]:
    """Draws by the names of the truths, (chain, draw) each."""
    population = inference.population
    design = population.design
    draws = {name: population.slopes[name] for name in ("K_c_fwd", "K_c_bwd", "alpha_sigma0")}
    draws["share sigma0"] = population.shapes("sigma0")[0]
    draws["exponent noise_sd"] = population.shapes("noise_sd")[1]
    for name in LEVELS_RANKED:
        k = design.names.index(name)
        z = population.draws.z[..., k]
        draws[f"level {name}"] = design.coordinates.centre[k] + design.spread[k] * z
    for group, members in FOLLOWERS.items():
        label = f"level_{design.groups[members[0]]}"
        draws[f"deviation {group}"] = population.effect_sds[label]
    tested = inference.values(0)
    return draws | {f"first test's {name}": tested[name] for name in TEST_RANKED}


def ranks_of(campaign, inference):
    """How many of L draws, taken evenly over chains and walkers, lie below each truth, by way.

    The ways differ in the scatter, and in what a new test shows with it.
    """
    population, test, ranks = inference.population, campaign.tests[0], {}
    design, draws, unseen = population.design, population.draws, _blank(campaign.priors, UNSEEN)

    def rank(quantities):
        """Ranks of values by name."""
        counts = {}
        for name, values in quantities.items():
            flat = values.reshape(-1)
            pick = np.linspace(0, flat.size - 1, DRAWS).astype(np.intp)
            counts[name] = int(np.sum(flat[pick] < campaign.truth[name]))
        return counts

    for way, factor in FACTORS.items():
        scatters = {f"scatter {name}": factor * v for name, v in population.scatters.items()}
        h = draws.h.copy()
        h[..., : design.free.size] += np.log(factor)
        variant = replace(population, draws=replace(draws, h=h))
        forecast = PredictionOptions("observation", draws=DRAWS, seed=campaign.seed[1])
        band = Predictor(variant, test.model, test.noise).predict(unseen.trace, forecast)
        predicted = {f"new test's {name}": band.values[name] for name in ("Fc_fwd", "sigma0")}
        predicted |= _seen_in(unseen, np.asarray(band.draws))
        ranks[way] = rank(scatters | drawn_values(inference) | predicted)
    return ranks
