"""A population and its NetCDF file, in which the paper's constants stand by name."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.population.design import Setting, design_of
from mfd_bayes.population.joint_fit import Residual, TravelBasis
from mfd_bayes.population.population import LawDraws, Population, Starts
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import load_arrays, save_arrays

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mfd_bayes.calibration.priors import PriorFile
    from mfd_bayes.friction.model import Model

Array = NDArray[np.float64]

FORMAT = "mixed model 1"  # kind of stored population; others are not read
_RESIDUAL = ("mean", "covariance", "log_shape")
_FIGURES = ("slip_force", "stroke_share", "lag_one", "noise_time", "travel")


def save_population(path: Path, population: Population) -> None:
    """Write the draws of a population, and all else that it holds."""
    design, residual, starts = population.design, population.residual, population.starts
    arrays: dict[str, Array] = {
        **population.slopes,
        **{f"scatter_{name}": tau for name, tau in population.scatters.items()},
        **{f"deviation_{name}": omega for name, omega in population.effect_sds.items()},
        **{f"draws_{k}": v for k, v in vars(population.draws).items()},
        "law": population.choice.astype(np.float64),
    }
    facts = {
        "format": FORMAT,
        "names": [*design.names, *design.coordinates.names[len(design.names) :]],
        "settings": [asdict(setting) for setting in design.settings],
        "laws": design.laws,
        "dependence": design.dependence,
        "weights": population.law_weights,
        "alternatives": {k: v.tolist() for k, v in vars(population.alternatives).items()},
        "alternative_weight": population.alternative_weight.tolist(),
        "start_weights": None if starts.weights is None else starts.weights.tolist(),
        "unloaded": starts.unloaded,
        "actuation_unit": population.actuation_unit,
        "walkers": population.walkers,
        "basis": asdict(residual.basis),
        "residual": {name: getattr(residual, name) for name in _FIGURES},
        "discrepancy": {name: getattr(residual, name).tolist() for name in _RESIDUAL},
        **{name: value.tolist() for name, value in vars(population.convergence).items()},
    }
    save_arrays(path, arrays, json.loads(json_text(facts)))


def load_population(path: Path, priors: PriorFile, model: Model | None = None) -> Population:
    """Population of a file written by `save_population`; `model` is that of its tests."""
    arrays, facts = load_arrays(path)
    if facts.get("format") != FORMAT:
        raise StoreError(
            f"{path} holds a population of another version of this program: run "
            "mfd-bayes calibrate again"
        )
    try:
        return _population(arrays, facts, priors, model)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, MfdError) as error:
        raise StoreError(f"{path} is damaged: {error}") from error


def _population(
    arrays: Mapping[str, Array], facts: Mapping[str, Any], priors: PriorFile, model: Model | None
) -> Population:
    values = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
    settings = [Setting(**one) for one in facts["settings"]]
    laws, dependence = facts["laws"], facts["dependence"]
    design = design_of(priors, facts["names"], settings, laws, dependence, model)
    draws = LawDraws(**{k: values[f"draws_{k}"] for k in ("h", "z", "share", "exponent")})
    other = LawDraws(**{k: np.array(v, dtype=np.float64) for k, v in facts["alternatives"].items()})
    z = design.row(settings[0]).size  # which fails where a covariate is unknown
    sizes = (draws.h.shape[-1], draws.z.shape[-1], other.z.shape[-1])
    if sizes != (design.free.size + len(design.effects), z, z):
        raise ValueError("its draws do not fit its design")
    if not all(np.all(np.isfinite(value)) for value in values.values()):
        raise ValueError("it holds numbers that are not finite")
    starts = Starts.of(priors.parameters.get("start"))
    if facts["start_weights"] is not None and starts.fixed is None:
        starts = Starts(np.array(facts["start_weights"]), float(facts["unloaded"]))
    discrepancy: dict[str, Any] = {k: np.array(v) for k, v in facts["discrepancy"].items()}
    return Population(
        design=design,
        draws=draws,
        choice=values["law"].astype(np.intp),
        law_weights=facts["weights"],
        alternatives=other,
        alternative_weight=np.array(facts["alternative_weight"]),
        residual=Residual(TravelBasis(**facts["basis"]), **discrepancy, **facts["residual"]),
        starts=starts,
        priors=priors.parameters,
        actuation_unit=facts["actuation_unit"],
        walkers=int(facts["walkers"]),
        convergence=Convergence(*(np.array(facts[k]) for k in ("r_hat", "ess_bulk", "ess_tail"))),
    )


def save_test_draws(
    path: Path, values: Mapping[str, Array], units: Mapping[str, str], test: str
) -> None:
    """Write a test's posterior with the others: named variables (chain, draw) with units."""
    save_arrays(path, values, {"test": test}, units)
