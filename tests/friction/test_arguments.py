"""Arguments that do not fit are refused by every model, each by one sentence that names it."""

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.models import MODELS, find_model
from mfd_bayes.records.trace import Trace

TIME = np.arange(101) / 25.0
TRACE = Trace.from_arrays(TIME, np.sin(np.pi * TIME), 0.5)
PRIORS = load_priors("mfd").parameters
SOME = tuple(MODELS)


@pytest.fixture(params=SOME)
def model(request):
    return find_model(request.param)


def some_values(n=1):
    rng = np.random.default_rng(1)
    return {name: p.draw(rng, n) for name, p in PRIORS.items()} | {"gamma1": np.ones(n)}


def some_theta(model, n=1):
    return model.theta(some_values(n))


def begun(model, **options):
    """State after the first sample of a motion."""
    state = model.start(some_theta(model, 2), **options)
    return model.step(state, 0.0, 1.0, 0.0)[1]


# --- a state is the model's own


def late_force(model, state):
    """Force of a motion that goes on from a state."""
    for x in np.linspace(0.0, 0.4, 5):
        force, state = model.step(state, x, 0.5, 0.2)
    return force


def test_a_state_does_not_change_with_the_array_it_was_made_of(model):
    theta, start = some_theta(model), np.array([0.2])
    expected = late_force(model, model.start(theta, start))
    state = model.start(theta, start)
    theta *= 2.0
    start[:] = 0.9
    np.testing.assert_array_equal(late_force(model, state), expected)
    assert not np.array_equal(late_force(model, model.start(some_theta(model))), 2 * expected)


def test_a_state_does_not_change_with_the_factors_of_its_step(model):
    name = model.slip_forces[0]
    factors = np.array([1.1, 0.9])
    forces = []
    for change in (1.0, 3.0):
        given = factors.copy()
        _, state = model.step(begun(model), 0.1, 1.0, 0.1, scales={name: given})
        given *= change
        forces.append(model.step(state, 0.2, 1.0, 0.1, scales={name: factors})[0])
    np.testing.assert_array_equal(*forces)


@pytest.mark.parametrize("other", [*SOME, None])
def test_a_state_of_another_model_is_refused(model, other):
    state = None if other is None else begun(find_model(other))
    if other == model.name:
        assert model.step(state, 0.1, 1.0, 0.1)[0].shape == (2,)
        return
    with pytest.raises(FitError, match="state must come from start or step of"):
        model.step(state, 0.1, 1.0, 0.1)


# --- steps

NO_NUMBERS = ("0.1", None, [0.1], np.array([0.1]), True, np.nan, 1j)


@pytest.mark.parametrize("name", ["displacement", "velocity", "dt", "actuation"])
def test_a_step_takes_numbers_alone(model, name):
    good = {"displacement": 0.1, "velocity": 1.0, "dt": 0.1, "actuation": 0.5}
    state = begun(model, reference_actuation=0.5)
    for value in NO_NUMBERS:
        if name == "actuation" and value is None:
            continue
        with pytest.raises(FitError, match=f"{name} of a step must be a finite number"):
            model.step(state, **good | {name: value})


@pytest.mark.parametrize("value", ["0.5", [0.5], True, -1.0, np.inf])
def test_a_reference_is_a_positive_number(model, value):
    with pytest.raises(FitError, match="reference_actuation must be a finite number above 0"):
        model.start(some_theta(model), reference_actuation=value)


def test_a_step_takes_numbers_in_every_form(model):
    forms = (float, np.float64, np.array)
    forces = [model.step(begun(model), *map(form, (0.25, 1.0, 0.1)))[0] for form in forms]
    np.testing.assert_array_equal(forces[1:], forces[:-1])


@pytest.mark.parametrize("scales", [[1.0], "a", 5, np.ones((1, 101))])
def test_factors_are_given_by_name(model, scales):
    with pytest.raises(FitError, match="scales must be a mapping from names"):
        model.force(some_theta(model), TRACE, scales=scales)
    with pytest.raises(FitError, match="scales must be a mapping from names"):
        model.step(begun(model), 0.1, 1.0, 0.1, scales=scales)


@pytest.mark.parametrize("factor", ["a", [1.0, 2.0, 3.0], None, [[1.0], [1.0, 2.0]]])
def test_factors_are_numbers_that_fit(model, factor):
    name = model.slip_forces[0]
    with pytest.raises(FitError, match=f"{name}"):
        model.step(begun(model), 0.1, 1.0, 0.1, scales={name: factor})
    with pytest.raises(FitError, match=f"{name}"):
        model.force(some_theta(model), TRACE, scales={name: factor})


# --- what a result does not need is checked too


@pytest.mark.parametrize("start", ["nonsense", np.nan, 2, True, [0.1, 0.2]])
def test_a_start_is_checked_where_it_is_without_effect(model, start):
    theta = some_theta(model)
    for result in (model.force, model.travel, model.end):
        with pytest.raises(FitError, match="start must"):
            result(theta, TRACE, start)
    with pytest.raises(FitError, match="start must"):
        model.start(theta, start)


def test_theta_is_checked_where_it_is_without_effect(model):
    theta = some_theta(model)
    theta[0, 0] = np.nan
    for result in (model.travel, model.end):
        with pytest.raises(FitError, match=r"finite"):
            result(theta, TRACE)


@pytest.mark.parametrize("scales", [{"bogus": None}, [1]])
def test_factors_are_checked_where_they_are_without_effect(model, scales):
    with pytest.raises(FitError, match="scales m"):
        model.end(some_theta(model), TRACE, scales=scales)


@pytest.mark.parametrize("trace", [None, TIME, "trace"])
@pytest.mark.parametrize("n", [0, 1])
def test_a_trace_is_a_trace(model, trace, n):
    theta = some_theta(model)[:n]
    for result in (model.force, model.travel, model.end):
        with pytest.raises(FitError, match="trace must be a Trace"):
            result(theta, trace)


# --- names


def test_a_table_is_read_by_its_names(model):
    theta = some_theta(model, 3)
    table = pd.DataFrame(theta, columns=list(model.parameters))
    table["other"] = "text"
    shuffled = table[sorted(table.columns)]
    for result in (model.force, model.travel, model.end):
        np.testing.assert_array_equal(result(shuffled, TRACE), result(theta, TRACE))
    ours, theirs = (late_force(model, model.start(given)) for given in (theta, shuffled))
    np.testing.assert_array_equal(theirs, ours)


def test_a_table_without_the_names_is_refused(model):
    theta = some_theta(model)
    last = model.parameters[-1]
    lacking = pd.DataFrame(theta, columns=list(model.parameters)).drop(columns=last)
    for table in (lacking, pd.DataFrame(theta).rename(columns={0: model.parameters[0]})):
        with pytest.raises(FitError, match=f"theta is a table, .* it lacks .*{last}"):
            model.force(table, TRACE)


@pytest.mark.parametrize("values", [None, [1.0], "a", 5, dict])
def test_values_are_given_by_name(model, values):
    results = [model.theta]
    results += [model.gap, model.crossing] if model.has_gap else []
    for result in results:
        with pytest.raises(FitError, match="values must be a mapping from names"):
            result(values)


def test_a_value_that_is_missing_is_named(model):
    for name in model.parameters:
        values = {k: v for k, v in some_values().items() if k != name}
        if name in {q.name for q in model.quantities if not q.sampled}:
            continue
        with pytest.raises(FitError, match=f"values by name lack .*{name}"):
            model.theta(values)
    results = [model.theta, *([model.gap, model.crossing] if model.has_gap else [])]
    for result in results:
        with pytest.raises(FitError, match="values by name lack"):
            result({})


def test_values_have_one_shape(model):
    for value in (1.0, np.ones((1, 1)), np.ones(3), "x"):
        for name in (model.quantities[0].name, model.slip_forces[1]):
            with pytest.raises(FitError, match=r"values of \w+ must have shape|must hold real"):
                model.theta(some_values() | {name: value})


def test_parameters_of_the_paper_are_no_sampled_values():
    model = MODELS["three_stage"]
    own = dict(zip(model.parameters, some_theta(model).T, strict=True))
    with pytest.raises(FitError, match="lack static_excess_fwd, static_excess_bwd, ell"):
        model.theta(own)


@pytest.mark.parametrize("name", [None, 5, ["lugre"], {}, "maxwell", "lugre+weakening"])
def test_a_model_that_is_none_is_refused(name):
    with pytest.raises(FitError, match="unknown model"):
        find_model(name)


# --- values of parameters

POSITIVE = {
    "three_stage": ("sigma0", "gamma1", "gamma2", "v_s"),
    "lugre": ("sigma0", "v_s"),
    "bouc_wen": ("k", "Fy_fwd", "Fy_bwd"),
    "backlash": ("k_fwd", "k_bwd", "ell", "Fc_fwd", "Fc_bwd", "v_s"),
}


def test_a_parameter_outside_its_limits_is_named(model):
    theta = some_theta(model, 3)
    limits = {q.name: (q.least, q.most) for q in model.quantities}
    for i, name in enumerate(model.parameters):
        least, most = limits[name]
        bad = [np.nan, np.inf, least - 0.1, *([most + 0.1] if np.isfinite(most) else [])]
        bad += [0.0] if name in POSITIVE[model.name] else []
        for value in bad:
            changed = theta.copy()
            changed[1, i] = value
            for call in (model.start, lambda vectors: model.force(vectors, TRACE)):
                with pytest.raises(FitError, match=f"parameter {name} must be finite and .* got"):
                    call(changed)


@pytest.mark.parametrize("name", ["three_stage", "lugre"])
@pytest.mark.parametrize("side", ["fwd", "bwd"])
def test_static_friction_is_at_least_kinetic_but_for_rounding(name, side):
    model = MODELS[name]
    theta = some_theta(model, 2)
    static, kinetic = (model.parameters.index(f"F{kind}_{side}") for kind in "sc")
    theta[:, static] = theta[:, kinetic] * (1.0 - 1e-13)
    assert model.force(theta, TRACE).shape == (2, TRACE.samples)
    theta[1, static] *= 1.0 - 1e-9
    with pytest.raises(FitError, match=f"Fs_{side} must be at least kinetic Fc_{side}"):
        model.force(theta, TRACE)


def test_theta_of_another_shape_is_refused(model):
    p = len(model.parameters)
    for shape in ((p,), (1, p - 1), (1, p + 1 if p != 13 else 15), (1, 1, p)):
        with pytest.raises(FitError, match=rf"theta must have shape \(n, {p}\) for {model.name}"):
            model.force(np.ones(shape), TRACE)


def test_no_vectors_have_no_force(model):
    assert model.force(np.ones((0, len(model.parameters))), TRACE).shape == (0, TRACE.samples)


@pytest.mark.parametrize("direction", [2, 0, "x", [1, 1, 1]])
def test_a_direction_is_plus_or_minus_one(model, direction):
    with pytest.raises(FitError, match="direction must be 1 or -1"):
        model.start(some_theta(model), direction=direction)


def test_factors_of_another_parameter_or_shape_are_refused(model):
    name, theta = model.slip_forces[0], some_theta(model, 3)
    for key, factor in (
        (model.parameters[1] if model.name != "backlash" else "k_fwd", np.ones((1, 101))),
        (name, np.ones((2, 101))),
        (name, np.ones(101)),
        (name, np.full((1, 101), np.nan)),
        (name, -np.ones((1, 101))),
    ):
        with pytest.raises(FitError, match=rf"scales .*{key}"):
            model.force(theta, TRACE, scales={key: factor})
