"""Stored tests and draws: they come back bit for bit, and a damaged file is named."""

import pickle
import warnings

import h5py
import numpy as np
import pytest
import xarray as xr

from mfd_bayes.calibration.priors import units
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import (
    load_arrays,
    load_groups,
    load_test,
    load_trace,
    save_arrays,
    save_test,
    save_trace,
)

RNG = np.random.default_rng(1)
UNITS = {name: units()[name] for name in ThreeStage().parameters}
TIME = np.arange(0, 4, 0.02)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
TRACE = Trace.from_arrays(TIME, MOTION, actuation=0.8, force=np.sign(MOTION), velocity=np.cos(TIME))
VALUES = {name: RNG.lognormal(size=(4, 30)) for name in UNITS}
STATS = {name: RNG.normal(size=(4, 30)) for name in ("lp", "log_prior", "log_likelihood")}
PREDICTIVE = RNG.normal(size=(4, 5, TIME.size))
FACTS = {"model": "three_stage", "r_hat": np.float64(1.01), "steps": np.int64(400), "ess": np.nan}


def save(path):
    save_test(path, VALUES, UNITS, STATS, TRACE, PREDICTIVE, FACTS)
    return path


def same_trace(got, expected):
    for name in ("time", "displacement", "velocity", "force", "turning_points", "actuation"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert got.direction == expected.direction


def test_a_test_comes_back_as_it_was_saved(tmp_path):
    path = save(save(tmp_path / "posterior.nc"))  # saving again replaces the file
    assert list(tmp_path.iterdir()) == [path]
    stored = load_test(path)
    assert set(stored.draws.data_vars) == set(UNITS)
    for name, values in VALUES.items():
        np.testing.assert_array_equal(stored.draws[name], values)
        np.testing.assert_array_equal(stored.values()[name], values.reshape(-1))
    for name, values in STATS.items():
        np.testing.assert_array_equal(stored.stats[name], values)
    same_trace(stored.trace, TRACE)
    assert stored.facts == {"model": "three_stage", "r_hat": 1.01, "steps": 400, "ess": None}
    predicted = load_groups(path)["posterior_predictive"]["force"]
    np.testing.assert_allclose(predicted, PREDICTIVE, rtol=1e-6)


def test_arviz_reads_each_quantity_by_name_with_its_unit(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
    data = az.from_netcdf(save(tmp_path / "posterior.nc"))
    summary = az.summary(data, var_names=["Fc_fwd", "k3"], round_to="none")
    for name in ("Fc_fwd", "k3"):
        assert float(summary.loc[name, "mean"]) == pytest.approx(VALUES[name].mean(), rel=1e-3)
        assert 40 < float(summary.loc[name, "ess_bulk"]) < 300  # of 120 independent draws
        assert data["posterior"][name].attrs["units"] == UNITS[name]
        assert data["posterior"][name].dims == ("chain", "draw")


def test_a_record_comes_back_with_every_kind_of_actuation(tmp_path):
    for actuation in [None, np.linspace(0, 1, TIME.size)]:
        trace = Trace.from_arrays(TIME, MOTION, actuation, force=MOTION)
        save_trace(tmp_path / "record.nc", trace, {"id": "a"})
        got, facts = load_trace(tmp_path / "record.nc")
        same_trace(got, trace)
        assert facts == {"id": "a"}


# --- damaged files

READERS = (load_test, load_trace, load_arrays)


def test_a_file_that_is_no_netcdf_or_of_another_program_is_named(tmp_path):
    valid = save(tmp_path / "whole.nc").read_bytes()
    path = tmp_path / "posterior.nc"
    for group in ("posterior", "sample_stats", "observed_data", "constant_data"):
        data = xr.Dataset({"mu": (("chain", "draw"), np.zeros((2, 3)))})
        data.to_netcdf(path, mode="a", group=group, engine="h5netcdf")
    foreign = path.read_bytes()
    path.unlink()
    for content in (None, foreign, b"", b"time,force\n0,1\n", valid[: len(valid) // 2], valid[:-9]):
        if content is not None:
            path.write_bytes(content)
        for read in (load_test, load_trace, load_arrays):
            with pytest.raises(StoreError, match=r"posterior\.nc"):
                read(path)


def packed(group, secret):
    group.create_dataset("time", data=np.zeros(30), chunks=(30,), compression="lzf")


def linked(group, secret):
    group["time"] = h5py.ExternalLink(str(secret), "time")


def virtual(group, secret):
    layout = h5py.VirtualLayout((30,), float)
    layout[:] = h5py.VirtualSource(str(secret), "time", (30,))
    group.create_virtual_dataset("time", layout)


def pickled(group, secret):
    group["evil"] = np.void(pickle.dumps(print))


def declared(group, secret):
    group.create_dataset("time", (4, 300_000_000), "f8", chunks=(1, 1000))  # larger than the file


@pytest.mark.parametrize("make", [packed, linked, virtual, pickled, declared])
def test_a_file_reaches_nowhere_else_and_holds_plain_numbers_alone(tmp_path, make):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["time"] = np.arange(30.0)
    path = tmp_path / "population.nc"
    save_arrays(path, {"mu": np.zeros((2, 3))}, {})
    with h5py.File(path, "a") as file:
        make(file["posterior"], tmp_path / "secret.h5")
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_arrays(path)
