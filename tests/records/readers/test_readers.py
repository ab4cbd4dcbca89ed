"""All formats: files that are none, and JSON; a real record is the same from each of them."""

import json
import pickle
import sys
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook

import mfd_bayes as mb
from mfd_bayes.records import readers
from mfd_bayes.records.readers import SUFFIXES, read_table
from mfd_bayes.records.readers.table import Table
from mfd_bayes.records.record import read_record


def test_unknown_suffixes_list_the_known_ones_and_nothing_is_unpickled(tmp_path, refused):
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"a": [1, 2]}))
    assert refused(path) == (
        f"{path} has the unknown suffix '.pkl'; expected .csv, .txt, .dat, .tsv, .asc, .lvm, "
        ".xlsx, .tdms, .json, .mat"
    )


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".TXT"])
def test_missing_empty_and_broken_files_and_folders_are_record_errors(tmp_path, refused, suffix):
    path = tmp_path / f"a{suffix}"
    assert refused(path) == f"cannot read {path}: No such file or directory"
    path.write_bytes(b"")
    assert refused(path) == f"{path} is empty"
    path.write_bytes(bytes(range(256)))
    refused(path)
    path.unlink()
    path.mkdir()
    refused(path)


@pytest.mark.parametrize(
    ("suffix", "library", "extra"), [(".xlsx", "openpyxl", "excel"), (".tdms", "npTDMS", "tdms")]
)
def test_a_missing_library_is_named_with_the_command_that_installs_it(
    tmp_path, refused, monkeypatch, suffix, library, extra
):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"what it holds is not looked at")
    monkeypatch.setitem(sys.modules, library.lower(), None)
    assert refused(path) == (
        f'reading {path} needs {library}, which is not installed: pip install "mfd_bayes[{extra}]"'
    )


# --- JSON

JSON_FORMS = {
    "lists": {"a": [1, 2.5, 3], "b": [4, 5, 6], "note": "x"},
    "rows": [{"a": 1, "b": 4}, {"a": 2.5, "b": 5}, {"a": 3, "b": 6}],
    "columns": {"a": {"0": 1, "1": 2.5, "2": 3}, "b": {"0": 4, "1": 5, "2": 6}},
    "sorted": {"a": {"0": 1, "2": 3, "1": 2.5}, "b": {"1": 5, "0": 4, "2": 6}},
    "split": {"columns": ["a", "b"], "index": [0, 1, 2], "data": [[1, 4], [2.5, 5], [3, 6]]},
}


@pytest.mark.parametrize("form", JSON_FORMS)
def test_every_json_form_gives_the_same_columns(tmp_path, form):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(JSON_FORMS[form]))
    assert read_table(path).names == ("a", "b")
    columns = read_table(path).columns(["a", "b"])
    np.testing.assert_array_equal([columns["a"], columns["b"]], [[1, 2.5, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("text", "names", "expected"),
    [
        ("{", "a", "not valid JSON"),
        ("[" * 100_000, "a", "not valid JSON"),
        ("3", "a", "object of lists"),
        ("{}", "a", "no columns"),
        ("[1, 2]", "a", "row 1"),
        ('{"a": [1, "x"]}', "a", "sample 2"),
        ('{"a": [1, null]}', "a", "an empty cell"),
        ('{"a": [1, true]}', "a", "sample 2"),
        ('{"a": [1, NaN]}', "a", "sample 2"),
        ('{"a": [1, 1' + "0" * 400 + "]}", "a", "sample 2"),
        ('[{"a": 1}, {"b": 2}]', "a", "sample 2"),
        ('{"a": {"0": 1}, "b": {"1": 1}, "rig": {"id": 3}}', "ab", "row labels"),
        ('{"a": [1, 2], "b": [1]}', "ab", "a 2, b 1"),
        (json.dumps({f"c{i}": [1.0] for i in range(1001)}), "a", "1,001 columns"),
    ],
)
def test_bad_json_is_refused(tmp_path, refused, text, names, expected):
    path = tmp_path / "a.json"
    path.write_text(text)
    assert expected in refused(path, list(names))
    if "rig" in text:  # a column of other rows is in nobody's way
        np.testing.assert_array_equal(read_table(path).columns(["a"])["a"], [1.0])


# --- one record, many formats


def read_spaced(path):
    """Toy: a line of names, then numbers, with blanks between them."""
    names, *lines = path.read_text().splitlines()
    cells = np.array([line.split() for line in lines], float).T
    return Table(path, dict(zip(names.split(), cells, strict=True)))


def test_a_format_is_added_by_one_function_and_one_line(tmp_path, monkeypatch):
    formats = MappingProxyType(dict(readers.FORMATS) | {".toy": read_spaced})
    monkeypatch.setattr(readers, "FORMATS", formats)
    time = np.arange(100) * 0.05
    rows = np.column_stack([time, np.sin(2 * time), np.cos(2 * time)])
    header = "time_s displacement_in force_kip"
    np.savetxt(tmp_path / "a.toy", rows, "%.6f", header=header, comments="")
    record = mb.read_record(tmp_path / "a.toy")
    np.testing.assert_allclose(record.force, rows[:, 2], atol=1e-6)


def write_text(path, columns, units, separator, decimal):
    """Text as a test controller of this language writes it."""
    body = pd.DataFrame(columns).to_csv(sep=separator, decimal=decimal, index=False, header=False)
    lines = ["Data Acquisition: Timed", "", separator.join(columns), separator.join(units), body]
    path.write_text("\n".join(lines))


def write_excel(path, columns, units):
    workbook = Workbook(write_only=True)
    sheet = workbook.create_sheet("spring 2022")
    for row in (["Brake 7"], list(columns), units, *np.column_stack([*columns.values()]).tolist()):
        sheet.append(row)
    workbook.save(path)


def write_tdms(path, columns, units):
    time, *rest = columns
    clock = {"wf_start_offset": 0.0, "wf_increment": columns[time][1]}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("test", name, columns[name], {"unit_string": unit, **clock})
                for name, unit in zip(rest, units[1:], strict=True)
            ]
        )


WRITERS = {
    "mts.txt": lambda *table: write_text(*table, "\t", "."),
    "german.csv": lambda *table: write_text(*table, ";", ","),
    "aligned.asc": lambda *table: write_text(*table, " ", "."),
    "sheet.xlsx": write_excel,
    "labview.tdms": write_tdms,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_real_record_is_the_same_from_every_format(tmp_path, data_folder, name):
    record = read_record(data_folder / "2022_80lb_0.50Hz_1.0in.csv")
    columns = {
        "time": record.time,
        "Stroke": record.displacement * 25.4,
        "Load": record.force * 1000,
    }
    WRITERS[name](tmp_path / name, columns, ["Sec", "mm", "lbf"])
    roles = {"time": "time", "displacement": "Stroke", "force": "Load"}
    read = read_record(tmp_path / name, roles)
    assert read.rate == pytest.approx(record.rate, rel=1e-6)
    np.testing.assert_allclose(read.time, record.time, atol=1e-5)
    np.testing.assert_allclose(read.displacement, record.displacement, atol=1e-12)
    np.testing.assert_allclose(read.force, record.force, atol=1e-12)
