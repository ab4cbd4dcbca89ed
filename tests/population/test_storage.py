"""A stored population is loaded unchanged."""

import json
import shutil
import warnings
from dataclasses import replace

import h5py
import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.laws import COMPARE
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.design import Layout
from mfd_bayes.population.population import Population
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.discrepancy import Residual
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.storage import (
    effect_of,
    load_population,
    save_population,
    save_test_draws,
)
from mfd_bayes.population.strokes import StrokeLevels
from mfd_bayes.population.discrepancy import TravelBasis
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import load_arrays

NAMES = (
    "sigma0",
    "sigma1",
    "sigma2",
    "Fc_fwd",
    "Fc_bwd",
    "static_excess_fwd",
    "static_excess_bwd",
    "k2",
    "k3",
    "d2",
    "d3",
    "ell",
    "v_s",
    "offset",
    "noise_sd",
    "noise_time",
)


@pytest.fixture(scope="module")
def population(priors):
    laws = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": COMPARE}
    settings = [
        Setting(p, s, {"velocity": v, "amplitude": 1.0})
        for p, s, v in ((0.5, "a", 1.0), (0.8, "b", 2.0), (1.5, "b", 3.0))
    ]
    layout = lay_out(priors, NAMES, settings, laws, {"k3": ("velocity",)})
    rng = np.random.default_rng(1)
    d, cells = len(NAMES), sum(len(e.cells) for e in layout.effects)
    factors = np.tril(rng.normal(size=(4, 60, d, d)))
    factors /= np.linalg.norm(factors, axis=-1, keepdims=True)
    return Population(
        layout=layout,
        h=rng.normal(-2.0, 0.2, size=(4, 60, layout.dim)),
        latent=0.1 * rng.normal(size=(4, 60, 1 + cells, d)),
        choice=layout.draw_choice(240).reshape(4, 60, -1),
        together=factors.astype(np.float32).astype(np.float64),  # stored in single precision
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(np.array([1.001, 1.0]), np.array([500.0, 6e3]), np.ones(2)),
        residual=residual_of(rng),
        starts=rng.random((4, 60, 3)).astype(np.float32).astype(np.float64),
        left=np.array([0.1, 0.5, 0.7]),
        unloaded=0.9,
    )


def residual_of(rng):
    """A discrepancy and a noise whose figures all differ."""
    basis = TravelBasis(0.9, 2.1)
    root = 0.01 * rng.normal(size=(basis.size, basis.size))
    return Residual(
        basis=basis,
        mean=0.02 * rng.normal(size=basis.size),
        covariance=root @ root.T,
        log_shape=0.1 * rng.normal(size=basis.size),
        slip_force=1.3,
        levels=StrokeLevels(rng.uniform(0.0, 0.9, basis.size), 0.6),
        noise_time=0.04,
        information=0.2,
    )


@pytest.fixture(scope="module")
def back(tmp_path_factory, priors, population):
    path = tmp_path_factory.mktemp("stored") / "population.nc"
    save_population(path, population)
    return load_population(path, priors)


def test_a_population_comes_back_bit_by_bit(population, back):
    for name in ("h", "latent", "choice", "together"):
        np.testing.assert_array_equal(getattr(back, name), getattr(population, name))
    for name in Convergence.__dataclass_fields__:
        expected = getattr(population.convergence, name)
        np.testing.assert_array_equal(getattr(back.convergence, name), expected)
    assert (back.actuation_unit, back.walkers) == ("ksi", 6)


def test_where_tests_begin_and_end_comes_back(tmp_path, priors, population, back):
    np.testing.assert_array_equal(back.starts, population.starts)
    np.testing.assert_array_equal(back.left, population.left)
    assert back.unloaded == population.unloaded
    save_population(tmp_path / "one.nc", population)
    rewritten(tmp_path / "one.nc", left=[0.1])
    with pytest.raises(StoreError, match="left must be as many as the settings"):
        load_population(tmp_path / "one.nc", priors)


def test_discrepancy_and_noise_come_back_bit_by_bit(population, back):
    pairs = [
        (getattr(back.residual, name), getattr(population.residual, name))
        for name in Residual.__dataclass_fields__
        if name != "levels"
    ]
    levels = back.residual.levels, population.residual.levels
    pairs += [(levels[0].share, levels[1].share), (levels[0].memory, levels[1].memory)]
    for stored, expected in pairs:
        np.testing.assert_array_equal(stored, expected)
        assert type(stored) is type(expected)
    time = np.arange(120) / 40
    trace = Trace.from_arrays(time, np.sin(np.pi * time))
    np.testing.assert_array_equal(back.residual.shape(trace), population.residual.shape(trace))


def rewritten(path, **changes):
    """The facts of a stored file changed; those that become None are left out."""
    with h5py.File(path, "r+") as file:
        facts = json.loads(file["posterior"].attrs["facts"]) | changes
        kept = {name: value for name, value in facts.items() if value is not None}
        file["posterior"].attrs["facts"] = json.dumps(kept)


def test_a_file_of_an_earlier_version_has_no_discrepancy(tmp_path, priors, population):
    path = tmp_path / "older.nc"
    save_population(path, population)
    rewritten(path, residual=None, sparse=None, left=None, unloaded=None)
    found = load_population(path, priors)
    assert found.residual is None
    assert found.left is None
    assert found.unloaded == 0.0
    assert found.layout.sparse == ()
    np.testing.assert_array_equal(found.h, population.h)


def test_a_population_without_a_discrepancy_is_stored_without_one(tmp_path, priors, population):
    save_population(tmp_path / "none.nc", replace(population, residual=None))
    assert load_population(tmp_path / "none.nc", priors).residual is None


@pytest.fixture(scope="module")
def saved(tmp_path_factory, priors, population):
    """A stored population, which loads when its discrepancy is written again, and that one."""
    path = tmp_path_factory.mktemp("saved") / "population.nc"
    save_population(path, population)
    with h5py.File(path) as file:
        residual = json.loads(file["posterior"].attrs["facts"])["residual"]
    rewritten(path, residual=residual)
    load_population(path, priors)  # the control: so far it is as it was
    return path, residual


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mean", [0.0]),
        ("covariance", [[0.0] * 31] * 32),
        ("log_shape", [1e3] * 32),
        ("slip_force", 0.0),
        ("noise_time", -1.0),
        ("information", 1.5),
        ("basis", {"shortest": 0.0, "longest": 1.0}),
        ("basis", {"shortest": 1.0}),
    ],
)
def test_a_damaged_discrepancy_is_refused(tmp_path, priors, saved, name, value):
    whole, residual = saved
    path = tmp_path / "population.nc"
    shutil.copyfile(whole, path)
    rewritten(path, residual=residual | {name: value})
    with pytest.raises(StoreError, match=r"population\.nc.*residual"):
        load_population(path, priors)


def test_its_layout_comes_back(population, back):
    assert len(population.layout.effects) > 2
    for name in Layout.__dataclass_fields__:
        stored, expected = getattr(back.layout, name), getattr(population.layout, name)
        if name == "effects":
            stored, expected = ([vars_of(e) for e in both] for both in (stored, expected))
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(stored, expected)
        else:
            assert stored == expected, name
    assert list(back.layout.laws) == list(population.layout.laws)


def vars_of(effect):
    return {name: getattr(effect, name) for name in effect.__dataclass_fields__}


def test_what_is_derived_is_the_same(population, back):
    assert back.slopes.keys() == population.slopes.keys()
    assert "K_c_bwd" in back.slopes
    assert "K_c_fwd" not in back.slopes  # its law has no slope
    for what in ("slopes", "scatters", "effect_sds", "dependences"):
        for name, values in getattr(population, what).items():
            np.testing.assert_array_equal(getattr(back, what)[name], values)
    assert back.law_weights == population.law_weights
    grid = np.array([0.0, 0.3, 2.0])
    for name in ("Fc_fwd", "sigma0", "offset"):
        np.testing.assert_array_equal(back.median(name, grid), population.median(name, grid))


@pytest.mark.parametrize("actuation", [0.8, 1.1, "history"])
@pytest.mark.parametrize("kind", ["device", "observation"])
def test_predictions_are_the_same(population, back, kind, actuation):
    time = np.arange(120) / 40
    level = np.linspace(0.5, 1.5, 120) if actuation == "history" else actuation
    trace = Trace.from_arrays(time, np.sin(np.pi * time), level)
    forecast = Forecast(kind, draws=20, seed=3, session="b")
    first, again = (
        Predictor(p, ThreeStage(), find_noise("ou")).predict(trace, forecast)
        for p in (population, back)
    )
    np.testing.assert_array_equal(first.draws, again.draws)
    assert np.all(np.isfinite(first.draws))


def test_arviz_reads_the_file_by_the_papers_names(tmp_path, population):
    path = tmp_path / "population.nc"
    save_population(path, population)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
    data = az.from_netcdf(path)
    slope = data.posterior["K_c_bwd"]
    assert slope.dims == ("chain", "draw")
    np.testing.assert_array_equal(slope, population.slopes["K_c_bwd"])
    for name in ("scatter_Fc_fwd", "deviation_level_friction", "deviation_session_friction"):
        assert data.posterior[name].dims == ("chain", "draw")
    assert json.loads(data.posterior.attrs["facts"])["names"] == list(NAMES)


def test_a_pooled_test_is_written_by_its_quantities(tmp_path, population):
    layout = population.layout
    draws = np.random.default_rng(2).normal(size=(4, 10, len(NAMES) + 1))
    save_test_draws(tmp_path / "test.nc", layout, draws, {"k3": "kip/in"}, "first")
    arrays, facts = load_arrays(tmp_path / "test.nc")
    assert facts == {"test": "first"}
    assert set(arrays) == set(NAMES)
    q = layout.centre + layout.spread * draws[2, 7, :-1]
    expected = layout.coordinates.values(q[None])
    for name in NAMES:
        assert arrays[name][2, 7] == pytest.approx(expected[name][0], rel=1e-12)


def test_a_missing_file_is_said_to_be_missing(tmp_path, priors):
    with pytest.raises(StoreError, match=r"nothing\.nc does not exist"):
        load_population(tmp_path / "nothing.nc", priors)


def test_a_file_of_another_kind_is_refused(tmp_path, priors):
    (tmp_path / "population.nc").write_text("time_s,force_kip\n0,1\n")
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_population(tmp_path / "population.nc", priors)


def test_effects_come_back_with_their_kernel(population, back, tmp_path, priors):
    assert {effect.kernel for effect in back.layout.effects} == {"matern"}
    scales = {effect.name: effect.scale for effect in back.layout.effects}
    assert scales == {"level": 2.0, "session": 1.0}
    kept = [effect.reference for effect in back.layout.effects]
    assert kept == [effect.reference for effect in population.layout.effects]
    assert {effect.name for effect in back.layout.effects if effect.reference} == {"level"}
    older = [replace(effect, kernel="exponential") for effect in population.layout.effects]
    layout = replace(population.layout, effects=tuple(older))
    save_population(tmp_path / "older.nc", replace(population, layout=layout))
    found = load_population(tmp_path / "older.nc", priors).layout.effects
    assert {effect.kernel for effect in found} == {"exponential"}


def test_effects_of_earlier_versions_are_as_wide_as_scatter():
    facts = {"name": "level", "group": 0, "members": [0], "cells": [["", 0.8]], "home": [0]}
    assert effect_of(facts).scale == 1.0
    assert effect_of({**facts, "scale": 2.0}).scale == 2.0
    assert effect_of(facts).reference == 0.0
