"""Log prior density of a population's draws.

It is that of levels, slopes, scatter, effects' standard deviations and shapes of laws, and of what
each test has to itself. What lies between, the tests' quantities given the population, is the same
under every prior file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.design import EXPONENT, LAW_NAMES, LAWS, Design
from mfd_bayes.population.population import LawDraws, Population

Array = NDArray[np.float64]


def natural_levels(design: Design, z: Array) -> Array:
    """Levels of coefficients z (..., Z) on the scale of their coordinates, (..., d)."""
    d = len(design.names)
    return np.asarray(design.coordinates.centre[:d] + design.spread * z[..., :d])


def log_prior(
    population: Population, pooled: Sequence[Mapping[str, Array]], design: Design | None = None
) -> Array:
    """Log density of the draws under their own prior, or that of another design, (chain, draw).

    `pooled` are draws of each test's quantities by name, (chain, draw). Another design must have
    the same layout and coordinates: its levels, scatter and priors may have other figures.
    """
    layout = population.design
    design = design or layout
    log = log_population_prior(population.draws, layout, design)
    free = np.isin(population.choice, [i for i, n in enumerate(LAW_NAMES) if _bends(n)])
    mean, sd = EXPONENT
    distance = free * (population.draws.exponent - mean) / sd
    log = log - 0.5 * np.sum(distance**2, axis=-1)
    for j, values in enumerate(pooled):
        for k, name in enumerate(design.coordinates.names):
            if k >= len(layout.names) or not design.informs[j, k]:
                prior = design.coordinates.priors[name]
                log = log + prior.log_density(prior.coordinate(values[name]))
    return np.asarray(log)


def log_population_prior(draws: LawDraws, layout: Design, design: Design) -> Array:
    """That of levels, slopes, scatter and effects' sds of draws of one layout, under a design."""
    d, size = len(layout.names), layout.z_sd.size
    distance = natural_levels(layout, draws.z) - design.coordinates.centre[:d]
    log = -0.5 * np.sum((distance / design.spread) ** 2, axis=-1) - np.log(design.spread).sum()
    log = log - 0.5 * np.sum((draws.z[..., d:size] / layout.z_sd[d:]) ** 2, axis=-1)
    scale = np.concatenate(
        [design.scatter_sd[design.free], [effect.scale for effect in design.effects]]
    )
    squares = np.sum((np.exp(draws.h) / scale) ** 2, axis=-1)
    return np.asarray(log - 0.5 * squares - np.log(scale).sum())


def _bends(law: str) -> bool:
    """Whether a law's exponent is inferred."""
    return LAWS[law].exponent is None
