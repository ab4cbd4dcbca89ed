"""What holds for every model: batches, mirrors, time, actuation, energy, and what is refused."""

import contextlib

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.models import MODELS, find_model
from mfd_bayes.records.trace import Trace
from tests.friction.motions import walk

pytestmark = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
PRIORS = load_priors("mfd").parameters


def some_values(n=1, seed=1):
    rng = np.random.default_rng(seed)
    return {name: p.draw(rng, n) for name, p in PRIORS.items()} | {"gamma1": np.ones(n)}


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


def assert_close(force, expected, tolerance=1e-8):
    peak = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(force / peak, expected / peak, rtol=0, atol=tolerance)


def test_a_batch_equals_its_vectors_each_with_its_own_start_and_factors(model):
    for actuation in [1.0, 1.0 + 0.4 * np.sin(TIME)]:
        theta, start = dampers(model, 40), np.linspace(0.0, 1.0, 40)
        trace = trace_of(actuation=actuation)
        factors = np.linspace(0.5, 2.0, 40)[:, None] * np.linspace(1.0, 2.0, TIME.size)
        for scales in (None, dict.fromkeys(model.actuated, factors)):
            together = model.force(theta, trace, start, scales=scales)
            for i in (0, 13, 39):
                row_scales = scales and {name: f[i : i + 1] for name, f in scales.items()}
                single = model.force(theta[i : i + 1], trace, start[i : i + 1], scales=row_scales)
                assert_close(together[i : i + 1], single)


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
        forward, reverse = (
            model.force(theta, trace_of(sign * MOTION), start)
            for sign, start in ((1.0, 0.3), (-1.0, mirror(0.3)))
        )
        if alike:
            assert_close(-reverse, forward)
        else:
            assert np.max(np.abs(forward + reverse)) > 0.1  # the control


def test_without_actuation_slip_has_no_friction(model):
    theta = dampers(model, 5, sigma1=0.0, sigma2=0.0, c=0.0, alpha=0.0, k2=0.0, k_0=0.0)
    wide = trace_of(2.0 * np.sin(np.pi * TIME), np.zeros(TIME.size))
    slipping = (np.abs(np.cos(np.pi * TIME)) > 0.9) & (wide.time > 3.0)
    assert np.max(np.abs(model.force(theta, wide)[:, slipping])) < 1e-3


def test_force_is_continuous_in_time(model):
    # a jump does not shrink with the step; the force of a smooth motion does, in proportion
    theta = dampers(model, 8)
    largest = []
    for rate in (250.0, 2000.0):
        time = np.arange(0.0, 4.0, 1.0 / rate)
        force = model.force(theta, trace_of(0.3 * np.sin(np.pi * time), time=time))
        largest.append(np.max(np.abs(np.diff(force))))
    assert largest[1] < largest[0] / 2.5


def test_a_steady_cycle_gives_no_energy(model):
    for amplitude in [1.0, 0.1, 0.01]:
        time = np.arange(0.0, 20.0, 0.005)
        trace = trace_of(amplitude * np.sin(np.pi * time), time=time)
        force, last_cycle = model.force(dampers(model, 20), trace), slice(-401, None)
        energy = np.trapezoid(force[:, last_cycle], trace.displacement[last_cycle], axis=1)
        assert np.all(energy > -1e-3 * amplitude * np.abs(force).max(axis=1))


def test_no_motion_keeps_one_force(model):
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


def stepped(model, theta, trace, start=None, *, reference=None, levels=None, scales=None):
    """Force of `model.step` at every sample, (n, T)."""
    reference = reference if levels is not None else trace.reference_actuation
    options = {"direction": trace.path.direction, "reference_actuation": reference}
    state, forces = model.start(theta, start, **options), []
    levels = np.broadcast_to(trace.actuation if levels is None else levels, trace.samples)
    for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
        dt = trace.time[i] - trace.time[i - 1] if i else 0.0
        now = {name: factor[:, i] for name, factor in (scales or {}).items()}
        force, state = model.step(state, x, v, dt, levels[i], scales=now or None)
        forces.append(force)
    return np.array(forces).T


def test_steps_equal_the_force_of_the_record(model):
    for level in LEVELS.values():
        for motion in MOTIONS.values():
            trace, theta = trace_of(motion, level, STEPS), dampers(model, 4)
            start = np.array([0.0, 0.2, 0.7, 1.0])
            expected = model.force(theta, trace, start)
            assert np.ptp(expected) > 0.1
            assert_close(stepped(model, theta, trace, start), expected)


def test_a_building_meets_the_device_of_the_record(model):
    """Each damper has a motion of its own; some are stepped again from the state before."""
    for level in LEVELS.values():
        n, rng = 5, np.random.default_rng(3)
        theta, start = dampers(model, n), rng.uniform(0, 1, n)
        sizes = np.linspace(0.1, 1.0, n) * np.array([1, -1, 1, -1, 1])
        x = sizes[:, None] * np.sin(np.linspace(2, 6, n)[:, None] * STEPS)
        traces = [trace_of(own, level, STEPS) for own in x]
        v = np.stack([trace.velocity for trace in traces])
        v[:, 0] = 0.0  # it begins at rest
        traces = [
            Trace.from_arrays(STEPS, position, level, velocity=speed, hysteresis=0.0)
            for position, speed in zip(x, v, strict=True)
        ]
        reference = traces[0].reference_actuation
        levels = np.broadcast_to(level, STEPS.size)
        shares = [model.proportional(np.full(n, p), reference) for p in levels]
        bank = model.start(theta, start, direction=np.sign(sizes))
        bank = bank.step(np.zeros(n), np.zeros(n), 0.0)  # as in a building
        bank = bank.step(x[:, 0], v[:, 0], 1.0, shares[0])
        forces, rows = [bank.force], np.array([3, 1])
        for i in range(1, STEPS.size):
            previous = bank
            wrong = x[:, i].copy()
            wrong[rows] += 0.1
            bank = previous.step(wrong, v[:, i], 0.02, shares[i])
            own = {name: share[rows] for name, share in shares[i].items()}
            again = previous.chosen(rows).step(x[rows, i], v[rows, i], 0.02, own)
            bank = bank.replaced(rows, again)
            forces.append(bank.force)
        expected = [
            model.force(row[None], trace, w0)[0]
            for row, trace, w0 in zip(theta, traces, start, strict=True)
        ]
        assert_close(np.array(forces).T, np.array(expected))


def test_given_factors_replace_the_proportion(model):
    trace, theta = trace_of(MOTIONS["partial"], time=STEPS), dampers(model, 3)
    factors = 1.0 + 0.4 * np.sin(np.array([[1.0], [2.0], [3.0]]) * STEPS)
    scales = dict.fromkeys((*model.slip_forces, *model.shared_laws), factors)
    expected = model.force(theta, trace, scales=scales)
    assert_close(stepped(model, theta, trace, scales=scales), expected)


def test_a_valve_that_is_closed_at_first_is_no_reference(model):
    trace, theta = trace_of(np.sin(np.pi * STEPS), time=STEPS), dampers(model, 1)

    def late(initial, reference=None):
        levels = np.where(STEPS > 0.0, 0.5, initial)
        return stepped(model, theta, trace, reference=reference, levels=levels)[0, 100:]

    np.testing.assert_allclose(late(0.0), late(0.5), rtol=1e-3, atol=2e-3)
    assert np.max(np.abs(late(0.0, 1.0) - late(0.5))) > 0.1  # the control


def test_a_batch_ends_in_the_gap_as_its_vectors_do_one_by_one(model):
    if not model.has_gap:
        return
    theta, start = dampers(model, 6), np.linspace(0.0, 1.0, 6)
    trace = walk(4)
    together = model.end(theta, trace, start)
    singles = [model.end(row[None], trace, w0)[0] for row, w0 in zip(theta, start, strict=True)]
    np.testing.assert_allclose(together, singles, atol=1e-8)
    assert np.all((together >= 0.0) & (together <= 1.0))


# --- arguments that do not fit: each by one sentence that names it

SECONDS = np.arange(101) / 25.0
TRACE = Trace.from_arrays(SECONDS, np.sin(np.pi * SECONDS), 0.5)
STEP = {"displacement": 0.1, "velocity": 1.0, "dt": 0.1}


def begun(model, **options):
    """State of two dampers after the first sample of a motion."""
    state = model.start(model.theta(some_values(2)), **options)
    return model.step(state, 0.0, 1.0, 0.0)[1]


def refused(words, function, *args, **options):
    with pytest.raises(FitError, match=words):
        function(*args, **options)


def test_theta_is_an_array_of_all_parameters(model):
    p = len(model.parameters)
    for shape in ((p,), (1, p - 1), (1, p + 1), (1, 1, p), ()):
        refused(rf"theta .* \(n, {p}\) for {model.name}", model.force, np.ones(shape), TRACE)
    for make in (lambda x: np.ma.masked_greater(x, 0), lambda x: x + 1j, lambda x: x.astype(str)):
        refused(r"masked|real numbers", model.force, make(np.ones((2, p))), TRACE)
    empty = np.ones((0, p))
    assert model.force(empty, TRACE).shape == model.travel(empty, TRACE).shape == (0, 101)
    assert model.end(empty, TRACE).shape == (0,)


def test_a_parameter_outside_its_limits_is_named(model):
    theta = model.theta(some_values(3))
    limits = {quantity.name: (quantity.lower, quantity.upper) for quantity in model.quantities}
    assert model.positive
    for i, name in enumerate(model.parameters):
        lower, upper = limits[name]
        bad = [np.nan, np.inf, lower - 0.1, *([upper + 0.1] if np.isfinite(upper) else [])]
        for value in bad + [0.0] * (name in model.positive):
            invalid = theta.copy()
            invalid[1, i] = value
            for method, args in ((model.start, ()), (model.force, (TRACE,)), (model.end, (TRACE,))):
                refused(f"parameter {name} must be finite.* got", method, invalid, *args)


def test_static_friction_is_at_least_kinetic_but_for_rounding(model):
    for static, kinetic in model.shared_laws.items():
        theta = model.theta(some_values(2))
        i, j = model.parameters.index(static), model.parameters.index(kinetic)
        theta[:, i] = theta[:, j] * (1.0 - 1e-13)
        assert model.force(theta, TRACE).shape == (2, TRACE.samples)
        theta[1, i] *= 1.0 - 1e-9
        refused(f"{static} must be at least kinetic {kinetic}", model.force, theta, TRACE)


def test_trace_start_and_direction_are_checked_where_they_are_without_effect(model):
    theta = model.theta(some_values())
    for function in (model.force, model.travel, model.end):
        for trace in (None, TIME, "trace"):
            refused("trace must be a Trace", function, theta[:0], trace)
        for start in ("nonsense", np.nan, 2, -0.1, True, [0.1, 0.2], [[0.5]]):
            refused("start must", function, theta, TRACE, start)
            refused("start must", model.start, theta, start)
    for direction in (2, 0, "x", [1, 1, 1]):
        refused("direction must be 1 or -1", model.start, theta, direction=direction)
    for value in ("0.5", [0.5], True, -1.0, np.inf):
        refused("reference_actuation must be", model.start, theta, reference_actuation=value)


def test_factors_are_numbers_of_what_follows_the_actuation(model):
    name, theta, state = model.slip_forces[0], model.theta(some_values(3)), begun(model)
    for scales in ([1.0], "a", 5, np.ones((1, 101))):
        for function in (model.force, model.end):
            refused("scales must be a mapping", function, theta, TRACE, scales=scales)
        refused("scales must be", model.step, state, **STEP, scales=scales)
    shapes = [[1.0], [1.0, 2.0]], np.ones((2, 101)), np.ones(101)
    for factor in ("a", [1.0, 2.0, 3.0], None, *shapes):
        refused(name, model.force, theta, TRACE, scales={name: factor})
        refused(name, model.step, state, **STEP, scales={name: factor})
    unscaled = next(n for n in model.parameters if n not in model.actuated)
    for key, factor in ((unscaled, 1.0), (name, np.nan), (name, -1.0)):
        scales = {key: np.full((1, 101), factor)}
        refused(f"scales .*{key}", model.force, theta, TRACE, scales=scales)


def test_a_step_takes_numbers_alone(model):
    state = begun(model, reference_actuation=0.5)
    for name in (*STEP, "actuation"):
        missing = [None] * (name != "actuation")
        for value in ("0.1", [0.1], np.array([0.1]), True, np.nan, 1j, *missing):
            refused(f"{name} of a step must be a finite", model.step, state, **STEP | {name: value})
    forces = [model.step(state, *map(form, (0.25, 1.0, 0.1)))[0] for form in (float, np.array)]
    np.testing.assert_array_equal(*forces)


def test_a_state_of_another_model_is_refused(model):
    for peer in [*MODELS, None]:
        state = None if peer is None else begun(find_model(peer))
        if peer == model.name:
            assert model.step(state, **STEP)[0].shape == (2,)
        else:
            refused("state must come from start or step of", model.step, state, **STEP)


def test_a_table_is_read_by_its_names(model):
    theta, last_name = model.theta(some_values(3)), model.parameters[-1]
    table = pd.DataFrame(theta, columns=list(model.parameters)).assign(other="text")
    shuffled = table[sorted(table.columns)]
    for function in (model.force, model.travel, model.end):
        np.testing.assert_array_equal(function(shuffled, TRACE), function(theta, TRACE))
    states = [model.start(vectors) for vectors in (theta, shuffled)]
    np.testing.assert_array_equal(*(model.step(state, **STEP)[0] for state in states))
    for lacking in (table.drop(columns=last_name), pd.DataFrame(theta)):
        refused(f"theta is a table, .* it lacks .*{last_name}", model.force, lacking, TRACE)


def test_values_are_vectors_given_by_name(model):
    for function in [model.theta, *([model.gap, model.slip_to_slip] if model.has_gap else [])]:
        for values in (None, [1.0], "a", 5, dict):
            refused("values must be a mapping from names", function, values)
        refused("values by name lack", function, {})
    for quantity in model.quantities:
        if quantity.sampled and quantity.name in model.parameters:
            values = {k: v for k, v in some_values().items() if k != quantity.name}
            refused(f"values by name lack .*{quantity.name}", model.theta, values)
    for value in (1.0, np.ones((1, 1)), np.ones(3), "x"):
        for name in (model.quantities[0].name, model.slip_forces[1]):
            words = r"values of \w+ must have shape|must hold real"
            refused(words, model.theta, some_values() | {name: value})


def test_a_force_of_values_that_no_device_has_is_a_number_or_refused(model):
    time = np.arange(0.0, 8.0, 1 / 64)
    trace = Trace.from_arrays(time, np.sin(np.pi * time), 0.5)
    rng, theta, finite = np.random.default_rng(2), model.theta(some_values(3)), []
    powers = [0, 0, 0, -300, -38, -9, 9, 38, 300]
    for factors in [1e300, *(10.0 ** rng.choice(powers, size=(60, theta.shape[1])))]:
        with contextlib.suppress(FitError):
            finite.append(np.isfinite(model.force(factors * theta, trace)).all())
    assert len(finite) > 5
    assert all(finite)
