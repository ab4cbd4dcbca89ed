"""A record, a step in time and a building compute the same force, in every model."""

import numpy as np

from mfd_bayes.friction.models import MODELS
from mfd_bayes.records.trace import Trace
from mfd_bayes.response.device_draws import ElastoPlastic
from tests.friction.test_arguments import some_values

TIME = np.arange(0.0, 4.0, 0.02)
MOTIONS = {
    "turns between samples": np.sin(np.pi * TIME) + 0.3 * np.sin(1.3 * TIME),
    "in the gap": -0.05 * np.sin(np.pi * TIME) + 0.02 * np.sin(6.9 * TIME),
    "partial": (0.02 + 0.1 * TIME) * np.sin(np.pi * TIME),
    "rests": np.clip(1.4 * np.sin(np.pi * TIME), -1.0, 1.0),
}
LEVELS = {
    "constant": 1.0,
    "shut for a while": np.where((TIME > 2) & (TIME < 3), 0.1, 1.0 + 0.5 * np.sin(TIME)),
}


def dampers(model, n, seed=1):
    """Vectors drawn from the priors, (n, p)."""
    return model.theta(some_values(n, seed))


def trace_of(motion, level=1.0, time=TIME):
    return Trace.from_arrays(time, motion, level, hysteresis=0.0)


def stepped(model, theta, trace, start, **options):
    """Force of `model.step` at every sample, (n, T)."""
    options = {"reference_actuation": trace.reference_actuation} | options
    state = model.start(theta, start, direction=trace.path.direction, **options)
    levels, forces = np.broadcast_to(trace.actuation, trace.samples), []
    for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
        dt = trace.time[i] - trace.time[i - 1] if i else 0.0
        force, state = model.step(state, x, v, dt, levels[i])
        forces.append(force)
    return np.array(forces).T


def close(found, expected):
    """Whether forces agree within 1e-8 of each vector's peak; records leave 1e-9."""
    peak = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / peak, expected / peak, rtol=0, atol=1e-8)


def test_steps_equal_the_force_of_the_record():
    for model in MODELS.values():
        for level in LEVELS.values():
            for motion in MOTIONS.values():
                trace, theta = trace_of(motion, level), dampers(model, 4)
                start = np.array([0.0, 0.2, 0.7, 1.0])
                expected = model.force(theta, trace, start)
                assert np.ptp(expected) > 0.1, model.name
                close(stepped(model, theta, trace, start), expected)


def test_a_building_meets_the_device_of_the_record():
    """Each damper has a motion of its own; some are stepped again from the state before."""
    for model in MODELS.values():
        for level in LEVELS.values():
            n, rng = 5, np.random.default_rng(3)
            theta, start = dampers(model, n), rng.uniform(0, 1, n)
            sizes = np.linspace(0.1, 1.0, n) * np.array([1, -1, 1, -1, 1])
            x = sizes[:, None] * np.sin(np.linspace(2, 6, n)[:, None] * TIME)
            traces = [trace_of(own, level) for own in x]
            v = np.stack([trace.velocity for trace in traces])
            v[:, 0] = 0.0  # it begins at rest
            traces = [
                Trace.from_arrays(TIME, place, level, velocity=speed, hysteresis=0.0)
                for place, speed in zip(x, v, strict=True)
            ]
            reference = traces[0].reference_actuation
            levels = np.broadcast_to(level, TIME.size)
            shares = [model.proportional(np.full(n, p), reference) for p in levels]
            bank = model.start(theta, start, direction=np.sign(sizes))
            bank = bank.step(np.zeros(n), np.zeros(n), 0.0)  # as in a building
            bank = bank.step(x[:, 0], v[:, 0], 1.0, shares[0])
            forces, rows = [bank.force], np.array([3, 1])
            for i in range(1, TIME.size):
                before = bank
                wrong = x[:, i].copy()
                wrong[rows] += 0.1
                bank = before.step(wrong, v[:, i], 0.02, shares[i])
                own = {name: share[rows] for name, share in shares[i].items()}
                again = before.chosen(rows).step(x[rows, i], v[rows, i], 0.02, own)
                bank = bank.replaced(rows, again)
                forces.append(bank.force)
            expected = [
                model.force(row[None], trace, w0)[0]
                for row, trace, w0 in zip(theta, traces, start, strict=True)
            ]
            close(np.array(forces).T, np.array(expected))


def test_given_factors_replace_the_proportion():
    for model in MODELS.values():
        trace, theta = trace_of(MOTIONS["partial"]), dampers(model, 3)
        along = 1.0 + 0.4 * np.sin(np.array([[1.0], [2.0], [3.0]]) * TIME)
        scales = dict.fromkeys((*model.slip_forces, *model.tied_laws), along)
        state, forces = model.start(theta, direction=trace.path.direction), []
        for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
            now = {name: factor[:, i] for name, factor in scales.items()}
            force, state = model.step(state, x, v, 0.02, scales=now)
            forces.append(force)
        close(np.array(forces).T, model.force(theta, trace, scales=scales))


def test_a_state_can_be_stepped_again():
    for model in MODELS.values():
        state = model.start(dampers(model, 2))
        for i in range(30):
            _, state = model.step(state, 0.01 * i, 1.0, 0.01)
        tried = model.step(state, 0.35, 1.0, 0.01)[0]
        model.step(state, 0.1, -3.0, 0.01)
        np.testing.assert_array_equal(model.step(state, 0.35, 1.0, 0.01)[0], tried)


def test_a_valve_that_is_closed_at_first_is_no_reference():
    trace = trace_of(np.sin(np.pi * TIME))

    def late(model, first, reference=None):
        state, forces = model.start(dampers(model, 1), reference_actuation=reference), []
        for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
            force, state = model.step(state, x, v, 0.02, 0.5 if i else first)
            forces.append(force[0])
        return np.array(forces[100:])

    for model in MODELS.values():
        open_ = late(model, 0.5)
        np.testing.assert_allclose(late(model, 0.0), open_, rtol=1e-3, atol=2e-3)
        assert np.max(np.abs(late(model, 0.0, 1.0) - open_)) > 0.1, model.name  # the control


def test_a_plastic_spring_slips_at_its_strength():
    bank = ElastoPlastic.at_rest(np.array([10.0]), np.array([2.0]))
    forces = []
    for x in (0.1, 0.5, 0.4, 0.0):
        bank = bank.step(np.array([x]), np.zeros(1), 0.1)
        forces.append(float(bank.force[0]))
    np.testing.assert_allclose(forces, [1.0, 2.0, 1.0, -2.0])
