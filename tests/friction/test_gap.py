import itertools
import math

import numpy as np
import pytest

from mfd_bayes.friction.gap import Gap, blend, fade, follow
from mfd_bayes.records.trace import Trace

K2, K3, D2, D3, ELL = 0.5, 30.0, 0.1, 0.12, 0.005
D = D2 + D3


def a_gap(ell=ELL, n=1):
    return Gap(*(np.full(n, value) for value in (K2, K3, D2, D3, ell)))


def literal(u, side, slip, ell=ELL):
    """Force and weights written as in model.md section 4, for scalars."""

    def m(x):
        return 1 / (1 + math.exp(-x / ell))

    force = slip
    m12 = math.tanh(u / (2 * ell)) if u >= 0 else 0.0
    force = (1 - m12) * force + m12 * side * K2 * u
    m23 = m(u - D2)
    force = (1 - m23) * force + m23 * side * (K2 * D2 + K3 * (u - D2))
    m31 = m(u - D2 - D3)
    return (1 - m31) * force + m31 * slip


def legs(*corners, samples=11):
    """Trace that goes straight from corner to corner."""
    pieces = [np.linspace(a, b, samples)[1:] for a, b in itertools.pairwise(corners)]
    motion = np.concatenate([[corners[0]], *pieces])
    return Trace.from_arrays(0.01 * np.arange(motion.size), motion)


def states(trace, start=0.5, slip=0.0, **kwargs):
    gap = a_gap(**kwargs)
    return follow(gap, trace, np.array([start]), lambda _: np.array([slip]))


def travel(crossing, stretch, x):
    return float(crossing.offset[stretch, 0] + crossing.side[stretch, 0] * x)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("ell", [0.002, 0.005, 0.05])
def test_blend_equals_the_literal_formulas(side, ell):
    u = np.linspace(-0.1, 0.4, 101)
    slip = np.linspace(-2.0, 3.0, 101)
    expected = [literal(ui, side, fi, ell) for ui, fi in zip(u, slip, strict=True)]
    got = blend(a_gap(ell), u[:, None], np.full((101, 1), side), slip[:, None])
    np.testing.assert_allclose(got[:, 0], expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beyond_the_gap_and_before_it_the_device_slips(side):
    for u in (-10.0, -0.5, D + 0.3, 50.0):
        force = blend(a_gap(), np.array([[u]]), np.array([[side]]), np.array([[1.7]]))
        assert force[0, 0] == pytest.approx(1.7, abs=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_in_the_first_part_of_the_gap_it_sticks_and_in_the_second_it_builds_up(side):
    force = blend(a_gap(0.001), np.array([[0.05], [0.16]]), np.array([[side]]), np.array([[9.0]]))
    assert force[0, 0] == pytest.approx(side * K2 * 0.05, abs=1e-9)
    assert force[1, 0] == pytest.approx(side * (K2 * D2 + K3 * 0.06), abs=1e-9)


def test_half_weights_stand_at_the_ends_of_stage_three():
    # at u = d2 half of stage 3, at u = D half of slip
    gap, side, slip = a_gap(0.001), np.ones((1, 1)), np.full((1, 1), 4.0)
    at_d2 = blend(gap, np.array([[D2]]), side, slip)[0, 0]
    assert at_d2 == pytest.approx(K2 * D2, abs=1e-9)
    at_d = blend(gap, np.array([[D]]), side, slip)[0, 0]
    assert at_d == pytest.approx(0.5 * (K2 * D2 + K3 * D3) + 0.5 * 4.0, abs=1e-9)


def test_carried_force_fades_with_the_travel():
    gap = a_gap()
    assert fade(gap, np.zeros((1, 1)))[0, 0] == 1.0
    for u in (0.004, 0.02, -0.004):
        expected = 1 - math.tanh(abs(u) / (2 * ELL))
        assert fade(gap, np.array([[u]]))[0, 0] == pytest.approx(expected, rel=1e-12)
    assert fade(gap, np.array([[1.0]]))[0, 0] == 0.0


def test_extreme_travel_overflows_nothing():
    u = np.array([[-1e6], [1e6]])
    force = blend(a_gap(1e-6), u, np.ones((2, 1)), np.full((2, 1), 2.0))
    np.testing.assert_allclose(force, 2.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_full_crossings_switch_sides_and_start_at_zero(sign):
    crossing = states(legs(0, sign * 1.0, sign * -1.0, sign * 1.0))
    np.testing.assert_array_equal(crossing.side[:, 0], [sign, -sign, sign])
    assert travel(crossing, 0, 0) == pytest.approx(0.5 * D)
    assert travel(crossing, 0, sign * 1.0) == pytest.approx(0.5 * D + 1.0)
    assert travel(crossing, 1, sign * 1.0) == pytest.approx(0, abs=1e-15)
    assert travel(crossing, 1, sign * -1.0) == pytest.approx(2.0)
    assert travel(crossing, 2, sign * -1.0) == pytest.approx(0, abs=1e-15)


def test_turning_inside_the_gap_changes_nothing():
    # after slip at 1, into the gap by 0.15, back by 0.1, on by 0.1, then through
    crossing = states(legs(0, 1.0, 0.85, 0.95, 0.85, -1.0))
    for stretch in (2, 3):
        for state in (crossing.side, crossing.offset, crossing.carry):
            np.testing.assert_array_equal(state[stretch], state[1])
    assert travel(crossing, 3, 0.85) == pytest.approx(0.15)
    assert travel(crossing, 3, -1.0) == pytest.approx(2.0)


def test_going_back_out_of_the_gap_slips_on_the_side_it_had_left():
    # slip forward to 1, 0.1 into the gap, back to 1.3: u = -0.3 is not clipped on the way
    crossing = states(legs(0, 1.0, 0.9, 1.3, 0.0))
    assert crossing.side[1, 0] == crossing.side[2, 0] == -1
    assert travel(crossing, 2, 1.0) == pytest.approx(0, abs=1e-15)
    assert travel(crossing, 2, 1.3) == pytest.approx(-0.3)
    # turning there, the gap lies ahead again from its beginning, in the same direction
    assert crossing.side[3, 0] == -1
    assert travel(crossing, 3, 1.3) == pytest.approx(0, abs=1e-15)
    assert travel(crossing, 3, 1.3 - D) == pytest.approx(D)


def test_turning_exactly_at_the_ends_of_the_gap_counts_as_slip():
    crossing = states(legs(0.0, 0.5 * D, 0.0), start=0.5)
    assert travel(crossing, 0, 0.5 * D) == pytest.approx(D)
    assert crossing.side[1, 0] == -1
    back = states(legs(0.0, 1.0, 0.9, 1.0, 0.9))
    assert travel(back, 3, 1.0) == pytest.approx(0, abs=1e-15)
    assert back.side[3, 0] == -1


def test_start_places_the_first_sample_in_the_gap():
    for start in (0.0, 0.3, 1.0):
        assert travel(states(legs(0.2, -0.8, 0.4), start=start), 0, 0.2) == pytest.approx(start * D)


def test_vectors_of_a_batch_take_their_own_branch():
    # the same turn is inside a wide gap and after slip in a narrow one
    trace = legs(0, 1.0, 0.85, 1.0)
    wide = Gap(*(np.array(v) for v in ([K2] * 2, [K3] * 2, [0.1, 0.02], [0.1, 0.02], [ELL] * 2)))
    crossing = follow(wide, trace, np.full(2, 0.5), lambda _: np.zeros(2))
    np.testing.assert_array_equal(crossing.side[:, 0], [1, -1, -1])
    np.testing.assert_array_equal(crossing.side[:, 1], [1, -1, 1])


@pytest.mark.parametrize("ell", [0.005, 0.03, 0.1])
def test_force_is_the_same_just_before_and_just_after_every_turning_point(ell):
    # 0.01 beyond the gap, back out of it, inside it, and after full slip
    trace = legs(0, 1.0, 1.0 - D - 0.01, 1.0, 0.6, 0.62, 0.7, 0.6, 1.5, 1.4, 1.55, 1.4)
    gap, slip = a_gap(ell), 2.3
    crossing = states(trace, slip=slip, ell=ell)

    def force(stretch, x):
        u = np.array([travel(crossing, stretch, x)])
        blended = blend(gap, u, crossing.side[stretch], np.array([slip]))
        return float((blended + crossing.carry[stretch] * fade(gap, u))[0])

    for k, sample in enumerate(trace.turning_points):
        x = trace.displacement[sample]
        assert force(k + 1, x) == pytest.approx(force(k, x), abs=1e-9)
