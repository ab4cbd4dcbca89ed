import numpy as np
import pandas as pd
import pytest

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".CSV"])
def test_csv_gives_its_columns_and_skips_comments(tmp_path, suffix):
    rows = "\n".join(f"{float(t)!r}, {float(f)!r}" for t, f in zip(TIME, FORCE, strict=True))
    path = write(tmp_path / f"a{suffix}", f"\ufeff# lab 3\n\ntime_s, force_kip\n# go\n{rows}\n\n")
    assert read_table(path).names == ("time_s", "force_kip")
    columns = read_table(path).columns(["force_kip", "time_s"])
    np.testing.assert_allclose(columns["time_s"], TIME, rtol=1e-15)
    np.testing.assert_allclose(columns["force_kip"], FORCE, rtol=1e-15)


def test_csv_from_a_spreadsheet_with_quotes_and_crlf_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b'"a","b, c"\r\n"1.5",2\r\n"2.5",3\r\n')
    np.testing.assert_array_equal(read_table(path).columns(["a"])["a"], [1.5, 2.5])
    np.testing.assert_array_equal(read_table(path).columns(["b, c"])["b, c"], [2, 3])


@pytest.mark.parametrize("comma", ["\t", ";"])
def test_other_separators_are_recognised_by_the_header(tmp_path, comma):
    path = write(tmp_path / "a.txt", f"a{comma}b\n1{comma}2\n3{comma}4\n")
    np.testing.assert_array_equal(read_table(path).columns(["b"])["b"], [2, 4])


def test_a_bad_cell_is_named_by_line_and_column(tmp_path, refused):
    path = write(tmp_path / "a.csv", "# note\na,b\n1,2\n\n3,oops\n4,5\n")
    assert "line 5" in (message := refused(path, ["a", "b"]))
    assert "column 'b'" in message
    assert "'oops'" in message


@pytest.mark.parametrize(
    ("cell", "found"), [("nan", "'nan'"), ("", "an empty cell"), ("inf", "'inf'"), ("1_0", "'1_0'")]
)
def test_nan_empty_and_infinite_cells_are_refused(tmp_path, cell, found, refused):
    path = write(tmp_path / "a.csv", f"a,b\n1,2\n{cell},3\n")
    assert "line 3" in (message := refused(path))
    assert found in message


def test_a_short_line_has_an_empty_cell_and_a_long_line_is_refused(tmp_path, refused):
    short = write(tmp_path / "short.csv", "a,b\n1,2\n3\n")
    assert "line 3" in (message := refused(short, ["b"]))
    assert "column 'b'" in message
    long = write(tmp_path / "long.csv", "a,b\n1,2\n3,4,5\n")
    assert refused(long) == (
        f"line 3 of {long}: expected 2 cells, one for each name in line 1, found 3"
    )


def test_the_first_bad_cell_of_several_is_named(tmp_path, refused):
    path = write(tmp_path / "a.csv", "a,b\n1,2\n3,x\ny,5\n")
    assert "line 3" in refused(path, ["a", "b"])


def test_an_open_quote_is_refused(tmp_path, refused):
    assert "a quotation mark without its partner" in refused(
        write(tmp_path / "a.csv", 'a,b\n0,"1\n1,2\n')
    )


def test_unused_columns_may_hold_anything(tmp_path):
    path = write(tmp_path / "a.csv", "a,note\n1,first\n2,\n")
    np.testing.assert_array_equal(read_table(path).columns(["a"])["a"], [1, 2])


def test_a_missing_column_lists_those_there_are(tmp_path, refused):
    path = write(tmp_path / "a.csv", "time_s,displacement_in\n0,1\n")
    assert (
        refused(path, ["force_kip"])
        == f"missing column 'force_kip' in {path}; it has time_s, displacement_in"
    )


def test_a_column_named_twice_is_refused(tmp_path, refused):
    assert "more than one" in refused(write(tmp_path / "a.csv", "a,a\n1,2\n"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("\n# only\n\n", "is empty"),
        ("1,2\n3,4\n", "it has no names: give { column = 1 }"),
        ("a,b\n", "no data"),
    ],
)
def test_csv_without_header_or_data_is_refused(tmp_path, text, expected, refused):
    assert expected in refused(write(tmp_path / "a.csv", text))


def test_a_binary_file_called_csv_is_refused(tmp_path, refused):
    path = tmp_path / "a.csv"
    path.write_bytes(bytes(range(256)))
    assert "UTF-8" in refused(path)


# --- decimal commas


@pytest.mark.parametrize("separator", [";", "\t", "  "])
def test_decimal_commas_are_told_apart_from_separators(tmp_path, separator):
    rows = "".join(f"0,{i}25{separator}\N{MINUS SIGN}3,{i}\n" for i in range(9))
    path = write(tmp_path / "a.csv", f"Zeit{separator}Kraft\n{rows}")
    columns = read_table(path).columns(["Zeit", "Kraft"])
    np.testing.assert_array_equal(columns["Zeit"], np.arange(25, 900, 100) / 1000)
    np.testing.assert_allclose(columns["Kraft"], -3 - np.arange(9) / 10, rtol=1e-15)


@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), (";", "."), (",", "."), ("\t", ",")]
)
def test_what_pandas_writes_comes_back_to_the_last_bit(tmp_path, separator, decimal):
    frame = pd.DataFrame({"Zeit, s": TIME, "Kraft": FORCE, "note": "a, b"})
    path = tmp_path / "a.csv"
    frame.to_csv(path, sep=separator, decimal=decimal, index=False)
    columns = read_table(path).columns(["Zeit, s", "Kraft"])
    np.testing.assert_allclose(columns["Zeit, s"], TIME, rtol=1e-15)
    np.testing.assert_allclose(columns["Kraft"], FORCE, rtol=1e-15)


@pytest.mark.parametrize("cell", ["1.234,5", "1,234,567", "1 234,5", "1'234.5", "1.234.567"])
def test_a_thousands_separator_is_refused_with_its_place(tmp_path, refused, cell):
    path = write(tmp_path / "a.csv", f"a;b\n0,5;1\n0,25;{cell}\n")
    assert refused(path, ["a", "b"]) == (
        f"line 3 of {path}, column 'b': expected a finite number, found {cell!r}; a number is "
        "written without a thousands separator"
    )


def test_a_quoted_thousands_separator_between_commas_is_refused(tmp_path, refused):
    path = write(tmp_path / "a.csv", 'a,b\n1,"1,234.5"\n2,"1,234"\n')
    assert "line 2" in (message := refused(path, ["b"]))
    assert message.endswith("a number is written without a thousands separator")


def test_commas_that_may_stand_before_thousands_are_refused(tmp_path, refused):
    path = write(tmp_path / "a.txt", "a\tb\n1,125\t12,500\n2,250\t3\n")
    assert refused(path, ["b"]) == (
        f"numbers of {path} such as '1,125' may have a decimal comma or a thousands separator; "
        "write them with a decimal point"
    )
    settled = write(tmp_path / "b.txt", "a\tb\n0,125\t12,500\n2,250\t3\n")
    np.testing.assert_array_equal(read_table(settled).columns(["b"])["b"], [12.5, 3])


def test_points_and_commas_in_one_table_are_refused(tmp_path, refused):
    path = write(tmp_path / "a.csv", "a;b\n1;2\n0,125;1.5\n")
    assert refused(path, ["a", "b"]) == (
        f"{path} holds both points and commas, '1.5' in line 3, column 'b' and '0,125' in line 3, "
        "column 'a': expected one sign of decimals, and no thousands separators"
    )


# --- what test controllers write

HEADING = """\
MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A

Data Header:\tTime:\t10.0\tSec\t6/10/2013 4:45:56 PM
Data Acquisition: Timed
Station Name: brake, spring 3
Time: 10.0 s

"""


@pytest.mark.parametrize("separator", ["\t", ";", ",", "   "])
@pytest.mark.parametrize(
    "units", [("Sec", "mm", "kN"), ("[s]", "[mm]", "[kN]"), ("(s)", "in", "lbf")]
)
def test_names_units_and_numbers_are_found_below_a_heading(tmp_path, separator, units):
    rows = [("Running Time", "Axial Displacement", "Axial Force"), units]
    rows += [(f"{t:.3f}", f"{t / 7:.6f}", f"{f:.6e}") for t, f in zip(TIME, FORCE, strict=True)]
    body = "".join(separator.join(row) + "\n" for row in rows)
    table = read_table(write(tmp_path / "a.dat", HEADING + body))
    assert table.names == rows[0]
    assert dict(table.units) == {
        name: unit.strip("[]()") for name, unit in zip(rows[0], units, strict=True)
    }
    np.testing.assert_allclose(table.columns(["Axial Force"])["Axial Force"], FORCE, rtol=1e-6)
    assert table.place(0) == "line 10"


def test_a_bad_cell_below_a_heading_is_named_by_its_line(tmp_path, refused):
    path = write(tmp_path / "a.txt", f"{HEADING}Time\tForce\nSec\tkN\n0\t1\n0.1\tOVR\n")
    assert refused(path, ["Time", "Force"]) == (
        f"line 11 of {path}, column 'Force': expected a finite number, found 'OVR'"
    )


def test_columns_without_a_unit_have_none(tmp_path):
    text = "Time,Force,Count,Gain\nsec,kips,segments,-\n0,1,2,3\n"
    table = read_table(write(tmp_path / "a.csv", text))
    assert dict(table.units) == {"Time": "sec", "Force": "kips", "Count": "segments"}


def test_a_file_without_a_row_of_units_has_none(tmp_path):
    assert read_table(write(tmp_path / "a.csv", "time,force\n0,1\n")).units == {}


def test_a_title_is_no_row_of_names_above_units(tmp_path):
    # t, F and N are units too, but only N measures what records hold.
    table = read_table(write(tmp_path / "a.csv", "Lehigh,hall B,N\nt,F,N\n0,1,2\n"))
    assert table.names == ("t", "F", "N")


def test_settings_above_a_table_are_not_taken_for_it(tmp_path):
    text = "Station,MTS\nRate,1024\nGain,Offset\n1.5,2\nTime,Force\n0,1\n1,2\n2,3\n"
    path = write(tmp_path / "a.csv", text)
    assert read_table(path).names == ("Time", "Force")
    np.testing.assert_array_equal(read_table(path).columns(["Force"])["Force"], [1, 2, 3])


def test_separators_at_the_ends_of_lines_make_no_column(tmp_path):
    path = write(tmp_path / "a.tsv", "a\tb\t\n1\t2\t\n3\t4\t\n")
    assert read_table(path).names == ("a", "b")
    np.testing.assert_array_equal(read_table(path).columns(["b"])["b"], [2, 4])


@pytest.mark.parametrize("line", ["3", "3 4 5"])
def test_between_blanks_every_line_has_all_cells(tmp_path, refused, line):
    path = write(tmp_path / "a.asc", f"a b\n1 2\n{line}\n")
    count = len(line.split())
    assert refused(path) == (
        f"line 3 of {path}: expected 2 cells, one for each name in line 1, found {count}"
    )


def test_names_with_blanks_that_cannot_be_told_apart_are_no_names(tmp_path, refused):
    path = write(tmp_path / "a.asc", "Axial Force Time\n1 2\n3 4\n")
    assert "it has no names: give { column = 1 }" in refused(path, ["Time"])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_the_encodings_of_laboratories_are_read(tmp_path, encoding):
    path = tmp_path / "a.txt"
    path.write_bytes("Zeit\tWeg µ°\r\n0,5\t1\r\n".encode(encoding))
    np.testing.assert_array_equal(read_table(path).columns(["Zeit"])["Zeit"], [0.5])
    assert read_table(path).names == ("Zeit", "Weg µ°")


@pytest.mark.parametrize("marks", [1, 2])
def test_a_quotation_mark_does_not_swallow_the_next_lines(tmp_path, marks):
    lines = [
        f"{i / 50},{np.sin(i / 8):.4f},{chr(34) if i in range(5, 5 + marks) else ''}"
        for i in range(40)
    ]
    path = write(tmp_path / "a.csv", "time_s,displacement_in,note\n" + "\n".join(lines) + "\n")
    with pytest.raises(RecordError, match=r"a\.csv"):
        read_table(path).columns(("time_s", "displacement_in"))
