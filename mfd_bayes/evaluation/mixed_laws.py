"""Table II where laws are compared: the constants of each law, with its weight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.quantities import units
from mfd_bayes.evaluation.bands import spread_of
from mfd_bayes.evaluation.views import Row
from mfd_bayes.population.laws import COMPARE, INTERCEPTS, LAW_NAMES, LAWS, law_unit
from mfd_bayes.population.population import Population
from mfd_bayes.runs.unit_system import System

Array = NDArray[np.float64]

FEWEST = 20
"""Fewest draws under a law of which an interval is given."""

_SLOPES = {"Fc_fwd": "K_c_fwd", "Fc_bwd": "K_c_bwd", "sigma0": "alpha_sigma0"}


def mixed_rows(population: Population, actuation_unit: str, system: System) -> list[Row]:
    """Constants of every law of each quantity whose laws are compared.

    Each draw of the population has one law. The rows of a law are of the draws that have it, so
    they hold given that law; a law of too few draws has none. R̂ and effective sample sizes of such
    a part of the chains are not known.
    """
    unit, reference = actuation_unit, population.design.reference
    at = system.words([reference], unit, actuation=True)
    rows = []
    for name, law, picked in _chosen(population):
        weight = population.law_weights[name].get(law, 0.0)
        about = f"{law} law, weight {weight:.2g}"
        for constant, draws in _constants(population, name, law).items():
            of_level = constant == name
            rows.append(
                Row(
                    subject="population",
                    name=constant,
                    unit=units()[name] if of_level else law_unit(constant, unit),
                    **spread_of(draws[picked]),
                    r_hat=np.nan,
                    ess_bulk=np.nan,
                    ess_tail=np.nan,
                    contraction=np.nan,
                    note=f"{about}; at {at}" if of_level else about,
                )
            )
    return rows


def _chosen(population: Population) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Quantity, law, and which draws have it, (chain, draw), of all that have enough draws."""
    for column, (name, law) in enumerate(population.design.laws.items()):
        if law != COMPARE:
            continue
        for number, one in enumerate(LAW_NAMES):
            picked = population.choice[..., column] == number
            if np.count_nonzero(picked) >= FEWEST:
                yield name, one, picked


def _constants(population: Population, name: str, law: str) -> dict[str, Array]:
    """Constants of a quantity's law by name, (chain, draw): slope, intercept, level, exponent."""
    design, known = population.design, LAWS[law]
    level = population.median(name, np.array([design.reference]))[..., 0]
    share, exponent = population.shapes(name)
    found: dict[str, Array] = {}
    if known.exponent == 1.0 and known.share != 0.0 and name in _SLOPES:
        found[_SLOPES[name]] = level * share / design.reference
    else:
        found[name] = level
    if f"{name}_0" in INTERCEPTS and "share" in known.shapes:
        found[f"{name}_0"] = level * (1.0 - share)
    if "exponent" in known.shapes:
        found[f"exponent_{name}"] = exponent
    return found
