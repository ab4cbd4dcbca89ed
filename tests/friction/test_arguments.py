"""Arguments that do not fit are refused by every model, each by one sentence that names it."""

import contextlib

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.calibration.posterior import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.models import MODELS, find_model
from mfd_bayes.records.trace import Trace

TIME = np.arange(101) / 25.0
TRACE = Trace.from_arrays(TIME, np.sin(np.pi * TIME), 0.5)
PRIORS = load_priors("mfd").parameters
STEP = {"displacement": 0.1, "velocity": 1.0, "dt": 0.1}
pytestmark = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def some_values(n=1, seed=1):
    rng = np.random.default_rng(seed)
    return {name: p.draw(rng, n) for name, p in PRIORS.items()} | {"gamma1": np.ones(n)}


def begun(model, **options):
    """State of two dampers after the first sample of a motion."""
    state = model.start(model.theta(some_values(2)), **options)
    return model.step(state, 0.0, 1.0, 0.0)[1]


def refused(words, call, *args, **options):
    with pytest.raises(FitError, match=words):
        call(*args, **options)


def test_theta_is_an_array_of_all_parameters(model):
    p = len(model.parameters)
    for shape in ((p,), (1, p - 1), (1, p + 1), (1, 1, p), ()):
        refused(rf"theta .* \(n, {p}\) for {model.name}", model.force, np.ones(shape), TRACE)
    for make in (lambda x: np.ma.masked_greater(x, 0), lambda x: x + 1j, lambda x: x.astype(str)):
        refused(r"masked|real numbers", model.force, make(np.ones((2, p))), TRACE)
    none = np.ones((0, p))
    assert model.force(none, TRACE).shape == model.travel(none, TRACE).shape == (0, 101)
    assert model.end(none, TRACE).shape == (0,)


def test_a_parameter_outside_its_limits_is_named(model):
    theta = model.theta(some_values(3))
    limits = {quantity.name: (quantity.least, quantity.most) for quantity in model.quantities}
    assert model.positive
    for i, name in enumerate(model.parameters):
        least, most = limits[name]
        bad = [np.nan, np.inf, least - 0.1, *([most + 0.1] if np.isfinite(most) else [])]
        for value in bad + [0.0] * (name in model.positive):
            changed = theta.copy()
            changed[1, i] = value
            for call, args in ((model.start, ()), (model.force, (TRACE,)), (model.end, (TRACE,))):
                refused(f"parameter {name} must be finite.* got", call, changed, *args)


def test_static_friction_is_at_least_kinetic_but_for_rounding(model):
    for static, kinetic in model.tied_laws.items():
        theta = model.theta(some_values(2))
        at, other = model.parameters.index(static), model.parameters.index(kinetic)
        theta[:, at] = theta[:, other] * (1.0 - 1e-13)
        assert model.force(theta, TRACE).shape == (2, TRACE.samples)
        theta[1, at] *= 1.0 - 1e-9
        refused(f"{static} must be at least kinetic {kinetic}", model.force, theta, TRACE)


def test_trace_start_and_direction_are_checked_where_they_are_without_effect(model):
    theta = model.theta(some_values())
    for call in (model.force, model.travel, model.end):
        for trace in (None, TIME, "trace"):
            refused("trace must be a Trace", call, theta[:0], trace)
        for start in ("nonsense", np.nan, 2, -0.1, True, [0.1, 0.2], [[0.5]]):
            refused("start must", call, theta, TRACE, start)
            refused("start must", model.start, theta, start)
    for direction in (2, 0, "x", [1, 1, 1]):
        refused("direction must be 1 or -1", model.start, theta, direction=direction)
    for value in ("0.5", [0.5], True, -1.0, np.inf):
        refused("reference_actuation must be", model.start, theta, reference_actuation=value)


def test_factors_are_numbers_of_what_follows_the_actuation(model):
    name, theta, state = model.slip_forces[0], model.theta(some_values(3)), begun(model)
    for scales in ([1.0], "a", 5, np.ones((1, 101))):
        for call in (model.force, model.end):
            refused("scales must be a mapping", call, theta, TRACE, scales=scales)
        refused("scales must be", model.step, state, **STEP, scales=scales)
    shapes = [[1.0], [1.0, 2.0]], np.ones((2, 101)), np.ones(101)
    for factor in ("a", [1.0, 2.0, 3.0], None, *shapes):
        refused(name, model.force, theta, TRACE, scales={name: factor})
        refused(name, model.step, state, **STEP, scales={name: factor})
    other = next(n for n in model.parameters if n not in model.actuated)
    for key, factor in ((other, 1.0), (name, np.nan), (name, -1.0)):
        scales = {key: np.full((1, 101), factor)}
        refused(f"scales .*{key}", model.force, theta, TRACE, scales=scales)


def test_a_step_takes_numbers_alone(model):
    state = begun(model, reference_actuation=0.5)
    for name in (*STEP, "actuation"):
        none = [None] * (name != "actuation")
        for value in ("0.1", [0.1], np.array([0.1]), True, np.nan, 1j, *none):
            refused(f"{name} of a step must be a finite", model.step, state, **STEP | {name: value})
    forces = [model.step(state, *map(form, (0.25, 1.0, 0.1)))[0] for form in (float, np.array)]
    np.testing.assert_array_equal(*forces)


def test_a_state_of_another_model_is_refused(model):
    for other in [*MODELS, None]:
        state = None if other is None else begun(find_model(other))
        if other == model.name:
            assert model.step(state, **STEP)[0].shape == (2,)
        else:
            refused("state must come from start or step of", model.step, state, **STEP)


def test_a_table_is_read_by_its_names(model):
    theta, last = model.theta(some_values(3)), model.parameters[-1]
    table = pd.DataFrame(theta, columns=list(model.parameters)).assign(other="text")
    shuffled = table[sorted(table.columns)]
    for call in (model.force, model.travel, model.end):
        np.testing.assert_array_equal(call(shuffled, TRACE), call(theta, TRACE))
    states = [model.start(given) for given in (theta, shuffled)]
    np.testing.assert_array_equal(*(model.step(state, **STEP)[0] for state in states))
    for lacking in (table.drop(columns=last), pd.DataFrame(theta)):
        refused(f"theta is a table, .* it lacks .*{last}", model.force, lacking, TRACE)


def test_values_are_vectors_given_by_name(model):
    for call in [model.theta, *([model.gap, model.gap_width] if model.has_gap else [])]:
        for values in (None, [1.0], "a", 5, dict):
            refused("values must be a mapping from names", call, values)
        refused("values by name lack", call, {})
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
    trace = mb.Trace.from_arrays(time, np.sin(np.pi * time), 0.5)
    rng, theta, finite = np.random.default_rng(2), model.theta(some_values(3)), []
    powers = [0, 0, 0, -300, -38, -9, 9, 38, 300]
    for factors in [1e300, *(10.0 ** rng.choice(powers, size=(60, theta.shape[1])))]:
        with contextlib.suppress(FitError):
            finite.append(np.isfinite(model.force(factors * theta, trace)).all())
    assert len(finite) > 5
    assert all(finite)


def test_points_of_a_posterior_are_real_numbers_and_may_be_none(model):
    trace = mb.Trace.from_arrays(TIME, TRACE.displacement, 0.5, np.tanh(4 * TRACE.velocity))
    posterior = mb.Posterior(trace, "mfd", "ou", model.name)
    assert posterior.log_prob(np.empty((0, posterior.dim))).shape == (0,)
    for make in (lambda x: np.ma.masked_greater(x, 0), lambda x: x + 1j):
        refused(r"masked|real numbers", posterior.log_prob, make(np.ones((2, posterior.dim))))
