"""Several devices, and dates: what a population learns of them, and predicts."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.design import design_of
from mfd_bayes.population.mixed_model import MixedModel
from mfd_bayes.population.settings import Setting
from tests.population.made import make_population
from tests.population.test_predict import motion, settings, spread

TESTS = 6  # of each device


def learned(tested, values, dependence=None):
    """Draws of h and z of ln Fc_fwd of tests, known to 0.2 %, and the design."""
    design = design_of(load_priors("mfd"), ("Fc_fwd",), tested, {"Fc_fwd": "proportional"},
                       dependence)  # fmt: skip
    design = replace(design, leveled=False)
    y = (np.asarray(values) / design.spread[0])[:, None]
    precision = np.full((len(tested), 1, 1), (design.spread[0] / 0.002) ** 2)
    mixed = MixedModel(design, y, precision)
    choice, rng = np.array([0]), np.random.default_rng(1)
    h = mixed.sample(choice, rng, 2000)
    return design, h, mixed.marginal(h, choice)[1].draw(rng)


def test_the_scatter_of_devices_and_that_of_tests_are_told_apart():
    rng = np.random.default_rng(0)
    devices = rng.normal(0.0, 0.15, 8)
    tested = [Setting(1.0, "", {}, f"no. {d}") for d in range(8) for _ in range(TESTS)]
    values = np.repeat(devices, TESTS) + rng.normal(0.0, 0.02, 8 * TESTS)
    design, h, z = learned(tested, values)
    tau, omega = np.exp(np.quantile(h, [0.005, 0.995], axis=0)).T
    assert tau[0] < 0.02 < tau[1]
    assert omega[0] < devices.std(ddof=1) < omega[1]
    effects = z[:, design.columns(0)[0]] + z[:, [0]] * design.spread[0]
    np.testing.assert_allclose(effects.mean(axis=0), devices, atol=0.03)


def test_devices_that_do_not_differ_have_no_scatter():
    rng = np.random.default_rng(2)
    tested = [Setting(1.0, "", {}, f"no. {d}") for d in range(8) for _ in range(TESTS)]
    _, h, _ = learned(tested, rng.normal(0.0, 0.05, len(tested)))
    tau, omega = np.exp(np.median(h, axis=0))
    assert omega < 0.5 * tau


def test_tests_of_one_device_have_no_level_of_devices():
    tested = [Setting(1.0, "", {}, "no. 1") for _ in range(TESTS)]
    design, *_ = learned(tested, np.zeros(TESTS))
    assert [effect.name for effect in design.effects] == []


def test_a_new_device_scatters_more_than_a_known_one():
    tested = [replace(s, device=d) for s, d in zip(settings(), ("a", "a", "b"), strict=True)]
    population = make_population(tested, effect={"device_friction": 0.2}, scatter=0.05)
    made = Predictor(population, ThreeStage(), find_noise("iid"))
    known, new = (made.predict(motion(), Forecast(draws=4000, device=d)) for d in ("a", "new"))
    assert spread(known) == pytest.approx(0.05, rel=0.1)
    assert spread(new) == pytest.approx(np.hypot(0.05, 0.2), rel=0.1)
    mean = made.predict(motion(), Forecast("device", draws=4000, device="new"))
    assert spread(mean) < 0.02


def test_a_drift_is_found_where_there_is_one():
    rng, years = np.random.default_rng(3), np.repeat(2020.0 + np.arange(5.0), 3)
    tested = [Setting(1.0, "", {"date": year}) for year in years]
    slopes = []
    for rate in (-0.04, 0.0):
        values = rate * (years - 2022.0) + rng.normal(0.0, 0.02, years.size)
        design, _, z = learned(tested, values, {"Fc_fwd": ("date",)})
        slopes.append(np.quantile(z[:, 1] / 4.0, [0.025, 0.5, 0.975]))  # of four years
    assert slopes[0][0] < -0.04 < slopes[0][2] < -0.02
    assert slopes[1][0] < 0.0 < slopes[1][2]
    assert design.changed("date", Setting(1.0)) == pytest.approx(0.5)  # the latest one
    later = Setting(1.0, "", {"date": 2030.0})
    assert design.changed("date", later) == pytest.approx(2.0)
