"""Where in the gap a motion ends: a motion cut in two goes on as the whole does."""

import itertools

import numpy as np
import pytest

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model, Parameter
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from tests.friction import backlash_cases as backlash
from tests.friction.test_three_stage import D, random_theta
from tests.friction.test_three_stage import theta as theta_of

STAGES = ThreeStage()


def cut(trace, at):
    """Both parts of a trace; they share a sample."""
    parts = slice(0, at + 1), slice(at, None)
    return [
        Trace.from_arrays(
            *(column[part] for column in (trace.time, trace.displacement)),
            trace.actuation[part] if trace.varying else None,
            velocity=trace.velocity[part],
            hysteresis=trace.hysteresis,
        )
        for part in parts
    ]


def off(model, theta, trace, at, start=None):
    """Largest difference of the second part's force from the whole's, at each sample."""
    first, second = cut(trace, at)
    if start is None:
        start = model.start_at(model.end(theta, first, 0.3), second)
    whole = model.force(theta, trace, 0.3)[:, at:]
    return np.max(np.abs(model.force(theta, second, start) - whole), axis=0)


def test_a_backlash_cut_anywhere_goes_on_as_the_whole_does():
    for at in [40, 250, 420]:
        for amplitude in [1.0, 0.15, 0.05]:
            theta, trace = backlash.vectors(5), backlash.sine(amplitude)
            theta[:, -3:-1] = 0.0  # no static friction, by which a deflection can be out of range
            assert np.max(off(backlash.MODEL, theta, trace, at)) < 0.01, at
            assert np.max(off(backlash.MODEL, theta, trace, at, start=0.5)) > 0.05, at


def test_a_backlash_cut_goes_on_under_a_varying_actuation():
    level = 1.0 + 0.4 * np.sin(np.arange(1000) / 90.0)
    theta, whole = backlash.vectors(3), backlash.sine(0.4, actuation=level)
    at = 155  # in the gap, at a higher actuation than the mean
    first, second = cut(whole, at)
    share = level[: at + 1] / whole.reference_actuation
    scales = dict.fromkeys(("Fc_fwd", "Fc_bwd"), share[None])
    other = dict.fromkeys(scales, level[None, at:] / whole.reference_actuation)
    start = backlash.MODEL.start_at(backlash.MODEL.end(theta, first, scales=scales), second)
    found = backlash.MODEL.force(theta, second, start, scales=other)
    expected = backlash.MODEL.force(theta, whole)[:, at:]
    np.testing.assert_allclose(found, expected, atol=0.02)
    without = backlash.MODEL.end(theta, first)  # at the mean of the first part
    assert np.max(np.abs(without - backlash.MODEL.end(theta, first, scales=scales))) > 1e-3


def motion_of(*corners, samples=40):
    """Straight from corner to corner, at 1 in/s or less."""
    pieces = [np.linspace(a, b, samples)[1:] for a, b in itertools.pairwise(corners)]
    x = np.concatenate([[corners[0]], *pieces])
    return Trace.from_arrays(0.02 * np.arange(x.size), x, velocity=np.zeros(x.size), hysteresis=0.0)


def test_three_stages_cut_in_the_gap_go_on_as_the_whole_does():
    for sign in [1.0, -1.0]:
        for reached in [0.04, 0.1, 0.16]:
            corners = sign * np.array(
                [0.0, 0.6, -0.6, -0.6 + 0.5 * reached, -0.6 + reached, 0.5, -0.5]
            )
            trace, at = motion_of(*corners), 4 * 39
            theta = np.concatenate(
                [theta_of(), random_theta(np.random.default_rng(1), 4, d2=0.12, d3=0.1)]
            )
            away = off(STAGES, theta, trace, at)
            after = slice(39 + 5, None)  # past the first turn after slip
            assert np.max(away[after]) < 1e-6
            middle = off(STAGES, theta, trace, at, start=0.5)
            # before it, bristles that begin at rest differ on a short way
            assert np.linalg.norm(away[:39]) < 0.6 * np.linalg.norm(middle[:39])


def test_three_stages_at_a_turn_after_slip_begin_at_an_end_of_the_gap():
    theta = theta_of()
    for x, place in ((0.6, 1.0), (-0.6, 0.0)):
        ended = motion_of(0.0, x)
        assert STAGES.end(theta, ended) == place
        back = motion_of(x, 0.0)
        assert STAGES.start_at(STAGES.end(theta, ended), back) == 0.0  # travel since the slip
        on = motion_of(x, 2.0 * x)
        assert STAGES.start_at(STAGES.end(theta, ended), on) == 1.0
    inside = motion_of(0.6, -0.6, -0.6 + 0.25 * D)
    assert STAGES.end(theta, inside) == pytest.approx(0.25)


def test_a_batch_ends_as_its_vectors_do_one_by_one():
    for model in [STAGES, backlash.MODEL]:
        theta = (
            random_theta(np.random.default_rng(2), 6) if model is STAGES else backlash.vectors(6)
        )
        trace, start = backlash.walk(4), np.linspace(0.0, 1.0, 6)
        together = model.end(theta, trace, start)
        alone = [model.end(row[None], trace, w0)[0] for row, w0 in zip(theta, start, strict=True)]
        np.testing.assert_allclose(together, alone, atol=1e-8)
        assert np.all((together >= 0.0) & (together <= 1.0))
        assert model.end(theta[:0], trace).shape == (0,)


def test_the_place_of_a_backlash_is_taken_over_by_other_parameters():
    model, trace = backlash.MODEL, backlash.sine()
    wide, strong = backlash.theta(gap=0.4), backlash.theta(Fc_fwd=4.4, Fc_bwd=3.6)
    own = backlash.theta()
    middle, slip = np.array([0.5]), np.array([1.0])
    assert model.start_at(slip, trace, own, own) == pytest.approx(1.0)
    # beyond the gap the spring keeps its deflection: in slip with a wider gap, too
    assert model.start_at(slip, trace, own, wide) == pytest.approx(1.0)
    # and at twice the actuation it is half way to slip
    force = model.force(strong, trace, model.start_at(slip, trace, own, strong))[0, 0]
    assert force == pytest.approx(model.force(own, trace, slip)[0, 0], rel=0.05)
    # back at the lower one it slips
    assert model.start_at(slip, trace, strong, own) == 1.0
    inside = model.start_at(middle, trace, own, wide)
    z = 0.5 * (2.2 / 50.0 - 1.8 / 42.0)  # of the middle of the range, doubled as the gap is
    low, high = -0.2 - 1.8 / 42.0, 0.2 + 2.2 / 50.0
    assert inside == pytest.approx((2.0 * z - low) / (high - low))


def test_a_model_of_ones_own_with_a_gap_must_say_where_it_ends():
    class Own(Model):
        name = "own"
        parameters = (Parameter("k"),)
        has_gap = True

    with pytest.raises(FitError, match="the model own does not say where in its gap"):
        Own().end(np.ones((1, 1)), backlash.sine())
