"""A stored population predicts what it did, or is refused in one sentence."""

import json
import shutil
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest

from mfd_bayes.calibration.posterior import find_noise
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.design import setting_of
from mfd_bayes.population.population import SHAPES, Starts, load_population, save_population
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
        mean=0.02 * rng.normal(size=32), covariance=1e-4 * np.eye(32), stroke_share=0.3,
        log_shape=0.1 * rng.normal(size=32), slip_force=1.3, lag_one=0.4, noise_time=0.05,
    )  # fmt: skip
    weights = rng.random((2, SHAPES.size))
    made = make_population(
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
        starts=Starts(weights / weights.sum(), 0.4),
    )
    made.draws.z[...] += 0.01 * rng.normal(size=made.draws.z.shape)
    object.__setattr__(made, "walkers", 6)
    return made


@pytest.fixture(scope="module")
def stored(tmp_path_factory, population):
    path = tmp_path_factory.mktemp("stored") / "population.nc"
    save_population(path, population)
    return path


@pytest.fixture
def path(stored, tmp_path):
    return shutil.copy(stored, tmp_path / "population.nc")


def change(path, **facts):
    """The facts of a stored file changed; those that become None are left out."""
    with h5py.File(path, "r+") as file:
        found = json.loads(file["posterior"].attrs["facts"]) | facts
        kept = {name: value for name, value in found.items() if value is not None}
        file["posterior"].attrs["facts"] = json.dumps(kept)


def test_predictions_come_back_bit_by_bit(population, stored, priors):
    back = load_population(stored, priors)
    for actuation, kind, session in (
        (0.8, "device", "b"),
        (3.0, "new_test", "new"),
        (np.linspace(0.5, 1.5, TIME.size), "observation", "b"),
    ):
        forecast = Forecast(kind, draws=30, seed=3, session=session)
        first, again = (
            Predictor(p, ThreeStage(), find_noise("iid")).predict(motion(actuation), forecast)
            for p in (population, back)
        )
        np.testing.assert_array_equal(first.draws, again.draws)
        assert np.all(np.isfinite(first.draws))


def test_what_tables_show_comes_back(population, stored, priors):
    back = load_population(stored, priors)
    for what in ("slopes", "scatters", "effect_sds", "dependences"):
        assert getattr(back, what).keys() == getattr(population, what).keys() != set()
        for name, values in getattr(population, what).items():
            np.testing.assert_array_equal(getattr(back, what)[name], values)
    assert back.law_weights == population.law_weights
    assert (back.actuation_unit, back.walkers, back.common) == ("ksi", 6, population.common)
    for name, values in vars(population.convergence).items():
        np.testing.assert_array_equal(getattr(back.convergence, name), values)


def test_arviz_reads_the_file_by_the_papers_names(stored, population):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
    data = az.from_netcdf(stored)
    slope = data.posterior["K_c_bwd"]
    assert slope.dims == ("chain", "draw")
    np.testing.assert_array_equal(slope, population.slopes["K_c_bwd"])
    for name in ("scatter_Fc_fwd", "deviation_level_friction", "deviation_session_friction"):
        assert data.posterior[name].dims == ("chain", "draw")


def test_facts_that_do_not_fit_together_are_refused(stored, path, priors):
    for key, value in (
        ("format", "mixed model 0"),
        ("names", ["sigma0"]),
        ("settings", [{"weight": 1.0}]),
        ("laws", {"Fc_fwd": "cubic"}),
        ("basis", {"shortest": 1.0}),
        ("r_hat", None),
    ):
        shutil.copy(stored, path)
        change(path, **{key: value})
        words = "another version.*run mfd-bayes calibrate" if key == "format" else "is damaged"
        with pytest.raises(StoreError, match=rf"population\.nc.* {words}"):
            load_population(path, priors)


def test_what_is_no_such_file_is_refused(path, priors, tmp_path):
    with pytest.raises(StoreError, match=r"nothing\.nc does not exist"):
        load_population(tmp_path / "nothing.nc", priors)
    whole = Path(path).read_bytes()
    for text in (b"", b"time_s,force_kip\n0,1\n", whole[: len(whole) // 2]):
        (tmp_path / "bad.nc").write_bytes(text)
        with pytest.raises(StoreError, match=r"bad\.nc"):
            load_population(tmp_path / "bad.nc", priors)
