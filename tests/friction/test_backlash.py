"""The backlash model's physics: an ODE solver, closed forms, memory, and motions cut in two."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.records.cycles import features_of
from mfd_bayes.records.trace import Trace
from tests.friction.motions import (
    cut,
    off_after_cut,
    sine,
    solved_along_sine,
    solved_along_walk,
    walk,
)

MODEL = BacklashLuGre()
ROW = (50.0, 42.0, 0.2, 0.02, 0.4, 2.2, 1.8, 3.0, 0.02, 0.2, 0.15, 0.5)
VALUES = dict(zip(MODEL.parameters, ROW, strict=True))
BAR = 2e-3  # of the peak


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in MODEL.parameters]])


def vectors(n, seed=0, spread=0.4):
    rng = np.random.default_rng(seed)
    batch = theta() * rng.lognormal(0, spread, size=(n, 12))
    batch[:, MODEL.parameters.index("n")] = rng.uniform(1.0, 10.0, n)
    return batch


# --- an ODE solver


def spring(z, p):
    a, b = (z - p["gap"] / 2) / p["ell"], (z + p["gap"] / 2) / p["ell"]
    force = p["k_fwd"] * p["ell"] * np.logaddexp(0, a) - p["k_bwd"] * p["ell"] * np.logaddexp(0, -b)
    return force + p["k_0"] * z


def error(solve, trace, *amplitude, level=lambda time: 1.0, **changes):
    """Largest difference from the ODE solver, as a share of the peak."""
    p = VALUES | changes

    def rate(time, z, v):
        force = spring(z, p)
        side = "fwd" if force > 0 else "bwd"
        slip = p[f"Fc_{side}"] * (1 + p[f"static_excess_{side}"] * np.exp(-((v / p["v_s"]) ** 2)))
        return v * (1 - abs(force / (level(time) * slip)) ** p["n"]) if v * force > 0 else v

    low = -p["gap"] / 2 - p["Fc_bwd"] / p["k_bwd"]
    middle = 0.5 * (low + p["gap"] / 2 + p["Fc_fwd"] / p["k_fwd"])
    expected = spring(solve(rate, trace, *amplitude, middle), p) + p["sigma2"] * trace.velocity
    force = MODEL.force(theta(**changes), trace)[0]
    return np.max(np.abs(force - expected)) / np.max(np.abs(expected))


def test_force_equals_an_ode_solver_in_full_and_partial_cycles_and_in_the_gap():
    for n in [1.0, 6.0]:
        for amplitude in [1.0, 0.15, 0.05]:
            assert error(solved_along_sine, sine(amplitude), amplitude, n=n) < BAR


def test_a_random_walk_equals_an_ode_solver():
    for size, seed in [(0.01, 1), (0.05, 2), (0.3, 3)]:
        trace = walk(seed, samples=60, size=size)
        changes = {"n": 1.0 + 2.0 * seed, "gap": 0.1 * (seed - 1)}
        assert error(solved_along_walk, trace, **changes) < BAR


def test_a_varying_actuation_equals_an_ode_solver():
    def level(time):
        return 1 + 0.5 * np.sin(2.2 * time)

    trace = sine(0.5, actuation=level(np.arange(0, 5, 0.005)))
    mean = trace.reference_actuation
    assert error(solved_along_sine, trace, 0.5, level=lambda t: level(t) / mean) < BAR


# --- closed forms


def test_stages_follow_each_other_after_a_turn():
    """Slip, then unloading, the gap, build-up and slip again; shares of the way as they must be."""
    batch, trace = theta(n=8.0), sine(1.0, seconds=6.0, rate=400.0)
    turn, end = 400 * np.array([2.5, 3.45])  # a turn is at 2.5 s, the next at 3.5 s
    window = slice(int(turn) + 2, int(end))
    stage = MODEL.stages(batch, trace)[0, window]
    changes = stage[np.append(True, np.diff(stage) != 0)]
    np.testing.assert_array_equal(changes, [2, 4, 3, 1])
    way = np.abs(np.diff(trace.displacement))[window.start : window.stop]
    stuck, in_gap, built = (way[stage == k].sum() for k in (2, 4, 3))
    top = VALUES["Fc_fwd"] * (1 + VALUES["static_excess_fwd"])
    assert in_gap == pytest.approx(VALUES["gap"], rel=0.05)
    assert stuck == pytest.approx(top / VALUES["k_fwd"], rel=0.3)
    assert built == pytest.approx(VALUES["Fc_bwd"] / VALUES["k_bwd"], rel=0.3)


def test_the_travel_from_slip_to_slip_is_what_a_loop_shows():
    values = {name: np.array([value]) for name, value in VALUES.items()}
    expected = 0.2 + 2.2 / 50.0 + 1.8 / 42.0
    np.testing.assert_allclose(MODEL.slip_to_slip(values), expected)
    trace = sine(1.0, seconds=8.0)
    force = MODEL.force(theta(n=12.0, ell=0.005), trace)[0]
    assert features_of(replace(trace, force=force))["gap"] == pytest.approx(expected, rel=0.1)


def test_friction_that_falls_lets_go_as_the_motion_goes_on():
    for direction in [1.0, -1.0]:
        for n in [1.0, 20.0]:
            approach, departure = np.linspace(0, 1, 50), 1 + direction * np.linspace(0, 0.5, 50)
            motion, level = np.concatenate([approach, np.ones(5), departure]), np.ones(105)
            level[52:] = 1e-9
            time, zeros = np.arange(105) * 0.01, np.zeros(105)
            trace = Trace.from_arrays(time, motion, actuation=level, velocity=zeros)
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
            separate = np.concatenate([MODEL.force_unbounded(row[None], trace) for row in batch])
            together = MODEL.force_unbounded(batch, trace)
        np.testing.assert_allclose(together, separate, atol=1e-8)
        assert np.all(np.isfinite(together[0]))


# --- a motion cut in two goes on as the whole does


def test_a_motion_cut_anywhere_goes_on_as_the_whole_does():
    for index in [40, 250, 420]:
        for amplitude in [1.0, 0.15, 0.05]:
            batch, trace = vectors(5), sine(amplitude)
            batch[:, -3:-1] = 0.0  # no static friction, by which a deflection can be out of range
            assert np.max(off_after_cut(MODEL, batch, trace, index)) < 0.01, index
            assert np.max(off_after_cut(MODEL, batch, trace, index, start=0.5)) > 0.05, index


def test_a_motion_cut_under_a_varying_actuation_goes_on_as_the_whole_does():
    level = 1.0 + 0.4 * np.sin(np.arange(1000) / 90.0)
    batch, trace = vectors(3), sine(0.4, actuation=level)
    i = 155  # in the gap, at a higher actuation than the mean
    head, tail = cut(trace, i)
    share = level / trace.reference_actuation
    scales, tail_scales = (
        dict.fromkeys(("Fc_fwd", "Fc_bwd"), half[None]) for half in (share[: i + 1], share[i:])
    )
    start = MODEL.start_at(MODEL.end(batch, head, scales=scales), tail)
    force = MODEL.force(batch, tail, start, scales=tail_scales)
    np.testing.assert_allclose(force, MODEL.force(batch, trace)[:, i:], atol=0.02)
    unscaled = MODEL.end(batch, head)  # at the mean of the first part
    assert np.max(np.abs(unscaled - MODEL.end(batch, head, scales=scales))) > 1e-3


def test_the_place_of_the_spring_is_taken_over_by_other_parameters():
    trace, base = sine(), theta()
    wide, strong = theta(gap=0.4), theta(Fc_fwd=4.4, Fc_bwd=3.6)
    middle, slip = np.array([0.5]), np.array([1.0])
    assert MODEL.start_at(slip, trace, base, base) == pytest.approx(1.0)
    # beyond the gap the spring keeps its deflection: in slip with a wider gap, too
    assert MODEL.start_at(slip, trace, base, wide) == pytest.approx(1.0)
    # and at twice the actuation it is half way to slip
    force = MODEL.force(strong, trace, MODEL.start_at(slip, trace, base, strong))[0, 0]
    assert force == pytest.approx(MODEL.force(base, trace, slip)[0, 0], rel=0.05)
    # back at the lower one it slips
    assert MODEL.start_at(slip, trace, strong, base) == 1.0
    position = MODEL.start_at(middle, trace, base, wide)
    z = 0.5 * (2.2 / 50.0 - 1.8 / 42.0)  # of the middle of the range, doubled as the gap is
    low, high = -0.2 - 1.8 / 42.0, 0.2 + 2.2 / 50.0
    assert position == pytest.approx((2.0 * z - low) / (high - low))
