"""Coordinates of tests some of whose quantities are left out of the population."""

import pickle

import numpy as np
import pytest

from mfd_bayes.population.apart import Apart, Joined, joined, set_apart
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.settings import Setting

NAMES = ("Fc_fwd", "Fc_bwd", "static_excess_fwd", "v_s", "sigma0", "offset")


@pytest.fixture
def layout(priors):
    return lay_out(priors, NAMES, [Setting(p) for p in (0.0, 0.5, 0.8)])


def some(layout, n=50, own=2):
    return 0.7 * np.random.default_rng(3).standard_normal((n, len(layout.names) + own))


def test_what_is_split_is_joined_again(layout):
    apart, x = Apart.of(layout, 0), some(layout)
    assert [NAMES[k] for k in apart.columns] == ["Fc_fwd", "Fc_bwd"]
    split = apart.split(x)
    assert split.shape == (50, x.shape[1] + 2)
    np.testing.assert_allclose(apart.join(split), x, atol=1e-12)


def test_the_likelihood_does_not_depend_on_what_stands_in_its_place(layout):
    apart, x = Apart.of(layout, 0), some(layout)
    split = apart.split(x)
    split[:, :2] += 3.0
    np.testing.assert_allclose(apart.join(split), x, atol=1e-12)
    split[:, -1] += 1.0
    assert np.all(np.abs(apart.join(split)[:, 1] - x[:, 1]) > 0.1)  # the control


def test_the_priors_of_both_coordinates_are_the_test_s_own(layout):
    """Split draws then have the density by which they are weighted, whatever they stand for."""
    apart, x = Apart.of(layout, 0), some(layout)
    shared = layout.centre + layout.spread * x[:, : len(NAMES)]
    before = layout.coordinates.log_prior(shared)
    split = apart.split(x)
    there = layout.coordinates.log_prior(layout.centre + layout.spread * split[:, : len(NAMES)])
    own = apart.log_prior(split[:, -2:])
    stand_in = layout.coordinates.to_own(layout.centre + layout.spread * split[:, : len(NAMES)])
    in_its_place = sum(
        prior.log_density(stand_in[:, k]) for k, prior in zip((0, 1), apart.priors, strict=True)
    )
    np.testing.assert_allclose(before + in_its_place, there + own, atol=1e-9)


def test_tests_that_inform_everything_stay_as_they_are(layout, gaussian_test):
    d = len(NAMES)
    tests = [gaussian_test(np.zeros(d), 0.1 * np.eye(d)) for _ in range(3)]
    found = set_apart(layout, tests)
    assert found[1] is tests[1]
    assert found[2] is tests[2]
    assert found[0].mean.shape == (d + 2,)
    np.testing.assert_allclose(np.diag(found[0].covariance)[:2], 1e3)
    np.testing.assert_allclose(found[0].covariance[:2, 2:], 0.0)
    own = some(layout, own=0)
    x, kept = Apart.of(layout, 0).split(own), tests[0].log_likelihood(own)
    assert np.ptp(kept) > 1
    np.testing.assert_allclose(found[0].log_likelihood(x), kept, atol=1e-6)
    assert np.all(np.isfinite(found[0].log_own_prior(x[:, d:])))


def test_stored_draws_have_the_test_s_own_values(layout):
    x = some(layout, own=0)
    split = Apart.of(layout, 0).split(x).reshape(2, 25, -1)
    np.testing.assert_allclose(joined(layout, 0, split).reshape(50, -1), x, atol=1e-12)
    assert joined(layout, 1, split) is split


def total(x):
    return x.sum(axis=1)


def test_a_process_can_be_sent_it(layout):
    likelihood = Joined(Apart.of(layout, 0), total)
    x = Apart.of(layout, 0).split(some(layout))
    again = pickle.loads(pickle.dumps(likelihood))
    np.testing.assert_array_equal(again(x), likelihood(x))
