"""The discrepancy along a motion is that of predictions, and is continuous at turns."""

import numpy as np

from mfd_bayes.population.discrepancy import KNOTS, TravelBasis
from mfd_bayes.records.trace import Trace
from mfd_bayes.response.leftover import SETTLE, Leftover


def followed(x, coefficients, basis):
    state = Leftover(basis, coefficients[None], np.ones((1, 1))).at_rest()
    forces = []
    for place in x:
        state = state.step(np.array([[place]]))
        forces.append(float(state.force[0, 0]))
    return np.array(forces)


def test_it_is_the_discrepancy_of_predictions_away_from_turns():
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


def test_it_does_not_jump_at_a_turn():
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
