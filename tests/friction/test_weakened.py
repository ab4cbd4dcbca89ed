"""Friction that falls with the travel since a turn, around every model."""

import copy
import pickle

import numpy as np
import pytest
from scipy import optimize

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import MODELS, find_model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.friction.weakened import Weakened
from mfd_bayes.records.trace import Trace

PRIORS = load_priors("mfd")
TIME = np.arange(0.0, 6.0, 1 / 64)
SMALL_TURNS = 1.2 * np.sin(2.5 * TIME + 0.3) + 0.2 * np.sin(8.2 * TIME)
LEVEL = 1.0 + 0.4 * np.sin(TIME)


def trace_of(x=SMALL_TURNS, actuation=1.0, **options):
    return Trace.from_arrays(TIME[: len(x)], x, actuation, np.zeros(len(x)), **options)


def dampers(model, n=5, seed=1):
    """Parameters (n, p) from the prior, and places in the gap (n,)."""
    posterior = Posterior(trace_of(), PRIORS, "iid", model)
    drawn = posterior.draw_prior(np.random.default_rng(seed), n)
    return posterior.theta(drawn), drawn["start"]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("actuation", [1.0, LEVEL], ids=["constant", "varying"])
def test_without_any_fall_the_force_is_that_of_the_model(name, actuation):
    model, trace = find_model(f"{name}+weakening"), trace_of(actuation=actuation)
    theta, start = dampers(model)
    theta[:, -2:] = 0.0
    plain = model.base.force(theta[:, :-2], trace, start)
    assert np.allclose(model.force(theta, trace, start), plain, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["three_stage", "backlash"])
def test_a_motion_ends_where_that_of_the_model_ends(name):
    model, trace = find_model(f"{name}+weakening"), trace_of()
    theta, start = dampers(model)
    theta[:, -2:] = 0.0
    place = model.base.end(theta[:, :-2], trace, start)
    assert np.allclose(model.end(theta, trace, start), place, rtol=0, atol=1e-6)
    begun = model.base.start_at(place, trace, theta[:, :-2], theta[::-1, :-2])
    assert np.array_equal(model.start_at(place, trace, theta, theta[::-1]), begun)
    assert np.allclose(model.start_at(place, trace), model.base.start_at(place, trace))


def test_friction_that_falls_moves_the_end_of_a_spring():
    model = find_model("backlash+weakening")
    trace = trace_of(1.2 * np.sin(2.5 * TIME[TIME < 2.4]))  # it ends in slip
    theta, start = dampers(model)
    theta[:, -2:] = 0.0
    even = model.end(theta, trace, start)
    theta[:, -2:] = 0.5
    assert np.all(np.abs(model.end(theta, trace, start) - even) > 1e-3)


@pytest.mark.parametrize("side", ["fwd", "bwd"])
def test_the_slip_force_falls_as_its_formula_says(side):
    x = 2.0 * np.sin(0.5 * np.pi * TIME[TIME < 4.1])
    model = find_model(f"lugre+weakening_{side}")
    #        sigma0 sigma1 sigma2 Fs_fwd Fc_fwd Fs_bwd Fc_bwd v_s  w
    theta = np.array([[500.0, 0.0, 0.0, 2.0, 2.0, 1.5, 1.5, 0.5, 0.2]])
    force = model.force(theta, trace_of(x))[0]
    kept = (TIME[: x.size] > 1.2) & (TIME[: x.size] < 2.9)  # on the way back, in slip
    factor = 1.0 + 0.2 * (np.exp(-(2.0 - x[kept]) / 0.5) - np.exp(-1.0))
    expected = -1.5 * (factor if side == "bwd" else np.ones(factor.size))
    assert np.allclose(force[kept], expected, rtol=0, atol=0.01)
    assert np.ptp(factor) > 0.1


@pytest.mark.parametrize("name", MODELS)
def test_factors_of_the_actuation_are_multiplied_with_it(name):
    model = find_model(f"{name}+weakening")
    theta, start = dampers(model)
    trace, constant = trace_of(actuation=LEVEL), trace_of(actuation=1.0)
    names = [n for side in ("fwd", "bwd") for n in model.friction(side)]
    share = (LEVEL / trace.reference_actuation)[None]
    given = model.force(theta, constant, start, scales=dict.fromkeys(names, share))
    assert np.allclose(given, model.force(theta, trace, start), rtol=0, atol=1e-9)


@pytest.mark.parametrize("ending", ["weakening", "weakening_bwd"])
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("actuation", [1.0, LEVEL], ids=["constant", "varying"])
def test_steps_equal_the_force_of_the_whole_motion(name, ending, actuation):
    model, trace = find_model(f"{name}+{ending}"), trace_of(actuation=actuation, hysteresis=0.0)
    theta, start = dampers(model)
    state = model.start(theta, start, reference_actuation=trace.reference_actuation)
    levels = np.broadcast_to(trace.actuation, trace.samples)
    found = []
    for x, v, level in zip(trace.displacement, trace.velocity, levels, strict=True):
        force, state = model.step(state, x, v, 1 / 64, None if trace.varying is False else level)
        found.append(force)
    assert np.allclose(np.array(found).T, model.force(theta, trace, start), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["three_stage", "lugre", "backlash"])
def test_turns_make_no_jump(name):
    """Where the motion turns, in the gap and in slip, the force changes hardly more in a step."""
    model, time = find_model(f"{name}+weakening"), np.arange(0.0, 3.0, 1 / 2048)
    trace = Trace.from_arrays(time, 0.8 * np.sin(2.5 * time) + 0.15 * np.sin(9.0 * time), 1.0)
    theta, start = dampers(model, 8)
    theta[:, -2:] = [0.4, -0.4]  # 1.25 times the slip force after a turn
    steps, plain = (
        np.abs(np.diff(force, axis=1)).max(axis=1)
        for force in (
            model.force(theta, trace, start),
            model.base.force(theta[:, :-2], trace, start),
        )
    )
    assert np.all(steps < 1.3 * plain)


@pytest.mark.parametrize("planted", [(0.2, 0.1), (0.0, 0.0)], ids=["planted", "control"])
def test_a_planted_fall_is_found_and_none_where_there_is_none(planted):
    trace = trace_of(1.2 * np.sin(3.0 * TIME))
    model = Weakened(ThreeStage())
    theta = np.array(
        [[60, 0.0, 0.01, 2.4, 2.0, 1.9, 1.5, 0.5, 30, 0.1, 0.08, 1.0, 0.005, 0.5, *planted]]
    )
    rng = np.random.default_rng(2)
    force = model.force(theta, trace, 0.5)[0] + rng.normal(0.0, 0.03, trace.samples)
    measured = Trace.from_arrays(TIME, trace.displacement, 1.0, force)
    posterior = Posterior(measured, PRIORS, "iid", model)
    others = {n: np.array([PRIORS.parameters[n].typical]) for n in posterior.names}
    middle = posterior.coordinates(others | {"Fc_fwd": np.array([1.8]), "Fc_bwd": np.array([1.6])})

    def residual(q):
        return np.concatenate([posterior.residual(q[None])[0] / 0.03, q - middle[0]])

    best = optimize.least_squares(residual, middle[0], max_nfev=60).x
    values = posterior.values(best[None])
    found = [values[f"weakening_{side}"][0] for side in ("fwd", "bwd")]
    assert found == pytest.approx(planted, abs=0.03)


def test_names_say_in_which_directions_friction_falls():
    assert find_model("lugre+weakening") == Weakened(LuGre())
    one = find_model("three_stage+weakening_bwd")
    assert one == Weakened(ThreeStage(), ("bwd",))
    assert one.parameters == (*ThreeStage.parameters, "weakening_bwd")
    assert one.quantities[-1].name == "weakening_bwd"
    assert one.composed(("static_excess_fwd",)) == ("Fs_fwd",)
    for wrong in ("lugre+", "lugre+travel", "lugre+weakening+weakening", "other+weakening"):
        with pytest.raises(FitError, match="unknown model"):
            find_model(wrong)


def test_it_can_be_sent_to_another_process():
    model = find_model("backlash+weakening")
    theta, start = dampers(model, 2)
    force = model.force(theta, trace_of(), start)
    for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert np.array_equal(other.force(theta, trace_of(), start), force)


def test_what_does_not_fit_is_refused_in_one_sentence():
    model = find_model("lugre+weakening")
    theta, _ = dampers(model)
    with pytest.raises(FitError, match=r"shape \(n, 10\) for lugre\+weakening"):
        model.force(theta[:, :-1], trace_of())
    theta[2, -1] = 1.5
    with pytest.raises(FitError, match=r"weakening_bwd must lie between -1 and 1, got 1\.5"):
        model.force(theta, trace_of())


def test_a_model_must_say_what_slips_and_may_lack_steps():
    class Spring(Model):
        name = "spring"
        quantities = (Quantity("k", "stiffness", "k", "k", "stiffness"),)

    class Slider(Spring):
        slip_forces = ("k", "k")

    with pytest.raises(FitError, match="spring does not say which parameters are its slip forces"):
        Weakened(Spring())
    with pytest.raises(FitError, match="spring has no steps in time"):
        Weakened(Slider()).start(np.ones((1, 3)))
