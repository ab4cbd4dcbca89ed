"""The backlash model's interface: batches, steps, actuation, and what it refuses."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfd_bayes.errors import FitError
from mfd_bayes.friction import slip
from mfd_bayes.friction.course import Place, Plan, cut
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.trace import Trace
from tests.friction.backlash_cases import MODEL, VALUES, sine, stepped, theta, vectors, walk
from tests.friction.valves import late_forces

CLOSE = 1e-7  # kip


def test_batch_equals_single_vectors():
    batch = vectors(9)
    for trace in (sine(), walk(3), sine(actuation=1.5 + np.sin(np.arange(1000) / 40))):
        together = MODEL.force(batch, trace)
        for row, force in zip(batch, together, strict=True):
            np.testing.assert_allclose(MODEL.force(row[None], trace)[0], force, atol=CLOSE)


STUBBORN = [6.54, 1300.0, 0.0323, 0.0808, 0.002, 15.6, 0.00112, 1.0, 0.038, 0.336, 0.109, 1.39]
"""A damper that takes Newton's method almost a hundred steps."""

UNSOLVED = [34.24, 34.7, 0.2952, 0.03248, 0.8656, 0.04164, 8.323, 2.034, 0.049, 0.172, 0.061, 2.59]
"""A damper that slips at a two hundredth of the force in one direction: Newton's method fails."""

SUDDEN = {"k_fwd": 4.7e4, "ell": 4e-5, "Fc_fwd": 0.1, "n": 1.02}
"""A damper that slips at once at every turn, in a ten thousandth of an inch."""


def test_dampers_that_are_hard_to_solve_leave_the_others_of_their_batch_alone(monkeypatch):
    batch = np.concatenate([theta(), [STUBBORN], theta(**SUDDEN), theta(n=400.0)])
    for trace in (sine(), walk(3)):
        alone = np.concatenate([MODEL.force(row[None], trace) for row in batch])
        np.testing.assert_allclose(MODEL.force(batch, trace), alone, atol=1e-5)
    with_one = np.concatenate([batch, [UNSOLVED]])
    with np.errstate(all="ignore"):
        found = MODEL.force_unbounded(with_one, sine())
    assert np.all(np.isnan(found[-1, 1:]))  # and not some number
    np.testing.assert_allclose(found[:-1], MODEL.force(batch, sine()), atol=1e-5)
    with pytest.raises(FitError, match="vector 4 is no finite number"):
        MODEL.force(with_one, sine())
    monkeypatch.setattr(slip, "ITERATIONS", 20)  # the control
    assert not np.all(np.isfinite(MODEL.force_unbounded([STUBBORN], sine())))


@pytest.mark.parametrize("actuation", [None, 1.5 + np.sin(np.arange(1000) / 40)])
def test_steps_that_are_solved_are_left_alone_also_where_slip_sets_in_at_once(
    monkeypatch, actuation
):
    taken, counted = [], slip.newton
    monkeypatch.setattr(slip, "newton", lambda *a: taken.append(a[2].shape[0]) or counted(*a))
    batch, trace = theta(**SUDDEN), sine(0.2, actuation=actuation)
    some, few = MODEL.force(batch, trace), sum(taken)
    taken.clear()
    monkeypatch.setattr(slip, "FEWER", 0.0)  # all steps each time
    np.testing.assert_allclose(some, MODEL.force(batch, trace), atol=1e-9)
    assert few < sum(taken)


def test_a_way_on_which_slip_surely_sets_in_is_not_cut():
    moves, plan = np.array([0.1, 0.1, -0.1, -0.1]), Plan(step=1e-5, window=2e-5)
    assert cut(moves, plan, Place()).sign.size < 12
    longer = Plan(step=1e-3, window=2e-3)  # the control: fewer steps would do, and are made
    assert cut(moves, longer, Place()).sign.size > 12


def test_a_long_record_is_worked_on_in_pieces():
    time = np.linspace(0, 1, 40_000)
    batch = theta(sigma2=0.0)
    force = MODEL.force(batch, Trace.from_arrays(time, 0.5 * time))[0]
    few = MODEL.force(batch, Trace.from_arrays(time[::10], 0.5 * time[::10]))[0]
    np.testing.assert_allclose(force[::10], few, atol=2e-3)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), gradient=st.booleans())
def test_steps_equal_the_force_of_a_random_walk(seed, gradient):
    trace = walk(seed, samples=80)
    if gradient:
        trace = Trace.from_arrays(trace.time, trace.displacement)
    batch = vectors(3, seed)
    start = np.array([0.0, 0.4, 1.0])
    found = stepped(batch, trace, start=start)
    np.testing.assert_allclose(found, MODEL.force(batch, trace, start), atol=CLOSE)


@pytest.mark.parametrize("amplitude", [1.0, 0.1])
def test_steps_equal_the_force_of_a_smooth_motion(amplitude):
    trace, batch = sine(amplitude, rate=40.0), vectors(4)
    np.testing.assert_allclose(stepped(batch, trace), MODEL.force(batch, trace), atol=CLOSE)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_steps_equal_the_force_under_a_varying_actuation(seed):
    rng = np.random.default_rng(seed)
    level = 0.2 + np.abs(np.cumsum(rng.normal(size=80))) * (rng.uniform(size=80) < 0.9)
    trace, batch = walk(seed, samples=80, actuation=level), vectors(3, seed)
    force = MODEL.force(batch, trace)
    assert np.all(np.isfinite(force))
    found = stepped(batch, trace, trace.reference_actuation)
    np.testing.assert_allclose(found, force, atol=CLOSE)


def test_steps_equal_the_force_under_scales():
    trace, batch = sine(0.2, rate=40.0), vectors(3)
    share = 1 + 0.5 * np.sin(np.arange(trace.samples) / 9)
    scales = {"Fc_fwd": np.stack([share, share**2, 1 / share]), "Fc_bwd": share[None]}
    force = MODEL.force(batch, trace, scales=scales)
    np.testing.assert_allclose(stepped(batch, trace, scales=scales), force, atol=CLOSE)


def test_a_step_leaves_its_state_as_it_was():
    _, state = MODEL.step(MODEL.start(vectors(2)), 0.0, 1.0, 0.0)
    found, _ = MODEL.step(state, 0.05, 1.0, 0.05)
    again, _ = MODEL.step(state, 0.05, 1.0, 0.05)
    np.testing.assert_array_equal(found, again)


def test_a_history_of_constant_actuation_is_a_constant_actuation():
    batch = vectors(5)
    constant = MODEL.force(batch, sine())
    history = MODEL.force(batch, sine(actuation=np.full(1000, 0.7)))
    np.testing.assert_allclose(history, constant, atol=CLOSE)


def test_a_cut_record_has_the_same_force_as_the_whole():
    trace, batch = walk(8), vectors(3)
    cut = Trace.from_arrays(
        trace.time[:120], trace.displacement[:120], velocity=trace.velocity[:120]
    )
    whole = MODEL.force(batch, trace)[:, :120]
    np.testing.assert_allclose(MODEL.force(batch, cut), whole, atol=CLOSE)


def test_no_vectors_have_no_force():
    assert MODEL.force(np.ones((0, 12)), sine()).shape == (0, 1000)


def test_parameters_are_in_their_order_with_units():
    assert MODEL.parameters == tuple(VALUES)
    units = ["kip/in"] * 2 + ["in"] * 2 + ["kip/in", "kip", "kip", "1", "kip*s/in", "1", "1"]
    assert [q.unit for q in MODEL.quantities] == [*units, "in/s"]
    assert find_model("backlash").has_gap
    assert MODEL.gap({"gap": np.array([0.3])}) == 0.3


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        *[(name, 0.0, "positive") for name in ("k_fwd", "k_bwd", "ell", "Fc_fwd", "Fc_bwd", "v_s")],
        *[(name, -0.1, "at least 0") for name in ("gap", "k_0", "sigma2", "static_excess_fwd")],
        ("n", 0.9, "at least 1"),
        ("gap", np.nan, "at least 0"),
        ("k_bwd", np.inf, "positive"),
    ],
)
def test_values_that_do_not_fit_are_refused_by_name(name, value, words):
    for call in (MODEL.start, lambda batch: MODEL.force(batch, sine())):
        with pytest.raises(FitError, match=f"{name} must be finite and {words}, got {value}"):
            call(theta(**{name: value}))


@pytest.mark.parametrize("shape", [(12,), (1, 11), (1, 14)])
def test_theta_of_another_shape_is_refused(shape):
    with pytest.raises(FitError, match="backlash"):
        MODEL.force(np.ones(shape), sine())


@pytest.mark.parametrize("start", [-0.1, 1.1, np.nan, [0.5, 0.5]])
def test_a_start_that_does_not_fit_is_refused(start):
    for call in (MODEL.start, lambda batch, w0: MODEL.force(batch, sine(), w0)):
        with pytest.raises(FitError, match="start must be a fraction"):
            call(theta(), start)


@pytest.mark.parametrize(
    "scales",
    [
        {"k_fwd": np.ones((1, 1000))},
        {"Fc_fwd": np.ones((2, 1000))},
        {"Fc_fwd": np.full((1, 1000), np.nan)},
        {"Fc_bwd": -np.ones((1, 1000))},
    ],
)
def test_scales_that_do_not_fit_are_refused(scales):
    with pytest.raises(FitError, match=next(iter(scales))):
        MODEL.force(theta(), sine(), scales=scales)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("displacement", np.nan, "a finite number"),
        ("velocity", np.inf, "a finite number"),
        ("dt", np.nan, "a finite number above 0"),
        ("dt", 0.0, "a finite number above 0"),
        ("actuation", -1.0, "a finite number of at least 0"),
    ],
)
def test_steps_that_do_not_fit_are_refused_by_name(name, value, words):
    good = {"displacement": 0.0, "velocity": 0.0, "dt": 0.01, "actuation": 1.0}
    _, state = MODEL.step(MODEL.start(theta(), reference_actuation=1.0), **good)
    with pytest.raises(FitError, match=f"{name} of a step must be {words}, got {value}"):
        MODEL.step(state, **good | {name: value})


@pytest.mark.parametrize("reference", [-1.0, 0.0, np.nan])
def test_a_reference_actuation_that_does_not_fit_is_refused_by_name(reference):
    with pytest.raises(FitError, match=f"reference_actuation must be .*, got {reference}"):
        MODEL.start(theta(), reference_actuation=reference)


def test_a_valve_that_is_closed_at_first_is_no_reference():
    trace = sine()

    forces = partial(late_forces, MODEL, theta(), trace)
    expected = forces(0.5)
    np.testing.assert_allclose(forces(0.0), expected, rtol=1e-4, atol=1e-4)
    assert np.max(np.abs(forces(0.0, reference=1.0) - expected)) > 0.1  # the control
