"""The backlash model's physics: an ODE solver, closed forms, memory and energy."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.records.loops import loop_estimate
from mfd_bayes.records.trace import Trace
from tests.friction.backlash_cases import (
    MODEL,
    VALUES,
    of_sine,
    of_walk,
    sine,
    theta,
    walk,
)

BAR = 2e-3  # of the peak


def off(force, expected):
    return np.max(np.abs(force - expected)) / np.max(np.abs(expected))


def test_force_equals_an_ode_solver_in_full_and_partial_cycles_and_in_the_gap():
    for n in [1.0, 6.0]:
        for amplitude in [1.0, 0.15, 0.05]:
            values, trace = VALUES | {"n": n}, sine(amplitude)
            assert off(MODEL.force(theta(n=n), trace)[0], of_sine(trace, amplitude, values)) < BAR


def test_a_random_walk_equals_an_ode_solver():
    for size, seed in [(0.01, 1), (0.05, 2), (0.3, 3)]:
        trace = walk(seed, samples=60, size=size)
        values = VALUES | {"n": 1.0 + 2.0 * seed, "gap": 0.1 * (seed - 1)}
        batch = theta(n=values["n"], gap=values["gap"])
        assert off(MODEL.force(batch, trace)[0], of_walk(trace, values)) < BAR


def test_a_varying_actuation_equals_an_ode_solver():
    def level(time):
        return 1 + 0.5 * np.sin(2.2 * time)

    trace = sine(0.5, actuation=level(np.arange(0, 5, 0.005)))
    mean = trace.reference_actuation
    expected = of_sine(trace, 0.5, VALUES, lambda t: level(t) / mean)
    assert off(MODEL.force(theta(), trace)[0], expected) < BAR


def test_stages_follow_each_other_after_a_turn():
    """Slip, then unloading, the gap, build-up and slip again; shares of the way as they must be."""
    batch, trace = theta(n=8.0), sine(1.0, seconds=6.0, rate=400.0)
    turn, end = 400 * np.array([2.5, 3.45])  # a turn is at 2.5 s, the next at 3.5 s
    part = slice(int(turn) + 2, int(end))
    stage = MODEL.stages(batch, trace)[0, part]
    changes = stage[np.append(True, np.diff(stage) != 0)]
    np.testing.assert_array_equal(changes, [2, 4, 3, 1])
    way = np.abs(np.diff(trace.displacement))[part.start : part.stop]
    stuck, inside, built = (way[stage == k].sum() for k in (2, 4, 3))
    top = VALUES["Fc_fwd"] * (1 + VALUES["static_excess_fwd"])
    assert inside == pytest.approx(VALUES["gap"], rel=0.05)
    assert stuck == pytest.approx(top / VALUES["k_fwd"], rel=0.3)
    assert built == pytest.approx(VALUES["Fc_bwd"] / VALUES["k_bwd"], rel=0.3)


def test_the_travel_from_slip_to_slip_is_what_a_loop_shows():
    values = {name: np.array([value]) for name, value in VALUES.items()}
    expected = 0.2 + 2.2 / 50.0 + 1.8 / 42.0
    np.testing.assert_allclose(MODEL.gap_width(values), expected)
    trace = sine(1.0, seconds=8.0)
    force = MODEL.force(theta(n=12.0, ell=0.005), trace)[0]
    read = loop_estimate(replace(trace, force=force))
    assert read.gap == pytest.approx(expected, rel=0.1)


def test_friction_that_falls_lets_go_as_the_motion_goes_on():
    for back in [1.0, -1.0]:
        for n in [1.0, 20.0]:
            motion = np.concatenate(
                [np.linspace(0, 1, 50), np.ones(5), 1 + back * np.linspace(0, 0.5, 50)]
            )
            level = np.where(np.arange(105) < 52, 1.0, 1e-9)
            still = np.zeros(105)
            trace = Trace.from_arrays(
                np.arange(105) * 0.01, motion, actuation=level, velocity=still
            )
            force = MODEL.force(theta(k_0=0.0, n=n), trace)[0]
            np.testing.assert_allclose(force[50:55], force[49], rtol=1e-9)  # nothing moves
            assert abs(force[-1]) < 1e-3 * force[49]


STUBBORN = [6.54, 1300.0, 0.0323, 0.0808, 0.002, 15.6, 0.00112, 1.0, 0.038, 0.336, 0.109, 1.39]
"""A damper that is hard to solve: it slips backward at a thousandth of the force."""

SUDDEN = {"k_fwd": 4.7e4, "ell": 4e-5, "Fc_fwd": 0.1, "n": 1.02}
"""A damper that slips at once at every turn, in a ten thousandth of an inch."""


def test_dampers_that_are_hard_to_solve_leave_the_others_of_their_batch_alone():
    batch = np.concatenate([theta(), [STUBBORN], theta(**SUDDEN), theta(n=400.0)])
    for trace in (sine(), walk(3)):
        with np.errstate(all="ignore"):
            alone = np.concatenate([MODEL.force_unbounded(row[None], trace) for row in batch])
            together = MODEL.force_unbounded(batch, trace)
        np.testing.assert_allclose(together, alone, atol=1e-5)
        assert np.all(np.isfinite(together[0]))
