"""Densities of several priors together are those of each by itself."""

import numpy as np
import pytest

from mfd_bayes.calibration.families import FAMILIES
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.calibration.prior_table import PriorTable
from mfd_bayes.calibration.priors import Prior

PRIORS = [
    Prior("lognormal", {"median": 2.0, "spread": 0.7}),
    Prior("truncated_normal", {"mean": 1.0, "sd": 2.0, "lower": 0.5, "upper": 2.0}),
    Prior("normal", {"mean": -1.0, "sd": 0.2}),
    Prior("truncated_normal", {"mean": 1.0, "sd": 2.0, "lower": -0.5}),
    Prior("lognormal", {"median": 0.1, "spread": 0.2}),
    Prior("truncated_normal", {"mean": 0.0, "sd": 1.0, "lower": 9.0, "upper": 11.0}),
    Prior("half_normal", {"sd": 0.3}),
    Prior("half_normal", {"sd": 5.0}),
    Prior("uniform", {"lower": 0.2, "upper": 3.0}),
    Prior("uniform", {"lower": -1.0, "upper": 7.0}),
    Prior("gamma", {"shape": 2.0, "scale": 0.1}),
    Prior("gamma", {"shape": 0.5, "scale": 3.0}),
    Prior("beta", {"a": 2.0, "b": 5.0}),
    Prior("beta", {"a": 0.5, "b": 0.5}),
    Prior("normal", {"mean": 4.0, "sd": 3.0}),
    Prior("fixed", {"value": 3.0}),
]
SHIPPED = {name: list(load_priors(name).parameters.values()) for name in ("mfd", "brfd")}


def coordinates(priors, n=50):
    rng = np.random.default_rng(3)
    return np.stack([prior.coordinate(prior.draw(rng, n)) for prior in priors], axis=1)


def test_every_family_is_tested():
    assert {prior.family for prior in PRIORS} == set(FAMILIES)


@pytest.mark.parametrize("priors", [PRIORS, *SHIPPED.values()], ids=["all", *SHIPPED])
@pytest.mark.parametrize("n", [0, 1, 50])
def test_values_and_densities_are_those_of_each_prior(priors, n):
    q, table = coordinates(priors, n), PriorTable(priors)
    expected = np.zeros(n)
    for prior, column, value in zip(priors, q.T, table.values(q), strict=True):
        np.testing.assert_array_equal(value, prior.value(column))
        expected += prior.log_density(column)
    np.testing.assert_allclose(table.log_density(q), expected, rtol=1e-14)


@pytest.mark.parametrize("far", [-1e4, -800.0, 800.0, 1e4])
def test_one_coordinate_out_of_range_has_no_density(far):
    q = np.repeat(coordinates(PRIORS, 1), len(PRIORS), axis=0)
    q[np.diag_indices(len(PRIORS))] = far
    each = [prior.log_density(np.array([far]))[0] for prior in PRIORS]
    found = PriorTable(PRIORS).log_density(q)
    assert not np.any(np.isnan(found))
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(each))
