"""Ground motions are read in every layout, and mistakes name file and line."""

import os
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.ground import Ground, parse_ground, read_ground
from mfd_bayes.units import GRAVITY

PEER = """PEER NGA STRONG MOTION DATABASE RECORD
Imperial Valley, 5/19/1940, El Centro
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=   6, DT=   .0100 SEC
  .1000E-01  -.2000E-01   .3000E-01
 -.4000E-01   .5000E-01   .0000E+00
"""


@pytest.fixture
def records():
    root = Path(os.environ.get("MFD_BAYES_DATA", Path(__file__).parents[3] / "shared" / "data"))
    folder = root / "ground_motions"
    if not folder.is_dir():
        pytest.skip(f"ground motions not found at {folder}")
    return folder


def test_a_header_of_four_lines_gives_step_and_values(tmp_path):
    path = tmp_path / "a.AT2"
    path.write_text(PEER)
    ground = read_ground(path)
    assert ground.step == 0.01
    assert np.allclose(ground.acceleration / GRAVITY, [0.01, -0.02, 0.03, -0.04, 0.05, 0.0])
    assert ground.with_peak(GRAVITY).peak == pytest.approx(GRAVITY)
    path.write_text(PEER.replace("NPTS=   6", "NPTS=   7"))
    with pytest.raises(BuildingError, match="NPTS = 7, and there are 6"):
        read_ground(path)
    path.write_text(PEER.replace(".3000E-01", ".3000E-01 ouch"))
    with pytest.raises(BuildingError, match=r"a\.AT2 line 5: expected numbers, got 'ouch'"):
        read_ground(path)


def test_real_records_are_read(records):
    ground = read_ground(records / "el_centro.AT2")
    assert ground.acceleration.size == 1559
    assert ground.peak / GRAVITY == pytest.approx(0.3188, abs=1e-4)
    with pytest.raises(BuildingError, match="does not say its step"):
        read_ground(records / "Rinaldi.AT2")
    path, step, unit = parse_ground(f"{records / 'Rinaldi.AT2'}:0.01s")
    assert read_ground(path, step=step, unit=unit).acceleration.size == 1991


def test_a_table_has_units(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_ms,acceleration_cm/s^2\n" + "".join(f"{20 * i},{i}\n" for i in range(9)))
    ground = read_ground(path)
    assert ground.step == pytest.approx(0.02)
    assert ground.acceleration[-1] == pytest.approx(8 / 2.54)
    path.write_text("time_s,acceleration_g\n0,1\n0.1,2\n0.3,1\n")
    with pytest.raises(BuildingError, match="one even step"):
        read_ground(path)


def test_a_ground_motion_has_numbers_of_its_own():
    given = np.array([1.0, -2.0, 1.5])
    ground = Ground("g", 0.02, given)
    assert not np.shares_memory(ground.acceleration, given)
    with pytest.raises(ValueError, match="read-only"):
        ground.acceleration[0] = 9.0
    assert ground.scaled(2.0).peak == 4.0


GROUND = Ground("g", 0.02, [1.0, -2.0, 1.5])


@pytest.mark.parametrize(
    ("call", "words", "values"),
    [
        (lambda v: Ground("g", v, np.ones(5)), "step", (0.0, -0.02, np.nan, "0.02", None, True)),
        (lambda v: read_ground("a.txt", step=v), "step", (0.0, -0.02, np.nan, "0.02", [0.02])),
        (lambda v: Ground("g", 0.02, v), "g: ", ("x", ["a"], None, [1.0], [[1.0, 2.0]])),
        (lambda v: Ground("g", 0.02, v), "g: ", ([1.0, np.nan], [0.0, 0.0], 5.0)),
        (lambda v: Ground(v, 0.02, np.ones(5)), "name", (5, None)),
        (GROUND.scaled, "factor must be a finite number", ("2", None, np.nan, [2.0])),
        (GROUND.with_peak, "peak must be a finite number above 0", ("2", None, np.nan, 0.0)),
        (read_ground, "ground must be a path", (None, 5, b"a.txt", ["a.txt"], "a\0b")),
        (lambda v: read_ground("a.txt", unit=v), "unit must be text", (5, None, ["g"])),
        (parse_ground, r"expected FILE, FILE:0\.01s", ("a.txt:fast", "a.txt:0.02")),
    ],
)
def test_what_is_no_ground_motion_is_named(call, words, values):
    for value in values:
        with pytest.raises(BuildingError, match=words):
            call(value)


@pytest.mark.parametrize("digits", [2, 4])
@pytest.mark.parametrize("between", ["  ", ", ", ";"])
@pytest.mark.parametrize("width", [2, 3])
def test_columns_of_time_and_acceleration_are_not_read_as_one(tmp_path, digits, between, width):
    path = tmp_path / "a.txt"
    moves = np.sin(np.arange(40.0))
    rows = [[f"{0.02 * i:.{digits}f}", *[f"{a:.4f}"] * (width - 1)] for i, a in enumerate(moves)]
    path.write_text("time accel\n" + "\n".join(map(between.join, rows)))
    with pytest.raises(BuildingError, match="looks like columns of time and acceleration: save"):
        read_ground(path, step=0.02)


@pytest.mark.parametrize("width", [1, 2, 3, 5])
def test_accelerations_in_rows_are_read_along_the_rows(tmp_path, width):
    path = tmp_path / "a.txt"
    moves = np.sin(np.arange(30.0)).round(4)
    path.write_text("\n".join(" ".join(map(str, row)) for row in moves.reshape(-1, width)))
    assert np.allclose(read_ground(path, step=0.02).acceleration / GRAVITY, moves)
    ramp = 0.1 * np.arange(1.0, 31.0).round(1)  # the header says that all of them are accelerations
    lines = (" ".join(map(str, row)) for row in ramp.reshape(-1, width))
    path.write_text("NPTS= 30, DT= .02 SEC\n" + "\n".join(lines))
    assert np.allclose(read_ground(path).acceleration / GRAVITY, ramp)


def test_what_is_given_may_not_contradict_the_file(tmp_path):
    path = tmp_path / "a.AT2"
    path.write_text(PEER)
    assert read_ground(path, step=0.01, unit="g").step == 0.01
    with pytest.raises(BuildingError, match=r"a\.AT2: the file's step is 0\.01 s, and 0\.005 s"):
        read_ground(path, step=0.005)
    with pytest.raises(BuildingError, match=r"header says 'UNITS OF G', and 'cm/s\^2' was given"):
        read_ground(path, unit="cm/s^2")
    path.write_text(PEER.replace(".0100 SEC", ".0039 SEC"))
    assert read_ground(path, step=1 / 256).step == 0.0039  # a header rounds


def test_what_is_given_may_not_contradict_a_table(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,acceleration_g\n0,0.1\n0.02,0.2\n0.04,0.1\n")
    assert read_ground(path, step=0.02, unit="g").step == pytest.approx(0.02)
    with pytest.raises(BuildingError, match=r"a\.csv: the file's step is 0\.02 s, and 0\.01 s"):
        read_ground(path, step=0.01)
    with pytest.raises(BuildingError, match=r"'acceleration_g' .*'g', and 'm/s\^2' was given"):
        read_ground(path, unit="m/s^2")


MOVES = 0.3 * np.sin(0.4 * np.arange(40)) * np.hanning(40)
NPTS = "NPTS=  40, DT= .0100 SEC"
IN_GAL = 980.665
COUNTS = 6182761 / 3920 * IN_GAL


def written(tmp_path, header, by=1.0, *, name="quake.AT2", columns=5, change=str):
    """A file of a header and of `MOVES` times a factor."""
    rows = (by * MOVES).reshape(-1, columns)
    body = "\n".join("".join(f"{value:15.7E}" for value in row) for row in rows)
    path = tmp_path / name
    path.write_text(f"{header}\n{change(body)}\n")
    return path


def read(given):
    path, step, unit = parse_ground(str(given))
    return read_ground(path, step=step, unit=unit)


def check(ground):
    assert ground.step == pytest.approx(0.01)
    assert np.allclose(ground.acceleration / GRAVITY, MOVES, atol=1e-6)


STEPS = [
    *(
        "DT= 1.0D-02 SEC",
        "DT= 1.d-2",
        "DT=   .0100 SEC,",
        "DT= 10 MS",
        "DT= 10.0 (ms)",
        "DT(ms)= 10",
    ),
    *("DT= .0100SEC", "SAMPLING RATE= 100 HZ", "RATE: 100 SPS", "SAMPLING FREQUENCY (Hz): 100"),
    *("SAMPLING_INTERVAL_S: 0.010000", "DT= .01 SEC, SAMPLING RATE= 100 HZ", "sampled at 100 Hz"),
    *("40 points at equal spacing of 0.01 sec", "  40   0.0100   NPTS, DT", "DELTA T: 0.01 s"),
]


@pytest.mark.parametrize("said", STEPS)
@pytest.mark.parametrize("first", ["NPTS=  40, ", "TITLE\n"])
def test_a_header_says_its_step_in_many_ways(tmp_path, said, first):
    if said[0] == " ":
        first = ""
    check(read(written(tmp_path, f"{first}{said}")))


def test_exponents_of_fortran_are_read(tmp_path):
    check(read(written(tmp_path, NPTS, change=lambda body: body.replace("E", "D"))))


@pytest.mark.parametrize(
    "said",
    [
        *("DT= 0,01 SEC", "DT= 1.0-02 SEC", "DT= 0.0.1", "DT= .0100x", "DT= 1.0D-02x SEC"),
        *(
            "DT= ...",
            "DT= -",
            "DT= e",
            "DT= 1/100",
            "DT= .01 NOMINAL",
            "DT= 10",
            "DT= .01 MIN",
            "DT= .01 SEC, RATE= 200 HZ",
        ),
    ],
)
def test_a_step_that_is_not_read_whole_or_cannot_be_right_is_refused(tmp_path, said):
    path = written(tmp_path, f"NPTS= 40, {said}")
    with pytest.raises(BuildingError, match="step"):
        read(path)


@pytest.mark.parametrize("said", ["NPTS= 4O", "NPTS= 1,040", "NPTS= 40.5", "NPTS= 39"])
def test_a_number_of_values_is_read_whole(tmp_path, said):
    with pytest.raises(BuildingError, match="NPTS"):
        read(written(tmp_path, f"{said}, DT= .01 SEC"))


@pytest.mark.parametrize(
    ("said", "by"),
    [
        ("ACCELERATION DATA IN UNITS OF (CM/S/S)", IN_GAL),
        ("ACCELERATION TIME SERIES IN UNITS OF G. FILTER POINTS: HP=0.05 Hz LP=25.0 Hz", 1.0),
        ("Units: cm/sec^2", IN_GAL),
        ("Units: sec, cm/s^2", IN_GAL),
        ("UNIT = gal", IN_GAL),
        ("UNITS OF %G", 100.0),
        ("Units [mm/s2]", 10.0 * IN_GAL),
        ("UNITS: IN/S2", GRAVITY),
        ("units=cm/sec2(04),Format=(8f10.3)", IN_GAL),
        ("Acceleration: m/s^2", 9.80665),
        ("Acceleration (cm per sec per sec); units of velocity: cm/s", IN_GAL),
        ("UNITS OF TIME: SEC\nUNITS: CM/S**2", IN_GAL),
        ("Peak acceleration (cm/s/s): 294", 1.0),
    ],
)
def test_a_header_says_its_unit_in_many_ways(tmp_path, said, by):
    check(read(written(tmp_path, f"{said}\n{NPTS}", by)))


@pytest.mark.parametrize(
    "unit", ["CM/S", "COUNTS", "G/10", "1/100 G", "G X 1000", "(unknown)", "VOLTS", ""]
)
def test_a_unit_that_cannot_be_read_is_never_taken_for_g(tmp_path, unit):
    path = written(tmp_path, f"ACCELERATION IN UNITS OF {unit}\n{NPTS}")
    with pytest.raises(BuildingError, match=r"header says 'UNITS OF.* is no acceleration"):
        read(path)
    check(read_ground(path, unit="g"))


def test_units_that_contradict_each_other_are_refused(tmp_path):
    with pytest.raises(BuildingError, match=r"header says 'UNITS OF G' and 'Units: cm/s"):
        read(written(tmp_path, f"UNITS OF G\nUnits: cm/s^2\n{NPTS}"))


KNET = """Station Code      MADEUP1
Record Time       2011/03/11 14:46:36
Sampling Freq(Hz) 100Hz
Dir.              E-W
Scale Factor      FACTOR
Max. Acc. (gal)   288.1
Memo."""


@pytest.mark.parametrize(
    "factor", ["3920(gal)/6182761", "3.92D3 (gal) / 6182761", "39.2(m/s^2)/6182761"]
)
def test_counts_are_multiplied_by_their_factor(tmp_path, factor):
    check(read(written(tmp_path, KNET.replace("FACTOR", factor), COUNTS, name="quake.EW")))


@pytest.mark.parametrize("factor", ["3920/6182761", "3920(gal)/61x", "0.001", "3920(gal)/0", ""])
def test_a_factor_that_cannot_be_read_is_refused(tmp_path, factor):
    path = written(tmp_path, KNET.replace("FACTOR", factor), COUNTS, name="quake.EW")
    with pytest.raises(BuildingError, match=r"header says 'Scale Factor.*which cannot be read"):
        read(f"{path}:0.01s:gal")


@pytest.mark.parametrize(
    "lead",
    ["40 0.0100 656", "0.0100 40", "40 1.0D-02", "40\n0.01", "40. 0.01", "NPTS, DT\n40, .01"],
)
def test_a_line_of_numbers_above_the_values_is_a_header(tmp_path, lead):
    check(read(written(tmp_path, f"UNITS: gal\n{lead}", IN_GAL)))
    with pytest.raises(BuildingError, match="looks like a number of values and a step"):
        read(written(tmp_path, "UNITS: gal\n41 0.0100 656", IN_GAL))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("0.12345-0.23456\n0.1 0.2\n0.3 0.4\n", "line 1: expected numbers, got '0.12345-0.23456'"),
        ("ouch 0.2 0.3\n0.1 0.2 0.3\n", "line 1: expected numbers, got 'ouch'"),
        ("0.1 0.2 0.3\n0.1 0.2 ouch\n", "line 2: expected numbers, got 'ouch'"),
        ("0,0123\n0,0345\n-0,0456\n", "decimal commas"),
        ("0.1 1_0\n0.3 0.4\n", "line 1: expected numbers, got '1_0'"),
    ],
)
def test_no_value_is_left_out_or_split_in_silence(tmp_path, text, sentence):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(BuildingError, match=sentence):
        read(f"{path}:0.01s:g")


def test_an_impossible_peak_is_asked_about(tmp_path):
    for header, by in (("T", IN_GAL), ("UNITS OF G", IN_GAL), ("T", 1e-4), ("UNITS OF G", 1e-4)):
        path = written(tmp_path, f"{header}\n{NPTS}", by)
        with pytest.raises(BuildingError, match=r"peak would be .* g, and ground motions have"):
            read(path)
        assert np.allclose(read_ground(path, meant=True).acceleration, by * MOVES * GRAVITY)
        assert np.allclose(read(f"{path}:g").acceleration, by * MOVES * GRAVITY)
    check(read(f"{written(tmp_path, NPTS, IN_GAL)}:gal"))


@pytest.mark.parametrize(
    "end", ["0.01s", "10 ms", "100Hz", "1.0D-02s", "0.01s:g", "g:0.01s", "0.01s:%g"]
)
@pytest.mark.parametrize("folder", ["run 10:30", "C:\\gm", "10:30"])
def test_a_path_may_have_colons(tmp_path, monkeypatch, folder, end):
    monkeypatch.chdir(tmp_path)
    (tmp_path / folder).mkdir()
    by = 100.0 if "%" in end else 1.0
    written(tmp_path / folder, "T", by, name="quake.txt")
    check(read(f"{folder}/quake.txt:{end}"))
    assert parse_ground("C:\\gm\\quake.txt:0.01s") == (Path("C:\\gm\\quake.txt"), 0.01, "")


def table(tmp_path, head, form="{:.3f}", by=1.0, step=0.01):
    path = tmp_path / "quake.csv"
    rows = (f"{form.format(step * i)},{by * a:.7f}" for i, a in enumerate(MOVES))
    path.write_text("\n".join([head, *rows, ""]))
    return path


@pytest.mark.parametrize(
    ("head", "by"),
    [
        ("time,acceleration\ns,g", 1.0),
        ("Time,Acceleration\n(sec),[G]", 1.0),
        ("time,acceleration\ns,gal", IN_GAL),
        ("time,acceleration\ns,cm/s2", IN_GAL),
        ("time,acceleration\ns,%g", 100.0),
        ("time_s,Acceleration (CM/SEC/SEC)", IN_GAL),
        ("time_s,acceleration_gal", IN_GAL),
    ],
)
def test_a_table_may_have_a_row_of_units(tmp_path, head, by):
    check(read(table(tmp_path, head, by=by)))


def test_the_unit_of_the_times_may_stand_in_the_row_of_units(tmp_path):
    check(read(table(tmp_path, "time,acceleration\nms,g", step=10.0)))
    with pytest.raises(BuildingError, match="'time_s' is in 's' by its name and in 'ms' by"):
        read(table(tmp_path, "time_s,acceleration\nms,g", step=10.0))
    with pytest.raises(BuildingError, match="the file's step is 10 s"):
        read(table(tmp_path, "time,acceleration_g", step=10.0))


def test_times_may_be_rounded_to_a_quarter_of_the_step(tmp_path):
    path = table(tmp_path, "time_s,acceleration_g", "{:.3f}", step=1 / 256)
    assert read(path).step == pytest.approx(1 / 256, rel=5e-3)
    assert read(f"{path}:0.00390625s").step == 1 / 256


@pytest.mark.parametrize("form", ["{:.4f}", "{:.3f}", "{:.5g}", "{:.3g}", "{}"])
def test_times_may_be_rounded(tmp_path, form):
    path = table(tmp_path, "time_s,acceleration_g", form, step=1 / 128)
    assert read(path).step == pytest.approx(1 / 128, rel=2e-3)
    assert read(f"{path}:0.0078125s").step == 0.0078125
    with pytest.raises(BuildingError, match=r"file's step is .* and 0\.01 s was given"):
        read(f"{path}:0.01s")


def test_times_more_coarse_than_the_step_need_a_step(tmp_path):
    path = table(tmp_path, "time_s,acceleration_g", "{:.2f}", step=0.005)
    with pytest.raises(BuildingError, match="one even step"):
        read(path)
    assert read(f"{path}:0.005s").step == 0.005


def test_a_lost_sample_is_no_rounding(tmp_path):
    path = table(tmp_path, "time_s,acceleration_g", "{:.2f}")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:20], *lines[21:]]))
    for given in (path, f"{path}:0.01s"):
        with pytest.raises(BuildingError, match="one even step"):
            read(given)
