"""Time integration beside closed forms and lsim; energy, and draws that are named."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from mfd_bayes.applications.buildings.building import Content, building_of
from mfd_bayes.applications.buildings.dampers import Dampers, no_dampers
from mfd_bayes.applications.buildings.ground import Ground
from mfd_bayes.applications.buildings.time_integration import equilibrium, integrate, settle
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import find_model
from mfd_bayes.friction.quantities import Parameter
from mfd_bayes.records.trace import Trace

RATIO = 0.05
FINE = 0.01
"""Largest bend of forces within a step."""


def shear_building(storeys=3, *, dampers=True, stiffness=100.0, yields=None, brace="rigid"):
    """Equal storeys with 5 % in every mode."""
    storey = {"mass": "0.2 kip*s^2/in", "height": "144 in", "stiffness": f"{stiffness} kip/in"}
    if yields:
        storey["yield_force"] = f"{yields} kip"
    places = range(1, storeys + 1) if dampers else ()
    content = {
        "building": {"damping": {"kind": "modal", "ratio": RATIO}},
        "storey": [storey] * storeys,
        "damper": [{"storey": i, "actuation": "1 ksi", "brace": brace} for i in places],
    }
    return building_of(Content.model_validate(content), Path("b.toml"))


def shaking(samples=100, seed=1, peak=150.0):
    white = np.random.default_rng(seed).standard_normal(samples)
    values = np.convolve(white, np.hanning(7), mode="same")
    return Ground("random", 0.02, peak * values / np.abs(values).max())


def bouc_wen(n, m, slip=8.0, spread=0.1, seed=2):
    rng = np.random.default_rng(seed)
    row = np.array([80.0, 0.02, slip, slip, 0.6, 1.5, 0.02])
    theta = np.broadcast_to(row, (n, m, 7)).copy()
    theta[..., 2:4] *= np.exp(spread * rng.standard_normal((n, m, 1)))
    return Dampers(BoucWen(), theta, np.full((n, m), 0.5), theta[..., 2])


@pytest.mark.parametrize("step", [0.02, 0.05])
def test_a_linear_building_follows_the_closed_form_of_its_modes(step):
    building = shear_building(dampers=False)
    ground = Ground("constant", step, np.full(200, 40.0))
    solution = integrate(building, ground, no_dampers(), FINE)
    modes, t = building.modes, ground.time[:, None]
    omega = modes.frequencies
    damped = omega * np.sqrt(1 - RATIO**2)
    wave = np.cos(damped * t) + RATIO / np.sqrt(1 - RATIO**2) * np.sin(damped * t)
    share = modes.shapes.T @ building.mass @ building.influence
    q = -40.0 * share / omega**2 * (1 - np.exp(-RATIO * omega * t) * wave)
    drift = q @ modes.shapes.T @ building.drifts.T
    assert np.abs(solution.histories[0][0] - drift).max() < 1e-6 * np.abs(drift).max()  # in float32
    assert np.all(solution.drift[0, 0] >= (1 - 1e-9) * np.abs(drift).max(axis=0))
    assert solution.imbalance[0, 0] < 1e-7


def test_energy_is_accounted_for():
    for brace in ("rigid", "60 kip/in"):
        building = shear_building(2, brace=brace, yields=25)
        solution = integrate(building, shaking(60, peak=300.0), bouc_wen(2, 2), 0.03)
        assert solution.imbalance.max() < 1e-5
        assert solution.energy.min() > 0
        assert np.all(solution.open == 0)


ROWS = {
    "lugre": (80.0, 0.16, 0.02, 5.5, 5.0, 6.3, 5.5, 0.6),
    "bouc_wen": (40.0, 0.03, 5.0, 5.6, 0.7, 1.8, 0.01),
    "backlash": (55.0, 65.0, 0.25, 0.02, 1.0, 5.0, 5.6, 3.0, 0.02, 0.1, 0.15, 0.6),
    "three_stage": (80.0, 0.16, 0.02, 5.5, 5.0, 6.3, 5.5, 3.0, 35.0, 0.2, 0.1, 1.0, 0.04, 0.6),
}


@pytest.mark.parametrize("name", ROWS)
def test_one_storey_moves_as_a_linear_one_under_the_force_that_its_model_predicts(name):
    building, model, row = (
        shear_building(1, stiffness=25.0),
        find_model(name),
        np.array([ROWS[name]]),
    )
    coarse = shaking(100, peak=140.0)
    time = np.arange(0.0, coarse.time[-1], 0.001)
    ground = Ground("fine", 0.001, np.interp(time, coarse.time, coarse.acceleration))
    dampers = Dampers(model, row[None], np.full((1, 1), 0.5), np.full((1, 1), 5.0))
    solution = settle(building, ground, dampers, 0.002)
    x, pull = solution.travels[0][0, :, 0].astype(float), solution.forces[0][0, :, 0]
    force = model.force(row, Trace.from_arrays(ground.time, x, hysteresis=0.0), 0.5)[0]
    assert solution.travel[0, 0, 0] == pytest.approx(np.abs(x).max(), rel=1e-3)
    assert solution.force[0, 0, 0] == pytest.approx(np.abs(pull).max(), rel=1e-3)
    assert solution.travel[0, 0, 0] > 0.3
    assert np.allclose(force, pull, atol=0.002 * np.abs(pull).max())
    m, c, k = building.mass[0, 0], building.damping[0, 0], building.stiffness[0, 0]
    lti = signal.StateSpace([[0.0, 1.0], [-k / m, -c / m]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    _, expected, _ = signal.lsim(lti, -ground.acceleration - (force - force[0]) / m, ground.time)
    assert np.allclose(x, expected, atol=0.002 * np.abs(x).max())


def test_draws_do_not_meet_each_other():
    building, ground, draws = shear_building(2), shaking(60, peak=300.0), 60
    dampers, rows = bouc_wen(draws, 2, spread=1.0), np.array([0, draws // 2, draws - 1])
    together = integrate(building, ground, dampers, FINE, count=draws)
    subset = integrate(building, ground, dampers.chosen(rows), FINE, count=3)
    assert np.unique(together.steps).size > 1
    assert np.allclose(together.drift[rows], subset.drift, rtol=1e-6)
    assert np.allclose(together.histories[0][rows], subset.histories[0], atol=1e-5)
    assert np.allclose(together.forces[0][rows], subset.forces[0], atol=1e-4)


def test_steps_are_short_where_forces_bend_and_change_less_than_is_estimated():
    building, loud = shear_building(2), shaking(60, peak=300.0)
    quiet = replace(loud, acceleration=0.02 * loud.acceleration)
    regular, long = (integrate(building, g, bouc_wen(4, 2), 0.03) for g in (loud, quiet))
    assert regular.steps.max() <= 0.01 < long.steps.min()
    fine = integrate(building, loud, bouc_wen(4, 2), 0.001)
    assert np.abs(regular.drift / fine.drift - 1.0).max() < 0.003
    error = np.abs(regular.drift - fine.drift).max(axis=2) / fine.drift.max(axis=2)
    assert np.all(error < regular.change)
    rough = settle(building, loud, bouc_wen(4, 2), 1e-6, rounds=0)
    assert rough.change.max() > 1e-6  # a tolerance that cannot be reached is not said to be


class Dashpot(Model):
    """A user's own model that can stand in a building."""

    name = "dashpot"
    parameters = (Parameter("c", "kip*s/in"),)

    def force(self, theta, trace):
        return theta * trace.velocity

    def start(self, theta):
        return {"c": theta[:, 0]}

    def step(self, state, displacement, velocity, dt):
        return state["c"] * velocity, state


def test_a_model_of_ones_own_stands_in_a_building():
    c = 0.8
    dampers = Dampers(Dashpot(), np.full((2, 2, 1), c), np.full((2, 2), 0.5), np.ones((2, 2)))
    solution = integrate(shear_building(2), shaking(), dampers, FINE)
    bare = shear_building(2, dampers=False)
    damped = replace(bare, damping=bare.damping + c * bare.drifts.T @ bare.drifts)
    expected = integrate(damped, shaking(), no_dampers(), FINE)
    assert np.allclose(solution.drift, expected.drift, rtol=1e-3)
    assert not np.allclose(integrate(bare, shaking(), no_dampers(), FINE).drift, expected.drift)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_softening_dampers_that_share_a_travel_have_a_regular_equilibrium(count):
    """Forces fall steeply with the travel: clipped for each damper alone, two are singular."""

    class Softening:
        def step(self, travel, velocity, size, time):
            return SimpleNamespace(force=1.0 - 0.6 * np.clip(travel + count, -1.0, 1.0))

    flexibility, begin = -np.ones((count, count)), np.full((2, 1, count), 1.2)
    solution = equilibrium(
        *(Softening(), lambda force: (force @ flexibility, 0.0 * force), (0.02, 0.02)),
        *(flexibility, (begin[0], 0.0 * begin[1]), np.full((1, count), 1e-6), 30),
    )
    assert np.all(np.isfinite(solution[1]))
