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
from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import FEWEST, Band, Forecast, Predictor
from mfd_bayes.population.design import design_of
from mfd_bayes.population.discrepancy import KNOTS, Residual, TravelBasis, knot_covariance
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.laws import LAW_NAMES
from mfd_bayes.population.population import LawDraws, Population
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.population.starts import Starts
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
    population = make_population(motion, model, level_sd=level_sd)
    predictor = Predictor(population, find_model(model), find_noise("iid"))
    return Study(predictor, motion, "another" if level_sd > LAWFUL else "")


def make_population(
    motion: Trace, model: str, scatter: float = 0.15, level_sd: float = LAWFUL
) -> Population:
    """A population with levels known to 3 % and scatter of 15 %."""
    priors, medians, lawful = load_priors("mfd"), MEDIANS[model], level_sd <= LAWFUL
    settings = [Setting(p, "", setting_of(motion).covariates) for p in (0.5, 1.0, 2.0)]
    laws = None if lawful else {"Fc_fwd": "power", "Fc_bwd": "power"}
    design = design_of(priors, tuple(medians), settings, laws)
    d, shape, rng = len(medians), (4, 500), np.random.default_rng(1)
    design = replace(design, reference=1.0, common=np.zeros(d, dtype=bool))
    middle = design.coordinates.of({n: np.array([v]) for n, v in medians.items()})[0]
    z = np.zeros((*shape, design.quantity.size))
    z[..., :d] = middle + 0.03 * rng.normal(size=(*shape, d)) / design.spread
    h = np.full((*shape, d + len(design.effects)), np.log(level_sd))
    h[..., :d] = np.log(np.where(np.array(design.names) == "offset", 0.05, scatter))
    shapes = np.ones((shape[0] * shape[1], len(design.shapes)))
    if not lawful:  # what draws of the hyperparameters say of laws and levels differs too
        h[..., d:] += 0.4 * rng.normal(size=(*shape, 1))
        shapes = 0.8 + 0.2 * rng.normal(size=shapes.shape)
    choice = np.tile([LAW_NAMES.index(law) for law in design.laws.values()], (len(shapes), 1))
    share, exponent = (s.reshape(*shape, -1) for s in design.law_shapes(shapes, choice))
    return Population(
        design=design,
        draws=LawDraws(h, z, share, exponent),
        choice=choice.reshape(*shape, -1),
        law_weights={name: {law: 1.0} for name, law in design.laws.items()},
        alternatives=LawDraws(h[0, :0], z[0, :0], share[0, :0], exponent[0, :0]),
        alternative_weight=np.zeros(0),
        residual=make_residual(),
        starts=Starts(None, UNLOADED[model]),
        priors={name: priors.parameters[name] for name in (*medians, "start", "gamma1")},
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(np.ones(1), np.ones(1), np.ones(1)),
    )


def make_residual() -> Residual:
    """A known discrepancy of some 0.02 kip, even noise, and strokes with levels of their own."""
    wave = 0.02 * np.sin(np.arange(2 * KNOTS))
    even = np.zeros(wave.size)
    # samples count fully, as the noise of the truth is independent
    return Residual(
        TravelBasis(2.0 * LARGE, 2.0 * LARGE), wave, 1e-12 * knot_covariance(), even,
        slip_force=1.1, stroke_share=0.4, lag_one=1e-3, noise_time=1.0 / RATE / np.log(1e3),
        travel=1e-6,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Truth:
    """One test: its record, the damper's force without offset and noise, and its quantities."""

    trace: Trace
    damper: Array
    values: Mapping[str, Array]


def draw_truth(study: Study, rng: np.random.Generator, noisier: float = 1.0) -> Truth:
    """A test of the population; its noise is so many times larger than its noise_sd says."""
    predictor, motion = study.predictor, study.motion
    drawn = predictor.draw(motion, Forecast(draws=FEWEST, session=study.session), rng)
    values = {name: value[:1] for name, value in predictor.values(drawn).items()}
    force = predictor.force(motion, drawn)[0]
    noise = predictor.population.residual.draw_noise(rng, motion, values["noise_sd"])[0]
    measured = force + values["offset"] + noisier * noise
    return Truth(replace(motion, force=measured), force, values)


def ask(study: Study, truth: Truth, share: float, seed: int = 0, draws: int = DRAWS) -> Band:
    """Band of a test of which a share of the record is given."""
    forecast = Forecast(draws=draws, seed=seed, session=study.session)
    if share == 0.0:
        return study.predictor.predict(study.motion, forecast)
    end = float(study.motion.time[-1]) * share
    return predict_given(study.predictor, truth.trace, forecast, (0.0, end))


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
