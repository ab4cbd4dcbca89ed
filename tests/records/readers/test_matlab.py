import h5py
import numpy as np
import pytest
from scipy.io import savemat

from mfd_bayes.records.readers import read_table

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3


def matlab_v5(path):
    test = {"time": TIME[:, None], "force": FORCE[None, :]}
    savemat(path, {"t": TIME[:, None], "test": test, "name": "p500", "K": np.eye(3), "n": 3.0})


def matlab_v73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        double = {"MATLAB_class": np.bytes_("double")}
        file.create_dataset("t", data=TIME[None, :]).attrs.update(double)
        file.create_dataset("K", data=np.eye(3)).attrs.update(double)
        file.create_dataset("n", data=np.array([[3.0]])).attrs.update(double)
        name = file.create_dataset("name", data=np.array([[112], [53]], dtype=np.uint16))
        name.attrs.update({"MATLAB_class": np.bytes_("char"), "MATLAB_int_decode": 2})
        test = file.create_group("test")
        test.attrs["MATLAB_class"] = np.bytes_("struct")
        test.create_dataset("time", data=TIME[None, :]).attrs.update(double)
        test.create_dataset("force", data=FORCE[:, None]).attrs.update(double)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as file:
        file.write(head)


@pytest.mark.parametrize("make", [matlab_v5, matlab_v73])
def test_matlab_vectors_and_struct_fields_are_columns(tmp_path, make):
    path = tmp_path / "a.mat"
    make(path)
    assert set(read_table(path).names) == {"t", "test.time", "test.force"}
    columns = read_table(path).columns(["t", "test.force"])
    np.testing.assert_array_equal(columns["t"], TIME)
    np.testing.assert_array_equal(columns["test.force"], FORCE)


def test_bad_matlab_files_are_refused(tmp_path, refused):
    path = tmp_path / "a.mat"
    for content in (b"not a mat file" * 50, b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" * 9):
        path.write_bytes(content)
        refused(path)
    savemat(path, {"a": np.array([1.0, np.nan, 2.0])})
    assert "sample 2" in refused(path)
    savemat(path, {"name": "x"})
    assert "no numeric column" in refused(path)
