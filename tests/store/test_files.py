import errno
import json
import os
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from mfd_bayes.calibration.prior_files import units
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import remove_partial_files
from mfd_bayes.store.files import (
    is_part,
    read_json,
    write_atomically,
    write_bytes,
    write_json,
    write_text,
)
from mfd_bayes.store.netcdf import (
    CalibratedTest,
    load_arrays,
    load_test,
    load_trace,
    save_arrays,
    save_test,
    save_trace,
)

RNG = np.random.default_rng(0)
UNITS = {name: units()[name] for name in ThreeStage().parameters}
TIME = np.arange(0, 4, 0.02)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
TRACE = Trace.from_arrays(TIME, MOTION, actuation=0.8, force=np.sign(MOTION), velocity=np.cos(TIME))
VALUES = {name: RNG.lognormal(size=(4, 30)) for name in UNITS}
STATS = {name: RNG.normal(size=(4, 30)) for name in ("lp", "log_prior", "log_likelihood")}
PREDICTIVE = RNG.normal(size=(4, 5, TIME.size))
FACTS = {"model": "three_stage", "r_hat": np.float64(1.01), "steps": np.int64(400), "ess": np.nan}


def save(path, trace=TRACE):
    save_test(path, CalibratedTest(VALUES, UNITS, STATS, trace, PREDICTIVE, FACTS))
    return path


def open_with_arviz(path):
    """Variables of a group by ArviZ, whichever it is: InferenceData or DataTree."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz

    data = arviz.from_netcdf(path)
    modern = int(arviz.__version__.split(".")[0]) >= 1
    return lambda group: data[group].to_dataset() if modern else getattr(data, group)


def same_trace(got, expected):
    for name in ("time", "displacement", "velocity", "force", "turning_points", "actuation"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert got.direction == expected.direction


def test_a_test_comes_back_as_it_was_saved(tmp_path):
    stored = load_test(save(tmp_path / "posterior.nc"))
    assert set(stored.draws.data_vars) == set(UNITS)
    for name, values in VALUES.items():
        np.testing.assert_array_equal(stored.draws[name], values)
        np.testing.assert_array_equal(stored.values()[name], values.reshape(-1))
    for name, values in STATS.items():
        np.testing.assert_array_equal(stored.stats[name], values)
    same_trace(stored.trace, TRACE)
    assert stored.facts == {"model": "three_stage", "r_hat": 1.01, "steps": 400, "ess": None}


@pytest.mark.parametrize("actuation", [None, 0.0, 0.8, np.linspace(0, 1, TIME.size)])
def test_every_kind_of_actuation_comes_back(tmp_path, actuation):
    trace = Trace.from_arrays(TIME, MOTION, actuation, force=MOTION)
    same_trace(load_test(save(tmp_path / "posterior.nc", trace)).trace, trace)
    save_trace(tmp_path / "record.nc", trace, {"id": "a"})
    got, facts = load_trace(tmp_path / "record.nc")
    same_trace(got, trace)
    assert facts == {"id": "a"}


def test_arviz_opens_the_file_with_names_and_units(tmp_path):
    group = open_with_arviz(save(tmp_path / "posterior.nc"))
    posterior = group("posterior")
    assert set(posterior.data_vars) == set(UNITS)
    for name, unit in UNITS.items():
        assert posterior[name].dims == ("chain", "draw")
        assert posterior[name].attrs["units"] == unit
    assert set(group("sample_stats").data_vars) == {"lp", "log_prior", "log_likelihood"}
    observed, replicas = group("observed_data")["force"], group("posterior_predictive")["force"]
    assert observed.attrs["units"] == replicas.attrs["units"] == "kip"
    np.testing.assert_array_equal(observed, TRACE.force)
    np.testing.assert_allclose(replicas, PREDICTIVE, rtol=1e-6)
    np.testing.assert_array_equal(replicas["time"], TIME)


def test_arrays_of_any_dimension_come_back(tmp_path):
    arrays = {"K": RNG.normal(size=(4, 9)), "theta": RNG.normal(size=(4, 9, 3, 2))}
    save_arrays(tmp_path / "population.nc", arrays, {"laws": {"Fc_fwd": "power"}})
    got, facts = load_arrays(tmp_path / "population.nc")
    assert set(got) == set(arrays)
    for name, values in arrays.items():
        np.testing.assert_array_equal(got[name], values)
    assert facts == {"laws": {"Fc_fwd": "power"}}


def test_saving_again_replaces_the_file(tmp_path):
    path = save(tmp_path / "posterior.nc")
    other = Trace.from_arrays(TIME[:50], MOTION[:50], force=MOTION[:50])
    save_test(
        path,
        CalibratedTest(VALUES, UNITS, STATS, other, PREDICTIVE[..., :50], {"model": "lugre"}),
    )
    assert load_test(path).facts == {"model": "lugre"}
    assert load_test(path).trace.samples == 50
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]


class Stopped(Exception):  # noqa: N818
    pass


@pytest.mark.parametrize("error", [Stopped, KeyboardInterrupt])
def test_a_write_that_fails_leaves_the_old_file_and_no_part(tmp_path, error):
    path = tmp_path / "report.html"
    write_text(path, "old")

    def write(part):
        part.write_text("half of the n")
        raise error

    with pytest.raises(error):
        write_atomically(path, write)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_a_store_error_with_the_files_name(tmp_path):
    def write(part):
        part.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(StoreError, match=r"report\.html.*No space left"):
        write_atomically(tmp_path / "report.html", write)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_becomes_read_only_is_a_store_error_with_the_files_name(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    for name in ("replace", "unlink"):
        monkeypatch.setattr(Path, name, refuse)
    with pytest.raises(StoreError, match=r"report\.html.*Read-only"):
        write_text(tmp_path / "report.html", "")
    remove_partial_files(tmp_path)  # at the end of a run: it must not hide the first error
    monkeypatch.undo()
    (part,) = tmp_path.iterdir()
    assert is_part(part, "report.html")
    remove_partial_files(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_a_store_error(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(StoreError, match=r"report\.html"):
        write_text(tmp_path / "out" / "report.html", "")


def test_a_failing_save_leaves_the_old_posterior(tmp_path):
    path = save(tmp_path / "posterior.nc")
    before = path.read_bytes()
    ragged = STATS | {"lp": np.zeros((4, 31)), "other": "text"}
    test = CalibratedTest(VALUES, UNITS, ragged, TRACE, PREDICTIVE, FACTS)
    with pytest.raises(Exception, match=r"draw|31"):
        save_test(path, test)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002, 0o027])
def test_folders_are_made_and_files_keep_the_umask(tmp_path, umask):
    path = tmp_path / "a" / "b" / "x.bin"
    before = os.umask(umask)
    try:
        write_bytes(path, b"\x00\xff")
    finally:
        os.umask(before)
    assert path.read_bytes() == b"\x00\xff"
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask
    assert path.parent.stat().st_mode & 0o777 == 0o777 & ~umask


READERS = pytest.mark.parametrize("read", [load_test, load_trace, load_arrays])


@READERS
def test_a_missing_file_is_named(tmp_path, read):
    with pytest.raises(StoreError, match=r"gone\.nc"):
        read(tmp_path / "gone.nc")


@READERS
@pytest.mark.parametrize("content", [b"", b"time,force\n0,1\n", b"CDF\x01" + bytes(200)])
def test_a_file_that_is_no_hdf5_is_named(tmp_path, read, content):
    path = tmp_path / "posterior.nc"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"posterior\.nc"):
        read(path)


@READERS
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_named(tmp_path, read, share):
    path = save(tmp_path / "posterior.nc")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(StoreError, match=r"posterior\.nc"):
        read(path)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # h5netcdf's close
@pytest.mark.parametrize("read", [load_test, load_arrays])
@pytest.mark.parametrize("twentieth", [1, 8])
def test_a_file_with_a_damaged_part_is_named_or_still_read(tmp_path, read, twentieth):
    path = save(tmp_path / "posterior.nc")
    content = bytearray(path.read_bytes())
    begin, end = (len(content) * k // 20 for k in (twentieth, twentieth + 1))
    content[begin:end] = b"\xff" * (end - begin)
    path.write_bytes(content)
    try:
        read(path)
    except StoreError as error:
        assert "posterior.nc" in str(error)  # noqa: PT017


@READERS
def test_netcdf_of_another_program_is_named(tmp_path, read):
    path = tmp_path / "other.nc"
    for mode, name in (
        ("w", "posterior"),
        ("a", "sample_stats"),
        ("a", "observed_data"),
        ("a", "constant_data"),
    ):
        data = xr.Dataset({"mu": (("chain", "draw"), np.zeros((2, 3)))})
        data.to_netcdf(path, mode=mode, group=name, engine="h5netcdf")
    with pytest.raises(StoreError, match=r"other\.nc"):
        read(path)


def test_json_is_valid_though_a_figure_is_not_finite(tmp_path):
    path = tmp_path / "manifest.json"
    content = {
        "nan": np.nan,
        "inf": [np.inf, -np.inf, 1.5],
        "numpy": {"f": np.float32("nan"), "i": np.int64(3), "t": (1, np.float64(2.0))},
        "path": tmp_path,
        4: None,
        "yes": True,
        "µ": "Größe",
    }
    write_json(path, content)

    def refuse(constant):
        raise AssertionError(constant)

    got = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert got["nan"] is None
    assert got["inf"] == [None, None, 1.5]
    assert got["numpy"] == {"f": None, "i": 3, "t": [1, 2.0]}
    assert got["path"] == str(tmp_path)
    assert (got["4"], got["yes"], got["µ"]) == (None, True, "Größe")
    assert read_json(path) == got


def test_json_takes_a_truth_of_numpys(tmp_path):
    write_json(tmp_path / "a.json", {"verdict": np.bool_(True)})
    assert read_json(tmp_path / "a.json") == {"verdict": True}


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"\xff\xfe", b"[" * 100_000])
def test_a_file_that_holds_no_json_object_is_named(tmp_path, content):
    path = tmp_path / "manifest.json"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"manifest\.json"):
        read_json(path)


def test_a_missing_json_file_is_named(tmp_path):
    with pytest.raises(StoreError, match=r"manifest\.json"):
        read_json(tmp_path / "manifest.json")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a":' * 60 + "1" + "}" * 60, "nested more than 50 times"),
        ('{"a": ["\\ud800"]}', "not valid JSON"),
        ('{"\\udfff": 1}', "not valid JSON"),
    ],
)
def test_json_that_could_not_be_written_again_is_refused(tmp_path, text, words):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=words):
        read_json(tmp_path / "manifest.json")


def test_json_of_some_depth_and_any_script_is_read(tmp_path):
    content = {"a": [[[[{"Größe": "\U0001f600"}]]]]}
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    assert read_json(tmp_path / "manifest.json") == content


def test_a_scale_that_is_a_text_is_damage_of_the_file(tmp_path):
    path = save(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        next(iter(file["posterior"].values())).attrs["scale_factor"] = "kip"
    with pytest.raises(StoreError, match=r"a\.nc"):
        load_test(path)
