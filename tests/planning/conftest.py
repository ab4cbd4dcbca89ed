"""Populations of given values, whose best next tests are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.design import Setting
from tests.population.made import THREE_STAGE, make_population, no_residual

MEDIANS = THREE_STAGE | {"offset": 0.0, "noise_sd": 0.01}
"""At 1 ksi."""

DRAWS = 1600


def make_situation(
    *,
    level=0.05,
    scatter=0.05,
    exponent=0.0,
    effect=1e-9,
    levels=(0.9, 1.0),
    sessions=(),
    devices=(),
    noise=0.01,
) -> tuple[Predictor, tuple[Candidate, ...]]:
    """Slip forces known to `level` at 1 ksi, with a scatter, and an exponent known so well.

    Tests were made at `levels`, in `sessions`, of `devices`; an effect of this size on slip forces
    is known to be 0 for them, and unknown for others. Everything else is known, and the same in all
    tests.
    """
    made = [*sessions, *[""] * len(levels)][: len(levels)]
    owned = [*devices, *[""] * len(levels)][: len(levels)]
    settings = [Setting(p, s, {}, d) for p, s, d in zip(levels, made, owned, strict=True)]
    slip = ("Fc_fwd", "Fc_bwd")
    population = make_population(
        settings,
        {"Fc_fwd": "power", "Fc_bwd": "power", "sigma0": "proportional"},
        medians=MEDIANS | {"noise_sd": noise},
        level_sd=dict.fromkeys(slip, level),
        scatter=dict.fromkeys(slip, scatter),
        effect=dict.fromkeys(("level_friction", "session_friction", "device_friction"), effect),
        exponent_sd=exponent,
        shape=(4, DRAWS // 4),
        residual=no_residual(noise_time=0.1),
    )
    design = population.design  # no more is unknown of levels than is said here
    design = replace(design, scatter_sd=np.zeros_like(design.scatter_sd))
    population = replace(population, design=design)
    tests = tuple(Candidate(p, 0.5, 1.0) for p in levels)
    return Predictor(population, ThreeStage(), find_noise("ou")), tests


@pytest.fixture(scope="session", name="make_situation")
def _make_situation() -> Callable[..., tuple[Predictor, tuple[Candidate, ...]]]:
    return make_situation
