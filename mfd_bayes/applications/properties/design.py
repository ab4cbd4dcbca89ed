"""Bounding properties of a standard: nominal values times its λ, at any level of actuation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mfd_bayes.applications.properties.factors import property_factors
from mfd_bayes.applications.properties.harmonic import levels_of
from mfd_bayes.applications.properties.page import to_compare
from mfd_bayes.evaluation.scores import Rows
from mfd_bayes.population.design import same_level
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.runs.run import Run


def design_factors(run: Run, level: float) -> Mapping[str, tuple[float, float]]:
    """λ_min and λ_max at a level of actuation, by name of the property.

    From the tests at that level; between and beyond the tested ones the extremes over all levels.
    Empty where the campaign names no standard that composes them.
    """
    standard = run.manifest.standard
    if standard is None or standard.factors is None:
        return {}
    evidence = to_compare(run, predicted=False)
    levels = levels_of(evidence.tests)
    nearest = [each for each in levels if same_level(each, level)] or levels
    factors: dict[str, tuple[float, float]] = {}
    for row in property_factors(standard, evidence, nearest):
        for name, item in PROPERTIES.items():
            if not np.isfinite(row.lambda_max):  # the records do not show it
                continue
            if item.quantity == row.quantity and item.direction == row.direction:
                low, high = factors.get(name, (row.lambda_min, row.lambda_max))
                factors[name] = min(low, row.lambda_min), max(high, row.lambda_max)
    return factors


def standard_bounds(run: Run, level: float, rows: Rows) -> Rows:
    """Rows of bounds by the standard, beside those of `evaluation.bounds.design_rows`."""
    factors, standard = design_factors(run, level), run.manifest.standard
    if standard is None:
        return ()
    return tuple(
        row
        | {
            "basis": "standard",
            "of": f"{standard.title}, λ times nominal",
            "lower": row["nominal"] * factors[row["name"]][0],
            "upper": row["nominal"] * factors[row["name"]][1],
            "lower_ratio": factors[row["name"]][0],
            "upper_ratio": factors[row["name"]][1],
            "note": "",
        }
        for row in rows
        if row["basis"] == "mean" and row["name"] in factors
    )
