"""Tests that stand apart from the others."""

import numpy as np
import pytest

from mfd_bayes.evaluation.checks import standing_out


@pytest.mark.parametrize("count", [5, 8, 20])
def test_a_gap_half_as_large_again_stands_apart_and_no_other_does(count):
    rng = np.random.default_rng(1)
    deviations = rng.normal(scale=[0.05, 0.05, 0.02], size=(count, 3))
    deviations[2, 2] += np.log(1.5)
    if count == 5:  # with four others, only what is far beyond all doubt
        deviations[2, 2] += np.log(2.0)
    ((test, quantity, away),) = standing_out(deviations)
    assert (test, quantity) == (2, 2)
    assert away > 8.0


def test_tests_stand_apart_by_chance_as_rarely_as_stated():
    rng = np.random.default_rng(2)
    campaigns = rng.normal(size=(2000, 8, 4))
    share = np.mean([any(True for _ in standing_out(one)) for one in campaigns])
    assert share < 0.02
