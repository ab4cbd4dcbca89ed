"""What loggers, controllers and spreadsheets write is read, or refused with its place.

Each file is made by its format's own library.
"""

import csv
import datetime
import json
import os
import pickle
import re
import signal
import struct
import sys
import threading

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, RootObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat

import mfd_bayes as mb
from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import SUFFIXES, read_table

TIME = np.arange(400) / 50.0  # s
TRAVEL = 20.0 * np.sin(np.pi * TIME)  # mm
FORCE = 7.0 * np.tanh(3.0 * np.cos(np.pi * TIME)) + 0.25 * np.sin(31.0 * TIME)  # N
ROWS = np.column_stack([TIME, TRAVEL, FORCE])
UNITS = {"time": "s", "displacement": "mm", "force": "N"}
NAMES = "time_s,displacement_mm,force_N\n"
WAVE = {"wf_increment": 0.02, "wf_start_offset": 0.0}


def refusal(path, names=("a",)):
    """Sentence with which columns of a file are refused."""
    with pytest.raises(RecordError) as caught:
        read_table(path).columns(names)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def put(folder, content, name="a.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# --- layouts


def lines(separator=",", decimal=".", columns=(0, 1, 2)):
    rows = ROWS[:, list(columns)]
    text = "\n".join(separator.join(f"{cell:.9f}" for cell in row) for row in rows) + "\n"
    return text.replace(".", decimal)


def sign_apart(match):
    """A number's sign and first digit as some loggers write them: "+   0"."""
    return f"{match[1] or '+'}   {match[2]}"


def text(content, encoding="utf-8", suffix=".csv"):
    return lambda folder: put(folder, content.encode(encoding), f"a{suffix}")


def quoted(folder):
    with (folder / "a.csv").open("w", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerow(["Time (s)", "Load, axial (N)", "Stroke (mm)"])
        writer.writerows(ROWS[:, [0, 2, 1]].tolist())
    return folder / "a.csv"


def sheets(folder, **content):
    """Workbook whose sheets have these rows."""
    book = Workbook()
    book.remove(book.active)
    for title, rows in content.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append([cell.item() if isinstance(cell, np.generic) else cell for cell in row])
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx"


def workbook(*heading, start_column=1):
    return lambda folder: sheets(
        folder, A=[[None] * (start_column - 1) + list(line) for line in (*heading, *ROWS.tolist())]
    )


def tdms(*channels, repeats=1):
    """File of (group, channel, values, properties), written so many times."""

    def write(folder):
        with TdmsWriter(folder / "a.tdms") as writer:
            for _ in range(repeats):
                writer.write_segment([ChannelObject(*channel) for channel in channels])
        return folder / "a.tdms"

    return write


def matlab(content):
    def write(folder):
        savemat(folder / "a.mat", content)
        return folder / "a.mat"

    return write


def matlab_v73(folder):
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        for name, values in {"log": ROWS.T, "test/n": np.array([[3.0]]), "K": np.eye(3)}.items():
            file[name] = values  # a matrix of a row for each sample, as MATLAB stores it
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["word"] = np.array([[112], [53]], dtype=np.uint16)
        file["word"].attrs["MATLAB_class"] = np.bytes_("char")
    return folder / "a.mat"


def json_of(content):
    return lambda folder: put(folder, json.dumps(content), "a.json")


TITLE = "ACME logger 4\nSeal friction, 3 bar\nStarted 12.03.2024 10:04\nChannels as wired\n\n"
MTS = "MTS793|MPT|ENU|1|0|A\nTest 7\nData Acquisition: Timed\t\tTime:\t3.2\tSec\n"
LVM = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n"
CLOCK = ("Clock", "t", TIME, {"unit_string": "s"})
MM, N = {"unit_string": "mm"}, {"NI_UnitDescription": "[N]"}
SIMULINK = np.array(
    [(TRAVEL[:, None], "Stroke_mm"), (FORCE[:, None], "Load_N")],
    dtype=[("values", "O"), ("label", "O")],
)
DSPACE = np.array(
    [(TIME, "t", "s"), (TRAVEL, "x", "mm"), (FORCE, "f", "N")],
    dtype=[("Data", "O"), ("Name", "O"), ("Unit", "O")],
)
SIGNALS = ("Scope.signals(1).values Stroke_mm", "Scope.signals(2).values Load_N")
HEAD = [["Seal friction"], ["Clock", "Measured", None], ["time", "displacement", "force"]]
COLUMNS = dict(zip(("time_s", "displacement_mm", "force_N"), ROWS.T.tolist(), strict=True))
FRAME = pd.DataFrame(COLUMNS)


def layout(write, *columns, units=None):
    """How a file is written, which of its columns are read, and their units."""
    return write, dict(zip(UNITS, columns, strict=False)), units


LAYOUTS = {
    "without a header": layout(text(lines()), 1, 2, 3, units=UNITS),
    "free text, tabs, decimal commas": layout(
        text(TITLE + lines("\t", ","), suffix=".asc"), 1, 2, 3, units=UNITS
    ),
    "semicolons, decimal commas": layout(
        text("Zeit [s];Weg [mm];Kraft [N]\n" + lines(";", ",")), "Zeit [s]", "Weg [mm]", "Kraft [N]"
    ),
    "MTS: units in a row": layout(
        text(MTS + "Time\tDisp\tForce\nSec\tmm\tN\n" + lines("\t"), suffix=".dat"),
        *("Time", "Disp", "Force"),
    ),
    "names that two columns have": layout(
        text("t_s,x_mm,x_mm,f_N\n" + lines(columns=(0, 2, 1, 2))), "t_s", 3, "f_N"
    ),
    "UTF-16": layout(text(NAMES.replace(",", "\t") + lines("\t"), "utf-16", ".TXT")),
    "Windows-1252": layout(text("Temp °C," + NAMES + lines(columns=(2, 0, 1, 2)), "cp1252")),
    "quoted cells with commas in names": layout(
        quoted, "Time (s)", "Stroke (mm)", "Load, axial (N)"
    ),
    "LabVIEW's .lvm": layout(
        text(LVM + "X_Value\tStroke\tLoad\tComment\n" + lines("\t"), suffix=".lvm"),
        *("X_Value", "Stroke", "Load"),
        units=UNITS,
    ),
    "Excel: titles and a row of units": layout(workbook(*HEAD, UNITS.values())),
    "Excel: without a header, from column B": layout(
        workbook(["rig 2"], start_column=2), 2, 3, 4, units=UNITS
    ),
    "TDMS: a time in one of two groups": layout(
        tdms(CLOCK, ("Rig", "x", TRAVEL, MM), ("Rig", "f", FORCE, N)), "t", "x", "f"
    ),
    "TDMS: waveforms of two groups with the same names": layout(
        tdms(("Disp", "ai0", TRAVEL, MM | WAVE), ("Force", "ai0", FORCE, N | WAVE)),
        *("time", "Disp/ai0", "Force/ai0"),
    ),
    "MATLAB: a struct": layout(
        matlab({"data": {"t": TIME, "x": TRAVEL, "f": FORCE}, "rig": "two"}),
        *("data.t", "data.x", "data.f"),
        units=UNITS,
    ),
    "MATLAB: Simulink's structure with time": layout(
        matlab({"Scope": {"time": TIME[:, None], "signals": SIMULINK}}),
        *("Scope.time", *SIGNALS),
        units={"time": "s"},
    ),
    "MATLAB: a matrix of long rows": layout(
        matlab({"log": ROWS.T, "K": np.eye(3), "z": TIME + 1j, "n": 2.0}),
        *("log(1,:)", "log(2,:)", "log(3,:)"),
        units=UNITS,
    ),
    "MATLAB 7.3: a matrix": layout(matlab_v73, "log(:,1)", "log(:,2)", "log(:,3)", units=UNITS),
    "JSON: a list of rows": layout(json_of(ROWS.tolist()), 1, 2, 3, units=UNITS),
    "JSON: an object of lists": layout(json_of(COLUMNS | {"note": "x"})),
    "JSON: an object of units": layout(
        json_of(
            dict(zip("txf", ROWS.T.tolist(), strict=True))
            | {"units": dict(zip("txf", UNITS.values(), strict=True))}
        ),
        *"txf",
    ),
    "JSON: objects": layout(json_of(FRAME.to_dict("records"))),
    "JSON: pandas' columns beside an object": layout(
        json_of(json.loads(FRAME.to_json()) | {"rig": {"id": 3}})
    ),
    "JSON: rows, units beside them": layout(
        json_of({"data": ROWS.tolist(), "units": list(UNITS.values())}), 1, 2, 3
    ),
    "JSON: rows, names and units in an object of their own": layout(
        json_of({"rig": "two", "run": {"channels": list("txf"), "rows": ROWS.tolist()}}),
        *"txf",
        units=UNITS,
    ),
    "JSON: an object in an object": layout(json_of({"meta": {"fs": 50}, "data": COLUMNS})),
    "JSON: signals with their units": layout(
        json_of(
            {
                name: {"unit": unit, "values": values}
                for name, unit, values in zip("txf", UNITS.values(), ROWS.T.tolist(), strict=True)
            }
        ),
        *"txf",
    ),
    "MATLAB: dSPACE's signals": layout(matlab({"rec": {"X": DSPACE[:1], "Y": DSPACE[1:]}}), *"txf"),
    "UTF-16 without a mark": layout(text(NAMES.replace(",", ";") + lines(";"), "utf-16-le")),
    "UTF-16, the other way round": layout(text(NAMES + lines(), "utf-16-be")),
    "bars": layout(text(NAMES.replace(",", "|") + lines("|"), suffix=".txt")),
    "numbers as NumPy 2 shows them": layout(
        text(NAMES + re.sub(r"([-\d.]+)", r"np.float64(\1)", lines()))
    ),
    "signs apart": layout(text(NAMES + re.sub(r"(?<![\d.])(-?)(\d)", sign_apart, lines()))),
    "a date and a remark": layout(
        text("05.03.2024 10:00\n5 bar\n" + lines(" "), suffix=".txt"), 1, 2, 3, units=UNITS
    ),
    "Excel: numbers as text with commas": layout(
        lambda folder: sheets(
            folder, A=[NAMES[:-1].split(","), *[row.split(";") for row in lines(";", ",").split()]]
        )
    ),
    "JSON: pandas' split": layout(json_of(json.loads(FRAME.to_json(orient="split")))),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read(tmp_path, name):
    write, columns, units = LAYOUTS[name]
    record = mb.read_record(write(tmp_path), columns, units)
    np.testing.assert_allclose(record.time, TIME, atol=1e-8)
    np.testing.assert_allclose(record.displacement * 25.4, TRAVEL, atol=1e-7)
    np.testing.assert_allclose(record.force * 4448.2216152605, FORCE, atol=1e-7)


def test_a_layout_that_tells_too_little_says_what_to_write(tmp_path):
    for content, columns, named in (
        (lines(), {}, "column = 1"),
        ("time_s,displacement_mm,time_s,force_N\n" + lines(columns=(0, 1, 0, 2)), {}, "column = 1"),
        (lines(), dict(zip(UNITS, (1, 2, 4), strict=True)), "column 4"),
    ):
        with pytest.raises(mb.MfdError, match=named):
            mb.read_record(put(tmp_path, content), columns)


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
def test_numbers_of_text_come_back_to_the_last_bit(
    tmp_path, values, separator, end, encoding, heading, note
):
    suffix = f"{separator}note" if note else ""
    rows = [f"{a!r}{separator}{b!r}{suffix}" for a, b in values]
    content = heading + "\n".join([f"Zeit°{separator}Kraft{suffix}", *rows]) + "\n"
    path = put(tmp_path, content.replace("\n", end).encode(encoding), "a.txt")
    columns = read_table(path).columns(["Zeit°", "Kraft"])
    np.testing.assert_array_equal(np.column_stack([columns["Zeit°"], columns["Kraft"]]), values)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("a,note\n1,first\n2,\n", {"a": [1, 2]}),
        ("a;b\n0,5;\N{MINUS SIGN}3,1\n0,25;2\n", {"a": [0.5, 0.25], "b": [-3.1, 2]}),
        ('a,b\n"0,5","-3,1"\n"0,25","2"\n', {"a": [0.5, 0.25], "b": [-3.1, 2]}),
        ("a  b\n0,5  -3,1\n0,25  2\n", {"a": [0.5, 0.25], "b": [-3.1, 2]}),
        ("a\tb\t\n0,125\t12,500\t\n2,250\t3\t\n", {"b": [12.5, 3]}),
        ("a,b\n1D-02,2d3\n1e4294967290,1\n", {"b": [2000, 1]}),
        ("Station,MTS\nRate,1024\nGain,Zero\n1.5,2\nt,F\n0,1\n1,2\n2,3\n", {"F": [1, 2, 3]}),
        ("Lehigh,hall B,N\nt,F,N\n0,1,2\n", {"t": [0], "F": [1], "N": [2]}),
    ],
)
def test_numbers_of_other_countries_and_programs_are_read(tmp_path, content, expected):
    columns = read_table(put(tmp_path, content)).columns(list(expected))
    for name, values in expected.items():
        np.testing.assert_allclose(columns[name], values, rtol=1e-15)


# --- what cannot be read

LONG = 2**17
TEXTS = {
    "text": ("# note\na,b\n1,2\n\n3,oops\n4,5\n", "ab", ["line 5", "'b'", "'oops'"]),
    "an underscore": ("a,b\n1,2\n1_0,3\n", "a", ["line 3", "'1_0'"]),
    "a short line": ("a,b\n1,2\n3\n", "b", ["line 3", "'b'"]),
    "a long line": ("a,b\n1,2\n3,4,5\n", "a", ["line 3", "line 1"]),
    "an open quotation": ('a,b\n0,"1\n1,2\n', "a", ["line 2", "quotation mark"]),
    "no such column": ("time_s,b\n0,1\n", "a", ["'a'", "time_s, b"]),
    "a name twice": ("a,a\n1,2\n", "a", ["{ column = 1 } or { column = 2 }"]),
    "no names": ("1,2\n3,4\n", "a", ["{ column = 1 }"]),
    "names alone": ("a,b\n", "a", ["no data"]),
    "bytes": (bytes(range(256)), "a", ["UTF-8"]),
    "thousands": ('a,b\n1,"1,234.5"\n2,"1,234"\n', "b", ["'1,234'", "thousands"]),
    "a comma for both": ("a\tb\n1,125\t12,500\n2,250\t3\n", "b", ["'1,125'"]),
    "points and commas": ("a;b\n1;2\n0,125;1.5\n", "ab", ["line 3", "points and commas"]),
    "thousands and decimals": ("a;b\n0,5;1\n0,25;1.234,5\n", "ab", ["line 3", "'1.234,5'"]),
    "a line for a book": ("a,b\n1,2\n#" + "x" * LONG + "\n", "a", ["line 3"]),
    "a name for a book": ("time_s," + "a_per_" * 900 + "\n1,2\n", "a", ["column 2"]),
    "too many columns": ("c," * 1000 + "c\n" + "1," * 1000 + "1\n", "a", ["1,001 columns"]),
    "an overflow": ("a,b\n1,2\n3,OL\n", "ab", ["'OL', an overflow"]),
    "thousands between tabs": (
        "a\tb\n0,5\t1 234,5\n0,7\t7 586,5\n",
        "ab",
        ["'1 234,5'", "thousands"],
    ),
    "narrow thousands": ("a\tb\n0,5\t1\n0,7\t7\u202f586,5\n", "ab", ["line 3", "thousands"]),
    "blank lines": ("a,b\n1,2" + "\n" * 10_000_001, "a", ["10,000,00", "lines"]),
    "lines of commas": ("a,b\n" + ("," * 999 + "\n") * 300 + "1,2\n", "ab", ["separators alone"]),
    "below units": ("T\tF\nSec\tkN\n0\t1\n0.1\tOVR\n", "TF", ["line 4", "'F'", "'OVR'"]),
}
JSONS = {
    "cut": ("{", "a", ["JSON"]),
    "a number": ("3", "a", ["object of lists"]),
    "no columns": ("{}", "a", ["no columns"]),
    "text": ('{"a": [1, "x"]}', "a", ["sample 2", "'x'"]),
    "NaN": ('{"a": [1, NaN]}', "a", ["sample 2"]),
    "too large": ('{"a": [1, 1' + "0" * 400 + "]}", "a", ["sample 2"]),
    "other rows": ('{"a": {"0": 1}, "b": {"1": 1}}', "ab", ["'b'"]),
    "other lengths": ('{"a": [1, 2], "b": [1]}', "ab", ["a 2, b 1"]),
}
SHORT = [list(row) for row in ROWS[:30, [0, 2]].tolist()]
ENTRIES = [(n, ".csv", *case) for n, case in TEXTS.items()]
ENTRIES += [(n, ".json", *case) for n, case in JSONS.items()]


@pytest.mark.parametrize(("name", "suffix", "content", "columns", "named"), ENTRIES)
def test_what_cannot_be_read_is_named_with_its_place(
    tmp_path, name, suffix, content, columns, named
):
    message = refusal(put(tmp_path, content, f"a{suffix}"), list(columns))
    assert [words for words in named if words not in message] == [], message


def test_files_that_are_none_or_cut_off_are_refused_and_nothing_is_unpickled(tmp_path):
    assert "'.pkl'" in refusal(put(tmp_path, pickle.dumps({"a": [1]}), "a.pkl"))
    book = sheets(tmp_path, Data=[["t", "x"], *SHORT]).read_bytes()
    file = matlab({"x": TIME, "y": TIME})(tmp_path).read_bytes()
    for name, intact, words in (("a.xlsx", book, "Excel"), ("a.mat", file, "")):
        for content in (b"PK none" * 90, intact[: len(intact) // 10], intact[: len(intact) // 2]):
            assert words in refusal(put(tmp_path, content, name))
        (tmp_path / name).unlink()
    locked = bytes.fromhex("D0CF11E0A1B11AE1") + bytes(600)
    assert "password" in refusal(put(tmp_path, locked, "b.xlsx"))
    assert "sample 2" in refusal(matlab({"a": np.array([1.0, np.nan, 2.0])})(tmp_path))
    (tmp_path / "a.mat").unlink()
    for suffix in SUFFIXES:
        path = tmp_path / f"a{suffix}"
        refusal(path)
        for content in (b"", bytes(range(256))):
            path.write_bytes(content)
            refusal(path)
        path.unlink()
        path.mkdir()
        refusal(path)


def test_a_small_file_that_declares_much_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("force", (1_250_000_000,), "f8")  # 10 GB
    assert "needs more than 2 GB" in refusal(tmp_path / "a.mat", ["force"])
    for content, words in (
        ("[" + "[]," * 2_000_000 + "[]]", "1,000,000 lists"),
        (json.dumps([{f"c{i}": i} for i in range(200_000)]), "200,000 columns"),
    ):
        assert words in refusal(put(tmp_path, content, "a.json"))


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert "needs openpyxl" in refusal(put(tmp_path, b"any", "a.xlsx"))


# --- Excel


def test_of_sheets_the_one_with_a_table_is_read_and_a_copy_is_named(tmp_path):
    table = [["Time", None, "Force\n(kN)", "note"], ["Sec", None, "[kN]", "-"]]
    table += [[t, None, f, "x"] for t, f in SHORT]
    heading = [["Brake 7, spring"], ["Rate (Hz)", 1024], [None]]
    notes = [["Report", 2023], ["by", "me"]]
    read = read_table(sheets(tmp_path, Notes=notes, Plot=[], Data=heading + table, Copy=table))
    assert read.names == ("Time", "Force (kN)", "note")
    assert dict(read.units) == {"Time": "Sec", "Force (kN)": "kN"}
    np.testing.assert_allclose(read.columns(["Force (kN)"])["Force (kN)"], FORCE[:30], rtol=1e-15)
    assert read.place(0) == "row 6 of sheet 'Data'"
    assert "'Copy'" in read.doubts[0]
    assert "'Notes'" in refusal(sheets(tmp_path, Notes=notes, Plot=[]))


def test_a_cell_without_a_number_is_named_by_its_row_and_column(tmp_path):
    for cell, expected in (
        (None, "an empty cell"),
        ("#DIV/0!", "'#DIV/0!'"),
        (True, "'TRUE'"),
        (datetime.datetime(2024, 5, 1, 10, 30), "'2024-05-01 10:30:00'"),
        ("=A3*2", "formula"),
    ):
        rows = [["t", None, "x"], [0, None, 1], [1, None, cell], [2, None, 3]]
        path = sheets(tmp_path, Data=rows)
        message = refusal(path, ["t", "x"])
        assert message.startswith(f"row 3 of sheet 'Data' of {path}, column 'x'")
        assert expected in message


# --- TDMS


def test_the_increments_of_waveforms_make_a_time_for_each_group(tmp_path):
    table = read_table(tdms(("G", "x", FORCE, WAVE), ("G", "F", FORCE, WAVE), repeats=2)(tmp_path))
    assert table.names == ("time", "x", "F")
    np.testing.assert_allclose(table.columns(["time", "x"])["time"], np.arange(800) / 50)
    slow = WAVE | {"wf_increment": 0.1, "wf_start_offset": 0.5}
    table = read_table(tdms(("A", "x", FORCE, WAVE), ("B", "F", FORCE, slow))(tmp_path))
    assert table.names == ("A/time", "B/time", "x", "F")
    np.testing.assert_allclose(table.columns(["B/time"])["B/time"], 0.5 + np.arange(400) / 10)


def test_no_time_is_offered_where_there_is_one_or_none_can_be_made(tmp_path):
    for channels in (
        [("G", "Elapsed Time", TIME, {}), ("G", "x", FORCE, WAVE)],
        [("G", "x", FORCE, WAVE | {"wf_increment": 0.0}), ("G", "F", FORCE, {})],
        [("G", "x", FORCE, WAVE | {"wf_xunit_string": "Hz"}), ("G", "F", FORCE, {})],
        [("G", "x", FORCE, WAVE), ("G", "F", FORCE, WAVE | {"wf_increment": 0.1})],
    ):
        assert read_table(tdms(*channels)(tmp_path)).names == tuple(c[1] for c in channels)


def test_channels_without_numbers_or_of_other_lengths_are_refused_when_used(tmp_path):
    write = tdms(("G", "x", TIME), ("G", "note", ["a", "b"]), ("G", "b", TIME[:9]))
    np.testing.assert_array_equal(read_table(write(tmp_path)).columns(["x"])["x"], TIME)
    assert "'note'" in refusal(write(tmp_path), ["note"])
    assert "x 400, b 9" in refusal(write(tmp_path), ["x", "b"])


def tdms_part(samples, data=b"", *, follows=None):
    """Part of a file with a channel x of so many doubles, and other data than these."""
    listed = struct.pack("<LL", 1, 8) + b"/'G'/'x'"
    listed += struct.pack("<LLLQL", 20, 10, 1, samples, 0)
    offset = len(listed) + len(data) if follows is None else follows
    return struct.pack("<4sLLQQ", b"TDSm", 14, 4713, offset, len(listed)) + listed + data


TEN = np.arange(10.0).tobytes()


def test_a_file_that_is_cut_off_or_declares_what_it_has_not_is_refused(tmp_path, capfd):
    path = tdms(("G", "x", TIME))(tmp_path)
    assert "holds 390" in refusal(put(tmp_path, path.read_bytes()[:-80], "a.tdms"), ["x"])
    content = tdms_part(2**63, TEN, follows=2**64 - 1)
    assert "holds 10" in refusal(put(tmp_path, content, "a.tdms"), ["x"])
    unclosed = put(tmp_path, tdms_part(5, TEN, follows=2**64 - 1), "a.tdms")  # never closed
    np.testing.assert_array_equal(read_table(unclosed).columns(["x"])["x"], np.arange(10))
    for content in (b"hello world" * 9, b"TDSm" + bytes(90), b"TDSh" + bytes(90)):
        assert "TDMS" in refusal(put(tmp_path, content, "a.tdms"))
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({"operator": "x"})])
    assert "no channel" in refusal(path)
    assert capfd.readouterr().err == ""


def test_the_file_itself_is_read_and_not_an_index_beside_it(tmp_path):
    decoy = tdms(("G", "y", FORCE))(tmp_path).read_bytes()
    path = tdms(("G", "x", TIME))(tmp_path)
    path.with_name("a.tdms_index").write_bytes(b"TDSh" + decoy[4:])
    assert read_table(path).names == ("x",)


# --- all formats


@pytest.mark.skipif(sys.platform != "linux", reason="a process is copied as on Linux")
def test_binary_files_are_read_beside_threads_in_a_process_that_may_die(tmp_path, monkeypatch):
    path, stop = matlab({"t_s": TIME, "x_mm": TRAVEL})(tmp_path), threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    np.testing.assert_array_equal(read_table(path).columns(["x_mm"])["x_mm"], TRAVEL)
    stop.set()
    thread.join()
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: os.kill(os.getpid(), signal.SIGSEGV))
    refusal(path)
