"""Functions of the travel since a turn: where they stand, and where there are none."""

from itertools import pairwise

import numpy as np
import pytest

from mfd_bayes.population.discrepancy import KNOTS, TravelBasis
from mfd_bayes.records.trace import Trace

TIME = np.arange(400) / 100.0


def sine(amplitude):
    """Two cycles that begin and end between turns."""
    return Trace.from_arrays(TIME, amplitude * np.sin(2 * np.pi * 0.5 * TIME))


def path(*places):
    """Motion that turns at these places, 100 samples to a stroke."""
    strokes = [np.linspace(a, b, 100, endpoint=False) for a, b in pairwise(places)]
    x = np.concatenate([*strokes, places[-1:]])
    return Trace.from_arrays(np.arange(x.size) / 100.0, x)


def test_they_sum_to_one_in_full_strokes_and_to_none_before_the_first():
    basis, trace = TravelBasis.of([sine(0.5), sine(1.0)]), sine(1.0)
    assert (basis.shortest, basis.longest) == pytest.approx((1.0, 2.0), rel=1e-3)
    values = basis.values(trace)
    assert values.shape == (400, basis.size) == (400, 2 * KNOTS)
    assert np.all(values >= 0)
    total = values.sum(axis=1)
    first, second = trace.turning_points[:2]
    assert np.all(total[:first] == 0)  # no stroke is known yet
    # the first quarter is a half stroke of this test, as long as a full one of the other
    np.testing.assert_allclose(total[first:], 1.0, atol=1e-6)
    assert second > first


def test_directions_are_apart():
    trace = sine(1.0)
    values = TravelBasis.of([trace]).values(trace)[trace.turning_points[1] :]
    velocity = np.diff(trace.displacement)[trace.turning_points[1] :]
    forward = values[:-1, :KNOTS].sum(axis=1) > 0
    backward = values[:-1, KNOTS:].sum(axis=1) > 0
    assert not np.any(forward & backward)
    np.testing.assert_array_equal(forward[1:], velocity[1:] > 0)
    assert 0.3 < forward.mean() < 0.7


def test_they_are_the_same_at_the_same_travel():
    """Whatever the speed and the place: also in a test with shorter strokes."""
    long, short = sine(1.0), path(0.0, 1.0, 0.0, 1.0)
    basis = TravelBasis(1.0, 2.0)
    at_long, at_short = basis.values(long), basis.values(short)
    turn = long.turning_points[2]
    i = turn + 40
    travel = abs(long.displacement[i] - long.displacement[turn])
    forward = long.displacement[i] > long.displacement[turn]
    begin = short.turning_points[0] if not forward else short.turning_points[1]
    moved = np.abs(short.displacement[begin : begin + 99] - short.displacement[begin])
    j = begin + int(np.argmin(np.abs(moved - travel)))
    np.testing.assert_allclose(at_short[j], at_long[i], atol=0.08)  # 0.01 in of travel apart
    assert np.max(np.abs(at_short[j] - at_long[turn + 5])) > 0.5  # the control


def test_beyond_the_longest_stroke_there_are_none():
    trace = path(0.0, 2.0, -1.0, 2.0)
    values = TravelBasis(2.0, 2.0).values(trace)
    begin = trace.turning_points[0]
    travel = np.abs(trace.displacement[begin:200] - trace.displacement[begin])
    assert travel.max() > 2.9
    total = values[begin:200].sum(axis=1)
    np.testing.assert_allclose(total[travel < 2.0], 1.0)
    knot = np.log1p(20.0) / (KNOTS - 1)
    outside = travel > 2.0 * np.expm1(KNOTS * knot) / 20.0  # a knot further
    assert np.any(outside)
    assert np.all(total[outside] == 0.0)


@pytest.mark.parametrize(("stroke", "share"), [(0.4, 0.0), (0.5, 0.0), (0.625, 0.5), (0.75, 1.0)])
def test_after_short_strokes_there_are_none(stroke, share):
    trace = path(0.0, 1.0, 1.0 - stroke, 1.0)
    values = TravelBasis(1.0, 1.0).values(trace)
    last = slice(trace.turning_points[1] + 1, None)
    np.testing.assert_allclose(values[last].sum(axis=1), share, atol=1e-6)


def test_their_prior_is_smooth_and_without_a_tie_between_directions():
    basis = TravelBasis(1.0, 1.0)
    covariance = basis.covariance()
    assert np.linalg.eigvalsh(covariance).min() > 0
    np.testing.assert_allclose(np.diag(covariance), 1.0, atol=1e-5)
    assert np.all(covariance[:KNOTS, KNOTS:] == 0.0)
    assert np.all(np.diff(covariance[0, :KNOTS]) < 0)
    assert covariance[0, 1] > 0.85
    assert covariance[0, KNOTS - 1] < 0.01
