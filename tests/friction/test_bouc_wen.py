import itertools

import numpy as np

from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.records.trace import Trace
from tests.friction.motions import sine, solved_along_sine, solved_along_walk, walk

VALUES = {"k": 40.0, "alpha": 0.02, "Fy_fwd": 2.0, "Fy_bwd": 1.4, "beta": 0.7, "exponent": 2.0}
VALUES |= {"c": 0.02}
MODEL = BoucWen()


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in MODEL.parameters]])


def rate_of(values, level=lambda time: 1.0):
    """Rate of the hysteretic force, by its equation."""

    def rate(time, z, v):
        strength = level(time) * values["Fy_fwd" if v >= 0 else "Fy_bwd"]
        shape = 1 - values["beta"] + values["beta"] * np.sign(v * z)
        return values["k"] * v * (1 - abs(z / strength) ** values["exponent"] * shape)

    return rate


def error_along_sine(values, amplitude, trace, level=lambda time: 1.0):
    """Largest difference from the ODE solver, as a share of the peak."""
    z = solved_along_sine(rate_of(values, level), trace, amplitude)
    spring = values["alpha"] * values["k"] * trace.displacement
    expected = spring + (1 - values["alpha"]) * z + values["c"] * trace.velocity
    force = MODEL.force(theta(**values), trace)[0]
    return np.max(np.abs(force - expected)) / np.max(np.abs(expected))


def test_force_equals_an_ode_solver_to_a_fiftieth_of_a_percent():
    for exponent, beta, amplitude in itertools.product([1.0, 1.5, 5.0], [0.5, 1.0], [1.0, 0.06]):
        values = VALUES | {"exponent": exponent, "beta": beta}
        assert error_along_sine(values, amplitude, sine(amplitude, 3.0, 100.0)) < 2e-4


def test_random_turns_equal_an_ode_solver():
    trace = walk(5, samples=100, size=0.06)
    force = MODEL.force(theta(alpha=0.0, c=0.0), trace)[0]
    np.testing.assert_allclose(force, solved_along_walk(rate_of(VALUES), trace), atol=2e-4)


def test_varying_actuation_equals_an_ode_solver():
    def level(time):
        return 1 + 0.6 * np.sin(2.2 * time)

    trace = sine(0.3, rate=100.0, actuation=level(np.arange(0, 5, 0.01)))
    mean = trace.reference_actuation
    for exponent, beta in itertools.product([1.0, 4.0], [0.5, 1.0]):
        values = VALUES | {"exponent": exponent, "beta": beta}
        assert error_along_sine(values, 0.3, trace, lambda time: level(time) / mean) < 3e-3


def test_friction_that_falls_lets_go_as_the_motion_goes_on():
    for exponent, beta, direction in itertools.product([1.0, 200.0], [0.5, 1.0], [1.0, -1.0]):
        approach, departure = np.linspace(0, 1, 50), 1 + direction * np.linspace(0, 0.2, 50)
        motion = np.concatenate([approach, np.ones(5), departure])
        level = np.where(np.arange(105) < 52, 1.0, 1e-9)
        trace = Trace.from_arrays(np.arange(105) * 0.01, motion, actuation=level)
        force = MODEL.force(theta(alpha=0.0, c=0.0, exponent=exponent, beta=beta), trace)[0]
        assert np.all(np.abs(force) <= force[49] * (1 + 1e-9)), exponent
        np.testing.assert_allclose(force[50:55], force[49], rtol=1e-9)  # nothing moves
        assert abs(force[-1]) < 1e-4 * force[49], exponent


def test_spring_and_dashpot_are_measured_from_the_first_sample():
    trace = sine()
    moved = Trace.from_arrays(trace.time, trace.displacement + 3.0, velocity=trace.velocity)
    np.testing.assert_allclose(MODEL.force(theta(), moved), MODEL.force(theta(), trace), atol=1e-9)
    expected = VALUES["k"] * trace.displacement + VALUES["c"] * trace.velocity
    np.testing.assert_allclose(MODEL.force(theta(alpha=1.0), trace)[0], expected, atol=1e-12)
