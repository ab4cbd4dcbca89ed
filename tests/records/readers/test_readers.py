import pickle
import sys

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook

from mfd_bayes.records.readers import SUFFIXES, read_table
from mfd_bayes.records.record import read_record


def test_unknown_suffixes_list_the_known_ones_and_nothing_is_unpickled(tmp_path, refused):
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"a": [1, 2]}))
    assert refused(path) == (
        f"{path} has the unknown suffix '.pkl'; expected .csv, .txt, .dat, .tsv, .asc, .lvm, "
        ".xlsx, .tdms, .json, .mat"
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
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
    ("suffix", "module", "library", "extra"),
    [(".xlsx", "openpyxl", "openpyxl", "excel"), (".tdms", "nptdms", "npTDMS", "tdms")],
)
def test_a_missing_library_is_named_with_the_command_that_installs_it(
    tmp_path, refused, monkeypatch, suffix, module, library, extra
):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"what it holds is not looked at")
    monkeypatch.setitem(sys.modules, module, None)
    assert refused(path) == (
        f'reading {path} needs {library}, which is not installed: pip install "mfd_bayes[{extra}]"'
    )


def test_a_workbook_called_csv_is_not_read_as_one(tmp_path, refused):
    path = tmp_path / "a.csv"
    Workbook().save(path)
    assert refused(path) == f"{path} is not UTF-8 text, as a .csv file must be"


def test_the_case_of_a_suffix_does_not_matter(tmp_path):
    path = tmp_path / "a.TXT"
    path.write_text("t\tx\n1\t2\n")
    assert read_table(path).names == ("t", "x")


def write_text(path, columns, units, separator, decimal):
    """Text as a test controller of this language writes it."""
    frame = pd.DataFrame(columns)
    body = frame.to_csv(sep=separator, decimal=decimal, index=False, header=False)
    lines = ["Data Acquisition: Timed", "", separator.join(columns), separator.join(units), body]
    path.write_text("\n".join(lines))


def write_excel(path, columns, units):
    workbook = Workbook(write_only=True)
    sheet = workbook.create_sheet("spring 2022")
    for row in (
        ["Brake 7"],
        list(columns),
        units,
        *np.column_stack(list(columns.values())).tolist(),
    ):
        sheet.append(row)
    workbook.save(path)


def write_tdms(path, columns, units):
    time, *rest = columns
    clock = {"wf_start_offset": 0.0, "wf_increment": columns[time][1]}
    channels = [
        ChannelObject("test", name, columns[name], {"unit_string": unit, **clock})
        for name, unit in zip(rest, units[1:], strict=True)
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)


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
