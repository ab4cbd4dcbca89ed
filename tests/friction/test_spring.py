"""The spring of the backlash model, also where its corners are very sharp."""

import numpy as np
import pytest

from mfd_bayes.friction import slip
from mfd_bayes.friction.spring import Spring
from tests.friction.backlash_cases import MODEL, VALUES, sine, spring

SHARP = 3e-4  # in; the gap is 667 times as wide
NAMES = ("k_fwd", "k_bwd", "gap", "ell", "k_0")


SUDDEN = np.array([148.4, 92.5, 0.19, 2.84e-4, 0.573, 2.11, 1.654, 24.13, 0.0108, 0.28, 0.28, 0.53])
"""A damper with a sharp gap and sudden slip. Of those near it a quarter cycle without the guard."""


def most_steps(monkeypatch):
    """Newton's steps in the one piece of a motion, the most of 60 dampers one by one."""
    taken, counted = [], slip.newton
    monkeypatch.setattr(slip, "newton", lambda *a: taken.append(1) or counted(*a))
    trace, found = sine(1.0, seconds=3.0, rate=50.0), []
    for row in SUDDEN * np.random.default_rng(0).lognormal(0.0, 0.01, (60, SUDDEN.size)):
        taken.clear()
        force = MODEL.force_unbounded(row[None], trace)
        found.append(len(taken))
        assert np.all(np.isfinite(force)) or found[-1] == slip.ITERATIONS
    return max(found)


def springs(ell):
    columns = {name: np.full(len(ell), VALUES[name]) for name in NAMES} | {"ell": np.array(ell)}
    return Spring(**columns), columns


@pytest.mark.parametrize("exponent", [-600.0, -700.0, -720.0, -740.0, -744.0, -760.0, -3000.0])
def test_force_and_stiffness_are_exact_where_the_exponent_is_near_the_smallest_number(exponent):
    """Beside a vector with a round corner, which is not to lose its own digits."""
    one, columns = springs([SHARP, 0.02])
    z = np.array([columns["gap"][0] / 2 + exponent * SHARP, -0.11])
    force, slope = one.evaluate(z)
    np.testing.assert_allclose(force, spring(z, columns), rtol=1e-12, atol=1e-12)
    h = 1e-7
    rise = (spring(z + h, columns) - spring(z - h, columns)) / (2 * h)
    np.testing.assert_allclose(slope, rise, rtol=1e-5)


def test_without_the_guard_digits_are_lost(monkeypatch):
    """Negative control of the test above."""
    monkeypatch.setattr("mfd_bayes.friction.spring.LEAST", -1e9)
    one, columns = springs([SHARP])
    z = np.array([columns["gap"][0] / 2 - 744.0 * SHARP])
    assert abs(one.force(z) / spring(z, columns) - 1.0)[0] > 1e-3


def test_newton_takes_few_steps_at_a_sharp_corner_and_sudden_slip(monkeypatch):
    assert most_steps(monkeypatch) < 8


def test_without_the_guard_newton_goes_to_and_fro(monkeypatch):
    """Negative control of the test above."""
    monkeypatch.setattr("mfd_bayes.friction.spring.LEAST", -1e9)
    assert most_steps(monkeypatch) == slip.ITERATIONS
