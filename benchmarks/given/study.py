"""Synthetic tests drawn from a population with given values, and ranks of what is to be predicted.

Truth and prediction share every assumption, so that ranks are uniform if the first part is taken in
rightly: parameters with scatter, a start anywhere in the gap (with `backlash`, four of five tests
begin without load), offset, discrepancy, and independent noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import Band
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.pace import Counting, Pace
from mfd_bayes.population.population import Population
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.discrepancy import Residual, slip_force_of
from mfd_bayes.population.starts import standing_of
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.population.strokes import StrokeLevels
from mfd_bayes.population.discrepancy import KNOTS, TravelBasis
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

THREE_STAGE = {
    "sigma0": 25.0,  # kip/in
    "sigma1": 0.02,  # kip·s/in
    "sigma2": 0.01,
    "Fc_fwd": 1.0,  # kip
    "Fc_bwd": 1.2,
    "static_excess_fwd": 0.15,
    "static_excess_bwd": 0.15,
    "k2": 0.8,  # kip/in
    "k3": 20.0,
    "d2": 0.10,  # in
    "d3": 0.08,
    "ell": 0.02,
    "v_s": 0.4,  # in/s
    "offset": 0.0,  # kip
    "noise_sd": 0.05,
}
BACKLASH = {
    "k_fwd": 20.0,  # kip/in
    "k_bwd": 25.0,
    "gap": 0.15,  # in
    "k_0": 0.5,  # kip/in
    "n": 2.0,
}
MEDIANS = {
    "three_stage": THREE_STAGE,
    "backlash": BACKLASH
    | {
        name: value
        for name, value in THREE_STAGE.items()
        if name not in ("sigma0", "sigma1", "k2", "k3", "d2", "d3")
    },
}
STIFFNESS = ("k2", "k_fwd")
UNLOADED = {"three_stage": 0.0, "backlash": 0.8}
"""Probability that a test begins without load; the three stages do not tell load from none."""

RATE = 32.0  # Hz
SMALL, LARGE = 0.04, 0.5  # in: inside the gap, then full strokes
BEGUN = 1.0  # s, when these begin
END = 4.0
DRAWS = 99
"""Draws of each prediction: ranks go from 0 to this."""

SHARES = (0.0, 0.25, 0.5, 1.0)
"""Of the record that are given."""

SAMPLES = (1.2, 2.2, 3.4)
"""Times, s, at which the damper's force is ranked."""


@dataclass(frozen=True, eq=False)
class Study:
    """Population and motion of all tests."""

    predictor: Predictor
    motion: Trace
    pace: Pace
    session: str = ""


LAWFUL = 1e-6
"""Sd of levels that do not deviate from the laws."""


def make_study(model: str = "three_stage", level_sd: float = LAWFUL) -> Study:
    """The study of a model with a gap.

    Where levels of actuation deviate from the laws, with this sd, the actuation doubles during the
    test, which belongs to a session without other tests.
    """
    time = np.arange(int(END * RATE)) / RATE
    small = SMALL * np.sin(2.0 * np.pi * 2.0 * time)
    later = np.maximum(time - BEGUN, 0.0)
    large = LARGE * np.sin(2.0 * np.pi * 0.7 * later)
    actuation = 0.7 * 2.0 ** (time / END) if level_sd > LAWFUL else 1.0
    motion = Trace.from_arrays(time, np.where(time < BEGUN, small, large), actuation)
    one = Pace.of([motion])
    # samples count fully, as the noise of the truth is independent
    pace = Pace(one.steps, one.speeds, 1e-6 * one.travels)
    population = make_population(motion, model, level_sd=level_sd)
    predictor = Predictor(population, find_model(model), find_noise("iid"))
    return Study(predictor, motion, pace, "another" if level_sd > LAWFUL else "")


def make_population(
    motion: Trace, model: str, scatter: float = 0.15, level_sd: float = LAWFUL
) -> Population:
    """A population with levels known to 3 % and scatter of 15 %."""
    priors, medians = load_priors("mfd"), MEDIANS[model]
    settings = [Setting(p, "", setting_of(motion).covariates) for p in (0.5, 1.0, 2.0)]
    lawful = level_sd <= LAWFUL
    laws = None if lawful else {"Fc_fwd": "power", "Fc_bwd": "power"}
    layout = replace(lay_out(priors, tuple(medians), settings, laws), reference=1.0)
    d, shape = len(medians), (4, 500)
    rng = np.random.default_rng(1)
    middle = layout.coordinates.of({n: np.array([v]) for n, v in medians.items()})[0]
    latent = np.zeros((*shape, 1 + sum(len(e.cells) for e in layout.effects), d))
    latent[:, :, 0] = middle + 0.03 * rng.normal(size=(*shape, d)) - layout.centre
    latent[:, :, 0] /= layout.spread
    h = np.zeros((*shape, layout.dim))
    h[..., :d] = np.log(np.where(np.array(layout.names) == "offset", 0.05, scatter))
    h[..., d : d + len(layout.effects)] = np.log(level_sd)
    if not lawful:  # what draws of the hyperparameters say of laws and levels differs too
        h[..., d : d + len(layout.effects)] += 0.4 * rng.normal(size=(*shape, 1))
        shapes = 0.8 + 0.2 * rng.normal(size=(*shape, len(layout.shapes)))
        h[..., d + len(layout.effects) :] = shapes
    kept = {name: priors.parameters[name] for name in (*medians, "start", "gamma1")}
    return Population(
        layout=layout,
        h=h,
        latent=latent,
        choice=layout.draw_choice(shape[0] * shape[1]).reshape(*shape, -1),
        together=np.broadcast_to(np.eye(d), (*shape, d, d)),
        priors=kept,
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(np.ones(1), np.ones(1), np.ones(1)),
        residual=make_residual(motion),
        unloaded=UNLOADED[model],
    )


def make_residual(motion: Trace) -> Residual:
    """Discrepancy of some 0.03 kip, even noise, and strokes that slip at levels of their own."""
    basis = TravelBasis.of([motion])
    wave = 0.02 * np.sin(np.arange(basis.size))
    covariance = 0.03**2 * basis.covariance()
    even = np.zeros(basis.size)
    slips = np.arange(2 * KNOTS) % KNOTS > 10
    levels = StrokeLevels(np.where(slips, 0.7, 0.0), 0.5)
    return Residual(basis, wave, covariance, even, 1.1, levels, 1e-4, 1.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """One test: its record, the damper's force without offset and noise, and its quantities."""

    trace: Trace
    damper: Array
    values: Mapping[str, Array]


def draw_truth(study: Study, rng: np.random.Generator, noisier: float = 1.0) -> Truth:
    """A test of the population; its noise is so many times larger than its noise_sd says."""
    predictor, motion = study.predictor, study.motion
    population = predictor.population
    index = rng.choice(population.size, size=1)
    setting = setting_of(motion, study.session)
    varying = motion.varying
    values = population.values(population.draw_parts(setting, index, rng, leveled=not varying))
    standing = standing_of(population, predictor.model, values, motion)
    values |= {"start": population.draw_starts(rng, 1, setting, standing), "gamma1": np.ones(1)}
    scales = {}
    if varying:
        level, scales = _deviation(population, motion, int(index[0]), rng)
        values |= {name: values[name] * factor for name, factor in level.items()}
    force = _damper(study, values, scales, rng)
    noise = _noise(study, replace(motion, force=force), rng)
    measured = force + values["offset"] + noisier * values["noise_sd"] * noise
    return Truth(replace(motion, force=measured), force, values)


def _deviation(
    population: Population, motion: Trace, index: int, rng: np.random.Generator
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Factors of a test's level, and along its history over the level, of a session of its own.

    They are drawn sample by sample from the covariance of levels (docs/pages/model.md, laws).
    """
    layout, history = population.layout, np.append(motion.actuation, motion.reference_actuation)
    r = np.sqrt(3.0) * np.abs(np.log2(history[:, None] / history))
    level, scales = {}, {}
    for i, effect in enumerate(layout.effects):
        sd = float(np.exp(population.h.reshape(population.size, -1)[index, len(layout.names) + i]))
        size = sd * np.clip(effect.reference / history, 0.5, 2.0)
        values, vectors = np.linalg.eigh(size[:, None] * size * (1.0 + r) * np.exp(-r))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        for k in effect.members:
            name = layout.names[k]
            drawn = root @ rng.standard_normal(history.size)
            law = population.ratio(name, history).reshape(population.size, -1)[index]
            level[name] = np.exp(drawn[-1:])
            scales[name] = (np.exp(drawn[:-1] - drawn[-1]) * law[:-1] / law[-1])[None]
    return level, scales | {f"Fs_{way}": scales[f"Fc_{way}"] for way in ("fwd", "bwd")}


def _damper(
    study: Study,
    values: Mapping[str, Array],
    scales: Mapping[str, Array],
    rng: np.random.Generator,
) -> Array:
    model, motion = study.predictor.model, study.motion
    residual = study.predictor.population.residual
    force = model.force(model.theta(values), motion, values["start"], scales=scales or None)
    if residual is not None:
        coefficients = residual.draw_coefficients(rng, 1)
        force = force + residual.discrepancy(motion, slip_force_of(model, values), coefficients)
    return np.asarray(force[0])


def _noise(study: Study, damper: Trace, rng: np.random.Generator) -> Array:
    """Noise of a test over its standard deviation, (T,), of which strokes have levels in common."""
    residual = study.predictor.population.residual
    counting = Counting(residual, study.pace, 1.0 / RATE, residual.slip_force)
    counted = counting.counted(damper, np.full(damper.samples, True))
    levels = residual.levels.draw(rng, 1, int(counted.strokes[-1]) + 1)[0, counted.strokes]
    rest = np.sqrt(1.0 - counted.common**2) * rng.standard_normal(damper.samples)
    return np.asarray(counted.shape * (counted.common * levels + rest))


def ask(study: Study, truth: Truth, share: float, seed: int = 0, draws: int = DRAWS) -> Band:
    """Band of a test of which a share of the record is given."""
    forecast = Forecast(draws=draws, seed=seed, session=study.session)
    if share == 0.0:
        return study.predictor.predict(study.motion, forecast)
    end = float(study.motion.time[-1]) * share
    return predict_given(study.predictor, truth.trace, forecast, (0.0, end), study.pace)


def ranks_of(truth: Truth, band: Band) -> dict[str, int]:
    """Ranks of the true forces and quantities among a band's draws."""
    found = {}
    for time in SAMPLES:
        at = int(np.searchsorted(band.time, time))
        found[f"force at {time:g} s"] = int(np.sum(band.draws[:, at] < truth.damper[at]))
    known, drawn = _quantities(truth.values), _quantities(band.values)
    return found | {name: int(np.sum(drawn[name] < known[name])) for name in known}


def _quantities(values: Mapping[str, Array]) -> dict[str, Array]:
    stiffness = next(name for name in STIFFNESS if name in values)
    names = ("Fc_fwd", "Fc_bwd", stiffness, "offset", "noise_sd", "start")
    gap = values["gap"] if "gap" in values else values["d2"] + values["d3"]
    return {name: values[name] for name in names} | {"gap": gap}
