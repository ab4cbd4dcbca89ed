"""A population with given values, whose levels of actuation may deviate from the laws."""

from dataclasses import replace

import numpy as np

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.design import Setting, design_of, setting_of
from mfd_bayes.population.joint_fit import KNOTS, Residual, TravelBasis, knot_covariance
from mfd_bayes.population.laws import LAW_NAMES
from mfd_bayes.population.population import LawDraws, Population, Starts
from mfd_bayes.records.trace import Trace

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
UNLOADED = {"three_stage": 0.0, "backlash": 0.8}
"""Probability that a test begins without load; the three stages do not tell load from none."""

RATE = 32.0  # Hz
SMALL, LARGE = 0.04, 0.5  # in: inside the gap, then full strokes
BEGUN = 1.0  # s, when these begin
END = 4.0

LAWFUL = 1e-6
"""Sd of levels that do not deviate from the laws."""


def make_predictor(model="three_stage", level_sd=LAWFUL):
    """The predictor of a model with a gap.

    Where levels of actuation deviate from the laws, with this sd, the actuation doubles during the
    test.
    """
    time = np.arange(int(END * RATE)) / RATE
    small = SMALL * np.sin(2.0 * np.pi * 2.0 * time)
    later = np.maximum(time - BEGUN, 0.0)
    large = LARGE * np.sin(2.0 * np.pi * 0.7 * later)
    actuation = 0.7 * 2.0 ** (time / END) if level_sd > LAWFUL else 1.0
    motion = Trace.from_arrays(time, np.where(time < BEGUN, small, large), actuation)
    population = make_population(motion, model, level_sd)
    return Predictor(population, find_model(model), find_noise("iid"))


def make_population(motion, model, level_sd, scatter=0.15):
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


def make_residual():
    """A known discrepancy of some 0.02 kip, even noise, and strokes with levels of their own."""
    wave = 0.02 * np.sin(np.arange(2 * KNOTS))
    even = np.zeros(wave.size)
    # samples count fully, as the noise of the truth is independent
    return Residual(
        TravelBasis(2.0 * LARGE, 2.0 * LARGE), wave, 1e-12 * knot_covariance(), even,
        slip_force=1.1, stroke_share=0.4, lag_one=1e-3, noise_time=1.0 / RATE / np.log(1e3),
        travel=1e-6,
    )  # fmt: skip
