"""Sequential Monte Carlo of a test's posterior."""

import numpy as np
import pytest

from mfd_bayes.population import tempering
from mfd_bayes.population.along import Along
from mfd_bayes.population.parts import Expected
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.starts import StartDensity
from mfd_bayes.population.tempering import temper

LABELS, POINTS = 40, 2000


def prior_of(mean):
    """Prior with these means of the labels, (`LABELS`, d); each quantity has a variance of 1."""
    ones, d = np.ones(LABELS), mean.shape[1]
    unit = np.broadcast_to(np.eye(d), (LABELS, d, d))
    nothing = Expected(mean, 0.0 * mean, (), 0.0 * mean, unit)
    around = Along(None, Setting(1.0), np.zeros(1))
    return TestPrior(
        np.arange(LABELS), around, nothing, mean, unit, StartDensity(ones, ones, ones < 0)
    )


@pytest.fixture(scope="module")
def prior():
    """Of one quantity; each label's density is near the next one's."""
    return prior_of(np.linspace(-0.5, 0.5, LABELS)[:, None])


@pytest.mark.parametrize("depends", [True, False])
def test_labels_follow_a_likelihood_that_depends_on_them(prior, depends):
    slope = 4.0

    def log_likelihood(labels, points):
        return slope * labels / LABELS - 2.0 * (points[:, 0] - 1.0) ** 2

    rng = np.random.default_rng(1)
    found = temper(prior, log_likelihood, rng, POINTS, depends=depends)
    # each label has a weight of its own, and a Gaussian posterior of the point
    mean = prior.mean[:, 0]
    weight = np.exp(slope * np.arange(LABELS) / LABELS - 0.5 * (1.0 - mean) ** 2 / 1.25)
    weight /= weight.sum()
    label, point = weight @ np.arange(LABELS), weight @ (mean + 4.0) / 5.0
    near = abs(found.labels.mean() - label) < 0.08 * LABELS
    assert near == depends  # the control takes labels by the prior alone
    if depends:
        assert found.points[:, 0].mean() == pytest.approx(point, abs=0.05)
        sd = np.sqrt(weight @ np.arange(LABELS) ** 2.0 - label**2)
        assert found.labels.std() == pytest.approx(sd, rel=0.15)


COORDINATES = 30


@pytest.fixture(scope="module")
def wide():
    """Of thirty quantities; all labels have the same density."""
    return prior_of(np.zeros((LABELS, COORDINATES)))


@pytest.mark.parametrize("reversible", [True, False])
def test_many_coordinates_get_the_posterior_of_the_closed_form(wide, reversible, monkeypatch):
    """A likelihood ties thirty coordinates together; the control has no ratio of densities."""
    if not reversible:
        step = tempering._Near.step
        monkeypatch.setattr(
            tempering._Near, "step", lambda *given: (step(*given)[0], np.zeros(len(given[1])))
        )
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(20, COORDINATES))
    told = rows @ rng.normal(size=COORDINATES)

    def log_likelihood(labels, points):
        return -0.5 * np.sum((points[:, :-1] @ rows.T - told) ** 2, axis=1) / 0.1**2

    found = temper(wide, log_likelihood, rng, POINTS).points[:, :-1]
    covariance = np.linalg.inv(np.eye(COORDINATES) + rows.T @ rows / 0.1**2)
    root = np.linalg.cholesky(covariance)
    mean = covariance @ rows.T @ told / 0.1**2
    standard = np.linalg.solve(root, (found - mean).T)
    spread = float(np.mean(standard**2))
    assert (abs(spread - 1.0) < 0.06) == reversible
    if reversible:
        assert np.abs(standard.mean(axis=1)).max() < 0.15
        assert np.abs(standard.std(axis=1) - 1.0).max() < 0.15
