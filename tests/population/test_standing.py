"""A proportional law that the tests contradict is found out, and one that they obey is not."""

import numpy as np
import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.population.hierarchy import pool
from mfd_bayes.population.marginal import Pooling, TestSummary, summarize
from mfd_bayes.population.standing import free_exponents

PRIORS = load_priors("brfd")
NAMES = ("sigma0", "Fc_fwd", "Fc_bwd", "k3")
TENSIONS = (0.020, 0.022, 0.025, 0.035, 0.070, 0.080)
EFFORT = Effort(ess=100, limit=640, r_hat=1.05, length=1.0)


def campaign(
    exponent: float, tensions: tuple[float, ...] = TENSIONS
) -> tuple[Pooling, list[TestSummary]]:
    """Tests whose friction follows a power of the tension, with 5 % scatter."""
    rng = np.random.default_rng(4)
    pooling = pool(PRIORS, NAMES, tensions)
    tests = []
    for tension in tensions:
        level = np.log([16.0, 2.0, 2.0, 30.0])
        level[1:3] += exponent * np.log(tension / pooling.reference)
        q = level + 0.05 * rng.standard_normal(4) + 0.02 * rng.standard_normal((4000, 4))
        tests.append(summarize(pooling, tension, q))
    return pooling, tests


def found(exponent: float, tensions: tuple[float, ...] = TENSIONS) -> dict[str, tuple]:
    pooling, tests = campaign(exponent, tensions)
    return free_exponents(pooling, tests, PRIORS.parameters, EFFORT, np.random.default_rng(1))


@pytest.mark.parametrize("exponent", [1.0, 0.6])
def test_the_exponent_of_the_tests_is_inside_its_interval(exponent: float) -> None:
    exponents = found(exponent)
    assert set(exponents) == {"Fc_fwd", "Fc_bwd"}
    for low, middle, high in exponents.values():
        assert low < exponent < high
        assert middle == pytest.approx(exponent, abs=0.15)


def test_a_law_that_is_not_proportional_is_told_apart() -> None:
    assert all(high < 1.0 for _, _, high in found(0.6).values())


def test_two_levels_say_nothing() -> None:
    assert found(0.6, (0.020, 0.080)) == {}
