"""Whether the data support a proportional law: the exponent that they choose if it is free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.population.hierarchy import infer
from mfd_bayes.population.marginal import Pooling, TestSummary

LEVELS = 3
"""Fewest actuation levels from which an exponent can be told from scatter."""


def free_exponents(
    pooling: Pooling,
    tests: Sequence[TestSummary],
    priors: Mapping[str, Prior],
    effort: Effort,
    rng: np.random.Generator,
) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    All proportional laws are freed at once, each with the power law's prior N(1, ½²). Empty
    where no law is proportional, or the tests are at fewer than `LEVELS` levels.
    """
    names = [name for name, law in pooling.laws.items() if law == "proportional"]
    levels = {round(float(np.log(test.actuation)), 3) for test in tests}
    if not names or len(levels) < LEVELS:
        return {}
    freed = replace(pooling, laws=dict(pooling.laws) | dict.fromkeys(names, "power"))
    population = infer(freed, tests, priors, "", effort, rng)
    found = {}
    for name in names:
        low, middle, high = np.quantile(population.shapes[name], [0.025, 0.5, 0.975])
        found[name] = (float(low), float(middle), float(high))
    return found
