"""No number of a file is lost, or read as another, in silence: what commands say about a folder."""

import json
import tomllib

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app

TIME = np.arange(240) / 20.0
TRAVEL = 12.0 * np.sin(0.5 * np.pi * TIME)


def force(time):
    return 950.0 * np.tanh(3.0 * np.cos(0.5 * np.pi * time)) + 3.0 * np.sin(31.0 * time)


ROWS = np.column_stack([TIME, TRAVEL, force(TIME)])
NAMES = ["Time (s)", "Stroke (mm)", "Load (N)"]
HEAD = ",".join(NAMES) + "\n"


def text(rows, separator=","):
    return "".join(separator.join(f"{cell:.4f}" for cell in row) + "\n" for row in rows)


@pytest.fixture(autouse=True)
def _beside_the_files(tmp_path, monkeypatch):
    """Pictures of `inspect` go to the current folder."""
    monkeypatch.chdir(tmp_path)


def run(*words):
    outcome = CliRunner().invoke(app, [str(word) for word in words])
    assert outcome.exception is None or isinstance(outcome.exception, SystemExit), outcome.exception
    return outcome.exit_code, " ".join(outcome.output.split())


def init(folder):
    """Exit code and words of `init`, and the campaign that it wrote, if any."""
    code, said = run("init", folder, "--force")
    path = folder / "campaign.toml"
    return code, said, tomllib.loads(path.read_text()) if path.exists() else {}


def inspected(folder):
    """What `inspect` says of the campaign that `init` writes."""
    code, said, _ = init(folder)
    assert code == 0, said
    code, said = run("inspect", folder / "campaign.toml")
    assert code == 0, said
    return said


def refusal(folder):
    """Why `init` takes no test from a folder."""
    code, said, _ = init(folder)
    assert code == 2, said
    return said


# --- a heading above every block

MTS = "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\n"
MTS_NAMES, MTS_UNITS = "Time\tAxial Displacement\tAxial Force\n", "Sec\tmm\tN\n"


def mts(*blocks, names=MTS_NAMES, units=MTS_UNITS):
    return MTS + "".join(
        f"Data Header:\tTimed\tCycle 1\tTime:\t{rows[0, 0]:.2f}\tSec\t1/2/2024 10:12:13 AM\n"
        + (names + units + text(rows, "\t"))
        for rows in blocks
    )


def blocks(size):
    return mts(*(ROWS[at : at + size] for at in range(0, 240, size)))


def between(words, at=80):
    return HEAD + text(ROWS[:at]) + words + text(ROWS[at:])


COMMENT = "# time_s,stroke_mm,load_N\n"
ALL = "samples 240 over 11.95 s"
BELOW = "\nMax,12.00,956.1\nMin,-12.00,-957.2\nEnd of test\n"
READ = {
    "blocks of 5 samples": (blocks(5), [ALL]),
    "blocks of 80 samples": (blocks(80), [ALL]),
    "blocks of 200 samples": (blocks(200), [ALL]),
    "names again": (between(HEAD), [ALL]),
    "names below a line": ("Cycle 1\n" + between("Cycle 2\n" + HEAD), [ALL]),
    "names without units": (mts(ROWS[:80]) + MTS_NAMES + text(ROWS[80:], "\t"), [ALL]),
    "comments": (COMMENT + text(ROWS[:80]) + COMMENT + text(ROWS[80:]), [ALL]),
    "statistics below": (HEAD + text(ROWS) + BELOW, [ALL, "rows not used line 243 and below"]),
    "a small table above": (
        "Channel,Gain,Zero\n1,2.5,0.1\n2,3,0\n\n" + HEAD + text(ROWS),
        [ALL, "rows not used lines 2 to 3"],
    ),
}


@pytest.mark.parametrize(("content", "words"), READ.values(), ids=READ)
def test_every_number_is_read_and_what_is_not_is_told(tmp_path, content, words):
    (tmp_path / "run_5bar.csv").write_text(content)
    said = inspected(tmp_path)
    assert [each for each in words if each not in said] == [], said


AGAIN = ROWS[80:160] - [4.0, 0.0, 0.0]
KILO = text(ROWS[80:] * [1.0, 1.0, 1e-3], "\t")
ORDER = "# time_s disp_mm force_N\n", "# time_s force_N disp_mm\n"
OUT_OF_RANGE = "".join(f"OVR,{x:.3f},{t:.2f}\n" for t, x, _ in ROWS[235:])
REFUSED = {
    "times that start again": (
        mts(ROWS[:80], AGAIN),
        ["the heading is repeated from line 86", "keep one block in a file"],
    ),
    **{
        f"{words.strip()} at {at}": (between(words, at), ["run_5bar"])
        for words in (
            "Time (s),Load (N),Stroke (mm)\n",
            "Time (s),Stroke (in),Load (N)\n",
            "Time (s),Stroke (mm),Load (kN)\n",
            "pause\n",
        )
        for at in (10, 80, 220)
    },
    "a table of others at 80": (between("Channel,Peak,Mean\n", 80), ["run_5bar"]),
    "a table of others at 220": (between("Channel,Peak,Mean\n", 220), ["run_5bar"]),
    "a block in other units": (mts(ROWS[:80]) + MTS_NAMES + "Sec\tmm\tkN\n" + KILO, ["run_5bar"]),
    "10 numbers above": (text(ROWS[:10]) + HEAD + text(ROWS[10:]), ["more than one table"]),
    "80 numbers above": (text(ROWS[:80]) + HEAD + text(ROWS[80:]), ["more than one table"]),
    "a comment in another order": (
        ORDER[0] + text(ROWS[:80], " ") + ORDER[1] + text(ROWS[80:, [0, 2, 1]], " "),
        ["line 82"],
    ),
    "an error of a spreadsheet": (
        HEAD + text(ROWS[:80]) + "#N/A,1,2\n" + text(ROWS[81:]),
        ["found '#N/A'"],
    ),
    "a sensor out of range at the end": (
        "Load (N),Stroke (mm),Time (s)\n" + text(ROWS[:235, [2, 1, 0]]) + OUT_OF_RANGE,
        ["found 'OVR'"],
    ),
}


@pytest.mark.parametrize(("content", "words"), REFUSED.values(), ids=REFUSED)
def test_what_may_be_lost_is_refused(tmp_path, content, words):
    (tmp_path / "run_5bar.csv").write_text(content)
    said = refusal(tmp_path)
    assert [each for each in words if each not in said] == [], said


@pytest.mark.parametrize(
    ("comment", "separator"), [("# ", ","), ("% ", " "), ("#", "\t"), ("# ", " ")]
)
def test_the_comment_right_above_numbers_names_the_columns(tmp_path, comment, separator):
    names = comment + separator.join(("time_s", "disp_mm", "force_N")) + "\n"
    (tmp_path / "run_5bar.txt").write_text("# a test\n" + names + text(ROWS, separator))
    _, _, campaign = init(tmp_path)
    units = {role: column["unit"] for role, column in campaign["columns"].items()}
    assert units == {"time": "s", "displacement": "mm", "force": "N"}


@pytest.mark.parametrize(
    ("cell", "window"),
    [*((cell, "0 s to 8 s") for cell in ("#N/A", "", "OVR", "nan")), ("", "3 s to 11 s")],
)
def test_cells_outside_the_window_need_not_be_numbers(tmp_path, cell, window):
    bad = "".join(f"{t:.2f},{x:.4f},{cell}\n" for t, x, _ in ROWS[200:])
    (tmp_path / "a.csv").write_text(HEAD + text(ROWS[:200]) + bad)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(unit="N") + f'fit = "{window}"\n')
    code, said = run("inspect", tmp_path / "campaign.toml")
    if "11" in window:
        assert code == 2
        assert "line 202" in said
    else:
        assert code == 0
        assert "the first at line 202, lie outside the window fit" in said
        assert "samples 161 over 8 s" in said


# --- Excel


def workbook(folder, **sheets):
    book = Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append([cell.item() if isinstance(cell, np.generic) else cell for cell in row])
    book.save(folder / "run_5bar.xlsx")


def test_blocks_and_a_footer_of_a_sheet(tmp_path):
    workbook(
        tmp_path,
        A=[["Cycle 1"], NAMES, *ROWS[:80], ["Cycle 2"], NAMES, *ROWS[80:], ["Max", 12.0, 9.0]],
    )
    said = inspected(tmp_path)
    assert "samples 240 over 11.95 s" in said
    assert "rows not used row 245 and below" in said


def test_blocks_of_a_sheet_whose_times_start_again_are_refused(tmp_path):
    workbook(tmp_path, A=[NAMES, *ROWS[:80], NAMES, *ROWS[:80]])
    assert "the heading is repeated from row 82" in refusal(tmp_path)


def test_another_sheet_with_the_same_columns_is_told(tmp_path):
    workbook(tmp_path, first=[NAMES, *ROWS[:120]], second=[NAMES, *ROWS[120:]])
    _, said, _ = init(tmp_path)
    assert "sheet 'first' is read; 'second' has the same columns, and is not" in said
    assert "'second' has the same columns" in inspected(tmp_path)


# --- channels that begin at different times


def tdms(folder, *channels):
    with TdmsWriter(folder / "run_5bar.tdms") as writer:
        writer.write_segment([ChannelObject("Rig", *channel) for channel in channels])
    return folder / "run_5bar.tdms"


def wave(unit, late=0.0, *, offset=0.0, step=0.05):
    began = np.datetime64("2024-03-05T10:00:00", "us") + np.timedelta64(round(1e6 * late), "us")
    return {
        "wf_increment": step,
        "wf_start_offset": offset,
        "wf_start_time": began,
        "unit_string": unit,
    }


@pytest.mark.parametrize(("late", "offset"), [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5)])
def test_channels_that_begin_later_are_aligned(tmp_path, late, offset):
    path = tdms(
        tmp_path,
        ("Disp", TRAVEL, wave("mm")),
        ("Load", force(TIME + 1.0), wave("N", late, offset=offset)),
    )
    said = inspected(tmp_path)
    assert "samples 220 over 10.95 s" in said
    assert "Load begins 1 s after Disp" in said
    record = mb.read_record(path, {"time": "time", "displacement": "Disp", "force": "Load"})
    np.testing.assert_allclose(record.time, TIME[20:], atol=1e-9)
    np.testing.assert_allclose(25.4 * record.displacement, TRAVEL[20:], atol=1e-9)
    np.testing.assert_allclose(record.force, force(TIME[20:]) * 2.248089430997105e-4, rtol=1e-9)


def test_channels_between_each_others_samples_are_interpolated(tmp_path):
    path = tdms(
        tmp_path,
        ("Disp", TRAVEL, wave("mm")),
        ("Load", force(TIME + 0.025), wave("N", 0.025)),
    )
    record = mb.read_record(path, {"time": "time", "displacement": "Disp", "force": "Load"})
    np.testing.assert_allclose(
        25.4 * record.displacement, 12.0 * np.sin(0.5 * np.pi * record.time), atol=0.01
    )


def test_a_short_channel_that_is_not_used_cuts_nothing(tmp_path):
    path = tdms(
        tmp_path,
        ("Disp", TRAVEL, wave("mm")),
        ("Load", ROWS[:, 2], wave("N")),
        ("Trigger", ROWS[:20, 2], wave("V")),
    )
    record = mb.read_record(path, {"time": "time", "displacement": "Disp", "force": "Load"})
    assert record.time.size == 240


def test_channels_of_different_lengths_are_cut_and_it_is_told(tmp_path):
    tdms(tmp_path, ("Disp", TRAVEL, wave("mm")), ("Load", ROWS[:230, 2], wave("N")))
    said = inspected(tmp_path)
    assert "samples 230" in said
    assert "Load has 230 samples, Disp 240" in said


@pytest.mark.parametrize(
    ("load", "more", "said"),
    [
        (wave("N", 60.0), (), "never measured at the same time"),
        (wave("N", step=0.01), (), "Disp has a step of 0.05, Load of 0.01"),
        (wave("N", 1.0), [("Time", TIME, {"unit_string": "s"})], "Load begins 1 s after Disp"),
        (wave("N", step=0.01), [("Time", TIME, {"unit_string": "s"})], "one of 0.01 s"),
    ],
)
def test_channels_that_cannot_be_aligned_are_refused(tmp_path, load, more, said):
    tdms(tmp_path, *more, ("Disp", TRAVEL, wave("mm")), ("Load", ROWS[:, 2], load))
    assert said in refusal(tmp_path)


# --- structs in structs


@pytest.mark.parametrize("labels", [("Stroke_mm", "Load_N"), ("", "")])
def test_a_structure_with_time_of_simulink_is_read(tmp_path, labels):
    kinds = [("values", "O"), ("label", "O")]
    signals = np.array([(ROWS[:, [k + 1]], labels[k]) for k in (0, 1)], dtype=kinds).reshape(1, 2)
    savemat(tmp_path / "run_5bar.mat", {"Scope": {"time": TIME[:, None], "signals": signals}})
    _, said, campaign = init(tmp_path)
    names = [campaign["columns"][role]["name"] for role in ("time", "displacement", "force")]
    values = [f"Scope.signals({k}).values {labels[k - 1]}".strip() for k in (1, 2)]
    assert names == ["Scope.time", *values], said


# --- units and times that are not known


def unit_of(folder, role):
    """Unit that `init` writes for a role, and what it says."""
    code, said, campaign = init(folder)
    assert code == 0, said
    return campaign["columns"][role].get("unit"), said


UNKNOWN = ("tonf", "ton", "t", "kg", "kgs", "Kg", "div", "V", "mV", "counts", "x10 kN", "%")


@pytest.mark.parametrize(
    ("role", "head", "unit"),
    [
        *(("force", f"Time(s),Disp(mm),Load({unit})", unit) for unit in UNKNOWN),
        ("force", "Time(s),Disp(mm),Load [tonf]", "tonf"),
        ("force", "Time(s),Disp(mm),Load <kg>", "kg"),
        ("force", "time_s,disp_mm,load_tonf", "tonf"),
        ("force", "time_s,disp_mm,Load kg", "kg"),
        ("force", "Time,Disp,Load\ns,mm,tonf", "tonf"),
        ("force", "Time,Disp,Load\ns,div,tonf", "tonf"),
        ("force", "Time,Disp,Load\n-,mm,kg", "kg"),
        ("time", "Time (div),Disp (mm),Load (N)", "div"),
        ("displacement", "Time (s),Stroke [div],Load (N)", "div"),
        ("displacement", "Time (s),Disp (V),Load (N)", "V"),
    ],
)
def test_a_unit_that_is_not_known_is_named_and_left_open(tmp_path, role, head, unit):
    (tmp_path / "run_5bar.csv").write_text(head + "\n" + text(ROWS))
    found, said = unit_of(tmp_path, role)
    assert found is None
    assert f"the unit of {role} is unknown; {unit!r}" in said


def test_it_is_named_in_a_channel_a_workbook_and_an_object_too(tmp_path):
    tdms(tmp_path, ("Disp", TRAVEL, wave("mm")), ("Load", ROWS[:, 2], wave("tonf")))
    workbook(tmp_path, A=[["Time", "Disp", "Load"], ["s", "mm", "tonf"], *ROWS])
    columns = dict(zip(("time", "disp", "load"), ROWS.T.tolist(), strict=True))
    units = {"units": {"time": "s", "disp": "mm", "load": "tonf"}}
    content = json.dumps(columns | units)
    (tmp_path / "run_5bar.json").write_text(content)
    _, said, campaign = init(tmp_path)
    assert len(campaign["test"]) == 3
    assert '"kN"' not in (tmp_path / "campaign.toml").read_text()
    assert "'tonf'" in said


def test_it_is_named_for_an_actuation_too(tmp_path):
    rows = np.column_stack([ROWS, np.full(240, 5.0)])
    head = "Time (s),Disp (mm),Load (N),Pressure (kg/cm2)\n"
    (tmp_path / "a.csv").write_text(head + text(rows))
    _, said, campaign = init(tmp_path)
    assert "actuation" not in campaign["test"][0]
    assert "'kg/cm2'" in said


@pytest.mark.parametrize(
    ("unit", "size", "role"),
    [
        ("kgf", 9.80665e-3 / 4.4482216152605, "force"),
        ("tf", 9.80665 / 4.4482216152605, "force"),
        ("klb", 1.0, "force"),
        ("klbs", 1.0, "force"),
        ("lbf", 1e-3, "force"),
        ("mils", 1e-3, "displacement"),
        ("mil", 1e-3, "displacement"),
        ("µm", 1e-3 / 25.4, "displacement"),
        ("um", 1e-3 / 25.4, "displacement"),
    ],
)
def test_units_of_laboratories_are_known(tmp_path, unit, size, role):
    names = {"displacement": "Disp (mm)", "force": "Load (N)"} | {role: f"Signal ({unit})"}
    head = f"Time (s),{names['displacement']},{names['force']}\n"
    (tmp_path / "a.csv").write_text(head + text(ROWS), encoding="utf-8")
    columns = {"time": "Time (s)", **names}
    record = mb.read_record(tmp_path / "a.csv", columns)
    number = ROWS[5, 1 if role == "displacement" else 2]
    assert getattr(record, role)[5] == pytest.approx(size * round(number, 4), rel=1e-9)


@pytest.mark.parametrize("unit", ["tonf", "kg", "t"])
def test_a_force_in_masses_is_refused_with_what_to_write(tmp_path, unit):
    (tmp_path / "a.csv").write_text(f"Time(s),Disp(mm),Load({unit})\n" + text(ROWS))
    columns = {"time": 1, "displacement": 2, "force": 3}
    with pytest.raises(mb.MfdError, match=r"if it is a force, write '(kgf|tf)'"):
        mb.read_record(tmp_path / "a.csv", columns)


CAMPAIGN = """
[campaign]
priors = "mfd"
[columns]
time = {{ column = 1, unit = "s" }}
displacement = {{ column = 2, unit = "mm" }}
force = {{ column = 3, unit = "{unit}" }}
[[test]]
id = "a"
file = "a.csv"
actuation = "5 bar"
"""


@pytest.mark.parametrize(
    ("head", "unit", "told"),
    [
        ("Time(s),Disp(mm),Load(tonf)", "kN", True),
        ("Time(s),Disp(mm),Load(kg)", "kN", True),
        ("Time(s),Disp(mm),Load [div]", "kN", True),
        ("Time,Disp,Load\ns,mm,tonf", "kN", True),
        ("Time,Disp,Load\ns,mm,N", "kN", True),
        ("Time(s),Disp(mm),Load(tonf)", "tf", False),
        ("Time(s),Disp(mm),Load(kg)", "kgf", False),
        ("Time(s),Disp(mm),Load(measured)", "kN", False),
        ("Time(s),Disp(mm),Load (cell 2)", "kN", False),
        ("Time(s),Disp(mm),Load (25 kip cell)", "kN", False),
        ("Time(s),X_Value,Axial_Load", "kN", False),
    ],
)
def test_inspect_warns_of_a_column_read_in_another_unit(tmp_path, head, unit, told):
    (tmp_path / "a.csv").write_text(head + "\n" + text(ROWS))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(unit=unit))
    code, said = run("inspect", tmp_path / "campaign.toml")
    assert code == 0, said
    assert ("which is it" in said) == told, said


@pytest.mark.parametrize(
    ("name", "first", "step"),
    [
        *((name, 1, 1) for name in ("Scan", "Sample", "Index", "No.", "#", "Count", "", "Time")),
        *(("Scan", 0, step) for step in (1, 2, 10)),
    ],
)
def test_a_counter_is_no_time(tmp_path, name, first, step):
    rows = "".join(f"{first + step * i},{x:.4f},{f:.4f}\n" for i, (_, x, f) in enumerate(ROWS))
    (tmp_path / "run_5bar.csv").write_text(f"{name},Stroke (mm),Load (N)\n{rows}")
    found, said = unit_of(tmp_path, "time")
    assert found is None
    assert not (tmp_path / "priors.toml").exists()
    assert step > 1 or "at which rate?" in said


@pytest.mark.parametrize("first", [45356.41666667, 739316.41666667])
def test_a_serial_number_of_days_is_no_time_in_seconds(tmp_path, first):
    rows = "".join(f"{first + t / 86400:.9f},{x:.4f},{f:.4f}\n" for t, x, f in ROWS)
    (tmp_path / "run_5bar.csv").write_text(f"Time,Stroke (mm),Load (N)\n{rows}")
    found, said = unit_of(tmp_path, "time")
    assert found == "day"
    assert "it looks like a date, counted in day" in said


def test_a_counter_that_states_ms_is_a_time(tmp_path):
    rows = "".join(f"{i},{x:.4f},{f:.4f}\n" for i, (_, x, f) in enumerate(ROWS))
    (tmp_path / "run_5bar.csv").write_text(f"Sample time (ms),Stroke (mm),Load (N)\n{rows}")
    assert unit_of(tmp_path, "time")[0] == "ms"


def test_a_name_is_compared_only_in_a_unit_that_is_known_and_tells_it(tmp_path):
    rows = ROWS * [1.0, 24.4 / 12.0, 1.0]
    (tmp_path / "slow_25mm.txt").write_text(text(rows, " "))
    found, said = unit_of(tmp_path, "displacement")
    assert found is None
    assert " in (a stroke" not in said
    assert 'write unit = "mm": the file\'s name says 25mm' in said


# --- slow tests


def slow(step, cycle, cycles=5):
    time = np.arange(0.0, cycles * cycle, step)
    return np.column_stack(
        [
            time,
            25.0 * np.sin(2 * np.pi * time / cycle),
            30.0 * np.tanh(3 * np.cos(2 * np.pi * time / cycle)),
        ]
    )


@pytest.mark.parametrize(
    ("step", "cycle"), [(1.0, 120.0), (5.0, 600.0), (10.0, 1800.0), (60.0, 7200.0)]
)
@pytest.mark.parametrize("head", ["Time (s)", "time_s", "Time [sec]", "Elapsed Time (s)"])
def test_a_slow_test_whose_heading_states_seconds_is_not_in_ms(tmp_path, step, cycle, head):
    (tmp_path / "a_5bar.csv").write_text(
        f"{head},Stroke (mm),Load (kN)\n" + text(slow(step, cycle))
    )
    _, said, _ = init(tmp_path)
    assert " ms" not in said
    assert "in ms rather" not in inspected(tmp_path)


def test_a_slow_time_without_a_unit_is_asked_for(tmp_path):
    (tmp_path / "a_5bar.csv").write_text("Time,Stroke (mm),Load (kN)\n" + text(slow(5.0, 600.0)))
    found, said = unit_of(tmp_path, "time")
    assert found is None
    assert "its steps may be s or ms" in said


def test_cycles_of_hours_without_a_unit_in_the_file_may_be_ms(tmp_path):
    (tmp_path / "a.csv").write_text("Time,Stroke,Load\n" + text(slow(50.0, 4000.0)))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(unit="kN"))
    assert "is time in ms rather than in s?" in run("inspect", tmp_path / "campaign.toml")[1]
    (tmp_path / "a.csv").write_text("Time,Stroke,Load\n" + text(slow(5.0, 600.0)))
    assert "in ms" not in run("inspect", tmp_path / "campaign.toml")[1]


def test_a_clock_a_thousand_times_slower_than_the_others_is_told(tmp_path):
    (tmp_path / "a_5bar.csv").write_text(HEAD + text(ROWS))
    (tmp_path / "b_10bar.csv").write_text(HEAD + text(ROWS * [1000.0, 1.0, 1.1]))
    assert "is time in ms rather than in s?" in inspected(tmp_path)
