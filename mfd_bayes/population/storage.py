"""A population ⇄ its NetCDF file, in which the paper's constants stand by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.population.hierarchy import Population
from mfd_bayes.population.marginal import Pooling
from mfd_bayes.store import load_arrays, save_arrays


def save_population(path: Path, population: Population) -> None:
    """Write the draws of a population: slopes and intercepts, levels, shapes and scatter."""
    pooling, convergence = population.pooling, population.convergence
    arrays = {
        **population.slopes,
        **{f"scatter_{group}": tau for group, tau in population.scatters.items()},
        **{f"shape_{name}": shape for name, shape in population.shapes.items()},
        "levels": population.levels,
    }
    facts = {
        "names": pooling.names,
        "centre": pooling.centre.tolist(),
        "spread": pooling.spread.tolist(),
        "laws": pooling.laws,
        "groups": pooling.groups,
        "member": pooling.member.tolist(),
        "scatter_sd": pooling.scatter_sd.tolist(),
        "reference": pooling.reference,
        "actuation_unit": population.actuation_unit,
        "walkers": population.walkers,
        "r_hat": convergence.r_hat.tolist(),
        "ess_bulk": convergence.ess_bulk.tolist(),
        "ess_tail": convergence.ess_tail.tolist(),
    }
    save_arrays(path, arrays, facts)


def load_population(path: Path, priors: PriorFile) -> Population:
    """Population of a file written by `save_population`.

    Raises
    ------
    StoreError
        When the file is missing or is no such file.
    """
    arrays, facts = load_arrays(path)
    pooling = Pooling(
        names=tuple(facts["names"]),
        centre=np.array(facts["centre"]),
        spread=np.array(facts["spread"]),
        laws=facts["laws"],
        groups=tuple(facts["groups"]),
        member=np.array(facts["member"], dtype=np.intp),
        scatter_sd=np.array(facts["scatter_sd"]),
        reference=facts["reference"],
    )
    return Population(
        pooling=pooling,
        levels=arrays["levels"],
        shapes={name: arrays[f"shape_{name}"] for name in pooling.shaped},
        scatter=np.stack([arrays[f"scatter_{group}"] for group in pooling.groups], axis=-1),
        priors=priors.parameters,
        actuation_unit=facts["actuation_unit"],
        walkers=facts["walkers"],
        convergence=Convergence(
            np.array(facts["r_hat"]), np.array(facts["ess_bulk"]), np.array(facts["ess_tail"])
        ),
    )
