"""Arguments that do not fit are refused by every model, each by one sentence that names it."""

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.models import MODELS, find_model
from mfd_bayes.records.trace import Trace

TIME = np.arange(101) / 25.0
TRACE = Trace.from_arrays(TIME, np.sin(np.pi * TIME), 0.5)
PRIORS = load_priors("mfd").parameters
POSITIVE = {
    "three_stage": ("sigma0", "gamma1", "gamma2", "v_s"),
    "lugre": ("sigma0", "v_s"),
    "bouc_wen": ("k", "Fy_fwd", "Fy_bwd"),
    "backlash": ("k_fwd", "k_bwd", "ell", "Fc_fwd", "Fc_bwd", "v_s"),
}


def some_values(n=1):
    rng = np.random.default_rng(1)
    return {name: p.draw(rng, n) for name, p in PRIORS.items()} | {"gamma1": np.ones(n)}


def begun(model, **options):
    """State of two dampers after the first sample of a motion."""
    state = model.start(model.theta(some_values(2)), **options)
    return model.step(state, 0.0, 1.0, 0.0)[1]


def refused(words, call, *args, **options):
    with pytest.raises(FitError, match=words):
        call(*args, **options)


# --- what a record and a step take


def test_theta_is_an_array_of_all_parameters():
    for model in MODELS.values():
        p = len(model.parameters)
        for shape in ((p,), (1, p - 1), (1, p + 1 if p != 13 else 15), (1, 1, p), ()):
            refused(
                rf"theta must have shape \(n, {p}\) for {model.name}",
                model.force,
                np.ones(shape),
                TRACE,
            )
        assert model.force(np.ones((0, p)), TRACE).shape == (0, TRACE.samples), model.name
        assert model.travel(np.ones((0, p)), TRACE).shape == (0, TRACE.samples), model.name
        assert model.end(np.ones((0, p)), TRACE).shape == (0,), model.name


def test_a_parameter_outside_its_limits_is_named():
    for model in MODELS.values():
        theta, limits = (
            model.theta(some_values(3)),
            {q.name: (q.least, q.most) for q in model.quantities},
        )
        for i, name in enumerate(model.parameters):
            least, most = limits[name]
            bad = [np.nan, np.inf, least - 0.1, *([most + 0.1] if np.isfinite(most) else [])]
            for value in bad + [0.0] * (name in POSITIVE[model.name]):
                changed = theta.copy()
                changed[1, i] = value
                for call, args in (
                    (model.start, ()),
                    (model.force, (TRACE,)),
                    (model.end, (TRACE,)),
                ):
                    refused(f"parameter {name} must be finite and .* got", call, changed, *args)


def test_static_friction_is_at_least_kinetic_but_for_rounding():
    for name in ["three_stage", "lugre"]:
        for side in ["fwd", "bwd"]:
            model = MODELS[name]
            theta = model.theta(some_values(2))
            static, kinetic = (model.parameters.index(f"F{kind}_{side}") for kind in "sc")
            theta[:, static] = theta[:, kinetic] * (1.0 - 1e-13)
            assert model.force(theta, TRACE).shape == (2, TRACE.samples), name
            theta[1, static] *= 1.0 - 1e-9
            refused(f"Fs_{side} must be at least kinetic Fc_{side}", model.force, theta, TRACE)


def test_trace_start_and_direction_are_checked_where_they_are_without_effect():
    for model in MODELS.values():
        theta = model.theta(some_values())
        for call in (model.force, model.travel, model.end):
            for trace in (None, TIME, "trace"):
                refused("trace must be a Trace", call, theta, trace)
                refused("trace must be a Trace", call, theta[:0], trace)
            for start in ("nonsense", np.nan, 2, -0.1, True, [0.1, 0.2], [[0.5]]):
                refused("start must", call, theta, TRACE, start)
                refused("start must", model.start, theta, start)
        for direction in (2, 0, "x", [1, 1, 1]):
            refused("direction must be 1 or -1", model.start, theta, direction=direction)
        for value in ("0.5", [0.5], True, -1.0, np.inf):
            words = "reference_actuation must be a finite number above 0"
            refused(words, model.start, theta, reference_actuation=value)


def test_factors_are_numbers_of_what_follows_the_actuation():
    for model in MODELS.values():
        name, theta = model.slip_forces[0], model.theta(some_values(3))
        other = "k_fwd" if model.name == "backlash" else model.parameters[1]
        for scales in ([1.0], "a", 5, np.ones((1, 101))):
            for call in (model.force, model.end):
                refused("scales must be a mapping from names", call, theta, TRACE, scales=scales)
            refused("scales must be", model.step, begun(model), 0.1, 1.0, 0.1, scales=scales)
        for factor in (
            "a",
            [1.0, 2.0, 3.0],
            None,
            [[1.0], [1.0, 2.0]],
            np.ones((2, 101)),
            np.ones(101),
        ):
            refused(name, model.force, theta, TRACE, scales={name: factor})
            refused(name, model.step, begun(model), 0.1, 1.0, 0.1, scales={name: factor})
        for key, factor in ((other, 1.0), (name, np.nan), (name, -1.0)):
            refused(
                f"scales .*{key}",
                model.force,
                theta,
                TRACE,
                scales={key: np.full((1, 101), factor)},
            )


def test_a_step_takes_numbers_alone():
    for model in MODELS.values():
        for name in ["displacement", "velocity", "dt", "actuation"]:
            good = {"displacement": 0.1, "velocity": 1.0, "dt": 0.1, "actuation": 0.5}
            state = begun(model, reference_actuation=0.5)
            for value in (
                "0.1",
                [0.1],
                np.array([0.1]),
                True,
                np.nan,
                1j,
                *([None] * (name != "actuation")),
            ):
                refused(
                    f"{name} of a step must be a finite number",
                    model.step,
                    state,
                    **good | {name: value},
                )
            forces = [
                model.step(state, *map(form, (0.25, 1.0, 0.1)))[0] for form in (float, np.array)
            ]
            np.testing.assert_array_equal(*forces)


def test_a_state_of_another_model_is_refused():
    for model in MODELS.values():
        for other in [*MODELS, None]:
            state = None if other is None else begun(find_model(other))
            if other == model.name:
                assert model.step(state, 0.1, 1.0, 0.1)[0].shape == (2,), model.name
            else:
                refused("state must come from start or step of", model.step, state, 0.1, 1.0, 0.1)


# --- names


def test_a_table_is_read_by_its_names():
    for model in MODELS.values():
        theta, last = model.theta(some_values(3)), model.parameters[-1]
        table = pd.DataFrame(theta, columns=list(model.parameters))
        table["other"] = "text"
        shuffled = table[sorted(table.columns)]
        for call in (model.force, model.travel, model.end):
            np.testing.assert_array_equal(call(shuffled, TRACE), call(theta, TRACE))
        states = [model.start(given) for given in (theta, shuffled)]
        np.testing.assert_array_equal(*(model.step(state, 0.1, 1.0, 0.1)[0] for state in states))
        for lacking in (table.drop(columns=last), pd.DataFrame(theta)):
            refused(f"theta is a table, .* it lacks .*{last}", model.force, lacking, TRACE)


def test_values_are_vectors_given_by_name():
    for model in MODELS.values():
        calls = [model.theta, *([model.gap, model.gap_width] if model.has_gap else [])]
        for call in calls:
            for values in (None, [1.0], "a", 5, dict):
                refused("values must be a mapping from names", call, values)
            refused("values by name lack", call, {})
        computed = {q.name for q in model.quantities if not q.sampled}
        for name in (name for name in model.parameters if name not in computed):
            values = {k: v for k, v in some_values().items() if k != name}
            refused(f"values by name lack .*{name}", model.theta, values)
        for value in (1.0, np.ones((1, 1)), np.ones(3), "x"):
            for name in (model.quantities[0].name, model.slip_forces[1]):
                words = r"values of \w+ must have shape|must hold real"
                refused(words, model.theta, some_values() | {name: value})


def test_a_model_that_is_none_is_refused():
    for name in [None, 5, ["lugre"], {}, "maxwell", "lugre+weakening"]:
        refused("unknown model", find_model, name)
