"""Text files: separators, decimal commas, headings and encodings; what cannot be read is named."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mfd_bayes.campaign.draft.columns import guess_columns, numbers_of
from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.readers.table import COLUMNS
from mfd_bayes.records.readers.text import LINE

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3


def write(folder, content, name="a.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=30),
    separator=st.sampled_from([",", ";", "\t", "  "]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    heading=st.sampled_from(["", "# lab 3\n\n", "ACME 4\nTest: 7\n\n"]),
    note=st.booleans(),
)
def test_numbers_come_back_to_the_last_bit(
    tmp_path, values, separator, end, encoding, heading, note
):
    more = f"{separator}note" if note else ""
    rows = [f"{a!r}{separator}{b!r}{more}" for a, b in values]
    text = heading + "\n".join([f"Zeit°{separator}Kraft{more}", *rows]) + "\n"
    path = write(tmp_path, text.replace("\n", end).encode(encoding), "a.txt")
    columns = read_table(path).columns(["Zeit°", "Kraft"])
    np.testing.assert_array_equal(np.column_stack([columns["Zeit°"], columns["Kraft"]]), values)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('"a","b, c"\r\n"1.5",2\r\n"2.5",3\r\n', {"a": [1.5, 2.5], "b, c": [2, 3]}),
        ("a,note\n1,first\n2,\n", {"a": [1, 2]}),
        ("a\tb\t\n1\t2\t\n3\t4\t\n", {"a": [1, 3], "b": [2, 4]}),
        ("a;b\n0,5;\N{MINUS SIGN}3,1\n0,25;2\n", {"a": [0.5, 0.25], "b": [-3.1, 2]}),
        ("a  b\n0,5  -3,1\n0,25  2\n", {"a": [0.5, 0.25], "b": [-3.1, 2]}),
        ("a\tb\n0,125\t12,500\n2,250\t3\n", {"b": [12.5, 3]}),
        ("a,b\n1D-02,2d3\n1e4294967290,1\n", {"b": [2000, 1]}),
        (
            "Station,MTS\nRate,1024\nGain,Offset\n1.5,2\nTime,Force\n0,1\n1,2\n2,3\n",
            {"Force": [1, 2, 3]},
        ),
        ("Lehigh,hall B,N\nt,F,N\n0,1,2\n", {"t": [0], "F": [1], "N": [2]}),
    ],
)
def test_forms_of_text_are_read(tmp_path, content, expected):
    columns = read_table(write(tmp_path, content)).columns(list(expected))
    for name, values in expected.items():
        np.testing.assert_allclose(columns[name], values, rtol=1e-15)


@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), (";", "."), (",", "."), ("\t", ",")]
)
def test_what_pandas_writes_comes_back(tmp_path, separator, decimal):
    frame = pd.DataFrame({"Zeit, s": TIME, "Kraft": FORCE, "note": "a, b"})
    frame.to_csv(tmp_path / "a.csv", sep=separator, decimal=decimal, index=False)
    columns = read_table(tmp_path / "a.csv").columns(["Zeit, s", "Kraft"])
    np.testing.assert_allclose(columns["Zeit, s"], TIME, rtol=1e-15)
    np.testing.assert_allclose(columns["Kraft"], FORCE, rtol=1e-15)


@pytest.mark.parametrize(
    ("content", "names", "expected"),
    [
        ("# note\na,b\n1,2\n\n3,oops\n4,5\n", "ab", ["line 5", "column 'b'", "'oops'"]),
        ("a,b\n1,2\nnan,3\n", "a", ["line 3", "'nan'"]),
        ("a,b\n1,2\n,3\n", "a", ["line 3", "an empty cell"]),
        ("a,b\n1,2\ninf,3\n", "a", ["line 3", "'inf'"]),
        ("a,b\n1,2\n1_0,3\n", "a", ["line 3", "'1_0'"]),
        ("a,b\n1,2\n3\n", "b", ["line 3", "column 'b'", "an empty cell"]),
        ("a,b\n1,2\n3,4,5\n", "a", ["line 3", "expected 2 cells, one for each name in line 1"]),
        ("a b\n1 2\n3\n", "a", ["line 3", "expected 2 cells", "found 1"]),
        ("a b\n1 2\n3 4 5\n", "a", ["line 3", "expected 2 cells", "found 3"]),
        ("a,b\n1,2\n3,x\ny,5\n", "ab", ["line 3"]),
        ('a,b\n0,"1\n1,2\n', "a", ["line 2", "a quotation mark without its partner"]),
        ("time_s,b\n0,1\n", "a", ["missing column 'a'", "it has time_s, b"]),
        ("a,a\n1,2\n", "a", ["more than one column 'a'", "{ column = 1 } or { column = 2 }"]),
        ("", "a", ["is empty"]),
        ("\n# only\n\n", "a", ["is empty"]),
        ("1,2\n3,4\n", "a", ["it has no names: give { column = 1 }"]),
        ("Axial Force Time\n1 2\n3 4\n", "a", ["it has no names: give { column = 1 }"]),
        ("a,b\n", "a", ["no data"]),
        (bytes(range(256)), "a", ["is not UTF-8 text"]),
        ('a,b\n1,"1,234.5"\n2,"1,234"\n', "b", ["line 2", "without a thousands separator"]),
        ("a\tb\n1,125\t12,500\n2,250\t3\n", "b", ["'1,125' may have a decimal comma or a"]),
        ("a;b\n1;2\n0,125;1.5\n", "ab", ["points and commas, '1.5' in line 3", "'0,125'"]),
        ("a,b\n1,2\n#" + "x" * LINE + "\n", "a", ["line 3", "is longer"]),
        ("time_s," + "(" * 5000 + "\n1,2\n", "a", ["the name of column 2"]),
        ("time_s," + "a_per_" * 900 + "\n1,2\n", "a", ["the name of column 2"]),
        ("c," * COLUMNS + "c\n" + "1," * COLUMNS + "1\n", "a", ["1,001 columns"]),
        ("T\tF\nSec\tkN\n0\t1\n0.1\tOVR\n", "TF", ["line 4", "column 'F'", "'OVR'"]),
        *(
            (f"a;b\n0,5;1\n0,25;{cell}\n", "ab", ["line 3", "column 'b'", repr(cell), "thousands"])
            for cell in ("1.234,5", "1,234,567", "1 234,5", "1'234.5")
        ),
    ],
)
def test_what_cannot_be_read_is_named_with_its_place(tmp_path, refused, content, names, expected):
    message = refused(write(tmp_path, content), list(names))
    assert [words for words in expected if words not in message] == [], message


HEADING = """\
MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A

Data Header:\tTime:\t10.0\tSec\t6/10/2013 4:45:56 PM
Data Acquisition: Timed
Station Name: brake, spring 3
Time: 10.0 s

"""


@pytest.mark.parametrize("separator", ["\t", ";", ",", "   "])
@pytest.mark.parametrize("units", [("Sec", "mm", "kN"), ("[s]", "[mm]", "[kN]")])
def test_names_units_and_numbers_are_found_below_a_heading(tmp_path, separator, units):
    rows = [("Running Time", "Axial Displacement", "Axial Force"), units]
    rows += [(f"{t:.3f}", f"{t / 7:.6f}", f"{f:.6e}") for t, f in zip(TIME, FORCE, strict=True)]
    body = "".join(separator.join(row) + "\n" for row in rows)
    table = read_table(write(tmp_path, HEADING + body, "a.dat"))
    assert table.names == rows[0]
    assert [unit.strip("[]") for unit in units] == list(table.units.values())
    np.testing.assert_allclose(table.columns(["Axial Force"])["Axial Force"], FORCE, rtol=1e-6)
    assert table.place(0) == "line 10"


@pytest.mark.parametrize(
    ("content", "units"),
    [
        (
            "Time,Force,Count,Gain\nsec,kips,segments,-\n0,1,2,3\n",
            {"Time": "sec", "Force": "kips", "Count": "segments"},
        ),
        ("time,force\n0,1\n", {}),
    ],
)
def test_a_row_of_units_is_told_from_text(tmp_path, content, units):
    assert dict(read_table(write(tmp_path, content)).units) == units


def test_a_quotation_mark_does_not_swallow_the_next_lines(tmp_path):
    for marks in (1, 2):
        lines = [
            f"{i / 50},{i / 8},{chr(34) if i in range(5, 5 + marks) else ''}" for i in range(40)
        ]
        path = write(tmp_path, "time_s,displacement_in,note\n" + "\n".join(lines) + "\n")
        with pytest.raises(RecordError, match=r"a\.csv"):
            read_table(path).columns(("time_s", "displacement_in"))


def test_numbers_too_large_are_no_column_that_is_guessed(tmp_path):
    table = read_table(
        write(tmp_path, "a,b\n" + "".join(f"{i},{(-1) ** i * 1e200}\n" for i in range(50)))
    )
    assert numbers_of(table, "b") is None
    assert "b" not in {guess.name for guess in guess_columns(table).values()}
