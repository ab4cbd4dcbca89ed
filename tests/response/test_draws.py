"""Draws of dampers whose actuation changes in time."""

import numpy as np
import pytest

from mfd_bayes.population.joint_fit import KNOTS, TravelBasis
from mfd_bayes.records.trace import Trace
from mfd_bayes.response.building import read_building
from mfd_bayes.response.device_draws import SETTLE, Choice, Leftover, draw_dampers
from tests.friction.backlash_cases import loads
from tests.response.populations import make_predictor

BUILDING = """
[building]
title = "Two storeys"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
"""
HISTORY = """
[[damper]]
storey = {storey}
actuation = {{ file = "valve.csv", column = "pressure_ksi", unit = "ksi" }}
"""
CONSTANT = """
[[damper]]
storey = {storey}
actuation = "1000 psi"
"""
SD = 0.3
CHOICE = Choice(kind="device", draws=2000, session="another")


@pytest.fixture(scope="module")
def predictor():
    """Levels of actuation deviate from the laws."""
    return make_predictor(level_sd=SD)


def dampers(predictor, folder, last, text=HISTORY, other=""):
    """Those of two storeys, whose actuation goes from 1 ksi to another."""
    for name, first in (("valve", 1.0), ("slower", 1.8)):
        (folder / f"{name}.csv").write_text(
            f"time_s,pressure_ksi\n0,{first}\n1,{first}\n1.01,{last}\n2.01,{last}\n",
            encoding="utf-8",
        )
    path = folder / "building.toml"
    both = text.format(storey=1) + (other or text).format(storey=2)
    path.write_text(BUILDING + both, encoding="utf-8")
    return draw_dampers(predictor.population, predictor.model, read_building(path), CHOICE)


def test_a_history_that_never_changes_is_the_constant(predictor, tmp_path):
    history, constant = (dampers(predictor, tmp_path, 1, text) for text in (HISTORY, CONSTANT))
    np.testing.assert_allclose(history.theta, constant.theta)
    np.testing.assert_allclose(history.scales["Fc_fwd"], 1.0)
    changing = dampers(predictor, tmp_path, 2)
    assert changing.scales["Fc_fwd"].shape == (CHOICE.draws, 2, changing.times.size)


@pytest.mark.parametrize(
    "other", [HISTORY.replace("valve", "slower"), CONSTANT.replace("1000", "2000")]
)
def test_dampers_at_one_actuation_are_alike_whatever_was_before(predictor, tmp_path, other):
    found = dampers(predictor, tmp_path, 2, other=other)
    column = [quantity.name for quantity in predictor.model.quantities].index("Fc_fwd")
    slip = np.log(found.theta[:, :, column] * found.scales["Fc_fwd"][:, :, -1])
    assert np.corrcoef(slip.T)[0, 1] > 0.99
    np.testing.assert_allclose(slip[:, 0], slip[:, 1], atol=0.03)
    before = np.log(found.theta[:, :, column] * found.scales["Fc_fwd"][:, :, 0])
    assert np.std(before[:, 0] - before[:, 1]) > 0.15  # the control: at 1 ksi, and at another


def test_dampers_of_a_building_deviate_from_the_laws_alike(predictor, tmp_path, monkeypatch):
    column = [quantity.name for quantity in predictor.model.quantities].index("Fc_fwd")

    def forward(found):
        """Logarithms of the first damper's forward slip force at 1 and at 2 ksi."""
        return np.log(found.theta[:, 0, column, None] * found.scales["Fc_fwd"][:, 0][:, [0, -1]])

    found = dampers(predictor, tmp_path, 2)
    np.testing.assert_array_equal(found.scales["Fc_fwd"][:, 0], found.scales["Fc_fwd"][:, 1])
    slip = forward(found)
    # what the laws say of each draw is known; the sd of the rest falls with the actuation, and
    # levels one octave apart are related
    population = predictor.population
    rng = np.random.default_rng([CHOICE.seed, 0])
    index = population.draw_index(CHOICE.draws, 1.0, rng)
    law = population.median("Fc_fwd", np.array([1.0, 2.0])).reshape(-1, 2)[index]
    away = slip - np.log(law)
    sds = population.effect_sds["level_friction"].ravel()[index]
    sd = np.sqrt(np.mean(sds**2))
    np.testing.assert_allclose(away.std(axis=0), [sd, sd / 2.0], rtol=0.15)
    assert np.corrcoef(away.T)[0, 1] == pytest.approx(0.48, abs=0.1)
    # the control: the laws hold along the history
    grid = type(population).grid
    monkeypatch.setattr(type(population), "grid", lambda self, level, _: grid(self, level, None))
    away = forward(dampers(predictor, tmp_path, 2)) - np.log(law)
    assert np.corrcoef(away.T)[0, 1] > 0.95


def test_dampers_begin_without_load_where_the_tests_did(tmp_path):
    backlash = make_predictor("backlash")

    def loaded():
        """Which dampers bear more than a quarter of the slip force before the motion, (n, 2)."""
        found = dampers(backlash, tmp_path, 1, CONSTANT)
        each = zip(found.theta.swapaxes(0, 1), found.start.T, strict=True)
        return np.abs([loads(*damper) for damper in each]).T > 0.25

    found = loaded()
    # four of five do, and some of the others
    assert np.all((found.mean(axis=0) > 0.01) & (found.mean(axis=0) < 0.2))
    # all dampers of a building do, or none; those that begin anywhere may still bear little
    assert np.corrcoef(found.T)[0, 1] > 0.1


def test_random_numbers_are_the_same_at_tested_levels_and_between(predictor, tmp_path):
    path = tmp_path / "building.toml"
    path.write_text(BUILDING + CONSTANT.format(storey=1), encoding="utf-8")
    building = read_building(path)
    column = [quantity.name for quantity in predictor.model.quantities].index("d2")

    def gaps(level, seed=1):
        choice = Choice("new_test", 400, seed)
        found = draw_dampers(
            predictor.population, predictor.model, building.at_level(level), choice
        )
        return np.log(found.theta[:, 0, column])

    tested = [setting.actuation for setting in predictor.population.design.settings]
    assert 1.0 in tested
    assert 1.2 not in tested
    assert np.corrcoef(gaps(1.0), gaps(1.2))[0, 1] > 0.99
    assert abs(np.corrcoef(gaps(1.0), gaps(1.2, seed=2))[0, 1]) < 0.5  # the control


def test_dampers_at_one_place_have_a_history_each(predictor, tmp_path):
    for name, level in (("valve", 2.0), ("slower", 0.5)):
        (tmp_path / f"{name}.csv").write_text(f"time_s,pressure_ksi\n0,1\n2,{level}\n")
    three = HISTORY + CONSTANT + HISTORY.replace("valve", "slower")
    path = tmp_path / "building.toml"
    path.write_text(BUILDING + three.format(storey=1), encoding="utf-8")
    building = read_building(path)
    _, levels = building.actuations
    assert [float(level[-1]) for level in levels] == [2.0, 1.0, 0.5]
    found = draw_dampers(predictor.population, predictor.model, building, CHOICE)
    last = np.median(found.scales["Fc_fwd"][:, :, -1] * found.slip, axis=0)
    assert last[0] > last[1] > last[2]


def followed(x, coefficients, basis):
    state = Leftover.at_rest(basis, coefficients[None], np.ones((1, 1)))
    forces = []
    for place in x:
        state = state.step(np.array([place]), np.zeros(1), 0.0)
        forces.append(float(state.force[0]))
    return np.array(forces)


def test_the_discrepancy_is_that_of_predictions_away_from_turns():
    time = np.linspace(0.0, 6.0, 1201)
    trace = Trace.from_arrays(time, np.sin(2 * np.pi * time), hysteresis=0.0)
    basis = TravelBasis(2.0, 2.0)
    coefficients = np.random.default_rng(1).standard_normal(2 * KNOTS)
    expected = basis(trace) @ coefficients
    got = followed(trace.displacement, coefficients, basis)
    turns = np.concatenate([[0], trace.turning_points, [1200]])
    last = turns[np.searchsorted(turns, np.arange(1201), side="right") - 1]
    away = np.abs(trace.displacement - trace.displacement[last]) > 1.1 * SETTLE * basis.longest
    away[: turns[3]] = False
    assert away.sum() > 500
    assert np.allclose(got[away], expected[away], atol=0.02 * np.ptp(expected))


def test_the_discrepancy_does_not_jump_at_a_turn():
    time = np.linspace(0.0, 4.0, 8001)
    basis = TravelBasis(2.0, 2.0)
    coefficients = np.random.default_rng(2).standard_normal(2 * KNOTS)
    force = followed(np.sin(2 * np.pi * time), coefficients, basis)
    assert np.abs(np.diff(force)).max() < 0.06 * np.ptp(force)


def test_small_strokes_have_none():
    time = np.linspace(0.0, 4.0, 401)
    basis = TravelBasis(2.0, 2.0)
    force = followed(0.2 * np.sin(2 * np.pi * time), np.ones(2 * KNOTS), basis)
    assert np.abs(force).max() == 0.0
