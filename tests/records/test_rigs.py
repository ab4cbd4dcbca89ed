"""What rigs and loggers write: no number is lost, or read as another, in silence.

Rates, time stamps, signs, units, blocks and footers, by what `init` and `inspect` say.
"""

import json
import tomllib
from datetime import datetime, timedelta

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook

import mfd_bayes as mb
from mfd_bayes.records.record import Source
from tests.command_line import said

pytestmark = pytest.mark.usefixtures("small_pictures")

STEP = 0.05
TIME = STEP * np.arange(240)
PHASE = 0.5 * np.pi * TIME
TRAVEL = 12.0 * np.sin(PHASE)  # mm


def force(time):
    """Of a friction damper, N."""
    return 950.0 * np.tanh(3.0 * np.cos(0.5 * np.pi * time)) + 3.0 * np.sin(31.0 * time)


FORCE = force(TIME)
ROWS = np.column_stack([TIME, TRAVEL, FORCE])
NAMES = ["Time (s)", "Stroke (mm)", "Load (N)"]
HEAD = ",".join(NAMES) + "\n"
ALL = "240 over 11.95 s"


def text(rows, separator=","):
    return "".join(separator.join(f"{cell:.4f}" for cell in row) + "\n" for row in rows)


def write(path, head, *columns, preamble=""):
    rows = [",".join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
    path.write_text(preamble + head + "\n" + "\n".join(rows) + "\n")


def run(*words, code=0):
    """What a command says, which must end with this code."""
    if words[0] == "inspect":
        words = (*words, "-o", words[1].parent, "--force")
    return said(*words, code=code)


def init(folder, code=0):
    """What `init` says, and the campaign that it writes."""
    printed = run("init", folder, "--force", code=code)
    path = folder / "campaign.toml"
    return printed, tomllib.loads(path.read_text()) if code == 0 else {}


def drafted(folder):
    """What `init` says, its campaign, and what `inspect` says of that."""
    return *init(folder), run("inspect", folder / "campaign.toml")


CAMPAIGN = """[columns]
{time}
displacement = {{ column = 2, unit = "mm" }}
force = {{ column = 3, unit = "{unit}" }}
[[test]]
id = "a"
file = "a.csv"
actuation = "5 bar"
{test}
"""


def inspected(folder, *, time='time = { column = 1, unit = "s" }', unit="N", test="", code=0):
    """What `inspect` says of a campaign of a.csv."""
    path = folder / "c.toml"
    path.write_text(CAMPAIGN.format(time=time, unit=unit, test=test))
    return run("inspect", path, code=code)


# --- blocks, headings between the numbers, footers

MTS_NAMES, MTS_UNITS = "Time\tAxial Displacement\tAxial Force\n", "Sec\tmm\tN\n"


def mts(*blocks, units=MTS_UNITS):
    return "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\n" + "".join(
        f"Data Header:\tTimed\tCycle 1\tTime:\t{rows[0, 0]:.2f}\tSec\t1/2/2024 10:12:13 AM\n"
        + (MTS_NAMES + units + text(rows, "\t"))
        for rows in blocks
    )


def between(words, row=80):
    return HEAD + text(ROWS[:row]) + words + text(ROWS[row:])


COMMENT = "# time_s,stroke_mm,load_N\n"
BELOW = "\nMax,12.00,956.1\nMin,-12.00,-957.2\nEnd of test\n"
READ = {
    "blocks of 5 samples": (mts(*(ROWS[at : at + 5] for at in range(0, 240, 5))), ""),
    "names again": (between(HEAD), ""),
    "names below a line": ("Cycle 1\n" + between("Cycle 2\n" + HEAD), ""),
    "comments": (COMMENT + text(ROWS[:80]) + COMMENT + text(ROWS[80:]), ""),
    "statistics below": (HEAD + text(ROWS) + BELOW, "line 243 and below"),
    "a table above": (
        "Channel,Gain,Zero\n1,2.5,0.1\n2,3,0\n\n" + HEAD + text(ROWS),
        "lines 2 to 3",
    ),
    "names and units in comments": ("% Time Disp Force\n% s mm N\n" + text(ROWS, " "), ""),
    "names in the last comment": ("# a test\n#time_s\tdisp_mm\tforce_N\n" + text(ROWS, "\t"), ""),
    "names with units behind blanks": ("# t (s) x (mm) F (N)\n" + text(ROWS, " "), ""),
    "quoted names": ('"t_s" "disp (mm)" "force_N"\n' + text(ROWS, " "), ""),
    "a third row of a heading": ("Time,Disp,Load\ns,mm,N\n,Smp,Smp\n" + text(ROWS), ""),
    "units in brackets at every page": (
        "".join(
            f"Page 2\nt,x,F\n(s),(mm),(N)\n{text(part)}\f\n" for part in (ROWS[:99], ROWS[99:])
        ),
        "",
    ),
    "a name behind an empty cell": (HEAD + text(ROWS) + "---,---\n,Max,956\n", "line 242"),
}


@pytest.mark.parametrize("name", READ)
def test_every_number_is_read_and_what_is_not_is_named(tmp_path, name):
    content, unused = READ[name]
    (tmp_path / "run_5bar.csv").write_text(content)
    report = drafted(tmp_path)[2]
    assert ALL in report
    assert unused in report
    assert bool(unused) == ("rows not used" in report)


KILO = text(ROWS[80:] * [1.0, 1.0, 1e-3], "\t")
SECOND = "# time_s force_N disp_mm\n"
OUT_OF_RANGE = "".join(f"OVR,{x:.3f},{t:.2f}\n" for t, x, _ in ROWS[235:])
REFUSED = {
    "times that start again": (mts(ROWS[:80], ROWS[80:160] - [4.0, 0.0, 0.0]), "line 86"),
    "names in another order": (between("Time (s),Load (N),Stroke (mm)\n"), "lines 2 to 81"),
    "names in another unit": (between("Time (s),Stroke (mm),Load (kN)\n", 220), ""),
    "another table": (between("Channel,Peak,Mean\n", 220), "line 222"),
    "a block in other units": (mts(ROWS[:80]) + MTS_NAMES + "Sec\tmm\tkN\n" + KILO, ""),
    "80 numbers above": (text(ROWS[:80]) + HEAD + text(ROWS[80:]), "lines 1 to 80"),
    "a comment in another order": (
        "# time_s disp_mm force_N\n" + text(ROWS[:80], " ") + SECOND + text(ROWS[80:], " "),
        "line 82",
    ),
    "an error of a spreadsheet": (between("#N/A,1,2\n"), "'#N/A'"),
    "a sensor out of range at the end": (
        "Load (N),Stroke (mm),Time (s)\n" + text(ROWS[:235, [2, 1, 0]]) + OUT_OF_RANGE,
        "'OVR'",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_may_be_lost_is_refused(tmp_path, name):
    content, named = REFUSED[name]
    (tmp_path / "run_5bar.csv").write_text(content)
    printed, _ = init(tmp_path, code=2)
    assert "run_5bar.csv" in printed
    assert named in printed


def test_blocks_and_a_footer_of_a_sheet(tmp_path):
    book = Workbook()
    blocks = [["Cycle 1"], NAMES, *ROWS[:80].tolist(), ["Cycle 2"], NAMES, *ROWS[80:].tolist()]
    for row in (*blocks, ["Max", 12.0, 9.0]):
        book.active.append(row)
    book.save(tmp_path / "run_5bar.xlsx")
    report = drafted(tmp_path)[2]
    assert ALL in report
    assert "row 245 and below" in report


def test_cells_outside_the_window_need_not_be_numbers(tmp_path):
    for cell in ("#N/A", "", "nan"):
        bad = "".join(f"{t:.2f},{x:.4f},{cell}\n" for t, x, _ in ROWS[200:])
        (tmp_path / "a.csv").write_text(HEAD + text(ROWS[:200]) + bad)
        assert "samples 161 over 8 s" in inspected(tmp_path, test='window = "0 s to 8 s"')
        assert "line 202" in inspected(tmp_path, test='window = "3 s to 11 s"', code=2)
    bad = "".join(f"stopped,{x:.4f},{f:.2f}\n" for _, x, f in ROWS[200:])
    (tmp_path / "a.csv").write_text(HEAD + text(ROWS[:200]) + bad)
    assert "samples 161 over 8 s" in inspected(tmp_path, test='window = "0 s to 8 s"')


# --- channels that begin at different times


def tdms(folder, *channels):
    with TdmsWriter(folder / "run_5bar.tdms") as writer:
        writer.write_segment([ChannelObject("Rig", *channel) for channel in channels])
    return folder / "run_5bar.tdms"


def wave(unit, late=0.0, *, offset=0.0, step=STEP):
    began = np.datetime64("2024-03-05T10:00:00", "us") + np.timedelta64(round(1e6 * late), "us")
    return {
        "wf_increment": step,
        "wf_start_offset": offset,
        "wf_start_time": began,
        "unit_string": unit,
    }


def test_channels_of_other_lengths_are_read_as_far_as_both_go_and_of_other_clocks_not(tmp_path):
    roles = {"time": Source(rate="20 Hz"), "displacement": "Disp", "force": "Load"}
    travel = ("Disp", TRAVEL, wave("mm"))
    path = tdms(tmp_path, travel, ("Load", FORCE[:230], wave("N")))
    assert "rows not used" in drafted(tmp_path)[2]
    np.testing.assert_allclose(mb.read_record(path, roles).time, TIME[:230], atol=1e-9)
    clock = ("Time", TIME, {"unit_string": "s"})
    for properties, channels in (
        (wave("N", 1.0), ()),
        (wave("N", 0.5, offset=0.5), ()),
        (wave("N", 1.0), [clock]),
        (wave("N", step=0.01), ()),
    ):
        path = tdms(tmp_path, *channels, travel, ("Load", FORCE, properties))
        with pytest.raises(mb.MfdError, match=r"Load (begins 1 s after Disp|has a step of 0.01)"):
            mb.read_record(path, roles)
        init(tmp_path, code=2)


# --- units that are not known, and counters


def counter(name):
    rows = zip(range(1, 241), TRAVEL, FORCE, strict=True)
    return f"{name},Stroke (mm),Load (N)\n" + text(rows)


def slow(step, cycle):
    time = np.arange(0.0, 5 * cycle, step)
    phase = 2 * np.pi * time / cycle
    return text(np.column_stack([time, 25.0 * np.sin(phase), 30.0 * np.tanh(3 * np.cos(phase))]))


UNKNOWN = ("tonf", "kg", "mV", "%", "x10 kN", "10^3 N", "x1000 N")
WITHOUT_TIME = "Displacement (mm),Force (N)\n" + text(ROWS[:, 1:])
DRAFTS = (  # a role, a file, the unit or the rate that is drafted, and what is said
    *(("force", f"Time(s),Disp(mm),Load({u})\n" + text(ROWS), "", f"{u!r}") for u in UNKNOWN),
    ("force", "time_s,disp_mm,load_tonf\n" + text(ROWS), "", "'tonf'"),
    ("force", "Time,Disp,Load\ns,mm,tonf\n" + text(ROWS), "", "'tonf'"),
    ("time", "Time (div),Disp (mm),Load (N)\n" + text(ROWS), "", "'div'"),
    ("displacement", "Time (s),Disp <V>,Load (N)\n" + text(ROWS), "", "'V'"),
    ("force", "Time (s),Disp (mm),Load (kN) x10\n" + text(ROWS), "", "'kN x10'"),
    # a counter is no time, and a test may be slow
    ("time", counter("Scan"), "", "at which rate?"),
    ("time", counter("Time"), "", "at which rate?"),
    ("time", "Scan rate: 20 Hz\n" + counter("Scan"), "20 Hz", ""),
    (
        *("time", "Scan rate: 20 Hz\n" + counter("Scan").replace("\n240.", "\n250.")),
        *("20 Hz", "samples may be lost"),
    ),
    ("time", counter("Sample time (ms)"), "ms", ""),  # which states what it counts
    ("time", "Time [sec],Stroke (mm),Load (kN)\n" + slow(1.0, 120.0), "sec", ""),
    ("time", "Elapsed Time (s),Stroke (mm),Load (kN)\n" + slow(60.0, 7200.0), "s", ""),
    ("time", "Time,Stroke (mm),Load (kN)\n" + slow(5.0, 600.0), "", "s or ms"),
    # a rate in place of a column of times
    ("time", "Sampling Rate (Hz),20\n" + WITHOUT_TIME, "20 Hz", ""),
    ("time", "Sampling interval: 0,05 s\n" + WITHOUT_TIME, "0.05 s", ""),
    ("time", "Scan rate: 0.02 kHz per channel\n" + WITHOUT_TIME, "0.02 kHz", ""),
    ("time", "Test frequency: 20 Hz\n" + WITHOUT_TIME, "", ""),
    ("time", "Sample rate: 1,000 Hz\n" + WITHOUT_TIME, "", ""),
    ("time", "fs = 20\nSample rate: 30 Hz\n" + WITHOUT_TIME, "", ""),
    ("time", "Max. sample rate: 20 Hz\n" + WITHOUT_TIME, "", ""),
    ("time", "Sample interval: 5 minutes\n" + WITHOUT_TIME, "", ""),
    ("time", "Rate: 0.02 kS/s\n" + WITHOUT_TIME, "0.02 kHz", ""),
    ("time", "Scan rate: 20 pts/sec\n" + WITHOUT_TIME, "20 Hz", ""),
    ("time", "サンプリング周波数：20Hz\n" + WITHOUT_TIME, "20 Hz", ""),
)


@pytest.mark.parametrize(("role", "content", "stated", "words"), DRAFTS, ids=range(len(DRAFTS)))
def test_a_unit_or_a_rate_is_that_which_the_file_states_and_otherwise_left_open(
    tmp_path, role, content, stated, words
):
    (tmp_path / "run_5bar.csv").write_text(content)
    printed, campaign = init(tmp_path)
    source = campaign["columns"].get(role, {})
    assert source.get("unit", source.get("rate", "")) == stated
    assert words in printed
    assert ("FIXME" in printed) == (not stated)
    report = run("inspect", tmp_path / "campaign.toml", code=0 if stated else 2)
    assert not stated or "in ms rather" not in report
    assert not stated.endswith("Hz") or ALL in report


def test_a_sentence_of_as_many_words_as_columns_is_no_row_of_names(tmp_path):
    (tmp_path / "run_5bar.txt").write_text("# made by Tim\n" + text(ROWS, " "))
    assert init(tmp_path)[1]["columns"]["time"]["column"] == 1


def test_inspect_warns_of_a_column_read_in_another_unit(tmp_path):
    for head, unit, warned in (
        ("Time(s),Disp(mm),Load(tonf)", "kN", True),
        ("Time,Disp,Load\ns,mm,N", "kN", True),
        ("Time(s),Disp(mm),Load(tonf)", "tf", False),
        ("Time(s),Disp(mm),Load(measured)", "kN", False),
        ("Time(s),Disp(mm),Load (25 kip cell)", "kN", False),
    ):
        (tmp_path / "a.csv").write_text(head + "\n" + text(ROWS))
        assert ("which is it" in inspected(tmp_path, unit=unit)) == warned, head


def test_a_length_in_the_files_name_tells_the_unit_and_is_not_compared_without(tmp_path):
    (tmp_path / "slow_25mm.txt").write_text(text(ROWS * [1.0, 24.4 / 12.0, 1.0], " "))
    printed, campaign = init(tmp_path)
    assert "unit" not in campaign["columns"]["displacement"]
    assert " in (a stroke" not in printed
    assert 'write unit = "mm"' in printed


def test_inspect_asks_whether_a_time_in_seconds_is_in_ms(tmp_path):
    for step, cycle, expected in ((50.0, 4000.0, True), (5.0, 600.0, False)):
        (tmp_path / "a.csv").write_text("Time,Stroke,Load\n" + slow(step, cycle))
        assert ("in ms rather than in s?" in inspected(tmp_path, unit="kN")) is expected


def test_a_clock_a_thousand_times_slower_than_the_others_is_named(tmp_path):
    (tmp_path / "a_5bar.csv").write_text(HEAD + text(ROWS))
    (tmp_path / "b_10bar.csv").write_text(HEAD + text(ROWS * [1000.0, 1.0, 1.1]))
    assert "is time in ms rather than in s?" in drafted(tmp_path)[2]


def test_a_rate_is_given_for_all_tests_or_for_one(tmp_path):
    write(tmp_path / "a.csv", "note,x_mm,f_N", ["x"] * 240, TRAVEL, FORCE)
    for time, test, printed in (
        ('rate = "20 Hz"', "", ALL),
        ('time = { rate = "50 ms" }', "", ALL),
        ('time = { column = 1, unit = "s" }', 'rate = "20 Hz"', ALL),
        ('rate = "5 Hz"', 'columns.rate = "20 Hz"', ALL),
        ('rate = "20"', "", "'20'"),
        ('rate = "0 Hz"', "", "'0 Hz'"),
        ('rate = "20 Hz"\ntime = { name = "t" }', "", "rate"),
        ('time = { name = "t", sign = -1 }', "", "'sign'"),
    ):
        assert printed in inspected(tmp_path, time=time, test=test, code=0 if printed == ALL else 2)


# --- the sign of a column


def test_only_the_tests_that_run_backward_are_turned_and_it_is_said(tmp_path):
    overflow = np.where(TIME[41] == TIME, -1e6, FORCE)  # turns no sign
    for name, load in (("a_5bar", FORCE), ("b_5bar", overflow), ("c_9bar", -FORCE)):
        write(tmp_path / f"{name}.csv", HEAD.strip(), TIME, TRAVEL, load)
    printed, campaign, report = drafted(tmp_path)
    assert "c_9bar: its loops run backward" in printed
    signs = [t.get("columns", {}).get("force", {}).get("sign") for t in campaign["test"]]
    assert signs == [None, None, -1]
    assert "force sign" not in report


# --- actuation in any unit


def test_an_actuation_is_given_in_its_own_unit(tmp_path):
    (tmp_path / "a.csv").write_text(HEAD + text(ROWS))
    for level in ("500 mA", "24 V", "3 turns", "40 %", "80 ft*lbf"):
        entry = f'[[test]]\nid = "b"\nfile = "a.csv"\nactuation = "{level}"'
        assert "kind" in inspected(tmp_path, test=entry, code=2)
        (tmp_path / "c.toml").write_text((tmp_path / "c.toml").read_text().replace("5 bar", level))
        assert f" actuation {level} " in run("inspect", tmp_path / "c.toml")


def test_init_drafts_the_current_of_a_test(tmp_path):
    for name, preamble, level, doubt in (
        ("run_250mA", "", "250 mA", ""),
        ("run_2A", "", "2 A", "2A is taken for A"),
        ("run", "Coil current: 0.75 A\n", "0.75 A", ""),
        ("run_500psi_2A", "", "500 psi", ""),
    ):
        write(tmp_path / f"{name}.csv", HEAD.strip(), *ROWS.T, preamble=preamble)
        printed, campaign = init(tmp_path)
        assert campaign["test"][0]["actuation"] == level
        assert (doubt in printed) if doubt else ("unsure" not in printed)
        (tmp_path / f"{name}.csv").unlink()


# --- time stamps

BEGIN = datetime(2024, 3, 5, 10, 0, 0)
NIGHT = datetime(2024, 3, 5, 23, 59, 55)


def stamps(form, begin=BEGIN):
    """Time stamps of a test, of a form of strftime in which %L stands for milliseconds."""
    moments = [begin + timedelta(seconds=STEP * k) for k in range(240)]
    return [m.strftime(form.replace("%L", f"{m.microsecond // 1000:03}")) for m in moments]


STAMPS = {
    "ISO that loses its .000": [s.removesuffix(".000") for s in stamps("%Y-%m-%d %H:%M:%S.%L")],
    "ISO with a zone": stamps("%Y-%m-%dT%H:%M:%S.%L+01:00"),
    "US with AM, at noon": stamps("%m/%d/%Y %I:%M:%S.%L %p", datetime(2024, 3, 5, 11, 59, 55)),
    "US past midnight": stamps("%m/%d/%Y %H:%M:%S.%L", NIGHT),
    "MATLAB": stamps("%d-%b-%Y %H:%M:%S.%L"),
    "as ctime": stamps("%a %b %d %H:%M:%S.%L %Y"),
    "clock past midnight": stamps("%H:%M:%S.%L", NIGHT),
    "clock of twelve hours, no AM": stamps("%I:%M:%S.%L", datetime(2024, 3, 5, 12, 59, 55)),
    "minutes and seconds": stamps("%M:%S.%L"),
    "clock before the date": stamps("%H:%M:%S.%L %d.%m.%Y"),
    "in brackets": stamps("[%H:%M:%S.%L]"),
    "a clock behind a colon": stamps("%d%b%Y:%H:%M:%S.%L"),
    "a clock behind a dash": stamps("%Y/%m/%d-%H:%M:%S.%L"),
    "digits alone": stamps("%Y%m%d %H%M%S.%L"),
    "timedelta of pandas": [f"0 days {s}" for s in stamps("%H:%M:%S.%L000")],
}
ROLES = {"time": "Timestamp", "displacement": 2, "force": 3}
STAMPED = "Timestamp,Displacement (mm),Force (N)"


@pytest.mark.parametrize("form", STAMPS)
def test_time_stamps_are_seconds_since_the_first_row(tmp_path, form):
    write(tmp_path / "a_5bar.csv", STAMPED, STAMPS[form], TRAVEL, FORCE)
    record = mb.read_record(tmp_path / "a_5bar.csv", ROLES, window="2 s to 8 s")
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    assert record.trace().time[[0, -1]] == pytest.approx([2.0, 8.0])
    printed, campaign = init(tmp_path)
    assert campaign["columns"]["time"] == {"name": "Timestamp", "unit": "s"}
    assert "FIXME" not in printed


def test_a_date_a_clock_and_a_counter_beside_each_other(tmp_path):
    clock, day = stamps("%H:%M:%S.%L", NIGHT), stamps("%d.%m.%Y", NIGHT)
    head = "No.,Date,Time,Displacement (mm),Force (N),Events"
    write(tmp_path / "a_5bar.csv", head, range(240), day, clock, TRAVEL, FORCE, [""] * 240)
    _, campaign, report = drafted(tmp_path)
    assert campaign["columns"]["time"]["name"] == "Time"
    assert ALL in report


def test_an_order_of_dates_that_nothing_tells_is_asked_for(tmp_path):
    days = [datetime(2024, 3, 5) + timedelta(days=k // 120, seconds=STEP * k) for k in range(240)]
    cells = [m.strftime("%m/%d/%Y %H:%M:%S.%f") for m in days]
    write(tmp_path / "a.csv", "Timestamp,x_mm,f_N", cells, TRAVEL, FORCE)
    assert "day first" in inspected(tmp_path, time='time = { name = "Timestamp" }', code=2)
    stated = 'time = { name = "Timestamp", dates = "month first" }'
    assert "time has a gap" in inspected(tmp_path, time=stated)


def test_a_cell_that_is_no_stamp_is_named_or_left_out(tmp_path):
    for cell in ("", "#N/A", "25:61:00", "later"):
        clock = stamps("%H:%M:%S.%L")
        clock[200] = cell
        write(tmp_path / "a.csv", STAMPED, clock, TRAVEL, FORCE)
        with pytest.raises(mb.MfdError, match=r"line 202 of .*, column 'Timestamp'"):
            mb.read_record(tmp_path / "a.csv", ROLES)
        assert mb.read_record(tmp_path / "a.csv", ROLES, window="0 s to 8 s").time.size == 200


def test_stamps_that_are_too_coarse_ask_for_the_rate(tmp_path):
    write(tmp_path / "a_5bar.csv", STAMPED, stamps("%H:%M:%S"), TRAVEL, FORCE)
    assert "about 20 in a second" in init(tmp_path)[0]
    with pytest.raises(mb.MfdError, match="rate"):
        mb.read_record(tmp_path / "a_5bar.csv", ROLES)


def test_moments_of_other_formats_are_a_time(tmp_path):
    moments = [BEGIN + timedelta(seconds=float(t)) for t in TIME]
    kinds = {"moments": moments, "clock": [m.time() for m in moments]}
    kinds["elapsed"] = [m - BEGIN for m in moments]
    for name, cells in kinds.items():
        book = Workbook()
        book.active.append(["Clock", "Disp (mm)", "Load (N)"])
        for row in zip(cells, TRAVEL.tolist(), FORCE.tolist(), strict=True):
            book.active.append(row)
        book.save(tmp_path / f"{name}_5bar.xlsx")
    clock = np.datetime64(BEGIN, "us") + (1e6 * TIME).astype("m8[us]")
    tdms(tmp_path, ("Clock", clock), ("Disp (mm)", TRAVEL), ("Load (N)", FORCE))
    columns = {"Disp (mm)": TRAVEL.tolist(), "Load (N)": FORCE.tolist()}
    columns |= {"Clock": stamps("%Y-%m-%dT%H:%M:%S.%LZ")}
    (tmp_path / "j_5bar.json").write_text(json.dumps(columns))
    campaign = init(tmp_path)[1]
    assert len(campaign["test"]) == 5
    assert campaign["columns"]["time"] == {"name": "Clock", "unit": "s"}
    roles = {"time": "Clock", "displacement": "Disp (mm)", "force": "Load (N)"}
    for test in campaign["test"]:
        record = mb.read_record(tmp_path / test["file"], roles)
        np.testing.assert_allclose(record.time, TIME, atol=1e-6)


def test_a_time_that_counts_from_a_date_is_since_the_first_row(tmp_path):
    for unit, offset, factor in (
        ("day", 45356.4166666667, 1 / 86400),  # Excel
        ("day", 739316.416666667, 1 / 86400),  # MATLAB
        ("s", 3792477600.0, 1.0),  # LabVIEW
        ("us", 1709632800000000.0, 1e6),
    ):
        cells = [f"{offset + t * factor:.10f}" for t in TIME]
        write(tmp_path / "a_5bar.csv", "X_Value,Displacement (mm),Force (N)", cells, TRAVEL, FORCE)
        printed, campaign = init(tmp_path)
        assert campaign["columns"]["time"]["unit"] == unit
        assert f"counted in {unit}" in printed
        roles = {"time": Source("X_Value", unit), "displacement": 2, "force": 3}
        record = mb.read_record(tmp_path / "a_5bar.csv", roles)
        np.testing.assert_allclose(record.time, TIME, atol=2e-5)
    for offset, factor in ((36000.0, 1.0), (0.4166666667, 1 / 86400)):  # of a day
        cells = [f"{offset + t * factor:.10f}" for t in TIME]
        write(tmp_path / "a_5bar.csv", "Clock,Displacement (mm),Force (N)", cells, TRAVEL, FORCE)
        assert "unit" not in init(tmp_path)[1]["columns"]["time"]


def test_wide_brackets_and_unit_signs_are_read(tmp_path):
    path = tmp_path / "a_5bar.csv"
    for encoding, head in (
        ("cp932", "時間［s］,変位［㎜］,荷重［N］"),
        ("utf-8", "時間［s］,変位［㎜］,荷重［N］"),
        ("iso2022_jp", "時間（s）,変位（mm）,荷重（N）"),
        ("utf-8", "t(s)[0],x(mm)[0],F(N)[1]"),
    ):
        path.write_bytes(f"{head}\n{text(ROWS)}".encode(encoding))
        printed, _, report = drafted(tmp_path)
        assert "FIXME" not in printed
        assert "displacement -12 to 12 mm" in report
