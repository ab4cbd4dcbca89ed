"""A bank of dampers with motions of their own equals each damper stepped by itself."""

import numpy as np
import pytest

from mfd_bayes.errors import FitError
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.banks import OneByOne, PlasticBank, bank_of
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.friction.weakened import Weakened

N = 6
FOLLOWERS = ("Fc_fwd", "Fs_fwd", "sigma0")


def three_stage(rng):
    slip = rng.uniform(1.2, 2.0, N)
    columns = (
        *(rng.uniform(20, 100, N), rng.uniform(0, 0.1, N), rng.uniform(0, 0.05, N)),
        *(1.4 * slip, slip, 1.3 * slip, 1.1 * slip),
        *(rng.uniform(1, 5, N), rng.uniform(5, 20, N), rng.uniform(0.05, 0.3, N)),
        *(rng.uniform(0.02, 0.1, N), np.ones(N), rng.uniform(0.001, 0.02, N)),
        rng.uniform(0.1, 0.5, N),
    )
    return ThreeStage(), np.column_stack(columns)


def lugre(rng):
    return LuGre(), three_stage(rng)[1][:, [0, 1, 2, 3, 4, 5, 6, 13]]


def bouc_wen(rng):
    ranges = ((20, 100), (0, 0.05), (1, 2), (1, 2), (0.5, 1), (1, 4), (0, 0.1))
    return BoucWen(), np.column_stack([rng.uniform(*ends, N) for ends in ranges])


def backlash(rng):
    ranges = ((37, 60), (37, 60), (0.16, 0.23), (0.02, 0.03), (0.5, 2), (2, 3), (3, 4), (1, 6))
    ranges = (*ranges, (0, 0.01), (0, 0.2), (0, 0.2), (0.3, 1))
    return BacklashLuGre(), np.column_stack([rng.uniform(*ends, N) for ends in ranges])


def weakened(made):
    def both(rng):
        model, theta = made(rng)
        return Weakened(model), np.column_stack([theta, rng.uniform(-0.3, 0.3, (N, 2))])

    return both


WEAKENED = tuple(map(weakened, (three_stage, lugre, bouc_wen)))


def motion(rng):
    """Displacements and velocities of N motions of two frequencies, as functions of time."""
    size, sign = rng.uniform(0.05, 1.5, N), rng.choice([-1.0, 1.0], N)
    slow, fast = rng.uniform(2, 9, N), rng.uniform(10, 30, N)

    def at(t):
        x = size * sign * (np.sin(slow * t) + 0.2 * np.sin(fast * t))
        v = size * sign * (slow * np.cos(slow * t) + 0.2 * fast * np.cos(fast * t))
        return x, v

    return at


@pytest.mark.parametrize("made", [three_stage, lugre, bouc_wen, backlash, *WEAKENED])
@pytest.mark.parametrize("varying", [False, True])
def test_a_bank_equals_its_dampers_one_by_one(made, varying):
    rng = np.random.default_rng(3)
    model, theta = made(rng)
    start, at = rng.uniform(0, 1, N), motion(rng)
    bank, each = bank_of(model, theta, start), OneByOne.at_rest(model, theta, start)
    names = model.slip_forces if made in (bouc_wen, backlash, WEAKENED[2]) else FOLLOWERS
    # the backlash model solves each step by a method of its own there
    near, change = (0.02, 0.1) if made is backlash else (1e-9, 0.5)
    for k in range(1, 150):
        scales = {n: np.full(N, 1 + change * np.sin(0.1 * k)) for n in names} if varying else None
        bank, each = (b.step(*at(0.01 * k), 0.01, scales) for b in (bank, each))
        assert np.allclose(bank.force, each.force, rtol=0, atol=near)
    assert np.ptp(bank.force) > 0.1


@pytest.mark.parametrize("made", [three_stage, bouc_wen, backlash, *WEAKENED])
def test_chosen_dampers_go_on_as_they_would_have(made):
    rng = np.random.default_rng(4)
    model, theta = made(rng)
    at, rows = motion(rng), np.array([4, 1])
    bank = bank_of(model, theta)
    for k in range(1, 40):
        bank = bank.step(*at(0.02 * k), 0.02)
    some = bank.chosen(rows)
    for k in range(40, 80):
        x, v = at(0.02 * k)
        bank, some = bank.step(x, v, 0.02), some.step(x[rows], v[rows], 0.02)
    assert np.allclose(some.force, bank.force[rows], rtol=0, atol=1e-7)


def test_a_step_leaves_its_bank_as_it_was():
    model, theta = three_stage(np.random.default_rng(5))
    bank = bank_of(model, theta).step(np.full(N, 0.3), np.full(N, 2.0), 0.1)
    before = bank.force.copy()
    one = bank.step(np.full(N, 0.2), np.full(N, -1.0), 0.1).force
    two = bank.step(np.full(N, 0.2), np.full(N, -1.0), 0.1).force
    assert np.array_equal(one, two)
    assert np.array_equal(bank.force, before)


def test_a_plastic_spring_slips_at_its_strength():
    bank = PlasticBank.at_rest(np.array([10.0]), np.array([2.0]))
    forces = []
    for x in (0.1, 0.5, 0.4, 0.0):
        bank = bank.step(np.array([x]), np.zeros(1), 0.1)
        forces.append(float(bank.force[0]))
    assert np.allclose(forces, [1.0, 2.0, 1.0, -2.0])


def test_a_model_without_steps_is_refused():
    class Still(Model):
        name = "still"

    with pytest.raises(FitError, match="no step in time"):
        bank_of(Still(), np.ones((1, 1)))


@pytest.mark.parametrize("made", [three_stage, lugre, bouc_wen, backlash, *WEAKENED])
def test_some_dampers_stepped_again_are_put_back_in_their_places(made):
    rng = np.random.default_rng(4)
    model, theta = made(rng)
    at, dt, rows = motion(rng), 0.01, np.array([1, 4])
    bank = bank_of(model, theta, np.full(N, 0.5) if model.has_gap else None).step(*at(dt), dt)
    x, v = at(2 * dt)
    wrong = x.copy()
    wrong[rows] += 0.1
    again = bank.chosen(rows).step(x[rows], v[rows], dt)
    mended = bank.step(wrong, v, dt).replaced(rows, again)
    assert np.allclose(mended.force, bank.step(x, v, dt).force, rtol=1e-12)
    after = at(3 * dt)
    expected = bank.step(x, v, dt).step(*after, dt).force
    assert np.allclose(mended.step(*after, dt).force, expected, rtol=1e-12)
