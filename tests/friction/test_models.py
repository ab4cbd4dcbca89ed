"""What holds for every model: batches, mirrors, time, actuation and energy."""

import numpy as np
import pytest

from mfd_bayes.friction.models import MODELS
from mfd_bayes.records.trace import Trace
from tests.friction.test_arguments import PRIORS

TIME = np.arange(0.0, 8.0, 0.01)
MOTION = (0.02 + 0.06 * TIME) * np.sin(np.pi * TIME) + 0.03 * np.sin(7.9 * TIME)


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]


def dampers(model, n, *, alike=False, **fixed):
    """Vectors drawn from the priors, (n, p); perhaps alike in both directions."""
    rng = np.random.default_rng(5)
    values = {name: p.draw(rng, n) for name, p in PRIORS.items()} | {"gamma1": np.ones(n)}
    values |= {name: np.full(n, value) for name, value in fixed.items()}
    if alike:
        values |= {k: values[k.replace("bwd", "fwd")] for k in values if k.endswith("_bwd")}
    return model.theta(values)


def trace_of(x=MOTION, actuation=1.0, time=TIME):
    return Trace.from_arrays(time, x, actuation, hysteresis=0.0)


def assert_close(force, expected, by=1e-8):
    peak = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(force / peak, expected / peak, rtol=0, atol=by)


@pytest.mark.parametrize("actuation", [1.0, 1.0 + 0.4 * np.sin(TIME)], ids=["constant", "varying"])
def test_a_batch_equals_its_vectors_each_with_its_own_start_and_factors(model, actuation):
    theta, start = dampers(model, 40), np.linspace(0.0, 1.0, 40)
    trace = trace_of(actuation=actuation)
    factors = np.linspace(0.5, 2.0, 40)[:, None] * np.linspace(1.0, 2.0, TIME.size)
    for scales in (None, dict.fromkeys(model.actuated, factors)):
        together = model.force(theta, trace, start, scales=scales)
        for i in (0, 13, 39):
            own = scales and {name: f[i : i + 1] for name, f in scales.items()}
            alone = model.force(theta[i : i + 1], trace, start[i : i + 1], scales=own)
            assert_close(together[i : i + 1], alone)


def test_a_record_cut_short_has_the_same_force(model):
    theta, whole = dampers(model, 3), trace_of()
    velocity = whole.velocity[:300]
    part = Trace.from_arrays(TIME[:300], MOTION[:300], velocity=velocity, hysteresis=0.0)
    assert_close(model.force(theta, part), model.force(theta, whole)[:, :300])


def test_the_start_is_the_middle_when_left_out_and_counts_only_in_a_gap(model):
    theta = dampers(model, 3)
    force = model.force(theta, trace_of())
    np.testing.assert_array_equal(model.force(theta, trace_of(), 0.5), force)
    np.testing.assert_array_equal(model.force(theta, trace_of(), np.full(3, 0.5)), force)
    assert np.array_equal(model.force(theta, trace_of(), 0.1), force) != model.has_gap


def test_opposite_motion_gives_the_opposite_force_where_both_directions_are_alike(model):
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
            assert np.max(np.abs(there + back)) > 0.1  # the control


def test_force_is_continuous_in_time(model):
    # a jump does not shrink with the step; the force of a smooth motion does, in proportion
    theta = dampers(model, 8)
    largest = []
    for rate in (250.0, 2000.0):
        time = np.arange(0.0, 4.0, 1.0 / rate)
        force = model.force(theta, trace_of(0.3 * np.sin(np.pi * time), time=time))
        largest.append(np.max(np.abs(np.diff(force))))
    assert largest[1] < largest[0] / 2.5


def test_a_history_of_constant_actuation_is_a_constant_actuation(model):
    theta = dampers(model, 5)
    history = trace_of(actuation=np.full(TIME.size, 0.8))
    assert_close(model.force(theta, history), model.force(theta, trace_of(actuation=0.8)))


def test_without_actuation_slip_has_no_friction(model):
    theta = dampers(model, 5, sigma1=0.0, sigma2=0.0, c=0.0, alpha=0.0, k2=0.0, k_0=0.0)
    wide = trace_of(2.0 * np.sin(np.pi * TIME), np.zeros(TIME.size))
    slipping = (np.abs(np.cos(np.pi * TIME)) > 0.9) & (wide.time > 3.0)
    assert np.max(np.abs(model.force(theta, wide)[:, slipping])) < 1e-3


@pytest.mark.parametrize("amplitude", [1.0, 0.1, 0.01])
def test_a_steady_cycle_gives_no_energy(model, amplitude):
    time = np.arange(0.0, 20.0, 0.005)
    trace = trace_of(amplitude * np.sin(np.pi * time), time=time)
    force, last = model.force(dampers(model, 20), trace), slice(-401, None)
    energy = np.trapezoid(force[:, last], trace.displacement[last], axis=1)
    assert np.all(energy > -1e-3 * amplitude * np.abs(force).max(axis=1))


def test_no_motion_keeps_one_force(model):
    force = model.force(dampers(model, 3), Trace.from_arrays([0.0, 1.0, 2.0], [0.3] * 3))
    np.testing.assert_array_equal(force, force[:, :1] * np.ones(3))
