"""What the noise of a stroke has in common: learned from noise that is made so."""

import numpy as np
import pytest

from mfd_bayes.population.discrepancy import Residual
from mfd_bayes.population.strokes import (
    Standardised,
    StrokeLevels,
    learn_levels,
    no_levels,
    strokes_of,
)
from mfd_bayes.population.discrepancy import KNOTS, TravelBasis
from mfd_bayes.records.trace import Trace

MEMORY = 0.6
CYCLES = 12


@pytest.fixture(scope="module")
def motion():
    time = np.arange(CYCLES * 200) / 200.0
    return Trace.from_arrays(time, -np.cos(2.0 * np.pi * time), 1.0, np.zeros(time.size))


@pytest.fixture(scope="module")
def truth():
    """Levels in the second half of a stroke."""
    share = np.where(np.arange(KNOTS) > 10, 0.7, 0.0)
    return StrokeLevels(np.concatenate([share, share]), MEMORY)


def residual_of(motion, levels):
    basis = TravelBasis.of([motion])
    even = np.zeros(basis.size)
    covariance = 1e-6 * basis.covariance()
    return Residual(basis, even, covariance, even, 1.0, levels, 1e-4, 1.0)


def noises(motion, levels, tests=8):
    """Standardised noise of some tests."""
    rng, residual = np.random.default_rng(1), residual_of(motion, levels)
    drawn = residual.draw_noise(rng, motion, np.ones(tests))
    functions, strokes = residual.basis.values(motion), strokes_of(motion)
    known = functions.sum(axis=1) > 0.99
    return [Standardised(one[known], functions[known], strokes[known]) for one in drawn]


def test_levels_are_found_again(motion, truth):
    found, rest = learn_levels(noises(motion, truth))
    at = np.arange(2 * KNOTS) % KNOTS
    assert np.all(np.abs(found.share[at > 11] - 0.7) < 0.15)
    assert np.all(found.share[at < 9] < 0.2)
    assert found.memory == pytest.approx(MEMORY, abs=0.15)
    for left in rest:
        assert left.std() == pytest.approx(1.0, abs=0.06)


def test_independent_noise_has_none(motion):
    found, _ = learn_levels(noises(motion, no_levels(2 * KNOTS)))
    assert found.share.max() < 0.2


def test_draws_of_the_noise_have_its_moments(motion, truth):
    residual, n = residual_of(motion, truth), 6000
    rng, strokes = np.random.default_rng(2), strokes_of(motion)
    drawn = residual.draw_noise(rng, motion, np.full(n, 0.05))
    np.testing.assert_allclose(drawn.std(axis=0), 0.05, rtol=0.06)
    late = [int(np.flatnonzero(strokes == i)[-3]) for i in (4, 5, 6)]
    early = int(np.flatnonzero(strokes == 4)[-8])
    one = np.corrcoef(drawn[:, [late[0], early, *late[1:]]].T)[0]
    assert one[1] == pytest.approx(0.49, abs=0.05)  # within a stroke
    assert one[2] == pytest.approx(0.0, abs=0.05)  # the next, in the other direction
    assert one[3] == pytest.approx(0.49 * MEMORY, abs=0.05)


def test_levels_that_are_given_are_taken(motion, truth):
    residual, rng = residual_of(motion, truth), np.random.default_rng(3)
    strokes = strokes_of(motion)
    levels = np.zeros((2000, strokes[-1] + 1))
    levels[:, 6] = 3.0
    drawn = residual.draw_noise(rng, motion, np.full(2000, 0.05), levels).mean(axis=0)
    late = residual.share(motion) > 0.69
    np.testing.assert_allclose(drawn[late & (strokes == 6)], 0.105, atol=0.006)
    np.testing.assert_allclose(drawn[strokes != 6], 0.0, atol=0.006)


def test_means_of_strokes_vary_less(truth):
    rng = np.random.default_rng(4)
    for count in (1, 3, 10):
        levels = truth.draw(rng, 20_000, 2 * count)[:, ::2]  # those of one direction
        expected = float(np.var(levels.mean(axis=1)))
        assert truth.averaged(count) == pytest.approx(expected, rel=0.05)


def test_strokes_are_counted_from_turn_to_turn(motion):
    strokes = strokes_of(motion)
    assert strokes[0] == 0
    assert strokes[-1] == 2 * CYCLES - 1
    assert set(np.diff(strokes)) == {0, 1}
