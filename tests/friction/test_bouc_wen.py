import itertools

import numpy as np
from scipy.integrate import solve_ivp

from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.records.trace import Trace

VALUES = {"k": 40.0, "alpha": 0.02, "Fy_fwd": 2.0, "Fy_bwd": 1.4, "beta": 0.7, "exponent": 2.0}
VALUES |= {"c": 0.02}
OMEGA = np.pi  # 0.5 Hz
MODEL = BoucWen()


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in MODEL.parameters]])


def sine(amplitude=1.0, seconds=5.0, rate=100.0, **options):
    time = np.arange(0, seconds, 1 / rate)
    motion = amplitude * np.sin(OMEGA * time)
    velocity = amplitude * OMEGA * np.cos(OMEGA * time)
    return Trace.from_arrays(time, motion, velocity=velocity, **options)


def slope(x_slope, z, values, level=1.0):
    strength = level * values["Fy_fwd" if x_slope >= 0 else "Fy_bwd"]
    shape = 1 - values["beta"] + values["beta"] * np.sign(x_slope * z)
    return values["k"] * x_slope * (1 - abs(z / strength) ** values["exponent"] * shape)


def solved(trace, amplitude, values, level=lambda time: 1.0):
    """The force by an ODE solver, restarted where the motion turns."""
    time = trace.time
    turns = (np.arange(np.ceil(time[-1] * OMEGA / np.pi)) + 0.5) * np.pi / OMEGA
    edges = [0.0, *turns[turns < time[-1]], time[-1]]
    z, state = np.zeros(time.size), [0.0]
    for i in range(len(edges) - 1):
        inside = (time >= edges[i]) & (time <= edges[i + 1])
        leg = solve_ivp(
            lambda t, z: [slope(amplitude * OMEGA * np.cos(OMEGA * t), z[0], values, level(t))],
            edges[i : i + 2],
            state,
            method="LSODA",
            rtol=1e-9,
            atol=1e-11,
            dense_output=True,
        )
        z[inside], state = leg.sol(time[inside])[0], [leg.y[0, -1]]
    spring = values["alpha"] * values["k"] * trace.displacement
    return spring + (1 - values["alpha"]) * z + values["c"] * trace.velocity


def test_force_equals_an_ode_solver_to_a_fiftieth_of_a_percent():
    for exponent, beta, amplitude in itertools.product([1.0, 1.5, 5.0], [0.5, 1.0], [1.0, 0.06]):
        values = VALUES | {"exponent": exponent, "beta": beta}
        trace = sine(amplitude, seconds=3.0)
        expected = solved(trace, amplitude, values)
        force = MODEL.force(theta(**values), trace)[0]
        np.testing.assert_allclose(force, expected, atol=2e-4 * np.max(np.abs(expected)))


def test_random_turns_equal_an_ode_solver():
    rng = np.random.default_rng(5)
    corners = np.concatenate([[0.0], np.cumsum(rng.normal(size=40) * 0.06)])
    motion = np.concatenate([np.linspace(a, b, 5)[:-1] for a, b in zip(corners, corners[1:])])  # noqa: B905, RUF007
    time = np.arange(motion.size) * 0.01
    # zero velocity, so that no turning point lies beyond its corner
    trace = Trace.from_arrays(time, motion, velocity=np.zeros(motion.size))
    z = [0.0]
    for way in np.diff(motion):
        leg = solve_ivp(
            lambda _, z, way=way: [slope(way, z[0], VALUES)], (0, 1), z[-1:], rtol=1e-8, atol=1e-10
        )
        z.append(leg.y[0, -1])
    force = MODEL.force(theta(alpha=0.0, c=0.0), trace)[0]
    np.testing.assert_allclose(force, z, atol=2e-4)


def test_varying_actuation_equals_an_ode_solver():
    def level(time):
        return 1 + 0.6 * np.sin(2.2 * time)

    trace = sine(0.3, actuation=level(np.arange(0, 5, 0.01)))
    mean = trace.reference_actuation
    for exponent, beta in itertools.product([1.0, 4.0], [0.5, 1.0]):
        values = VALUES | {"exponent": exponent, "beta": beta}
        expected = solved(trace, 0.3, values, lambda time: level(time) / mean)
        force = MODEL.force(theta(**values), trace)[0]
        np.testing.assert_allclose(force, expected, atol=3e-3 * np.max(np.abs(expected)))


def test_friction_that_falls_lets_go_as_the_motion_goes_on():
    for exponent, beta, back in itertools.product([1.0, 200.0], [0.5, 1.0], [1.0, -1.0]):
        there, away = np.linspace(0, 1, 50), 1 + back * np.linspace(0, 0.2, 50)
        motion = np.concatenate([there, np.ones(5), away])
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
    batch = theta(alpha=1.0)
    expected = VALUES["k"] * trace.displacement + VALUES["c"] * trace.velocity
    np.testing.assert_allclose(MODEL.force(batch, trace)[0], expected, atol=1e-12)
