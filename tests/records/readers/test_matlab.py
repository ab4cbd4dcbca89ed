"""What savemat and MATLAB 7.3 write is read; what is cut or changed ends in a sentence."""

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.io import loadmat, savemat

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3
VECTORS = st.sampled_from(["f8", "f4", "i1", "u2", "i4", "u8", "?"]).flatmap(
    lambda code: arrays.arrays(
        code,
        st.integers(2, 40).flatmap(lambda n: st.sampled_from([(n,), (n, 1), (1, n)])),
        elements={"allow_nan": False, "allow_infinity": False} if code[0] == "f" else None,
    )
)
NAMES = st.from_regex(r"[a-zA-Z][a-zA-Z0-9_]{0,20}", fullmatch=True)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.dictionaries(NAMES, VECTORS, min_size=1, max_size=4), st.booleans(), st.booleans())
def test_vectors_are_those_that_loadmat_reads(tmp_path, content, packed, nested):
    path = tmp_path / "a.mat"
    savemat(path, {"s": content} if nested else content, do_compression=packed)
    table = read_table(path)
    assert set(table.names) == {f"s.{name}" if nested else name for name in content}
    read = loadmat(path, simplify_cells=True)
    theirs = read["s"] if nested else read
    for name in table.names:
        expected = np.ravel(theirs[name.removeprefix("s.") if nested else name])
        np.testing.assert_array_equal(table.columns([name])[name], expected.astype(np.float64))


def test_vectors_and_struct_fields_of_version_73_are_columns(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        double = {"MATLAB_class": np.bytes_("double")}
        contents = {"t": TIME[None, :], "K": np.eye(3), "n": np.array([[3.0]])}
        contents |= {"test/time": TIME[None, :], "test/force": FORCE[:, None]}
        for name, values in contents.items():
            file.create_dataset(name, data=values).attrs.update(double)
        name = file.create_dataset("name", data=np.array([[112], [53]], dtype=np.uint16))
        name.attrs.update({"MATLAB_class": np.bytes_("char"), "MATLAB_int_decode": 2})
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    assert set(read_table(path).names) == {"t", "test.time", "test.force"}
    np.testing.assert_array_equal(read_table(path).columns(["test.force"])["test.force"], FORCE)


def test_what_is_no_vector_of_numbers_is_passed_over(tmp_path):
    content = {
        "cells": np.array([1.0, "two", np.eye(2)], dtype=object),
        "z": np.arange(5) + 1j,
        "matrix": np.eye(3),
        "scalar": 2.0,
        "empty": np.empty((0, 0)),
        "word": "p500",
        "deep": {"inner": {"x": np.arange(5.0)}, "y": np.arange(4.0), "word": "a"},
        "many": np.array([(1.0,), (2.0,)], dtype=[("x", "O")]),
        "x": np.arange(3.0),
    }
    savemat(tmp_path / "a.mat", content)
    assert read_table(tmp_path / "a.mat").names == ("deep.inner.x", "deep.y", "x")


def test_the_other_order_of_bytes_is_read(tmp_path):
    def element(kind, content):
        padded = content + bytes(-len(content) % 8)
        return kind.to_bytes(4, "big") + len(content).to_bytes(4, "big") + padded

    values = np.arange(4.0)
    matrix = (
        element(6, (6).to_bytes(4, "big") + bytes(4))
        + element(5, np.array([4, 1], ">i4").tobytes())
        + element(1, b"force")
        + element(9, values.astype(">f8").tobytes())
    )
    path = tmp_path / "a.mat"
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x01\x00MI" + element(14, matrix))
    np.testing.assert_array_equal(read_table(path).columns(["force"])["force"], values)


def test_what_is_no_matlab_file_or_cut_off_is_refused(tmp_path, refused):
    path = tmp_path / "a.mat"
    savemat(path, {"x": np.arange(100.0), "y": np.arange(100.0)})
    whole = path.read_bytes()
    bad = [b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" * 9, b"not a mat file" * 50]
    for content in [*bad, *(whole[: int(share * len(whole))] for share in (0.1, 0.7, 0.99))]:
        path.write_bytes(content)
        with pytest.raises(RecordError, match=r"a\.mat"):
            read_table(path)
    savemat(path, {"a": np.array([1.0, np.nan, 2.0])})
    assert "sample 2" in refused(path)
    savemat(path, {"name": "x"})
    assert "no numeric column" in refused(path)
