"""The best tests together: greedy choice and exchange."""

from itertools import combinations

import numpy as np
import pytest

from mfd_bayes.planning.choice import Pool, choose, exchange, greedy
from mfd_bayes.planning.gain import Goals

DRAWS = 4000


def pool_of(rows, noise=1.0, seed=0):
    """Tests that each measure one combination of two goals, with noise."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((DRAWS, 2))
    blocks = [(u @ row + noise * rng.standard_normal(DRAWS))[:, None] for row in np.asarray(rows)]
    return Pool(Goals(u), [block - block.mean(axis=0) for block in blocks])


def closed(rows, chosen, noise=1.0):
    b = np.asarray(rows)[list(chosen)]
    after = np.linalg.inv(np.eye(2) + b.T @ b / noise**2)
    return 1.0 - np.sqrt(np.diag(after)).sum() / 2.0


ROWS = [(2.0, 0.0), (2.0, 0.0), (0.0, 1.5), (0.3, 0.3)]
"""A test, its copy, one about the other goal, and a weak one."""


def test_sets_have_their_closed_form():
    pool = pool_of(ROWS)
    for size in (1, 2, 3):
        for chosen in combinations(range(4), size):
            assert pool.reduction(chosen) == pytest.approx(closed(ROWS, chosen), abs=0.025)


def test_the_second_best_test_is_not_the_copy_of_the_best():
    pool = pool_of(ROWS)
    one, two = choose(4, pool.reduction, 2)
    assert one[0] in (0, 1)
    assert 2 in two
    assert pool.reduction((0, 1)) < pool.reduction((0, 2)) - 0.05  # but alone the copy is second
    assert pool.reduction((1,)) > pool.reduction((2,))


def test_exchange_finds_what_greedy_misses():
    worth = {(0,): 3.0, (1,): 2.0, (2,): 2.0, (0, 1): 3.1, (0, 2): 3.1, (1, 2): 5.0}

    def value(chosen):
        return worth[tuple(sorted(chosen))]

    assert set(choose(3, value, 2)[-1]) == {1, 2}
    assert set(greedy((0,), 3, value, 2)[-1]) != {1, 2}  # the control
    assert set(exchange((0, 1), 3, value)) == {1, 2}


def test_more_tests_are_never_worth_less():
    pool = pool_of(np.random.default_rng(1).standard_normal((8, 2)))
    sets = choose(8, pool.reduction, 3)
    sets += greedy(sets[-1], 8, pool.reduction, 6)
    values = [pool.reduction(chosen) for chosen in sets]
    assert [len(chosen) for chosen in sets] == [1, 2, 3, 4, 5, 6]
    assert np.all(np.diff(values) > -0.002)


def test_noise_is_worth_nothing():
    rng = np.random.default_rng(2)
    goals = Goals(rng.standard_normal((1000, 1)))
    block = rng.standard_normal((1000, 12))
    assert Pool(goals, [block - block.mean(axis=0)]).reduction((0,)) < 0.006
