"""A stored population predicts what it did, or is refused in one sentence."""

import json
import shutil

import h5py
import numpy as np
import pytest

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import PredictionOptions, Predictor
from mfd_bayes.population.design import setting_of
from mfd_bayes.population.population import (
    SHAPES,
    InitialGapPrior,
    load_population,
    save_population,
)
from mfd_bayes.records.trace import Trace
from tests.population.made import make_population, no_residual

TIME = np.arange(120) / 40.0
LAWS = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}


def motion(actuation=1.0, amplitude=1.0):
    return Trace.from_arrays(TIME, amplitude * np.sin(np.pi * TIME), actuation)


@pytest.fixture(scope="module")
def population():
    """With all that a file may hold."""
    rng = np.random.default_rng(1)
    residual = no_residual(
        mean=0.02 * rng.normal(size=32), stroke_share=0.3,
        log_shape=0.1 * rng.normal(size=32), slip_force=1.3, lag_one=0.4, noise_time=0.05,
    )  # fmt: skip
    weights = rng.random((2, SHAPES.size))
    source = make_population(
        [
            setting_of(motion(p, x), s)
            for p, s, x in ((0.5, "a", 1), (0.8, "b", 1.5), (1.5, "b", 1))
        ],
        LAWS,
        exponent_sd=0.1,
        effect={"level_friction": 0.05, "session_friction": 0.03},
        shape=(2, 12),
        everywhere=False,
        reference=None,
        dependence={"Fc_fwd": ("amplitude",)},
        alternatives={"proportional": 0.6, "residual_power": 0.4},
        residual=residual,
        starts=InitialGapPrior(weights / weights.sum(), 0.4),
    )
    source.draws.z[...] += 0.01 * rng.normal(size=source.draws.z.shape)
    object.__setattr__(source, "walkers", 6)
    return source


@pytest.fixture(scope="module")
def stored(tmp_path_factory, population):
    path = tmp_path_factory.mktemp("stored") / "population.nc"
    save_population(path, population)
    return path


def test_predictions_and_what_tables_show_come_back_bit_by_bit(population, stored, priors):
    loaded = load_population(stored, priors)
    for actuation, kind, session in (
        (0.8, "mean", "b"),
        (3.0, "new_test", "new"),
        (np.linspace(0.5, 1.5, TIME.size), "observation", "b"),
    ):
        forecast = PredictionOptions(kind, draws=30, seed=3, session=session)
        original, again = (
            Predictor(p, ThreeStage(), find_noise("iid")).predict(motion(actuation), forecast)
            for p in (population, loaded)
        )
        np.testing.assert_array_equal(original.draws, again.draws)
        assert np.all(np.isfinite(original.draws))
    for attribute in ("slopes", "scatters", "effect_sds", "dependences"):
        assert getattr(loaded, attribute).keys() == getattr(population, attribute).keys() != set()
        for name, values in getattr(population, attribute).items():
            np.testing.assert_array_equal(getattr(loaded, attribute)[name], values)
    assert loaded.law_weights == population.law_weights
    assert (loaded.actuation_unit, loaded.walkers, loaded.common) == ("ksi", 6, population.common)
    for name, values in vars(population.convergence).items():
        np.testing.assert_array_equal(getattr(loaded.convergence, name), values)


def test_facts_that_do_not_fit_together_are_refused(stored, tmp_path, priors):
    path = tmp_path / "population.nc"
    for key, value in (
        ("format", "mixed model 0"),
        ("names", ["sigma0"]),
        ("settings", [{"weight": 1.0}]),
        ("laws", {"Fc_fwd": "cubic"}),
        ("basis", {"shortest": 1.0}),
        ("r_hat", None),
    ):
        shutil.copy(stored, path)
        with h5py.File(path, "r+") as file:
            facts = json.loads(file["posterior"].attrs["facts"]) | {key: value}
            present = {name: fact for name, fact in facts.items() if fact is not None}
            file["posterior"].attrs["facts"] = json.dumps(present)
        words = "another version.*run mfd-bayes calibrate" if key == "format" else "is damaged"
        with pytest.raises(StoreError, match=rf"population\.nc.* {words}"):
            load_population(path, priors)
