"""A population ⇄ its NetCDF file, in which the paper's constants stand by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.effects import Effect
from mfd_bayes.population.laws import LAWS
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.population import Population
from mfd_bayes.population.residual import Residual
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.stored import check_draws, check_facts
from mfd_bayes.population.strokes import StrokeLevels, no_levels
from mfd_bayes.population.travel import TravelBasis
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import load_arrays, save_arrays

Array = NDArray[np.float64]


def save_population(path: Path, population: Population) -> None:
    """Write the draws of a population: slopes and intercepts, levels, shapes and scatter.

    Raises
    ------
    StoreError
        When it cannot be written, or `load_population` would refuse it; nothing is written then.
    """
    convergence = population.convergence
    arrays: dict[str, Array] = {
        **population.slopes,
        **{f"scatter_{name}": tau for name, tau in population.scatters.items()},
        **{f"deviation_{name}": omega for name, omega in population.effect_sds.items()},
        "hyperparameters": population.h,
        "latent": population.latent,
        "law": population.choice.astype(np.float64),
        "together": np.asarray(population.together, dtype=np.float32),  # large
    }
    if population.starts is not None:
        arrays["starts"] = np.asarray(population.starts, dtype=np.float32)
    facts = {
        **_facts(population.layout),
        "left": None if population.left is None else population.left.tolist(),
        "unloaded": population.unloaded,
        "actuation_unit": population.actuation_unit,
        "walkers": population.walkers,
        "r_hat": convergence.r_hat.tolist(),
        "ess_bulk": convergence.ess_bulk.tolist(),
        "ess_tail": convergence.ess_tail.tolist(),
        "residual": _residual_facts(population.residual),
    }
    check_facts(json.loads(json_text(facts)), path)
    check_draws(population, path)
    save_arrays(path, arrays, facts)


def check_storable(layout: Layout, where: object) -> None:
    """Refuse a layout whose population could not be read once it is stored.

    `where` is the campaign file, for the message.

    Raises
    ------
    FitError
        When a figure of the tests is out of the range that is read.
    """
    rest = {"actuation_unit": "ksi", "walkers": 1, "r_hat": [], "ess_bulk": [], "ess_tail": []}
    try:
        check_facts(json.loads(json_text({**_facts(layout), **rest})), where)
    except StoreError as error:
        raise FitError(
            f"the tests of {where} have figures too large or too small to be stored: {error}"
        ) from error


def load_population(path: Path, priors: PriorFile) -> Population:
    """Population of a file written by `save_population`.

    Raises
    ------
    StoreError
        When the file is missing, damaged or of another version of the program.
    """
    arrays, facts = load_arrays(path)
    check_facts(facts, path)
    try:
        population = _population(arrays, facts, priors)
    except (KeyError, ValueError, TypeError) as error:
        raise StoreError(
            f"{path} is damaged or of another version of this program: {error}"
        ) from error
    check_draws(population, path)
    return population


def _population(
    arrays: Mapping[str, Array], facts: Mapping[str, Any], priors: PriorFile
) -> Population:
    laws = arrays["law"]
    if not np.all(np.isin(laws, np.arange(len(LAWS)))):
        raise ValueError("a law has a number that no known law has")
    return Population(
        layout=_layout_of(facts, priors),
        h=arrays["hyperparameters"].astype(np.float64),
        latent=arrays["latent"].astype(np.float64),
        choice=laws.astype(np.intp),
        together=arrays["together"].astype(np.float64),
        priors=priors.parameters,
        actuation_unit=facts["actuation_unit"],
        walkers=facts["walkers"],
        convergence=Convergence(
            np.array(facts["r_hat"]), np.array(facts["ess_bulk"]), np.array(facts["ess_tail"])
        ),
        residual=_residual_of(facts.get("residual")),
        starts=arrays["starts"].astype(np.float64) if "starts" in arrays else None,
        left=None if facts.get("left") is None else np.array(facts["left"], dtype=np.float64),
        unloaded=facts.get("unloaded", 0.0),
    )


def save_test_draws(
    path: Path, layout: Layout, draws: Array, units: Mapping[str, str], test: str
) -> None:
    """Write a test's posterior after layout: named variables (chain, draw) with units.

    Parameters
    ----------
    path : Path
    layout : Layout
    draws : (chain, draw, D)
        In prior units, shared coordinates first.
    units : mapping of str to str
    test : str
    """
    d = len(layout.names)
    q = layout.centre + layout.spread * draws.reshape(-1, draws.shape[2])[:, :d]
    values = layout.coordinates.values(q)
    arrays = {name: value.reshape(draws.shape[:2]) for name, value in values.items()}
    save_arrays(path, arrays, {"test": test}, units)


def _facts(layout: Layout) -> dict[str, Any]:
    """Layout as JSON can hold it."""
    found = {f.name: getattr(layout, f.name) for f in fields(layout) if f.name != "coordinates"}
    for name in ("centre", "spread", "member", "scatter_sd"):
        found[name] = found[name].tolist()
    for name in ("settings", "effects"):
        found[name] = [asdict(one) for one in found[name]]
    return {"names": layout.names, "speed": layout.coordinates.speed, **found}


def _layout_of(facts: Mapping[str, Any], priors: PriorFile) -> Layout:
    names, groups = tuple(facts["names"]), tuple(facts["groups"])
    scatter = np.array([priors.scatter[groups[g]].sd for g in facts["member"]])
    if not np.allclose(scatter, facts["scatter_sd"]):
        raise ValueError("its scatter is not that of the priors")
    arrays: dict[str, Any] = {k: np.array(facts[k]) for k in ("centre", "spread", "scatter_sd")}
    return Layout(
        coordinates=Coordinates(names, {n: priors.parameters[n] for n in names}, facts["speed"]),
        groups=groups,
        member=np.array(facts["member"], dtype=np.intp),
        settings=tuple(Setting(**s) for s in facts["settings"]),
        effects=tuple(effect_of(e) for e in facts["effects"]),
        dependence={name: tuple(those) for name, those in facts["dependence"].items()},
        sparse=tuple(facts.get("sparse", ())),
        common=tuple(facts.get("common", ())),
        odd=facts.get("odd", 0.0),
        **arrays,
        **{key: facts[key] for key in ("laws", "weights", "reference", "covariate_reference")},
    )


def effect_of(facts: Mapping[str, Any]) -> Effect:
    """Effect of what a file holds of it."""
    cells = tuple((str(session), float(at)) for session, at in facts["cells"])
    members, home = tuple(facts["members"]), tuple(facts["home"])
    kernel = facts.get("kernel", "exponential")  # which earlier versions do not name
    scale, reference = facts.get("scale", 1.0), facts.get("reference", 0.0)  # likewise
    return Effect(facts["name"], facts["group"], members, cells, home, kernel, scale, reference)


_FIGURES = ("slip_force", "noise_time", "information")
_ARRAYS = ("mean", "covariance", "log_shape")


def _residual_facts(residual: Residual | None) -> dict[str, Any] | None:
    """Discrepancy and noise as JSON can hold them."""
    if residual is None:
        return None
    arrays = {name: getattr(residual, name).tolist() for name in _ARRAYS}
    figures = {name: getattr(residual, name) for name in _FIGURES}
    levels = {**vars(residual.levels), "share": residual.levels.share.tolist()}
    return {"basis": asdict(residual.basis), "levels": levels, **arrays, **figures}


def _residual_of(facts: Mapping[str, Any] | None) -> Residual | None:
    if facts is None:
        return None
    found: dict[str, Any] = {name: facts[name] for name in _FIGURES}
    found |= {name: np.array(facts[name], dtype=np.float64) for name in _ARRAYS}
    basis = TravelBasis(**facts["basis"])
    levels = no_levels(basis.size)  # which earlier versions do not have
    known = facts.get("levels")
    if known:
        levels = StrokeLevels(**{**known, "share": np.array(known["share"], dtype=np.float64)})
    return Residual(basis=basis, levels=levels, **found)
