"""What is asked of a population and of its bands, and what is refused in one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError, MfdError, NotThereError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.settings import Setting, planned_setting, setting_of
from mfd_bayes.records.trace import Trace

TIME = np.arange(101) / 50
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
LEVELS = np.array([0.5, 1.0])


@pytest.fixture(scope="module")
def population(make_population):
    return make_population({"Fc_fwd": "proportional", "sigma0": "affine"})


@pytest.fixture(scope="module")
def band(population):
    return predicted(population, ThreeStage())


def predicted(population, model):
    trace = Trace.from_arrays(TIME, MOTION, 1.0)
    return Predictor(population, model, find_noise("ou")).predict(trace, Forecast(draws=20))


def test_static_friction_has_the_law_of_what_it_follows(population):
    kinetic = population.ratio("Fc_fwd", LEVELS)
    np.testing.assert_allclose(kinetic[0, 0], [0.5, 1.0])
    np.testing.assert_array_equal(population.ratio("Fs_fwd", LEVELS), kinetic)
    np.testing.assert_array_equal(population.ratio("d2", LEVELS), 1.0)  # no law


@pytest.mark.parametrize("name", ["Fc_fw", "gap", "", None, ["Fc_fwd"], 1])
def test_a_quantity_that_is_not_there_has_no_ratio_and_no_median(population, name):
    for asked in (population.ratio, population.median):
        with pytest.raises(NotThereError, match=r"no quantity .*: there are sigma0, ") as caught:
            asked(name, LEVELS)
        assert isinstance(caught.value, KeyError)
        assert not str(caught.value).startswith(("'", '"'))


def test_a_quantity_without_a_law_has_no_shapes(population):
    with pytest.raises(NotThereError, match="no law of 'd2': there are Fc_fwd, "):
        population.shapes("d2")


@pytest.mark.parametrize("wrong", [np.nan, -1.0, np.inf, "36 lbf", None, [0.5, np.nan]])
def test_an_actuation_that_cannot_be_has_no_median(population, wrong):
    for asked in (population.ratio, population.median):
        with pytest.raises(FitError, match="actuation"):
            asked("Fc_fwd", wrong)
    assert population.median("Fc_fwd", 0.5).shape == (4, 100, 1)


@pytest.mark.parametrize(
    ("index", "rng", "said"),
    [
        ([400], np.random.default_rng(1), "index must be whole numbers .* from 0 to 399"),
        ([-1], np.random.default_rng(1), "index must be whole numbers"),
        ([0.5], np.random.default_rng(1), "index must be whole numbers"),
        (3, np.random.default_rng(1), "index must be whole numbers"),
        ([0], 1, "rng must be a numpy.random.Generator.*got int"),
    ],
)
def test_draws_and_generators_that_are_none_are_refused(population, index, rng, said):
    with pytest.raises(FitError, match=said):
        population.draw_test(Setting(1.0), index, rng)


def test_a_setting_needs_what_quantities_follow(population):
    layout = replace(population.layout, covariate_reference={"velocity": 3.0})
    follows = replace(population, layout=layout)
    for setting, said in (
        (Setting(1.0), "needs the covariate 'velocity'"),
        (1.0, "setting must be a Setting, got float"),
        (Setting(np.nan), "actuation of a setting must be a finite number"),
    ):
        with pytest.raises(FitError, match=said):
            follows.draw_test(setting, np.arange(3), np.random.default_rng(1))


def test_a_band_tells_no_quantities_of_other_models(population, band):
    every = replace(population, priors=dict(load_priors("mfd").parameters))
    told = predicted(every, ThreeStage()).values
    assert set(told) == set(band.values)
    assert not {"gap", "k_fwd", "Fy_fwd", "alpha", "n"} & set(told)
    assert {"gamma1", "start", "noise_sd", "d2"} <= set(told)
    assert set(ThreeStage().parameters) - {"Fs_fwd", "Fs_bwd", "gamma2"} <= set(told)


def test_the_numbers_of_a_band_cannot_be_changed(band):
    for name in ("lower", "median", "upper", "draws"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(band, name)[...] = 0.0
    assert replace(band, lower=band.lower - 1.0).lower[0] == band.lower[0] - 1.0


@pytest.mark.parametrize("factor", [-1.0, np.nan, np.inf, "2", None, [2.0], True])
def test_a_band_is_widened_by_a_number(band, factor):
    with pytest.raises(FitError, match="factor must be a finite number of at least 0"):
        band.widened(factor)
    assert np.all(band.widened(0.0).lower == band.median)


@pytest.mark.parametrize("wrong", [None, TIME, "a", 5])
def test_a_prediction_is_of_a_trace(wrong):
    with pytest.raises(MfdError, match="trace must be a Trace"):
        setting_of(wrong)


def test_numbers_of_any_kind_are_planned_and_no_others():
    assert planned_setting((), np.array(0.036), "", {}).actuation == 0.036
    for wrong in (True, "36 lbf", [0.036], None):
        with pytest.raises(FitError, match="the planned actuation must be 0 or more"):
            planned_setting((), wrong, "", {})
