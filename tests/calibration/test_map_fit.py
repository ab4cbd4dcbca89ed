"""Climbs to modes, of which some are known."""

import numpy as np

from mfd_bayes.calibration.map_fit import Mode, climb, is_same

DIM, APART = 5, 9.0


def density(q):
    """A unit normal at 0, and a higher one half as wide 9 sd away in every dimension."""
    far = -0.5 * np.sum(((q - APART) / 0.5) ** 2, axis=1) - DIM * np.log(0.5)
    return np.logaddexp(-0.5 * np.sum(q**2, axis=1), far)


class Counted:
    """The density, and the number of points asked for."""

    def __init__(self):
        self.points = 0

    def __call__(self, q):
        self.points += len(q)
        return density(q)


def reached(begin, known=()):
    counted = Counted()
    return climb(counted, np.full(DIM, begin), np.full(DIM, 10.0), known), counted.points


def test_a_climb_ends_early_at_a_known_mode():
    mode, whole = reached(3.0)
    again, less = reached(-3.0, [mode])
    assert again is mode
    assert less < 0.5 * whole


def test_another_mode_than_the_known_one_is_found():
    main, _ = reached(1.0)
    far, points = reached(APART + 1.0, [main])
    assert not is_same(far, main)
    np.testing.assert_allclose(far.q, APART, atol=0.01)
    assert points == reached(APART + 1.0)[1]


def test_a_climb_that_is_above_a_known_point_goes_on():
    q = np.full(DIM, 1.2)
    below = Mode(q, float(density(q[None])[0]), np.eye(DIM))  # where BFGS ended too early
    found, _ = reached(0.6, [below])
    np.testing.assert_allclose(found.q, 0.0, atol=0.01)
