"""Layouts that loggers, controllers and spreadsheets write: each is read, or refused with what to
write in the campaign instead. Each file is made by its format's own library."""

import csv
import json
from collections.abc import Callable
from typing import NamedTuple

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat

from mfd_bayes.errors import MfdError
from mfd_bayes.records.record import read_record

TIME = np.arange(400) / 50.0  # s
TRAVEL = 20.0 * np.sin(np.pi * TIME)  # mm
FORCE = 7.0 * np.tanh(3.0 * np.cos(np.pi * TIME)) + 0.25 * np.sin(31.0 * TIME)  # N
ROWS = np.column_stack([TIME, TRAVEL, FORCE])
UNITS = {"time": "s", "displacement": "mm", "force": "N"}
NUMBERS = {"time": 1, "displacement": 2, "force": 3}


def lines(separator=",", decimal=".", rows=ROWS):
    text = "\n".join(separator.join(f"{cell:.9f}" for cell in row) for row in rows) + "\n"
    return text.replace(".", decimal)


def text(content, encoding="utf-8", suffix=".txt"):
    def write(folder):
        path = folder / f"a{suffix}"
        path.write_text(content, encoding=encoding)
        return path

    return write


def quoted(folder):
    with (folder / "a.csv").open("w", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerow(["Time (s)", "Load, axial (N)", "Stroke (mm)"])
        writer.writerows(ROWS[:, [0, 2, 1]].tolist())
    return folder / "a.csv"


def indexed(folder):
    frame = pd.DataFrame(ROWS, columns=["time_s", "displacement_mm", "force_N"])
    frame.to_csv(folder / "a.csv")
    return folder / "a.csv"


def workbook(*above, rows=ROWS, merged=(), first=1):
    def write(folder):
        book = Workbook()
        sheet = book.active
        for line in (*above, *rows.tolist()):
            sheet.append([None] * (first - 1) + list(line))
        for cells in merged:
            sheet.merge_cells(cells)
        book.save(folder / "a.xlsx")
        return folder / "a.xlsx"

    return write


def tdms(*channels):
    def write(folder):
        with TdmsWriter(folder / "a.tdms") as writer:
            writer.write_segment([ChannelObject(*channel) for channel in channels])
        return folder / "a.tdms"

    return write


WAVE = {"wf_increment": 0.02, "wf_start_offset": 0.0}


def matlab(content):
    def write(folder):
        savemat(folder / "a.mat", content)
        return folder / "a.mat"

    return write


def matlab_v73(folder):
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        file["log"] = ROWS.T  # as MATLAB stores a matrix of a row for each sample
        file["log"].attrs["MATLAB_class"] = np.bytes_("double")
    return folder / "a.mat"


def rows_of_json(folder):
    (folder / "a.json").write_text(json.dumps(ROWS.tolist()))
    return folder / "a.json"


TITLE = "ACME logger 4\nSeal friction, 3 bar\nStarted 12.03.2024 10:04\nChannels as wired\n\n"
MTS = "MTS793|MPT|ENU|1|0|A\nTest 7\nData Acquisition: Timed\t\tTime:\t3.2\tSec\n"
LVM = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n"


class Layout(NamedTuple):
    write: Callable
    columns: dict
    units: dict | None = None


READ = {
    "without a header, commas": Layout(text(lines(), suffix=".csv"), NUMBERS, UNITS),
    "free text, then blanks": Layout(text(TITLE + lines("   ")), NUMBERS, UNITS),
    "free text, tabs, decimal commas": Layout(
        text(TITLE + lines("\t", ","), suffix=".asc"), NUMBERS, UNITS
    ),
    "semicolons, decimal commas, no header": Layout(text(lines(";", ",")), NUMBERS, UNITS),
    "semicolons, decimal commas, names": Layout(
        text("Zeit [s];Weg [mm];Kraft [N]\n" + lines(";", ","), suffix=".csv"),
        {"time": "Zeit [s]", "displacement": "Weg [mm]", "force": "Kraft [N]"},
    ),
    "MTS: units in a row": Layout(
        text(
            MTS + "Time\tAxial Displacement\tAxial Force\nSec\tmm\tN\n" + lines("\t"), suffix=".dat"
        ),
        {"time": "Time", "displacement": "Axial Displacement", "force": "Axial Force"},
    ),
    "two time columns": Layout(
        text(
            "Time (s),Stroke (mm),Time (s),Load (N)\n" + lines(rows=ROWS[:, [0, 1, 0, 2]]),
            suffix=".csv",
        ),
        {"time": 1, "displacement": 2, "force": 4},
    ),
    "names that two columns have": Layout(
        text("t_s,x_mm,x_mm,f_N\n" + lines(rows=ROWS[:, [0, 2, 1, 2]]), suffix=".csv"),
        {"time": "t_s", "displacement": 3, "force": "f_N"},
    ),
    "a byte-order mark": Layout(
        text("time_s,displacement_mm,force_N\n" + lines(), "utf-8-sig", ".csv"), {}
    ),
    "UTF-16": Layout(text("time_s\tdisplacement_mm\tforce_N\n" + lines("\t"), "utf-16"), {}),
    "Windows-1252": Layout(
        text(
            "time_s;displacement_mm;force_N;Temp [°C]\n" + lines(";", rows=ROWS[:, [0, 1, 2, 2]]),
            "cp1252",
            ".csv",
        ),
        {},
    ),
    "text below the numbers": Layout(
        text("time_s,displacement_mm,force_N\n" + lines() + "\nEnd of test\n", suffix=".csv"), {}
    ),
    "quoted cells with commas in names": Layout(
        quoted, {"time": "Time (s)", "displacement": "Stroke (mm)", "force": "Load, axial (N)"}
    ),
    "pandas' index without a name": Layout(indexed, {}),
    "LabVIEW's .lvm": Layout(
        text(LVM + "X_Value\tStroke\tLoad\tComment\n" + lines("\t"), suffix=".lvm"),
        {"time": "X_Value", "displacement": "Stroke", "force": "Load"},
        UNITS,
    ),
    "Excel with merged headings": Layout(
        workbook(
            ["Seal friction, 3 bar"],
            ["Clock", "Measured", None],
            ["time", "displacement", "force"],
            ["s", "mm", "N"],
            merged=["A1:C1", "B2:C2"],
        ),
        {},
    ),
    "Excel without a header, from column B": Layout(
        workbook(["rig 2"], first=2), {"time": 2, "displacement": 3, "force": 4}, UNITS
    ),
    "TDMS: a time channel in one of two groups": Layout(
        tdms(
            ("Clock", "t", TIME, {"unit_string": "s"}),
            ("Rig", "x", TRAVEL, {"unit_string": "mm"}),
            ("Rig", "f", FORCE, {"unit_string": "N"}),
        ),
        {"time": "t", "displacement": "x", "force": "f"},
    ),
    "TDMS: waveforms of two groups with the same names": Layout(
        tdms(
            ("Displacement", "ai0", TRAVEL, {"unit_string": "mm"} | WAVE),
            ("Force", "ai0", FORCE, {"unit_string": "N"} | WAVE),
        ),
        {"time": "time", "displacement": "Displacement/ai0", "force": "Force/ai0"},
    ),
    "MATLAB: a struct": Layout(
        matlab({"data": {"t": TIME, "x": TRAVEL, "f": FORCE}, "rig": "two"}),
        {"time": "data.t", "displacement": "data.x", "force": "data.f"},
        UNITS,
    ),
    "MATLAB: a matrix": Layout(matlab({"log": ROWS, "rig": "two"}), NUMBERS, UNITS),
    "MATLAB: a matrix of long rows": Layout(
        matlab({"log": ROWS.T}),
        {"time": "log(1,:)", "displacement": "log(2,:)", "force": "log(3,:)"},
        UNITS,
    ),
    "MATLAB 7.3: a matrix": Layout(
        matlab_v73,
        {"time": "log(:,1)", "displacement": "log(:,2)", "force": "log(:,3)"},
        UNITS,
    ),
    "JSON: a list of rows": Layout(rows_of_json, NUMBERS, UNITS),
}


@pytest.mark.parametrize("layout", READ.values(), ids=READ)
def test_a_layout_is_read(tmp_path, layout):
    record = read_record(layout.write(tmp_path), layout.columns, layout.units)
    np.testing.assert_allclose(record.time, TIME, atol=1e-8)
    np.testing.assert_allclose(record.displacement * 25.4, TRAVEL, atol=1e-7)
    np.testing.assert_allclose(record.force * 4448.2216152605, FORCE, atol=1e-7)


REFUSED = {
    "without a header, and no columns said": (
        text(lines()),
        {},
        'say in a campaign which is which, as time = { column = 1, unit = "ms" }',
    ),
    "two time columns, and not said which": (
        text("time_s,displacement_mm,time_s,force_N\n" + lines(rows=ROWS[:, [0, 1, 0, 2]])),
        {},
        "several columns for time, column 1: time_s, column 3: time_s; say which, as "
        "time = { column = 1 }",
    ),
    "a number beyond the last column": (
        text(lines()),
        {"time": 1, "displacement": 2, "force": 4},
        "column 4 of",
    ),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_a_layout_is_refused_with_what_to_write(tmp_path, case):
    write, columns, expected = case
    path = write(tmp_path)
    with pytest.raises(MfdError) as caught:
        read_record(path, columns)
    assert expected in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wrong_number_gives_other_values(tmp_path):
    """The negative control: columns are not found by luck."""
    path = READ["without a header, commas"].write(tmp_path)
    record = read_record(path, {"time": 1, "displacement": 3, "force": 2}, UNITS)
    assert np.max(np.abs(record.displacement * 25.4 - TRAVEL)) > 1.0
