import itertools
import math

import numpy as np
import pytest

from mfd_bayes.friction.gap import follow
from mfd_bayes.friction.gap import travel as travel_since_slip
from mfd_bayes.friction.transitions import Crossing, Gap, blend
from mfd_bayes.records.trace import Trace

K2, K3, D2, D3, ELL = 0.5, 30.0, 0.1, 0.12, 0.005
D = D2 + D3


def a_gap(ell=ELL, n=1):
    return Gap(*(np.full(n, value) for value in (K2, K3, D2, D3, ell)))


def literal(u, side, slip, ell=ELL):
    """Force and weights for scalars, written as in model.md section 4."""

    def m(x):
        return 0.5 * (1 + math.tanh(0.5 * x / ell))

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
    path = trace.path
    at_turns = np.full((path.turning_points.size, 1), slip)
    return follow(a_gap(**kwargs), path, np.array([start]), at_turns)


def force_at(gap, u, side, slip, carry=0.0):
    """Force at travels u of one crossing, and with a carried force, (N,) each."""
    edge = 0.0 if side > 0 else -gap.width[0]
    crossing = Crossing(*(np.full((1, 1), value) for value in (side, edge, carry)))
    force = np.broadcast_to(np.asarray(slip, dtype=float), np.shape(u))[:, None].copy()
    blend(gap, crossing, np.zeros(len(u), dtype=int), side * np.asarray(u), force)
    return force[:, 0]


def travel(crossing, stretch, x):
    edge = float(crossing.edge[stretch, 0])
    return x - edge if crossing.side[stretch, 0] > 0 else edge + D - x


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("ell", [0.002, 0.005, 0.05])
def test_blend_equals_the_literal_formulas(side, ell):
    u = np.linspace(-0.1, 0.4, 101)
    slip = np.linspace(-2.0, 3.0, 101)
    expected = [literal(ui, side, fi, ell) for ui, fi in zip(u, slip, strict=True)]
    got = force_at(a_gap(ell), u, side, slip)
    np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-10)
    # without travels below 0, which use another branch
    ahead = u >= 0
    got = force_at(a_gap(ell), u[ahead], side, slip[ahead])
    np.testing.assert_allclose(got, np.array(expected)[ahead], rtol=1e-10, atol=1e-10)


def test_very_sharp_transitions_equal_the_literal_formulas():
    # these use separate exponentials, since exp(D/ℓ) overflows
    ell = D / 900
    near = np.array([-3.0, -0.5, 0.0, 0.5, 2.0, 7.0]) * ell
    u = np.concatenate([near, D2 + near, D + near, [0.5 * D2, D2 + 0.5 * D3, 2 * D]])
    expected = [literal(ui, 1.0, 1.7, ell) for ui in u]
    np.testing.assert_allclose(force_at(a_gap(ell), u, 1.0, 1.7), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beyond_the_gap_and_before_it_the_device_slips(side):
    force = force_at(a_gap(), [-10.0, -0.5, D + 0.3, 50.0], side, 1.7)
    np.testing.assert_allclose(force, 1.7, atol=1e-10)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_in_the_first_part_of_the_gap_it_sticks_and_in_the_second_it_builds_up(side):
    force = force_at(a_gap(0.001), [0.05, 0.16], side, 9.0)
    assert force[0] == pytest.approx(side * K2 * 0.05, abs=1e-9)
    assert force[1] == pytest.approx(side * (K2 * D2 + K3 * 0.06), abs=1e-9)


def test_half_weights_stand_at_the_ends_of_stage_three():
    # at u = d2 half of stage 3, at u = D half of slip
    at_d2, at_d = force_at(a_gap(0.001), [D2, D], 1.0, 4.0)
    assert at_d2 == pytest.approx(K2 * D2, abs=1e-9)
    assert at_d == pytest.approx(0.5 * (K2 * D2 + K3 * D3) + 0.5 * 4.0, abs=1e-9)


def test_carried_force_fades_with_the_travel():
    u = np.array([0.0, 0.004, 0.02, -0.004, 1.0])
    gap = a_gap()
    share = (force_at(gap, u, 1.0, 2.0, carry=0.3) - force_at(gap, u, 1.0, 2.0)) / 0.3
    np.testing.assert_allclose(share, 1 - np.tanh(np.abs(u) / (2 * ELL)), atol=1e-10)
    ahead = u >= 0
    alone = force_at(gap, u[ahead], 1.0, 2.0, carry=0.3) - force_at(gap, u[ahead], 1.0, 2.0)
    np.testing.assert_allclose(alone / 0.3, share[ahead], atol=1e-10)


def test_extreme_travel_overflows_nothing():
    for u in ([-1e6, 1e6], [1e6], [-1e6]):
        np.testing.assert_allclose(force_at(a_gap(1e-6), u, 1.0, 2.0), 2.0)
        np.testing.assert_allclose(force_at(a_gap(), u, 1.0, 2.0), 2.0)


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
        for state in (crossing.side, crossing.edge, crossing.carry):
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
    at_turns = np.zeros((trace.path.turning_points.size, 2))
    crossing = follow(wide, trace.path, np.full(2, 0.5), at_turns)
    np.testing.assert_array_equal(crossing.side[:, 0], [1, -1, -1])
    np.testing.assert_array_equal(crossing.side[:, 1], [1, -1, 1])


@pytest.mark.parametrize("ell", [0.005, 0.03, 0.1])
def test_force_is_the_same_just_before_and_just_after_every_turning_point(ell):
    # 0.01 beyond the gap, back out of it, inside it, and after full slip
    trace = legs(0, 1.0, 1.0 - D - 0.01, 1.0, 0.6, 0.62, 0.7, 0.6, 1.5, 1.4, 1.55, 1.4)
    gap, slip = a_gap(ell), 2.3
    crossing = states(trace, slip=slip, ell=ell)

    def force(stretch, x):
        force = np.full((1, 1), slip)
        blend(gap, crossing, np.array([stretch]), np.array([x]), force)
        return float(force[0, 0])

    for k, sample in enumerate(trace.turning_points):
        x = trace.displacement[sample]
        assert force(k + 1, x) == pytest.approx(force(k, x), abs=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_travel_since_slip_is_that_of_the_state_in_every_stretch(sign):
    # through the gap, back out of it, inside it, and through it again, by two dampers
    path = legs(*(sign * x for x in (0.1, 1.0, 0.85, 1.3, 0.4, 0.45, -1.0, 0.2))).path
    gap = Gap(*(np.array(v) for v in ([K2] * 2, [K3] * 2, [D2, 0.02], [D3, 0.03], [ELL] * 2)))
    start = np.array([0.2, 0.9])
    got = travel_since_slip(gap, path, start)
    crossing = follow(gap, path, start, np.zeros((path.turning_points.size, 2)))
    x = path.displacement[path.samples]
    for j, width in enumerate(gap.width):
        for i, k in enumerate(path.stretch):
            side, edge = crossing.side[k, j], crossing.edge[k, j]
            expected = x[i] - edge if side > 0 else edge + width - x[i]
            assert got[i, j] == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(got[0], start * gap.width)
    np.testing.assert_allclose(got[-1], 1.2, atol=1e-12)  # since the last turn
