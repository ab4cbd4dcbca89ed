"""The best actuation of a sweep, and levels of which none is better."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.response.building import Limits
from mfd_bayes.response.result import sweep_of

LEVELS = np.array([3.0, 4.0, 5.0, 6.0])


def response(drifts):
    """A response of draws with these largest drifts, (n,), as shares of the height."""
    drifts = np.asarray(drifts, dtype=float)[:, None]
    return SimpleNamespace(
        building=SimpleNamespace(limits=Limits(drift=0.01)),
        unstable=np.zeros(drifts.shape, dtype=bool),
        drift_ratio=drifts[..., None],
        measure=lambda name: drifts,
    )


def swept(goal, *drifts):
    return sweep_of((LEVELS, "ksi"), [response(d) for d in drifts], "drift", goal)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_where_all_levels_are_best_alike_there_is_no_best_one(share):
    rng = np.random.default_rng(1)
    drifts = [rng.permutation(np.where(np.arange(50) < 50 * share, 0.02, 0.005)) for _ in LEVELS]
    sweep = swept("passing", *drifts)
    assert np.isnan(sweep.best)
    assert sweep.interval == (3.0, 6.0)
    assert sweep.lowest.tolist() == LEVELS.tolist()


def test_levels_that_are_best_alike_are_all_in_the_interval():
    few, none = np.where(np.arange(50) < 20, 0.02, 0.005), np.full(50, 0.005)
    sweep = swept("passing", few, none, none, few)
    assert np.isnan(sweep.best)
    assert sweep.interval == (4.0, 5.0)
    assert sweep.lowest.tolist() == [4.0, 5.0]


def test_one_level_that_is_best_is_placed_by_its_neighbours():
    shape = np.random.default_rng(2).normal(1.0, 0.01, 50)
    sweep = swept("mean", *(shape * (0.01 + 0.001 * (level - 4.3) ** 2) for level in LEVELS))
    assert sweep.best == pytest.approx(4.3, abs=1e-6)
    assert sweep.interval == pytest.approx((4.3, 4.3), abs=1e-6)
    assert sweep.lowest.tolist() == [4.0]
