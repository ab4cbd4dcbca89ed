"""The backlash model's physics: an ODE solver, closed forms, memory and energy."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.friction.backlash import Spring
from mfd_bayes.records.loops import loop_estimate
from mfd_bayes.records.trace import Trace
from tests.friction.backlash_cases import (
    MODEL,
    OMEGA,
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
        values = VALUES | {"n": 1.0 + 2.0 * seed, "gap": 0.1 * seed}
        batch = theta(n=values["n"], gap=values["gap"])
        assert off(MODEL.force(batch, trace)[0], of_walk(trace, values)) < BAR


def test_a_varying_actuation_equals_an_ode_solver():
    def level(time):
        return 1 + 0.5 * np.sin(2.2 * time)

    trace = sine(0.5, actuation=level(np.arange(0, 5, 0.005)))
    mean = trace.reference_actuation
    expected = of_sine(trace, 0.5, VALUES, lambda t: level(t) / mean)
    assert off(MODEL.force(theta(), trace)[0], expected) < BAR


def test_without_a_gap_and_with_n_1_it_is_dahls_closed_form():
    """k_fwd = k_bwd without a gap is the spring k z, whatever ℓ; Dahl (1968) for the loading."""
    k, slip = 40.0, 2.0
    sides = {"k_fwd": k, "k_bwd": k, "Fc_fwd": slip, "Fc_bwd": slip, "n": 1.0}
    none = ("gap", "k_0", "sigma2", "static_excess_fwd", "static_excess_bwd")
    batch = theta(**sides, **dict.fromkeys(none, 0.0))
    time = np.linspace(0, 3, 3001)
    motion = np.interp(time, [0, 1, 2, 3], [0.0, 0.2, -0.1, 0.3])
    force = MODEL.force(batch, Trace.from_arrays(time, motion, velocity=np.zeros(time.size)))[0]
    expected, now = np.empty(time.size), 0.0
    for begin, end in ((0, 1000), (1000, 2000), (2000, 3000)):
        way = np.abs(motion[begin : end + 1] - motion[begin])
        sign = 1.0 if motion[end] > motion[begin] else -1.0
        free = max(-sign * now, 0.0) / k  # unloading is elastic down to no force
        loaded = np.maximum(way - free, 0.0)
        begun = max(sign * now, 0.0)
        part = slip - (slip - begun) * np.exp(-k * loaded / slip)
        expected[begin : end + 1] = np.where(way < free, now + sign * k * way, sign * part)
        now = expected[end]
    assert off(force, expected) < 1e-3


def test_a_motion_inside_the_gap_keeps_its_memory():
    """Back and forth many times where the spring is far below slip: the force is the same."""
    time = np.arange(0, 40, 0.01)
    trace = Trace.from_arrays(time, 0.04 * np.sin(OMEGA * time))
    force = MODEL.force(theta(n=6.0, sigma2=0.0), trace)[0]
    np.testing.assert_allclose(force[200:400], force[-200:], atol=1e-5)
    assert np.ptp(force[-200:]) > 0.02


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


CENTRE = np.array([50.0, 42.0, 0.2, 0.02, 0.4, 2.2, 1.8, 3.0, 0.0, 0.2, 0.15, 0.5])
SAMPLES, ROUNDS = 512, 3
LEAST_ENERGY = -2e-5


def dampers(count, rng):
    """Random parameters, (count, 12), without viscous friction; n from 1 to 10."""
    theta = CENTRE * rng.lognormal(0.0, 0.6, (count, CENTRE.size))
    theta[:, MODEL.parameters.index("n")] = rng.uniform(1.0, 10.0, count)
    return theta


def motions(count, rng):
    """Closed motions, each taken `ROUNDS` times."""
    angle = 2 * np.pi * np.arange(1, 5)[:, None] * np.arange(ROUNDS * SAMPLES + 1) / SAMPLES
    for _ in range(count):
        size, seconds = rng.lognormal(-2.0, 1.0), rng.lognormal(1.0, 1.0)
        waves = size * rng.normal(size=(4, 2)) / np.arange(1, 5)[:, None]
        x = (waves[:, :1] * np.sin(angle) + waves[:, 1:] * np.cos(angle)).sum(axis=0)
        time = np.arange(x.size) * seconds / SAMPLES
        yield Trace.from_arrays(time, x, velocity=np.zeros(x.size))


def taken_up(theta, trace):
    """Energy that the last round takes up, (n,), over largest force and way."""
    spring = Spring(*np.ascontiguousarray(theta.T[:5]))
    last = slice(-SAMPLES - 1, None)
    force, x = MODEL.force(theta, trace)[:, last], trace.displacement[last]
    low, high = spring.deflection(force[:, [0, -1]].T)
    between = low + (high - low) * np.linspace(0.0, 1.0, 41)[:, None]
    held = np.trapezoid(spring.evaluate(between)[0], between, axis=0)
    work = np.trapezoid(force, x, axis=1) - held
    return work / (np.abs(force).max(axis=1) * np.abs(np.diff(x)).sum())


def test_a_closed_motion_never_gives_energy():
    """What the last of three rounds takes up, over largest force and way, in 500 random cases."""
    rng = np.random.default_rng(4)
    batch = dampers(25, rng)
    found = np.array([taken_up(batch, trace) for trace in motions(20, rng)])
    assert np.min(found) > LEAST_ENERGY
    assert np.max(found) > 0.1
    # and a model that gives some would be seen: the same force, a little ahead of its motion
    trace = next(motions(1, rng))
    late = replace(trace, displacement=np.roll(trace.displacement, 40))
    force = MODEL.force(batch, late)[:, -SAMPLES - 1 :]
    assert np.min(np.trapezoid(force, trace.displacement[-SAMPLES - 1 :], axis=1)) < 0


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


def test_extreme_dampers_have_finite_forces_within_friction():
    for changes in [{"ell": 1e-5}, {"gap": 30.0}, {"n": 300.0}, {"k_fwd": 1e6}]:
        force = MODEL.force(theta(sigma2=0.0, **changes), sine(rate=50.0))[0]
        assert np.all(np.abs(force[50:]) <= 2.2 * 1.2 * 1.01)


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


def test_a_stiff_side_is_as_soft_when_the_actuation_varies():
    constant, batch = sine(0.3), theta(k_fwd=1e5)
    history = 1.0 + 1e-6 * np.sin(np.arange(constant.samples))
    varying = sine(0.3, actuation=history)
    force = MODEL.force(batch, constant)
    np.testing.assert_allclose(MODEL.force(batch, varying), force, atol=1e-4)
