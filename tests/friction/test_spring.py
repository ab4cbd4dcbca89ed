"""The spring of the backlash model, also where its corners are very sharp."""

import numpy as np
import pytest

from mfd_bayes.friction import newton, slip
from mfd_bayes.friction.spring import Spring
from tests.friction.backlash_cases import MODEL, VALUES, sine, spring, theta

SHARP = 3e-4  # in; the gap is 667 times as wide
NAMES = ("k_fwd", "k_bwd", "gap", "ell", "k_0")


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
    taken = []
    counted = slip.newton
    monkeypatch.setattr(slip, "newton", lambda *a: taken.append(len(a[2])) or counted(*a))
    values = {"gap": 0.19, "n": 24.0, "k_fwd": 150.0, "k_bwd": 93.0}
    batch = np.concatenate([theta(ell=ell, **values) for ell in (2.6e-4, 2.84e-4, 3e-4)])
    force = MODEL.force(batch, sine(1.0))
    assert np.all(np.isfinite(force))
    assert len(taken) < newton.STIFF
