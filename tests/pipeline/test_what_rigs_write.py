"""What rigs and loggers write: rates, time stamps, signs and units of actuation."""

import os
import re
import signal
import sys
import time
from datetime import datetime, timedelta

import numpy as np
import pandas as pd
import pytest
from openpyxl import Workbook
from scipy.io import savemat
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.records.channels import Source

STEP, STROKE, SLIP = 0.05, 12.0, 950.0  # s, mm, N


def loops(samples=240):
    """Displacement, mm, and force, N, of a friction damper at 0.25 Hz."""
    time = STEP * np.arange(samples)
    phase = 2 * np.pi * 0.25 * time
    return time, STROKE * np.sin(phase), SLIP * np.tanh(6 * np.cos(phase) + 2 * np.sin(phase))


def write(path, head, columns, above=""):
    rows = [",".join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
    path.write_text(above + head + "\n" + "\n".join(rows) + "\n")


def command(name, path, *words, code=0):
    if name == "inspect":
        words = (*words, "-o", path.parent, "--force")
    words = (name, path, *words)
    outcome = CliRunner().invoke(app, [str(word) for word in words])
    assert outcome.exit_code == code, outcome.output
    return " ".join(outcome.output.split())


def drafted(folder):
    """Words of `init`, the campaign's text, and those of `inspect`."""
    said = command("init", folder)
    return (
        said,
        (folder / "campaign.toml").read_text(),
        command("inspect", folder / "campaign.toml"),
    )


# A rate in place of a column of times


@pytest.mark.parametrize(
    ("above", "rate"),
    [
        ("Sample rate: 20 Hz\n", "20 Hz"),
        ("Sampling interval: 0,05 s\n", "0.05 s"),
        ("sample_rate_hz,20\n", "20 Hz"),
        ("Scan rate: 0.02 kHz per channel\n", "0.02 kHz"),
        ("Acquired 2024, at 20 Hz\nSampling Frequency, Hz: 20\n", "20 Hz"),
    ],
)
def test_init_drafts_the_rate_that_a_file_states(tmp_path, above, rate):
    _, *columns = loops()
    write(tmp_path / "a_5bar.csv", "Displacement (mm),Force (N)", columns, above)
    said, text, seen = drafted(tmp_path)
    assert f'time = {{ rate = "{rate}" }}' in text
    assert "FIXME" not in said
    assert "240 over 11.95 s" in seen
    assert "rate 20 Hz" in seen


@pytest.mark.parametrize(
    "above",
    ["Test frequency: 20 Hz\n", "fs = 20\nSample rate: 30 Hz\n"],
)
def test_a_rate_that_is_not_stated_is_asked_for(tmp_path, above):
    _, *columns = loops()
    write(tmp_path / "a_5bar.csv", "Displacement (mm),Force (N)", columns, above)
    said = command("init", tmp_path)
    assert "FIXME: columns: the unit of time is unknown; the file has none" in said
    assert 'give its rate: rate = "100 Hz"' in command(
        "inspect", tmp_path / "campaign.toml", code=2
    )


CAMPAIGN = """[columns]
{columns}
displacement = {{ name = "Displacement (mm)" }}
force = {{ name = "Force (N)" }}
[[test]]
id = "a"
file = "a.csv"
actuation = "5 bar"
{test}
"""


@pytest.mark.parametrize(
    ("columns", "test"),
    [
        ('rate = "20 Hz"', ""),
        ('time = { rate = "50 ms" }', ""),
        ('time = { name = "Time (s)" }', 'rate = "20 Hz"'),
        ('rate = "5 Hz"', 'columns.rate = "20 Hz"'),
    ],
)
def test_a_rate_is_given_for_all_tests_or_for_one(tmp_path, columns, test):
    write(tmp_path / "a.csv", "Displacement (mm),Force (N)", loops()[1:])
    (tmp_path / "c.toml").write_text(CAMPAIGN.format(columns=columns, test=test))
    assert "240 over 11.95 s" in command("inspect", tmp_path / "c.toml")


# The sign of a column


def test_init_turns_the_force_where_loops_run_backward_and_says_so(tmp_path):
    time, x, force = loops()
    write(tmp_path / "a_5bar.csv", "Time (s),Displacement (mm),Force (N)", [time, x, -force])
    said, text, seen = drafted(tmp_path)
    assert "loops run backward" in said
    assert 'force = { name = "Force (N)", unit = "N", sign = -1 }' in text
    assert "force sign" not in seen
    assert re.search(r"energy per cycle \d", seen)


def test_only_the_tests_that_run_backward_are_turned(tmp_path):
    time, x, force = loops()
    for name, sign in (("a_5bar", 1), ("b_5bar", 1), ("c_9bar", -1)):
        columns = [time, x, sign * force]
        write(tmp_path / f"{name}.csv", "Time (s),Displacement (mm),Force (N)", columns)
    said, text, seen = drafted(tmp_path)
    assert "unsure: c_9bar: its loops run backward" in said
    assert text.count("sign = -1 }") == 1
    assert 'columns.force = { name = "Force (N)", unit = "N", sign = -1 }' in text
    assert "force sign" not in seen


def test_an_overflow_value_turns_no_sign(tmp_path):
    time, x, force = loops()
    force[41] = -1e6
    write(tmp_path / "a_5bar.csv", "Time (s),Displacement (mm),Force (N)", [time, x, force])
    said, text, seen = drafted(tmp_path)
    assert "sign" not in said + text
    assert "force sign" not in seen
    assert "spikes: 1 isolated sample of the force" in seen


def test_the_warning_of_negative_work_names_the_key(tmp_path):
    time, x, force = loops()
    write(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N)", [time, x, -force])
    campaign = tmp_path / "c.toml"
    time_column = 'time = { name = "Time (s)" }'
    campaign.write_text(CAMPAIGN.format(columns=time_column, test=""))
    assert "write sign = -1 for one of them in [columns]" in command("inspect", campaign)
    turned = campaign.read_text().replace('"Displacement (mm)"', '"Displacement (mm)", sign = -1')
    campaign.write_text(turned)
    assert "force sign" not in command("inspect", campaign)
    campaign.write_text(turned.replace("sign = -1", "sign = 2"))
    assert "sign in" in command("inspect", campaign, code=2)


# Actuation in any unit


ACTUATED = """[campaign]
model = "lugre"
[columns]
time = {{ name = "t_s" }}
displacement = {{ name = "x_mm" }}
force = {{ name = "f_N" }}
"""
TEST = '[[test]]\nid = "{0}"\nfile = "{0}.csv"\nactuation = {1}\n'


def actuated(folder, *levels):
    """A campaign whose tests have these actuations."""
    time, x, force = loops()
    text = ACTUATED.format()
    for number, level in enumerate(levels):
        size = float(re.sub(r"[^\d.]", "", level)) if level[0] == '"' else 1.0
        noise = np.random.default_rng(number).normal(0.0, 6.0, time.size)
        columns = [time, x, force * size + noise, np.full(time.size, 1.5)]
        write(folder / f"r{number}.csv", "t_s,x_mm,f_N,drive_A", columns)
        text += TEST.format(f"r{number}", level)
    (folder / "c.toml").write_text(text)
    return folder / "c.toml"


@pytest.mark.parametrize(
    ("level", "shown"),
    [
        ("1 A", "1 A"),
        ("500 mA", "500 mA"),
        ("3 turns", "3 turns"),
        ("40 %", "40 %"),
        ("120 N*m", "120 N*m"),
        ("0.2 T", "0.2 T"),
    ],
)
def test_an_actuation_is_said_in_its_own_unit(tmp_path, level, shown):
    assert f" actuation {shown} " in command("inspect", actuated(tmp_path, f'"{level}"'))


@pytest.mark.parametrize("level", ["3 mm", "20 degC", "7 bananas"])
def test_a_unit_of_no_actuation_is_refused(tmp_path, level):
    said = command("inspect", actuated(tmp_path, f'"{level}"'), code=2)
    assert f"unit '{level.split()[1]}' of '{level}'" in said


def test_actuations_of_one_kind_may_differ_in_unit_and_others_are_refused(tmp_path):
    said = command("inspect", actuated(tmp_path, '"500 mA"', '"1 A"'))
    assert " actuation 0.5 A " in said
    assert " actuation 1 A " in said
    said = command("inspect", actuated(tmp_path, '"1 A"', '"1 V"'), code=2)
    assert "that of test 'r1' is in V or a multiple of it" in said
    said = command("inspect", actuated(tmp_path, '"1 A"', '"5 bar"'), code=2)
    assert "that of test 'r1' is a pressure" in said


@pytest.mark.parametrize(
    ("name", "above", "level", "doubt"),
    [
        ("run_0.5A", "", "0.5 A", ""),
        ("run_250mA", "", "250 mA", ""),
        ("run_2A", "", "2 A", "2A is taken for A"),
        ("run_12volts", "", "12 V", ""),
        ("run", "Coil current: 0.75 A\n", "0.75 A", ""),
        ("run_2turns", "", "2 turns", ""),
        ("run_500psi_2A", "", "500 psi", ""),
    ],
)
def test_init_drafts_the_current_of_a_test(tmp_path, name, above, level, doubt):
    write(tmp_path / f"{name}.csv", "Time (s),Displacement (mm),Force (N)", loops(), above)
    said, text, _ = drafted(tmp_path)
    assert f'actuation = "{level}"' in text
    assert (doubt in said) if doubt else ("unsure" not in said)


@pytest.mark.slow
def test_laws_tables_and_questions_are_in_the_unit_of_the_actuation(tmp_path):
    campaign = actuated(tmp_path, '"500 mA"', '"1000 mA"')
    command("init", campaign)
    campaign.write_text(
        campaign.read_text().replace("[campaign]", '[campaign]\npriors = "priors.toml"')
    )
    out = tmp_path / "out"
    command("calibrate", campaign, "-o", out, "--effort", "quick", "--jobs", 1, "--seed", 1)
    laws = (out / "laws.csv").read_text()
    assert re.search(r"K_c_fwd,k?N/mA,", laws)
    assert re.search(r"alpha_sigma0,k?N/mm/mA,", laws)
    asked = ("--sine", "12 mm, 0.25 Hz, 2 cycles", "--force", "-o", tmp_path / "b.csv")
    command("predict", out, *asked, "--actuation", "0.8 A")
    assert "must be in A or a multiple of it" in command(
        "predict", out, *asked, "--actuation", "500 psi", code=2
    )
    assert "mA, 0.25 Hz" in command("next", out, "-o", tmp_path / "n.csv")


# Time stamps


BEGIN = datetime(2024, 3, 5, 10, 0, 0)
NIGHT = datetime(2024, 3, 5, 23, 59, 55)


def stamps(form, begin=BEGIN, samples=240):
    """Time stamps of a test, of a form of strftime in which %L stands for milliseconds."""
    moments = [begin + timedelta(seconds=STEP * k) for k in range(samples)]
    return [m.strftime(form.replace("%L", f"{m.microsecond // 1000:03}")) for m in moments]


def no_zeros(stamp):
    """A stamp that loses its .000."""
    return stamp.removesuffix(".000")


STAMPS = {
    "ISO with a zone": stamps("%Y-%m-%dT%H:%M:%S.%L+01:00"),
    "ISO that loses its .000": [no_zeros(s) for s in stamps("%Y-%m-%d %H:%M:%S.%L")],
    "US at noon": stamps("%m/%d/%Y %I:%M:%S.%L %p", datetime(2024, 3, 5, 11, 59, 55)),
    "US without zeros": [s.lstrip("0").replace("/0", "/") for s in stamps("%m/%d/%Y %H:%M:%S.%L")],
    "US past midnight, told by the day": stamps(
        "%m/%d/%Y %I:%M:%S.%L %p", datetime(2024, 3, 25, 23, 59, 55)
    ),
    "US past midnight, told by the steps": stamps("%m/%d/%Y %H:%M:%S.%L", NIGHT),
    "German past midnight": stamps("%d.%m.%Y %H:%M:%S.%L", NIGHT),
    "past midnight at the end of a month": stamps(
        "%d/%m/%Y %H:%M:%S.%L", datetime(2024, 2, 29, 23, 59, 55)
    ),
    "MATLAB": stamps("%d-%b-%Y %H:%M:%S.%L"),
    "clock past midnight": stamps("%H:%M:%S.%L", NIGHT),
    "clock of twelve hours": stamps("%I:%M:%S.%L %p", datetime(2024, 3, 5, 11, 59, 55)),
    "milliseconds behind a colon": stamps("%H:%M:%S:%L"),
    "as ctime": stamps("%a %b %d %H:%M:%S.%L %Y"),
    "timedelta of pandas": [f"0 days {s}" for s in stamps("%H:%M:%S.%L000")],
}


@pytest.mark.parametrize("form", STAMPS)
def test_time_stamps_are_seconds_since_the_first_row(tmp_path, form):
    time, *columns = loops()
    write(
        tmp_path / "a_5bar.csv", "Timestamp,Displacement (mm),Force (N)", [STAMPS[form], *columns]
    )
    said, text, seen = drafted(tmp_path)
    assert 'time = { name = "Timestamp", unit = "s" }' in text
    assert "FIXME" not in said
    assert "240 over 11.95 s" in seen
    roles = {"time": "Timestamp", "displacement": 2, "force": 3}
    record = mb.read_record(tmp_path / "a_5bar.csv", roles, fit="2 s to 8 s")
    np.testing.assert_allclose(record.time, time, atol=1e-9)
    assert record.trace().time[[0, -1]] == pytest.approx([2.0, 8.0])


def test_a_date_a_clock_and_a_counter_beside_each_other(tmp_path):
    _, *columns = loops()
    clock = stamps("%H:%M:%S.%L", NIGHT)
    day = stamps("%d.%m.%Y", NIGHT)
    head = "No.,Date,Time,Displacement (mm),Force (N),Events"
    write(tmp_path / "a_5bar.csv", head, [range(240), day, clock, *columns, [""] * 240])
    _said, text, seen = drafted(tmp_path)
    assert 'time = { name = "Time", unit = "s" }' in text
    assert "240 over 11.95 s" in seen


def test_an_order_of_dates_that_nothing_tells_is_asked_for(tmp_path):
    _time, *columns = loops()
    moments = [
        datetime(2024, 3, 5) + timedelta(days=k // 120, seconds=STEP * k) for k in range(240)
    ]
    text = [m.strftime("%m/%d/%Y %H:%M:%S.%f") for m in moments]
    write(tmp_path / "a.csv", "Timestamp,x_mm,f_N", [text, *columns])
    roles = {"displacement": "x_mm", "force": "f_N"}
    with pytest.raises(mb.MfdError, match='write dates = "day first" or dates = "month first"'):
        mb.read_record(tmp_path / "a.csv", {"time": "Timestamp", **roles})
    given = {"time": Source("Timestamp", dates="month first"), **roles}
    assert mb.read_record(tmp_path / "a.csv", given).gap.startswith("time has a gap")
    stated = 'time = { name = "Timestamp", dates = "month first" }'
    text = CAMPAIGN.format(columns=stated, test="")
    (tmp_path / "c.toml").write_text(
        text.replace("Displacement (mm)", "x_mm").replace("Force (N)", "f_N")
    )
    assert "time has a gap" in command("inspect", tmp_path / "c.toml")


@pytest.mark.parametrize("cell", ["", "25:61:00"])
def test_a_cell_that_is_no_stamp_is_named_or_left_out(tmp_path, cell):
    _, *columns = loops()
    clock = stamps("%H:%M:%S.%L")
    clock[200] = cell
    write(tmp_path / "a.csv", "Timestamp,x_mm,f_N", [clock, *columns])
    roles = {"time": "Timestamp", "displacement": "x_mm", "force": "f_N"}
    with pytest.raises(mb.MfdError, match=r"line 202 of .*, column 'Timestamp'"):
        mb.read_record(tmp_path / "a.csv", roles)
    assert mb.read_record(tmp_path / "a.csv", roles, fit="0 s to 8 s").time.size == 200


@pytest.mark.parametrize("kind", ["moments", "clock"])
def test_dates_of_a_workbook_are_a_time(tmp_path, kind):
    time, x, force = loops()
    moments = [BEGIN + timedelta(seconds=float(t)) for t in time]
    cells = {
        "moments": moments,
        "clock": [m.time() for m in moments],
    }[kind]
    book = Workbook()
    book.active.append(["Time", "Displacement (mm)", "Force (N)"])
    for row in zip(cells, x.tolist(), force.tolist(), strict=True):
        book.active.append(list(row))
    book.save(tmp_path / "a_5bar.xlsx")
    _said, text, seen = drafted(tmp_path)
    assert 'time = { name = "Time", unit = "s" }' in text
    assert "240 over 11.95 s" in seen


@pytest.mark.parametrize(
    ("unit", "first", "by"),
    [
        ("day", 45356.4166666667, 1 / 86400),
        ("s", 3792477600.0, 1.0),
        ("ms", 1709632800000.0, 1e3),
    ],
    ids=["Excel", "LabVIEW", "ms"],
)
def test_a_time_that_counts_from_a_date_is_since_the_first_row(tmp_path, unit, first, by):
    time, *columns = loops()
    cells = [f"{first + t * by:.10f}" for t in time]
    write(tmp_path / "a_5bar.csv", "X_Value,Displacement (mm),Force (N)", [cells, *columns])
    said, text, seen = drafted(tmp_path)
    assert f'unit = "{unit}" }}  # unsure' in text
    assert f"it looks like a date, counted in {unit}" in said
    assert "240 over 11.95 s" in seen
    roles = {"time": Source("X_Value", unit), "displacement": 2, "force": 3}
    record = mb.read_record(tmp_path / "a_5bar.csv", roles, fit="0 s to 8 s")
    np.testing.assert_allclose(record.time, time, atol=2e-5)


# Cells outside the window


@pytest.mark.parametrize("window", ["0 s to 8 s", "0 s to 11 s"])
@pytest.mark.parametrize("form", ["csv", "xlsx", "mat"])
def test_bad_cells_outside_the_window_are_left_out_of_every_format(tmp_path, form, window):
    table = dict(zip(["t_s", "x_mm", "f_N"], loops(), strict=True))
    table["f_N"][200] = np.nan  # at 10 s
    path = tmp_path / f"a.{form}"
    if form == "csv":
        write(path, ",".join(table), table.values())
    elif form == "xlsx":
        pd.DataFrame(table).to_excel(path, index=False)
    else:
        savemat(path, table)
    units = {"time": "s", "displacement": "mm", "force": "N"}
    roles = {"time": "t_s", "displacement": "x_mm", "force": "f_N"}
    if window == "0 s to 8 s":
        record = mb.read_record(path, roles, units, fit=window)
        assert record.time.size == 200
        assert "lie outside the window fit" in record.doubts[0]
    else:
        with pytest.raises(mb.MfdError, match="column 'f_N': expected a finite number"):
            mb.read_record(path, roles, units, fit=window)


# Names as other keyboards and MATLAB write them


def test_wide_brackets_and_unit_signs_are_read(tmp_path):
    write(tmp_path / "a_5bar.csv", "時間［s］,変位［㎜］,荷重［N］", loops())
    path = tmp_path / "a_5bar.csv"
    path.write_bytes(path.read_text(encoding="utf-8").encode("cp932"))
    said, _, seen = drafted(tmp_path)
    assert "FIXME" not in said
    assert "displacement -12 to 12 mm" in seen


def test_a_column_of_a_matrix_has_no_unit_in_its_name(tmp_path):
    time, x, force = loops()
    savemat(tmp_path / "a_5bar.mat", {"t_s": time, "data": np.column_stack([x, force])})
    command("init", tmp_path)
    said = command("inspect", tmp_path / "campaign.toml", code=2)
    assert "has no unit in its name; give the unit of displacement" in said


# Binary files are read in another process


@pytest.mark.skipif(sys.platform != "linux", reason="a process is copied as on Linux")
def test_a_reader_that_dies_or_never_ends_is_a_sentence(tmp_path, monkeypatch):
    path = tmp_path / "a.mat"
    savemat(path, dict(zip(["t_s", "x_mm", "f_N"], loops(), strict=True)))
    roles = {"time": "t_s", "displacement": "x_mm", "force": "f_N"}
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: os.kill(os.getpid(), signal.SIGSEGV))
    with pytest.raises(mb.MfdError, match=r"a\.mat is not a MATLAB file, v5 or v7\.3, that can be"):
        mb.read_record(path, roles)
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: time.sleep(60))
    monkeypatch.setattr("mfd_bayes.records.readers.child.SECONDS", 0.2)
    with pytest.raises(mb.MfdError, match=r"a\.mat takes more than 0\.2 s to read"):
        mb.read_record(path, roles)
