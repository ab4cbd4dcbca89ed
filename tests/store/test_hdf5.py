"""HDF5 files of strangers: nothing outside of them is read, and nothing twice."""

import pickle

import h5py
import numpy as np
import pytest

from mfd_bayes.errors import RecordError, StoreError
from mfd_bayes.records.readers import read_table
from mfd_bayes.store.hdf5 import UnsafeError, check_heaps, check_objects
from mfd_bayes.store.netcdf import load_arrays, save_arrays

TIME = np.arange(30) / 10


@pytest.fixture
def secret(tmp_path):
    path = tmp_path / "elsewhere" / "secret.h5"
    path.parent.mkdir()
    with h5py.File(path, "w") as file:
        file["time"] = TIME
    return path


def external_link(file, secret):
    file["time"] = h5py.ExternalLink(str(secret), "time")


def soft_link(file, secret):
    file["other"] = TIME
    file["time"] = h5py.SoftLink("/other")


def virtual(file, secret):
    layout = h5py.VirtualLayout((30,), "f8")
    layout[:] = h5py.VirtualSource(str(secret), "time", (30,))
    file.create_virtual_dataset("time", layout)


def external_storage(file, secret):
    file.create_dataset("time", (30,), "f8", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])


def circle(file, secret):
    file.create_group("a")["again"] = file["/"]


def twice(file, secret):
    file["time"] = TIME
    file["force"] = file["time"]


def doubly_packed(file, secret):
    file.create_dataset("time", data=TIME, chunks=(30,), compression="lzf")


WORDS = {
    external_link: "link to elsewhere",
    soft_link: "link to elsewhere",
    virtual: "from another file",
    external_storage: "from another file",
    circle: "in two places",
    twice: "in two places",
    doubly_packed: "packs",
}


@pytest.mark.parametrize("make", [external_link, soft_link, virtual, external_storage])
def test_files_that_reach_outside_themselves_are_refused(tmp_path, secret, make):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        make(file, secret)
    with pytest.raises(RecordError, match=WORDS[make]) as caught:
        read_table(path).columns(["time"])
    assert "a.mat" in str(caught.value)


def test_without_the_check_the_secret_would_be_read(tmp_path, secret):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        external_link(file, secret)
        virtual_of = file.create_group("v")
        layout = h5py.VirtualLayout((30,), "f8")
        layout[:] = h5py.VirtualSource(str(secret), "time", (30,))
        virtual_of.create_virtual_dataset("time", layout)
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["time"][:], TIME)
        np.testing.assert_array_equal(file["v/time"][:], TIME)


@pytest.mark.parametrize("make", WORDS)
def test_a_stored_file_reaches_nowhere_either(tmp_path, secret, make):
    path = tmp_path / "population.nc"
    save_arrays(path, {"mu": np.zeros((2, 3))}, {})
    with h5py.File(path, "a") as file:
        make(file.create_group("more") if make is not circle else file, secret)
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_arrays(path)


def test_objects_are_not_made(tmp_path):
    """A pickle in a stored file is bytes that are refused, and never loaded."""
    path = tmp_path / "population.nc"
    save_arrays(path, {"mu": np.zeros((2, 3))}, {})
    with h5py.File(path, "a") as file:
        file["posterior"]["evil"] = np.void(pickle.dumps(print))
    with pytest.raises(StoreError, match="no numbers"):
        load_arrays(path)


def test_pieces_and_sizes_within_bounds_pass(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", data=np.zeros(5_000_000), chunks=(2_500_000,), compression="gzip")
        check_objects(file, 40_000_000)
        with pytest.raises(UnsafeError, match="declares 40 MB"):
            check_objects(file, 39_000_000)


def with_text(path):
    """A file with a text of any length, and where its global heap begins."""
    with h5py.File(path, "w") as file:
        file["x"] = TIME
        file["x"].attrs.create("about", "text", dtype=h5py.string_dtype())
    content = bytearray(path.read_bytes())
    return content, content.index(b"GCOL")


def heap_of(path):
    with h5py.File(path) as file:
        check_heaps(file)


def test_a_heap_of_texts_passes(tmp_path):
    with_text(tmp_path / "a.h5")
    heap_of(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("at", "size", "words"),
    [
        (8, 2**40, "beyond its end"),
        (24, 24, "do not fit"),  # from where on all sizes are 0: the library never ends
        (24, 2**63, "do not fit"),
        (24, 5000, "do not fit"),
    ],
)
def test_a_heap_that_is_never_read_to_its_end_is_refused(tmp_path, at, size, words):
    content, begin = with_text(tmp_path / "a.h5")
    content[begin + at : begin + at + 8] = size.to_bytes(8, "little")
    (tmp_path / "a.h5").write_bytes(content)
    with pytest.raises(UnsafeError, match=words):
        heap_of(tmp_path / "a.h5")
