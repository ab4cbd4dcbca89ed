"""What holds for every model: batches, mirrors, time, actuation and energy."""

import numpy as np

from mfd_bayes.friction.models import MODELS
from mfd_bayes.records.trace import Trace
from mfd_bayes.response.building import ElastoPlastic
from tests.friction.test_arguments import some_values

TIME = np.arange(0.0, 8.0, 0.01)
MOTION = (0.02 + 0.06 * TIME) * np.sin(np.pi * TIME) + 0.03 * np.sin(7.9 * TIME)


def dampers(model, n, *, alike=False, **fixed):
    """Vectors drawn from the priors, (n, p); perhaps alike in both directions."""
    values = some_values(n, 5)
    values |= {name: np.full(n, value) for name, value in fixed.items()}
    if alike:
        values |= {k: values[k.replace("bwd", "fwd")] for k in values if k.endswith("_bwd")}
    return model.theta(values)


def trace_of(x=MOTION, actuation=1.0, time=TIME):
    return Trace.from_arrays(time, x, actuation, hysteresis=0.0)


def assert_close(force, expected, by=1e-8):
    peak = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(force / peak, expected / peak, rtol=0, atol=by)


def test_a_batch_equals_its_vectors_each_with_its_own_start_and_factors():
    for model in MODELS.values():
        for actuation in [1.0, 1.0 + 0.4 * np.sin(TIME)]:
            theta, start = dampers(model, 40), np.linspace(0.0, 1.0, 40)
            trace = trace_of(actuation=actuation)
            factors = np.linspace(0.5, 2.0, 40)[:, None] * np.linspace(1.0, 2.0, TIME.size)
            for scales in (None, dict.fromkeys(model.actuated, factors)):
                together = model.force(theta, trace, start, scales=scales)
                for i in (0, 13, 39):
                    own = scales and {name: f[i : i + 1] for name, f in scales.items()}
                    alone = model.force(theta[i : i + 1], trace, start[i : i + 1], scales=own)
                    assert_close(together[i : i + 1], alone)


def test_the_start_is_the_middle_when_left_out_and_counts_only_in_a_gap():
    for model in MODELS.values():
        theta = dampers(model, 3)
        force = model.force(theta, trace_of())
        np.testing.assert_array_equal(model.force(theta, trace_of(), 0.5), force)
        np.testing.assert_array_equal(model.force(theta, trace_of(), np.full(3, 0.5)), force)
        assert np.array_equal(model.force(theta, trace_of(), 0.1), force) != model.has_gap, (
            model.name
        )


def test_opposite_motion_gives_the_opposite_force_where_both_directions_are_alike():
    for model in MODELS.values():
        mirror = (lambda w: 1.0 - w) if model.name == "backlash" else (lambda w: w)
        for alike in (True, False):
            theta = dampers(model, 5, alike=alike)
            there, back = (
                model.force(theta, trace_of(sign * MOTION), start)
                for sign, start in ((1.0, 0.3), (-1.0, mirror(0.3)))
            )
            if alike:
                assert_close(-back, there)
            else:
                assert np.max(np.abs(there + back)) > 0.1, model.name  # the control


def test_force_is_continuous_in_time():
    for model in MODELS.values():
        # a jump does not shrink with the step; the force of a smooth motion does, in proportion
        theta = dampers(model, 8)
        largest = []
        for rate in (250.0, 2000.0):
            time = np.arange(0.0, 4.0, 1.0 / rate)
            force = model.force(theta, trace_of(0.3 * np.sin(np.pi * time), time=time))
            largest.append(np.max(np.abs(np.diff(force))))
        assert largest[1] < largest[0] / 2.5, model.name


def test_without_actuation_slip_has_no_friction():
    for model in MODELS.values():
        theta = dampers(model, 5, sigma1=0.0, sigma2=0.0, c=0.0, alpha=0.0, k2=0.0, k_0=0.0)
        wide = trace_of(2.0 * np.sin(np.pi * TIME), np.zeros(TIME.size))
        slipping = (np.abs(np.cos(np.pi * TIME)) > 0.9) & (wide.time > 3.0)
        assert np.max(np.abs(model.force(theta, wide)[:, slipping])) < 1e-3, model.name


def test_a_steady_cycle_gives_no_energy():
    for model in MODELS.values():
        for amplitude in [1.0, 0.1, 0.01]:
            time = np.arange(0.0, 20.0, 0.005)
            trace = trace_of(amplitude * np.sin(np.pi * time), time=time)
            force, last = model.force(dampers(model, 20), trace), slice(-401, None)
            energy = np.trapezoid(force[:, last], trace.displacement[last], axis=1)
            assert np.all(energy > -1e-3 * amplitude * np.abs(force).max(axis=1)), model.name


def test_no_motion_keeps_one_force():
    for model in MODELS.values():
        force = model.force(dampers(model, 3), Trace.from_arrays([0.0, 1.0, 2.0], [0.3] * 3))
        np.testing.assert_allclose(force, force[:, :1] * np.ones(3), rtol=1e-12, atol=1e-15)


# --- a record, a step in time and a building compute the same force

STEPS = np.arange(0.0, 4.0, 0.02)
MOTIONS = {
    "turns between samples": np.sin(np.pi * STEPS) + 0.3 * np.sin(1.3 * STEPS),
    "in the gap": -0.05 * np.sin(np.pi * STEPS) + 0.02 * np.sin(6.9 * STEPS),
    "partial": (0.02 + 0.1 * STEPS) * np.sin(np.pi * STEPS),
    "rests": np.clip(1.4 * np.sin(np.pi * STEPS), -1.0, 1.0),
}
LEVELS = {
    "constant": 1.0,
    "shut for a while": np.where((STEPS > 2) & (STEPS < 3), 0.1, 1.0 + 0.5 * np.sin(STEPS)),
}


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


def test_steps_equal_the_force_of_the_record():
    for model in MODELS.values():
        for level in LEVELS.values():
            for motion in MOTIONS.values():
                trace, theta = trace_of(motion, level, STEPS), dampers(model, 4)
                start = np.array([0.0, 0.2, 0.7, 1.0])
                expected = model.force(theta, trace, start)
                assert np.ptp(expected) > 0.1, model.name
                assert_close(stepped(model, theta, trace, start), expected)


def test_a_building_meets_the_device_of_the_record():
    """Each damper has a motion of its own; some are stepped again from the state before."""
    for model in MODELS.values():
        for level in LEVELS.values():
            n, rng = 5, np.random.default_rng(3)
            theta, start = dampers(model, n), rng.uniform(0, 1, n)
            sizes = np.linspace(0.1, 1.0, n) * np.array([1, -1, 1, -1, 1])
            x = sizes[:, None] * np.sin(np.linspace(2, 6, n)[:, None] * STEPS)
            traces = [trace_of(own, level, STEPS) for own in x]
            v = np.stack([trace.velocity for trace in traces])
            v[:, 0] = 0.0  # it begins at rest
            traces = [
                Trace.from_arrays(STEPS, place, level, velocity=speed, hysteresis=0.0)
                for place, speed in zip(x, v, strict=True)
            ]
            reference = traces[0].reference_actuation
            levels = np.broadcast_to(level, STEPS.size)
            shares = [model.proportional(np.full(n, p), reference) for p in levels]
            bank = model.start(theta, start, direction=np.sign(sizes))
            bank = bank.step(np.zeros(n), np.zeros(n), 0.0)  # as in a building
            bank = bank.step(x[:, 0], v[:, 0], 1.0, shares[0])
            forces, rows = [bank.force], np.array([3, 1])
            for i in range(1, STEPS.size):
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
            assert_close(np.array(forces).T, np.array(expected))


def test_given_factors_replace_the_proportion():
    for model in MODELS.values():
        trace, theta = trace_of(MOTIONS["partial"], time=STEPS), dampers(model, 3)
        along = 1.0 + 0.4 * np.sin(np.array([[1.0], [2.0], [3.0]]) * STEPS)
        scales = dict.fromkeys((*model.slip_forces, *model.tied_laws), along)
        state, forces = model.start(theta, direction=trace.path.direction), []
        for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
            now = {name: factor[:, i] for name, factor in scales.items()}
            force, state = model.step(state, x, v, 0.02, scales=now)
            forces.append(force)
        assert_close(np.array(forces).T, model.force(theta, trace, scales=scales))


def test_a_valve_that_is_closed_at_first_is_no_reference():
    trace = trace_of(np.sin(np.pi * STEPS), time=STEPS)

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
