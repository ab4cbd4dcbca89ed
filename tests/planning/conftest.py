"""Populations of given values, whose best next tests are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.study import Situation
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting

MEDIANS = {
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
    "offset": 0.0,
    "noise_sd": 0.01,
    "noise_time": 0.1,
}
"""At 1 ksi."""

DRAWS = 1600


def make_situation(
    *, level=0.05, scatter=0.05, exponent=0.0, effect=1e-9, levels=(0.9, 1.0), sessions=()
) -> Situation:
    """Slip forces known to `level` at 1 ksi, with a scatter, and an exponent known so well.

    Tests were made at `levels`, in `sessions`; an effect of this size on slip forces is known to be
    0 for them, and unknown for others. Everything else is known, and the same in all tests.
    """
    priors = load_priors("mfd")
    made = [*sessions, *[""] * len(levels)][: len(levels)]
    settings = [Setting(p, session) for p, session in zip(levels, made, strict=True)]
    laws = {"Fc_fwd": "power", "Fc_bwd": "power", "sigma0": "proportional"}
    layout = replace(lay_out(priors, tuple(MEDIANS), settings, laws), reference=1.0)
    rng = np.random.default_rng(1)
    d, shape = len(MEDIANS), (4, DRAWS // 4)
    cells, effects = sum(len(e.cells) for e in layout.effects), len(layout.effects)
    slip = np.array([name in ("Fc_fwd", "Fc_bwd") for name in layout.names])
    h = np.zeros((*shape, layout.dim))
    h[..., :d] = np.log(np.where(slip, scatter, 1e-9))
    follow = [any(slip[k] for k in e.members) for e in layout.effects]
    h[..., d : d + effects] = np.log(np.where(follow, effect, 1e-9))
    shapes = layout.dim - d - effects
    h[..., d + effects :] = 1.0 + exponent * rng.standard_normal((*shape, shapes))
    middle = layout.coordinates.of({n: np.array([v]) for n, v in MEDIANS.items()})[0]
    latent = middle + np.where(slip, level, 0.0) * rng.standard_normal((*shape, d)) - layout.centre
    population = Population(
        layout=layout,
        h=h,
        latent=np.concatenate(
            [(latent / layout.spread)[:, :, None, :], np.zeros((*shape, cells, d))], axis=2
        ),
        choice=layout.draw_choice(DRAWS).reshape(*shape, -1),
        together=np.broadcast_to(np.eye(d), (*shape, d, d)),
        priors={name: priors.parameters[name] for name in (*MEDIANS, "start", "gamma1")},
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(np.ones(1), np.ones(1), np.ones(1)),
    )
    tests = tuple(Candidate(p, 0.5, 1.0) for p in levels)
    return Situation(population, ThreeStage(), find_noise("ou"), tests, tuple(made))


@pytest.fixture(scope="session", name="make_situation")
def _make_situation() -> Callable[..., Situation]:
    return make_situation
