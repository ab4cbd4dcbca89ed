import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfd_bayes.errors import FitError
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

MODELS = (ThreeStage(), LuGre())
TIME = np.arange(0.0, 4.0, 0.01)
CENTRE = np.array([60, 0.02, 0.01, 2.4, 2.0, 1.9, 1.5, 0.5, 30, 0.1, 0.08, 1.0, 0.005, 0.5])


def dampers(n, seed=0):
    rng = np.random.default_rng(seed)
    theta = CENTRE * rng.lognormal(0, 0.3, size=(n, CENTRE.size))
    theta[:, [3, 5]] = theta[:, [4, 6]] * rng.uniform(1, 1.4, size=(n, 2))
    return theta


def steps(model, theta, trace, start=None, **kwargs):
    """Force of every step, (n, T)."""
    kwargs |= {"start": start} if model.has_gap else {}
    state = model.start(theta, **kwargs)
    actuation = np.broadcast_to(trace.actuation, trace.samples)
    forces = []
    for k in range(trace.samples):
        dt = trace.time[k] - trace.time[k - 1] if k else 0.0
        level = None if np.isnan(actuation[k]) else actuation[k]
        force, state = model.step(state, trace.displacement[k], trace.velocity[k], dt, level)
        forces.append(force)
    return np.array(forces).T


MOTIONS = {
    "full, turning between samples": np.sin(np.pi * TIME + 0.3),
    "full, turning on samples": np.sin(np.pi * TIME),
    "backward first": -np.sin(np.pi * TIME),
    "from an extreme": np.cos(np.pi * TIME),
    "in the gap": 0.05 * np.sin(np.pi * TIME) + 0.02 * np.sin(6.9 * TIME + 0.4),
    "partial": (0.02 + 0.1 * TIME) * np.sin(np.pi * TIME),
    "with rests": np.clip(1.4 * np.sin(np.pi * TIME), -1.0, 1.0),
}


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_steps_equal_the_force_of_the_whole_motion(model, motion):
    trace = Trace.from_arrays(TIME, motion, hysteresis=0.0)
    theta = dampers(5)
    for start in (None, 0.1):
        expected = model.force(theta, trace, start=start)
        assert np.ptp(expected) > 0.1
        np.testing.assert_allclose(
            steps(model, theta, trace, start=start), expected, rtol=1e-9, atol=1e-9
        )


@settings(max_examples=12, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 0.1))
def test_steps_equal_the_force_of_a_random_walk(seed, scale):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.001, 0.02, 200))
    walk = np.cumsum(rng.normal(0, scale, 200) * rng.integers(0, 2, 200))
    trace = Trace.from_arrays(time, walk, hysteresis=0.0)
    theta = dampers(3, seed)
    for model in MODELS:
        stepped = steps(model, theta, trace, direction=trace.direction)
        np.testing.assert_allclose(stepped, model.force(theta, trace), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_steps_follow_a_varying_actuation(model):
    history = np.where((TIME > 2) & (TIME < 3), 0.0, 1.0 + 0.5 * np.sin(TIME))
    trace = Trace.from_arrays(TIME, MOTIONS["full, turning between samples"], actuation=history)
    theta = dampers(4)
    expected = model.force(theta, trace)
    stepped = steps(model, theta, trace, reference_actuation=trace.reference_actuation)
    np.testing.assert_allclose(stepped, expected, rtol=1e-9, atol=1e-9)
    # the first step's actuation is the reference when none is given
    other = steps(model, theta, trace)
    assert np.max(np.abs(other - expected)) > 0.01


@pytest.mark.parametrize("level", [0.3, 1.0, 2.5])
def test_parameters_belong_to_the_first_actuation_when_no_reference_is_given(level):
    trace = Trace.from_arrays(TIME[:200], MOTIONS["partial"][:200])
    constant = Trace.from_arrays(TIME[:200], MOTIONS["partial"][:200], actuation=level)
    theta = dampers(2)
    for model in MODELS:
        expected = steps(model, theta, trace)
        np.testing.assert_array_equal(steps(model, theta, constant), expected)
        # the control: with a given reference, friction is proportional to actuation over it
        other = steps(model, theta, constant, reference_actuation=2.0 * level)
        assert np.max(np.abs(other - expected)) > 0.01


def test_given_factors_replace_the_proportion():
    trace = Trace.from_arrays(TIME, MOTIONS["partial"])
    theta, model = dampers(3), MODELS[0]
    factors = np.random.default_rng(1).uniform(0.5, 2, size=(3, trace.samples))
    scales = {"Fc_fwd": factors, "Fs_fwd": factors}
    state, forces = model.start(theta), []
    for k in range(trace.samples):
        now = {name: factor[:, k] for name, factor in scales.items()}
        force, state = model.step(state, trace.displacement[k], trace.velocity[k], 0.01, scales=now)
        forces.append(force)
    expected = model.force(theta, trace, scales=scales)
    np.testing.assert_allclose(np.array(forces).T, expected, rtol=1e-9, atol=1e-9)


def test_a_state_can_be_taken_up_again():
    # a hybrid simulation that iterates steps from the same state more than once
    model, theta = MODELS[0], dampers(2)
    state = model.start(theta)
    for k in range(100):
        _, state = model.step(state, 0.01 * k, 1.0, 0.01)
    tried = model.step(state, 1.05, 1.0, 0.01)[0]
    model.step(state, 0.2, -3.0, 0.01)
    np.testing.assert_array_equal(model.step(state, 1.05, 1.0, 0.01)[0], tried)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"displacement": np.nan}, "displacement"),
        ({"velocity": np.inf}, "velocity"),
        ({"dt": 0.0}, "dt"),
        ({"dt": -0.01}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"actuation": -1.0}, "actuation"),
        ({"actuation": np.nan}, "actuation"),
        ({"scales": {"k3": 2.0}}, "k3"),
        ({"scales": {"Fc_fwd": [1.0, 2.0, 3.0]}}, "Fc_fwd"),
        ({"scales": {"Fc_fwd": -1.0}}, "Fc_fwd"),
        ({"scales": {"Fc_fwd": np.nan}}, "Fc_fwd"),
    ],
)
def test_a_bad_step_is_refused_by_name(changes, expected):
    model = MODELS[0]
    _, state = model.step(model.start(dampers(2)), 0.0, 1.0, 0.0)
    good = {"displacement": 0.01, "velocity": 1.0, "dt": 0.01}
    with pytest.raises(FitError, match=expected):
        model.step(state, **(good | changes))


def test_bad_settings_are_refused():
    model = MODELS[0]
    with pytest.raises(FitError, match="direction"):
        model.start(dampers(1), direction=2)
    with pytest.raises(FitError, match="reference_actuation"):
        model.start(dampers(1), reference_actuation=0.0)
    with pytest.raises(FitError, match="k3"):
        model.start(dampers(1) * np.where(np.arange(14) == 8, -1.0, 1.0))


@pytest.mark.parametrize("factor", [-1.0, np.inf, "x"])
def test_factors_that_do_not_fit_are_refused(factor):
    trace = Trace.from_arrays(TIME[:50], MOTIONS["partial"][:50])
    for model in MODELS:
        theta = dampers(2)
        along = [[factor] * 50]
        with pytest.raises(FitError, match="scales"):
            model.force(theta, trace, scales={"Fc_fwd": along})
        with pytest.raises(FitError, match="scales"):
            model.step(model.start(theta), 0.0, 0.0, 0.01, scales={"Fc_fwd": factor})


def test_travel_takes_parameter_vectors_alone():
    trace = Trace.from_arrays(TIME[:50], MOTIONS["partial"][:50])
    with pytest.raises(FitError, match=r"theta must have shape \(n, 8\)"):
        LuGre().travel(np.ones(8), trace)
    with pytest.raises(FitError, match=r"theta must have shape \(n, 8\)"):
        LuGre().end(np.ones(8), trace)
    papers = dampers(2)  # in the paper's order, with the columns of the gap
    assert papers.shape == (2, 14)
    assert LuGre().travel(papers, trace).shape == (2, trace.samples)
