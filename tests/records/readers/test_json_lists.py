import json

import numpy as np
import pytest

from mfd_bayes.records.readers import read_table


def write(path, text):
    path.write_text(text)
    return path


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
    assert read_table(path).names == ("a", "b")
    columns = read_table(path).columns(["a", "b"])
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
        ('{"a": [1, "x"]}', "sample 2"),
        ('{"a": [1, null]}', "an empty cell"),
        ('{"a": [1, true]}', "sample 2"),
        ('{"a": [1, NaN]}', "sample 2"),
        ('{"a": [1, 1' + "0" * 400 + "]}", "sample 2"),
        ('[{"a": 1}, {"b": 2}]', "sample 2"),
    ],
)
def test_bad_json_is_refused(tmp_path, text, expected, refused):
    assert expected in refused(write(tmp_path / "a.json", text))


def test_only_columns_that_are_read_must_have_the_same_rows(tmp_path, refused):
    path = write(tmp_path / "a.json", '{"a": {"0": 1}, "b": {"1": 1}, "rig": {"id": 3}}')
    assert "row labels" in refused(path, ("a", "b"))
    np.testing.assert_array_equal(read_table(path).columns(("a",))["a"], [1.0])


def test_columns_of_different_lengths_are_refused(tmp_path, refused):
    path = write(tmp_path / "a.json", '{"a": [1, 2], "b": [1]}')
    assert "a 2, b 1" in refused(path, ["a", "b"])
