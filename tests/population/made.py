"""Populations of given values, which no sampler has seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, systematic
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.design import (
    LAW_NAMES,
    TestConditions,
    design_of,
    setting_of,
    usual_shapes,
)
from mfd_bayes.population.mixed_model import MixedModel
from mfd_bayes.population.population import (
    KNOTS,
    InitialGapPrior,
    LawDraws,
    Population,
    Residual,
    TravelBasis,
)
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

THREE_STAGE = {
    "sigma0": 30.0,
    "sigma1": 0.02,
    "sigma2": 0.015,
    "Fc_fwd": 1.3,
    "Fc_bwd": 1.6,
    "static_excess_fwd": 0.15,
    "static_excess_bwd": 0.1,
    "k2": 0.6,
    "k3": 20.0,
    "d2": 0.09,
    "d3": 0.07,
    "ell": 0.02,
    "v_s": 0.4,
    "offset": 0.03,
    "noise_sd": 0.05,
}
"""Medians over tests at the reference actuation."""


def no_residual(**changes: Any) -> Residual:
    """No discrepancy, and even white noise."""
    zeros = np.zeros(2 * KNOTS)
    residual = Residual(
        TravelBasis(1.0, 1.0), zeros, zeros, 1.0, 0.0, 1e-3, 1e-3, 1e-6,
    )  # fmt: skip
    return replace(residual, **changes)


def make_population(
    settings: Sequence[TestConditions],
    laws: Mapping[str, str] | None = None,
    *,
    medians: Mapping[str, float] | None = None,
    level_sd: float | Mapping[str, float] = 0.01,
    scatter: float | Mapping[str, float] = 0.1,
    effect: float | Mapping[str, float] = 1e-6,
    share: float = 0.5,
    exponent: float = 1.0,
    exponent_sd: float = 0.0,
    shape: tuple[int, int] = (4, 100),
    everywhere: bool = True,
    residual: Residual | None = None,
    starts: InitialGapPrior | None = None,
    reference: float | None = 1.0,
    dependence: Mapping[str, Sequence[str]] | None = None,
    alternatives: Mapping[str, float] | None = None,
) -> Population:
    """A population with medians known to `level_sd`, and scatter and effects of these sds.

    A mapping has values by quantity, or by effect, and 0 or next to nothing for others.
    `everywhere` lets every quantity differ between tests. `alternatives` has weights of laws of
    slip forces beyond the levels.
    """
    priors, medians = load_priors("mfd"), dict(medians or THREE_STAGE)
    residual = residual or no_residual()
    design = design_of(priors, tuple(medians), settings, laws, dependence)
    design = replace(design, reference=reference or design.reference)
    if everywhere:
        design = replace(design, common=np.zeros(len(design.names), dtype=bool))
    rng, names = np.random.default_rng(1), design.names

    def by_name(value: float | Mapping[str, float], keys: Sequence[str], floor: float) -> Array:
        if isinstance(value, Mapping):
            return np.array([max(value.get(key, 0.0), floor) for key in keys])
        return np.full(len(keys), max(value, floor))

    tau = by_name(scatter, names, 1e-9)
    if "offset" in names and not isinstance(scatter, Mapping):
        tau[names.index("offset")] = min(scatter, 0.02)
    omega = by_name(effect, [f"{e.name}_{e.group}" for e in design.effects], 1e-9)
    h = np.log(np.concatenate([tau[design.free], omega]))
    d = len(names)
    middle = design.coordinates.of({n: np.array([medians[n]]) for n in names})[0]
    z = np.zeros((*shape, design.quantity.size))
    wide = by_name(level_sd, names, 0.0) / design.spread
    z[..., :d] = middle[:d] + wide * rng.standard_normal((*shape, d))
    laws_of = ["power" if law == "compare" else law for law in design.laws.values()]
    numbers = [LAW_NAMES.index(law) for law in laws_of]
    choice = np.broadcast_to(numbers, (*shape, len(numbers))).astype(np.intp)
    shapes = np.empty((choice[..., 0].size, len(design.shapes)))
    for i, (_, name) in enumerate(design.shapes):
        spread = exponent + exponent_sd * rng.standard_normal(len(shapes))
        shapes[:, i] = np.log(share / (1.0 - share)) if name == "share" else spread
    law_shapes = design.law_shapes(shapes, choice.reshape(len(shapes), -1))
    # laws beyond the levels: of slip forces, with the medians of their shapes
    weights, n_draws = dict(alternatives or {}), shape[1]
    rows = [
        [usual_shapes(named_law if n == "sigma0" else law) for n, named_law in design.laws.items()]
        for law in weights
    ]
    pairs = np.repeat(np.array(rows).reshape(len(rows), len(numbers), 2), n_draws, axis=0)
    weight = np.repeat([*weights.values()], n_draws) / n_draws
    alternative_draws = LawDraws(
        np.tile(h, (weight.size, 1)), np.resize(z[0], (weight.size, z.shape[-1])),
        pairs[..., 0], pairs[..., 1], np.zeros((weight.size, 2 * KNOTS)),
    )  # fmt: skip
    watched = np.full(h.size + len(design.shapes) + design.tabled.size, 900.0)
    prior_names = {*medians, "start", "gamma1"} & set(priors.parameters)
    return Population(
        design=design,
        draws=LawDraws(
            np.broadcast_to(h, (*shape, h.size)).copy(),
            z,
            *(s.reshape(choice.shape) for s in law_shapes),
            np.broadcast_to(residual.mean, (*shape, residual.mean.size)),
        ),
        choice=choice,
        law_weights={n: {LAW_NAMES[choice[0, 0, i]]: 1.0} for i, n in enumerate(design.laws)},
        alternatives=alternative_draws,
        alternative_weight=weight,
        residual=residual,
        starts=starts or InitialGapPrior(),
        priors={name: priors.parameters[name] for name in prior_names},
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(watched / 900.0, watched, watched),
    )


def make_predictor(
    model: str, tested: Sequence[TestConditions] | None = None, *arguments: Any, **options: Any
) -> Predictor:
    """The predictor of a population of a model, with medians typical of the priors by default."""
    friction, priors = find_model(model), load_priors("mfd").parameters
    names = [q.name for q in friction.quantities if q.sampled and q.name in priors]
    medians = {n: priors[n].median for n in names if n not in ("start", "gamma1")}
    options = {"medians": medians | {"offset": 0.0, "noise_sd": 0.05}} | options
    if tested is None:
        time = np.arange(128) / 32.0
        motion = np.sin(np.pi * time)
        tested = [setting_of(Trace.from_arrays(time, motion, p)) for p in (0.5, 1.0, 2.0)]
    population = make_population(tested, *arguments, **options)
    return Predictor(population, friction, find_noise("iid"))


def sample_h(mixed: MixedModel, choice: Array, rng: np.random.Generator, n: int) -> Array:
    """Draws of h, (n, dim), by importance resampling: many are the same."""
    _, g, log = mixed.importance_sample(choice, rng)
    return mixed.from_standard_normal(g[systematic(log, n, rng)])
