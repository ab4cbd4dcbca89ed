"""What holds for every model: batches, mirrors, time, actuation and energy."""

import numpy as np

from mfd_bayes.friction.models import MODELS
from mfd_bayes.records.trace import Trace
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
