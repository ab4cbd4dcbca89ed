import datetime

import numpy as np
import pytest
from openpyxl import Workbook

from mfd_bayes.records.readers import read_table

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3
ROWS = [list(row) for row in zip(TIME.tolist(), FORCE.tolist(), strict=True)]


def write(folder, name="a.xlsx", **sheets):
    """Workbook whose sheets have these rows."""
    workbook = Workbook()
    workbook.remove(workbook.active)
    for title, rows in sheets.items():
        sheet = workbook.create_sheet(title)
        for row in rows:
            sheet.append(row)
    workbook.save(folder / name)
    return folder / name


def test_the_first_sheet_that_holds_a_table_is_read_below_its_titles(tmp_path):
    heading = [["Brake 7, spring"], ["Rate (Hz)", 1024], [None]]
    table = [["Time", None, "Force\n(kN)", "note"], ["Sec", None, "[kN]", "-"]]
    table += [[t, None, f, "x"] for t, f in ROWS]
    path = write(
        tmp_path, Notes=[["Report", 2023], ["by", "me"]], Plot=[], Data=heading + table, Copy=table
    )
    read = read_table(path)
    assert read.names == ("Time", "Force (kN)", "note")
    assert dict(read.units) == {"Time": "Sec", "Force (kN)": "kN"}
    columns = read.columns(["Force (kN)", "Time"])
    np.testing.assert_array_equal(columns["Time"], TIME)
    np.testing.assert_allclose(columns["Force (kN)"], FORCE, rtol=1e-15)
    assert read.place(0) == "row 6 of sheet 'Data'"


def test_a_table_may_begin_in_any_column_and_have_blank_rows(tmp_path):
    path = write(tmp_path, Data=[[], [None, "t", "x"], [None, 0, 1], [], [None, 1, 2.5]])
    np.testing.assert_array_equal(read_table(path).columns(["x"])["x"], [1, 2.5])
    assert read_table(path).place(1) == "row 5 of sheet 'Data'"


def test_columns_end_where_the_wanted_ones_do(tmp_path):
    path = write(tmp_path, Data=[["t", "x", "q"], [0, 1, 5], [1, 2, 5], [None, None, 5]])
    np.testing.assert_array_equal(read_table(path).columns(["t", "x"])["t"], [0, 1])
    np.testing.assert_array_equal(read_table(path).columns(["q"])["q"], [5, 5, 5])


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        (None, "an empty cell"),
        ("off", "'off'"),
        ("#DIV/0!", "'#DIV/0!'"),
        (True, "'TRUE'"),
        (datetime.datetime(2024, 5, 1, 10, 30), "'2024-05-01 10:30:00', which is a time stamp"),
        (datetime.time(1, 2, 3), "'01:02:03', which is a time stamp"),
        ("=A3*2", "'(a formula without a stored value: save it in Excel)'"),
    ],
)
def test_a_cell_without_a_number_is_named_by_its_row_and_column(tmp_path, refused, cell, found):
    path = write(tmp_path, Data=[["t", None, "x"], [0, None, 1], [1, None, cell], [2, None, 3]])
    assert refused(path, ["t", "x"]).startswith(
        f"row 3 of sheet 'Data' of {path}, column 'x': expected a finite number, found {found}"
    )


def test_a_number_that_is_stored_as_text_is_one(tmp_path):
    path = write(tmp_path, Data=[["t", "x"], [0, "1.5"], ["1", 2]])
    columns = read_table(path).columns(["t", "x"])
    np.testing.assert_array_equal([columns["t"], columns["x"]], [[0, 1], [1.5, 2]])


def test_unused_columns_may_hold_anything(tmp_path):
    day = datetime.date(2024, 5, 1)
    path = write(tmp_path, Data=[["day", "t", "x"], [day, 0, 1], ["=B2", 1, 2]])
    np.testing.assert_array_equal(read_table(path).columns(["t", "x"])["x"], [1, 2])


def test_a_sheet_of_numbers_is_preferred_to_one_of_texts(tmp_path):
    notes = [["Sensor", "gain", "unit"], ["LVDT", 2.5, "V/mm"], ["cell", 3.5, "mV/V"]]
    path = write(tmp_path, Notes=notes, Data=[["t", "x"], [0, 1], [1, 2]])
    assert read_table(path).names == ("t", "x")
    assert read_table(write(tmp_path, Notes=notes)).names == ("Sensor", "gain", "unit")


def test_a_workbook_without_a_table_says_what_it_holds(tmp_path, refused):
    path = write(tmp_path, Notes=[["Report", 2023], ["by", "me"]], Plot=[])
    assert refused(path) == (
        f"{path} holds no row of two names or more above numbers: sheet 'Notes' begins with "
        "'Report', 2023.0; sheet 'Plot' is empty"
    )


def test_a_name_that_is_there_twice_is_refused(tmp_path, refused):
    path = write(tmp_path, Data=[["a", "a"], [0, 1]])
    assert refused(path) == (
        f"more than one column 'a' in {path}: say which by its number, "
        "{ column = 1 } or { column = 2 }"
    )


def test_what_is_no_workbook_is_refused(tmp_path, refused):
    whole = write(tmp_path, Data=[["t", "x"], *ROWS]).read_bytes()
    path = tmp_path / "b.xlsx"
    for content in (b"PK", b"t,x\n1,2\n", whole[:100], whole[: len(whole) // 2], whole[:-9]):
        path.write_bytes(content)
        assert refused(path) == f"{path} is not an Excel workbook (.xlsx) that can be read"


def test_old_and_locked_workbooks_are_refused_by_what_they_are(tmp_path, refused):
    path = tmp_path / "a.xlsx"
    path.write_bytes(bytes.fromhex("D0CF11E0A1B11AE1") + bytes(600))
    assert refused(path) == (
        f"{path} is an old .xls workbook or has a password; save it as .xlsx without one"
    )
