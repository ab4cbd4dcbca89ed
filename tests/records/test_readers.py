import json
import pickle

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import column_names, read_columns

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3


def write(path, text):
    path.write_text(text)
    return path


def refused(path, names=("a",)):
    with pytest.raises(RecordError) as caught:
        read_columns(path, names)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".CSV"])
def test_csv_gives_its_columns_and_skips_comments(tmp_path, suffix):
    rows = "\n".join(f"{float(t)!r}, {float(f)!r}" for t, f in zip(TIME, FORCE, strict=True))
    path = write(tmp_path / f"a{suffix}", f"\ufeff# lab 3\n\ntime_s, force_kip\n# go\n{rows}\n\n")
    assert column_names(path) == ("time_s", "force_kip")
    columns = read_columns(path, ["force_kip", "time_s"])
    np.testing.assert_allclose(columns["time_s"], TIME, rtol=1e-15)
    np.testing.assert_allclose(columns["force_kip"], FORCE, rtol=1e-15)


def test_csv_from_a_spreadsheet_with_quotes_and_crlf_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b'"a","b, c"\r\n"1.5",2\r\n"2.5",3\r\n')
    np.testing.assert_array_equal(read_columns(path, ["a"])["a"], [1.5, 2.5])
    np.testing.assert_array_equal(read_columns(path, ["b, c"])["b, c"], [2, 3])


@pytest.mark.parametrize("comma", ["\t", ";"])
def test_other_separators_are_recognised_by_the_header(tmp_path, comma):
    path = write(tmp_path / "a.txt", f"a{comma}b\n1{comma}2\n3{comma}4\n")
    np.testing.assert_array_equal(read_columns(path, ["b"])["b"], [2, 4])


def test_a_bad_cell_is_named_by_line_and_column(tmp_path):
    path = write(tmp_path / "a.csv", "# note\na,b\n1,2\n\n3,oops\n4,5\n")
    assert "line 5" in (message := refused(path, ["a", "b"]))
    assert "column 'b'" in message
    assert "'oops'" in message


@pytest.mark.parametrize(
    ("cell", "found"), [("nan", "'nan'"), ("", "an empty cell"), ("inf", "'inf'"), ("1_0", "'1_0'")]
)
def test_nan_empty_and_infinite_cells_are_refused(tmp_path, cell, found):
    path = write(tmp_path / "a.csv", f"a,b\n1,2\n{cell},3\n")
    assert "line 3" in (message := refused(path))
    assert found in message


def test_a_short_line_has_an_empty_cell_and_a_long_line_is_refused(tmp_path):
    short = write(tmp_path / "short.csv", "a,b\n1,2\n3\n")
    assert "line 3" in (message := refused(short, ["b"]))
    assert "column 'b'" in message
    long = write(tmp_path / "long.csv", "a,b\n1,2\n3,4,5\n")
    assert "line 3" in refused(long)


def test_the_first_bad_cell_of_several_is_named(tmp_path):
    path = write(tmp_path / "a.csv", "a,b\n1,2\n3,x\ny,5\n")
    assert "line 3" in refused(path, ["a", "b"])


def test_an_open_quote_is_refused(tmp_path):
    assert "not a table" in refused(write(tmp_path / "a.csv", 'a,b\n0,"1\n1,2\n'))


def test_unused_columns_may_hold_anything(tmp_path):
    path = write(tmp_path / "a.csv", "a,note\n1,first\n2,\n")
    np.testing.assert_array_equal(read_columns(path, ["a"])["a"], [1, 2])


def test_a_missing_column_lists_those_there_are(tmp_path):
    path = write(tmp_path / "a.csv", "time_s,displacement_in\n0,1\n")
    assert (
        refused(path, ["force_kip"])
        == f"missing column 'force_kip' in {path}; it has time_s, displacement_in"
    )


def test_a_column_named_twice_is_refused(tmp_path):
    assert "more than one" in refused(write(tmp_path / "a.csv", "a,a\n1,2\n"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("\n# only\n\n", "is empty"),
        ("1,2\n3,4\n", "has no header"),
        ("a,b\n", "no data"),
    ],
)
def test_csv_without_header_or_data_is_refused(tmp_path, text, expected):
    assert expected in refused(write(tmp_path / "a.csv", text))


def test_a_binary_file_called_csv_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(bytes(range(256)))
    assert "UTF-8" in refused(path)


def test_unknown_suffixes_list_the_known_ones_and_nothing_is_unpickled(tmp_path):
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"a": [1, 2]}))
    assert ".csv, .txt, .json, .mat" in refused(path)


def test_missing_files_and_folders_are_record_errors(tmp_path):
    (tmp_path / "b.csv").mkdir()
    for name in ("a.csv", "b.csv", "a.mat"):
        refused(tmp_path / name)


JSON_FORMS = {
    "lists": {"a": [1, 2.5, 3], "b": [4, 5, 6], "note": "x"},
    "rows": [{"a": 1, "b": 4}, {"a": 2.5, "b": 5}, {"a": 3, "b": 6}],
    "columns": {"a": {"0": 1, "1": 2.5, "2": 3}, "b": {"0": 4, "1": 5, "2": 6}},
    "sorted": {"a": {"0": 1, "2": 3, "1": 2.5}, "b": {"1": 5, "0": 4, "2": 6}},
    "split": {"columns": ["a", "b"], "index": [0, 1, 2], "data": [[1, 4], [2.5, 5], [3, 6]]},
}


@pytest.mark.parametrize("form", JSON_FORMS)
def test_every_json_form_gives_the_same_columns(tmp_path, form):
    path = write(tmp_path / "a.json", json.dumps(JSON_FORMS[form]))
    assert column_names(path) == ("a", "b")
    columns = read_columns(path, ["a", "b"])
    np.testing.assert_array_equal(columns["a"], [1, 2.5, 3])
    np.testing.assert_array_equal(columns["b"], [4, 5, 6])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("3", "object of lists"),
        ("{}", "no columns"),
        ("[1, 2]", "row 1"),
        ('{"a": [1, "2"]}', "sample 2"),
        ('{"a": [1, null]}', "'null'"),
        ('{"a": [1, true]}', "sample 2"),
        ('{"a": [1, NaN]}', "sample 2"),
        ('[{"a": 1}, {"b": 2}]', "sample 2"),
        ('{"a": {"0": 1}, "b": {"1": 1}}', "row labels"),
    ],
)
def test_bad_json_is_refused(tmp_path, text, expected):
    assert expected in refused(write(tmp_path / "a.json", text))


def test_columns_of_different_lengths_are_refused(tmp_path):
    path = write(tmp_path / "a.json", '{"a": [1, 2], "b": [1]}')
    assert "a 2, b 1" in refused(path, ["a", "b"])


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
    assert set(column_names(path)) == {"t", "test.time", "test.force"}
    columns = read_columns(path, ["t", "test.force"])
    np.testing.assert_array_equal(columns["t"], TIME)
    np.testing.assert_array_equal(columns["test.force"], FORCE)


def test_bad_matlab_files_are_refused(tmp_path):
    path = tmp_path / "a.mat"
    for content in (b"not a mat file" * 50, b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" * 9):
        path.write_bytes(content)
        refused(path)
    savemat(path, {"a": np.array([1.0, np.nan, 2.0])})
    assert "sample 2" in refused(path)
    savemat(path, {"name": "x"})
    assert "no numeric column" in refused(path)
