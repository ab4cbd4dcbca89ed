"""Snapshots of evenly spaced sweeps in bounded memory, and the draws made from them."""

import numpy as np
import pytest

from mfd_bayes.population import chains
from mfd_bayes.population.chains import Snapshot, TestDraws, ThinnedChains, by_walker


def state(sweep, chains=4, size=3):
    x = (100 * sweep + np.arange(chains * size)).reshape(chains, size).astype(np.float32)
    return Snapshot(np.zeros((chains, 1, 2)), np.zeros((chains, 2, 2)), x)


def fill(wanted, size, sweeps):
    kept = ThinnedChains(wanted, 4, size)
    for sweep in range(sweeps):
        if kept.wants(sweep):
            x = [np.full((4, 1), sweep), np.full((4, size - 1), sweep + 0.5)]
            kept.add(sweep, np.zeros((4, 1, 2)), np.zeros((4, 2, 2)), x)
        assert len(kept.snapshots) <= kept.most
    return kept


@pytest.mark.parametrize("sweeps", [40, 90, 91, 240, 1531, 2000])
@pytest.mark.parametrize("wanted", [1, 9, 47])
def test_enough_states_are_left_evenly_apart(wanted, sweeps):
    states = fill(wanted, 10, sweeps).since(sweeps // 10)
    kept = list(states)
    assert min(wanted, 0.9 * sweeps) <= len(kept) <= 2 * (wanted + wanted // 9 + 1)
    assert len(set(np.diff(kept))) <= 1
    for sweep, found in states.items():
        assert found.x.dtype == np.float32
        assert np.all(found.x[:, 0] == sweep)  # no snapshot is overwritten
        assert np.all(found.x[:, 1:] == sweep + 0.5)
    assert min(kept) >= sweeps // 10
    assert sweeps - 1 - max(kept) < max(np.diff(kept), default=sweeps)


def test_the_states_of_many_tests_are_fewer(monkeypatch):
    monkeypatch.setattr(chains, "ROOM", 4000)
    few, many, most = (fill(47, size, 500) for size in (5, 25, 2500))
    assert len(few.snapshots) >= 47
    assert len(many.snapshots) <= 40 < len(few.snapshots)
    assert chains.FEWEST / 2 <= len(most.snapshots) <= chains.FEWEST


def test_draws_of_tests_are_their_columns_by_chain_and_walker():
    states = [state(sweep) for sweep in range(5)]
    tests = TestDraws(states, [1, 2], ensembles=2)
    assert len(tests) == 2
    first, second = tests
    assert first.shape == (2, 10, 1)
    assert second.shape == (2, 10, 2)
    assert first.dtype == np.float64
    assert first[0, :5, 0].tolist() == [0, 100, 200, 300, 400]  # the first walker's
    assert second[1, 5, 1] == 3 * 3 + 2  # the last walker's of the second ensemble
    np.testing.assert_array_equal(tests[-1], second)
    assert [x.shape for x in tests[:1]] == [(2, 10, 1)]
    with pytest.raises(IndexError):
        tests[2]


def test_walkers_come_one_after_the_other():
    steps = [np.array([[1.0], [2.0]]), np.array([[3.0], [4.0]])]
    assert by_walker(steps, 1)[0, :, 0].tolist() == [1.0, 3.0, 2.0, 4.0]
