"""Draws of dampers: their actuation may change in time, and a discrepancy comes on top."""

import numpy as np
import pytest

from mfd_bayes.applications.buildings.building import read_building
from mfd_bayes.applications.buildings.dampers import SETTLE, Leftover, draw_dampers
from mfd_bayes.population.population import KNOTS, InitialGapPrior, TravelBasis
from mfd_bayes.records.trace import Trace
from tests.population.made import make_predictor

STOREY = '[[storey]]\nweight = "20 kip"\nheight = "144 in"\nstiffness = "8 kip/in"\n'
CHANGING = '{{ file = "{}.csv", column = "pressure_ksi", unit = "ksi" }}'
VALVE, SLOWER = CHANGING.format("valve"), CHANGING.format("slower")
SD = 0.3
CHOICE = {"kind": "mean", "draws": 2000, "seed": 1, "session": "another"}


@pytest.fixture(scope="module")
def predictor():
    """Levels of actuation deviate from the laws."""
    power = {"Fc_fwd": "power", "Fc_bwd": "power"}
    effect = {"level_friction": SD}
    return make_predictor("three_stage", laws=power, effect=effect, scatter=0.15, level_sd=0.03)


def building_of(folder, *actuations):
    """A building of two storeys, with a damper of each actuation."""
    text = 2 * STOREY
    for i, actuation in enumerate(actuations):
        text += f"[[damper]]\nstorey = {min(i + 1, 2)}\nactuation = {actuation}\n"
    (folder / "building.toml").write_text(text)
    return read_building(folder / "building.toml")


def dampers(predictor, folder, final, *actuations, choice=CHOICE):
    """Dampers whose valves open or close to a last actuation, ksi."""
    for name, initial in (("valve", 1.0), ("slower", 1.8)):
        rows = f"0,{initial}\n1,{initial}\n1.01,{final}\n2.01,{final}\n"
        (folder / f"{name}.csv").write_text("time_s,pressure_ksi\n" + rows)
    building = building_of(folder, *actuations)
    return draw_dampers(predictor.population, predictor.model, building, **choice)


def column_of(predictor, name):
    return predictor.model.parameters.index(name)


def slip_of(predictor, bank, index):
    """Forward slip force at one time of the history, (n, 2), kip."""
    scale = bank.scales["Fc_fwd"][:, :, index] if bank.scales else 1.0
    return bank.theta[:, :, column_of(predictor, "Fc_fwd")] * scale


def test_each_damper_has_a_scatter_of_its_own_and_all_share_the_law(tmp_path):
    two = ['"1000 psi"'] * 2

    def slips(scatter, level_sd):
        scatter_sd, level = {"Fc_fwd": 0.1}, {"Fc_fwd": level_sd}
        source = make_predictor("three_stage", scatter=scatter_sd, level_sd=level)
        choice = {"draws": 1000, "seed": 3, "scatter": scatter}
        return np.log(slip_of(source, dampers(source, tmp_path, 1, *two, choice=choice), 0))

    zero, single, double = (slips(scatter, 0.0) for scatter in (0.0, 1.0, 2.0))
    assert np.ptp(zero) < 1e-9
    np.testing.assert_allclose(single.std(axis=0), 0.1, rtol=4.0 / np.sqrt(2000.0))
    np.testing.assert_allclose(double.std(axis=0), 0.2, rtol=4.0 / np.sqrt(2000.0))
    assert abs(np.corrcoef(single.T)[0, 1]) < 4.0 / np.sqrt(1000.0)
    slip_a, slip_b = slips(0.0, 0.1).T
    assert slip_a.std() > 0.08
    np.testing.assert_allclose(slip_a, slip_b)


def test_a_history_that_never_changes_is_the_constant(predictor, tmp_path):
    history, constant = (dampers(predictor, tmp_path, 1, *2 * [a]) for a in (VALVE, '"1000 psi"'))
    np.testing.assert_allclose(history.theta, constant.theta)
    np.testing.assert_allclose(history.scales["Fc_fwd"], 1.0)


@pytest.mark.parametrize("second_valve", [SLOWER, '"2000 psi"'])
def test_dampers_at_one_actuation_are_alike_whatever_was_before(predictor, tmp_path, second_valve):
    bank = dampers(predictor, tmp_path, 2, VALVE, second_valve)
    initial, slip = (np.log(slip_of(predictor, bank, index)) for index in (0, -1))
    np.testing.assert_allclose(slip[:, 0], slip[:, 1], atol=0.03)
    assert np.std(initial[:, 0] - initial[:, 1]) > 0.15  # the control: at 1 ksi, and at another


def test_dampers_of_a_building_deviate_from_the_laws_alike(predictor, tmp_path):
    bank = dampers(predictor, tmp_path, 2, VALVE, VALVE)
    np.testing.assert_array_equal(bank.scales["Fc_fwd"][:, 0], bank.scales["Fc_fwd"][:, 1])
    # what the laws say of each draw is known; the sd of the rest falls with the actuation, and
    # levels one octave apart are related
    population, rng = predictor.population, np.random.default_rng([CHOICE["seed"], 0])
    index = population.draw_index(CHOICE["draws"], 1.0, rng)
    law = population.median("Fc_fwd", np.array([1.0, 2.0])).reshape(-1, 2)[index]
    slip = np.stack([slip_of(predictor, bank, step)[:, 0] for step in (0, -1)], axis=1)
    deviation = np.log(slip / law)
    np.testing.assert_allclose(deviation.std(axis=0), [SD, SD / 2.0], rtol=0.15)
    assert np.corrcoef(deviation.T)[0, 1] == pytest.approx(0.48, abs=0.1)


def test_dampers_begin_without_load_where_the_tests_did(tmp_path):
    backlash = make_predictor(
        "backlash", starts=InitialGapPrior(None, 0.8), scatter=0.15, level_sd=0.03
    )
    bank = dampers(backlash, tmp_path, 1, *2 * ['"1000 psi"'])
    loads, model = [], backlash.model
    for theta, start in zip(bank.theta.swapaxes(0, 1), bank.start.T, strict=True):
        spring, _ = model.step(model.start(theta, start), 0.0, 0.0, 0.0)
        forward, backward = (theta[:, column_of(backlash, name)] for name in ("Fc_fwd", "Fc_bwd"))
        loads.append(np.abs(spring) / np.where(spring > 0.0, forward, backward))
    loaded = np.transpose(loads) > 0.25  # of the slip force
    # four of five do not, and some of the others
    assert np.all((loaded.mean(axis=0) > 0.01) & (loaded.mean(axis=0) < 0.2))
    # all dampers of a building do, or none; those that begin anywhere may still bear little
    assert np.corrcoef(loaded.T)[0, 1] > 0.1


# --- the discrepancy


def followed(x, coefficients, basis):
    state = Leftover.at_rest(basis, coefficients[None], np.ones((1, 1)))
    forces = []
    for position in x:
        state = state.step(np.array([position]), np.zeros(1), 0.0)
        forces.append(float(state.force[0]))
    return np.array(forces)


def test_the_discrepancy_is_that_of_predictions_away_from_turns_and_jumps_at_none():
    time = np.linspace(0.0, 6.0, 1201)
    trace = Trace.from_arrays(time, np.sin(2 * np.pi * time), hysteresis=0.0)
    basis = TravelBasis(2.0, 2.0)
    coefficients = np.random.default_rng(1).standard_normal(2 * KNOTS)
    expected = basis(trace) @ coefficients
    got = followed(trace.displacement, coefficients, basis)
    turns = np.concatenate([[0], trace.turning_points, [1200]])
    turn = turns[np.searchsorted(turns, np.arange(1201), side="right") - 1]
    settled = np.abs(trace.displacement - trace.displacement[turn]) > 1.1 * SETTLE * basis.longest
    settled[: turns[3]] = False
    assert settled.sum() > 500
    assert np.allclose(got[settled], expected[settled], atol=0.02 * np.ptp(expected))
    fine = followed(np.sin(2 * np.pi * np.linspace(0.0, 2.0, 4001)), coefficients, basis)
    assert np.abs(np.diff(fine)).max() < 0.06 * np.ptp(fine)
    small = followed(0.2 * trace.displacement, np.ones(2 * KNOTS), basis)
    assert np.abs(small).max() == 0.0
