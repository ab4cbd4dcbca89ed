"""Several devices, and dates: what a population learns of them."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.population.design import Setting, design_of
from mfd_bayes.population.mixed_model import MixedModel

TESTS = 6  # of each of eight devices
TESTED = [Setting(1.0, "", {}, f"no. {d}") for d in range(8) for _ in range(TESTS)]


def learned(priors, tested, values, dependence=None):
    """Draws of h and z of ln Fc_fwd of tests, known to 0.2 %, and the design."""
    laws = {"Fc_fwd": "proportional"}
    design = design_of(priors, ("Fc_fwd",), tested, laws, dependence)
    design = replace(design, leveled=False)
    y = (np.asarray(values) / design.spread[0])[:, None]
    precision = np.full((len(tested), 1, 1), (design.spread[0] / 0.002) ** 2)
    mixed = MixedModel(design, y, precision)
    choice, rng = np.array([0]), np.random.default_rng(1)
    h = mixed.sample(choice, rng, 2000)
    return design, h, mixed.marginal(h, choice)[1].draw(rng)


def test_the_scatter_of_devices_and_that_of_tests_are_told_apart(priors):
    rng = np.random.default_rng(0)
    devices, noise = rng.normal(0.0, 0.15, 8), rng.normal(0.0, 0.02, 8 * TESTS)
    design, h, z = learned(priors, TESTED, np.repeat(devices, TESTS) + noise)
    tau, omega = np.exp(np.quantile(h, [0.005, 0.995], axis=0)).T
    assert tau[0] < 0.02 < tau[1]
    assert omega[0] < devices.std(ddof=1) < omega[1]
    effects = z[:, design.columns(0)[0]] + z[:, [0]] * design.spread[0]
    np.testing.assert_allclose(effects.mean(axis=0), devices, atol=0.03)
    # the control: devices that do not differ
    _, h, _ = learned(priors, TESTED, np.random.default_rng(2).normal(0.0, 0.05, len(TESTED)))
    tau, omega = np.exp(np.median(h, axis=0))
    assert omega < 0.5 * tau
    design, *_ = learned(priors, TESTED[:TESTS], np.zeros(TESTS))  # of one device
    assert design.effects == ()


def test_a_drift_is_found_where_there_is_one(priors):
    rng, years = np.random.default_rng(3), np.repeat(2020.0 + np.arange(5.0), 3)
    tested = [Setting(1.0, "", {"date": year}) for year in years]
    slopes = []
    for rate in (-0.04, 0.0):
        values = rate * (years - 2022.0) + rng.normal(0.0, 0.02, years.size)
        design, _, z = learned(priors, tested, values, {"Fc_fwd": ("date",)})
        slopes.append(np.quantile(z[:, 1] / 4.0, [0.025, 0.5, 0.975]))  # of four years
    assert slopes[0][0] < -0.04 < slopes[0][2] < -0.02
    assert slopes[1][0] < 0.0 < slopes[1][2]
    assert design.changed("date", Setting(1.0)) == pytest.approx(0.5)  # the latest one
    later = Setting(1.0, "", {"date": 2030.0})
    assert design.changed("date", later) == pytest.approx(2.0)
