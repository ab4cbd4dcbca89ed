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
from mfd_bayes.population.population import Population

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
    draws, layout = population.draws, population.design
    design = design or layout
    d, size = len(layout.names), layout.z_sd.size
    level = natural_levels(layout, draws.z)
    distance = (level - design.coordinates.centre[:d]) / design.spread
    log = -0.5 * np.sum(distance**2, axis=-1) - np.log(design.spread).sum()
    log = log - 0.5 * np.sum((draws.z[..., d:size] / layout.z_sd[d:]) ** 2, axis=-1)
    scale = np.concatenate(
        [design.scatter_sd[design.free], [effect.scale for effect in design.effects]]
    )
    log = log - 0.5 * np.sum((np.exp(draws.h) / scale) ** 2, axis=-1) - np.log(scale).sum()
    free = np.isin(population.choice, [i for i, n in enumerate(LAW_NAMES) if _bends(n)])
    mean, sd = EXPONENT
    log = log - 0.5 * np.sum(free * ((draws.exponent - mean) / sd) ** 2, axis=-1)
    for j, values in enumerate(pooled):
        for k, name in enumerate(design.coordinates.names):
            if k >= d or not design.informs[j, k]:
                prior = design.coordinates.priors[name]
                log = log + prior.log_density(prior.coordinate(values[name]))
    return np.asarray(log)


def _bends(law: str) -> bool:
    """Whether a law's exponent is inferred."""
    return LAWS[law].exponent is None
