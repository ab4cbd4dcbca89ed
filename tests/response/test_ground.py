"""Ground motions are read in every layout, and mistakes name file and line."""

import os
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.applications.buildings.ground import Ground, parse_ground, read_ground
from mfd_bayes.errors import BuildingError
from mfd_bayes.units import GRAVITY

MOVES = 0.3 * np.sin(0.4 * np.arange(40)) * np.hanning(40)
NPTS = "NPTS=  40, DT= .0100 SEC"
IN_GAL = 980.665
COUNTS = 6182761 / 3920 * IN_GAL


def written(tmp_path, header, factor=1.0, *, name="quake.AT2", change=str):
    """A file of a header and of `MOVES` times a factor."""
    body = "\n".join("".join(f"{v:15.7E}" for v in row) for row in factor * MOVES.reshape(-1, 5))
    path = tmp_path / name
    path.write_text(f"{header}\n{change(body)}\n")
    return path


def table(tmp_path, head, form="{:.3f}", factor=1.0, step=0.01):
    path = tmp_path / "quake.csv"
    rows = (f"{form.format(step * i)},{factor * a:.7f}" for i, a in enumerate(MOVES))
    path.write_text("\n".join([head, *rows, ""]))
    return path


def read(source):
    path, step, unit = parse_ground(str(source))
    return read_ground(path, step=step, unit=unit)


def check(ground):
    assert ground.step == pytest.approx(0.01)
    assert np.allclose(ground.acceleration / GRAVITY, MOVES, atol=1e-6)


def refused(words, function, *args, **options):
    with pytest.raises(BuildingError, match=words):
        function(*args, **options)


def test_real_records_are_read():
    root = Path(os.environ.get("MFD_BAYES_DATA", Path(__file__).parents[3] / "shared" / "data"))
    records = root / "ground_motions"
    if not records.is_dir():
        pytest.skip(f"ground motions not found at {records}")
    ground = read_ground(records / "el_centro.AT2")
    assert ground.acceleration.size == 1559
    assert ground.peak / GRAVITY == pytest.approx(0.3188, abs=1e-4)
    refused("does not say its step", read_ground, records / "Rinaldi.AT2")
    assert read(f"{records / 'Rinaldi.AT2'}:0.01s").acceleration.size == 1991


def test_a_ground_motion_has_numbers_of_its_own():
    acceleration = np.array([1.0, -2.0, 1.5])
    ground = Ground("g", 0.02, acceleration)
    assert not np.shares_memory(ground.acceleration, acceleration)
    with pytest.raises(ValueError, match="read-only"):
        ground.acceleration[0] = 9.0
    assert ground.scaled(2.0).peak == 4.0
    assert ground.with_peak(GRAVITY).peak == pytest.approx(GRAVITY)
    ones = np.ones(5)
    for function, words, values in (
        (lambda v: Ground("g", v, ones), "step", (0.0, -0.02, np.nan, "0.02", None, True)),
        (lambda v: Ground("g", 0.02, v), "g: ", ("x", ["a"], None, [1.0], [[1.0, 2.0]])),
        (lambda v: Ground("g", 0.02, v), "g: ", ([1.0, np.nan], [0.0, 0.0], 5.0)),
        (lambda v: Ground(v, 0.02, ones), "name", (5, None)),
        (ground.scaled, "factor must be a finite number", ("2", None, np.nan, [2.0])),
        (ground.with_peak, "peak must be a finite number above 0", ("2", None, np.nan, 0.0)),
        (read_ground, "ground must be a path", (None, 5, b"a.txt", ["a.txt"], "a\0b")),
        (lambda v: read_ground("a.txt", step=v), "step", (0.0, np.nan, "0.02", [0.02])),
        (lambda v: read_ground("a.txt", unit=v), "unit must be text", (5, None, ["g"])),
        (parse_ground, r"expected FILE, FILE:0\.01s", ("a.txt:fast", "a.txt:0.02")),
    ):
        for value in values:
            refused(words, function, value)


# --- headers


def test_a_header_says_its_step_in_many_ways(tmp_path):
    for text in (
        *("DT= 1.0D-02 SEC", "DT= 1.d-2", "DT=   .0100 SEC,", "DT= 10.0 (ms)", "DT(ms)= 10"),
        *("DT= .0100SEC", "SAMPLING RATE= 100 HZ", "RATE: 100 SPS", "sampled at 100 Hz"),
        *("SAMPLING FREQUENCY (Hz): 100", "SAMPLING_INTERVAL_S: 0.010000", "DELTA T: 0.01 s"),
        *("DT= .01 SEC, SAMPLING RATE= 100 HZ", "40 points at equal spacing of 0.01 sec"),
    ):
        for heading in ("NPTS=  40, ", "TITLE\n"):
            check(read(written(tmp_path, f"{heading}{text}")))
    check(read(written(tmp_path, "  40   0.0100   NPTS, DT")))
    check(read(written(tmp_path, NPTS, change=lambda body: body.replace("E", "D"))))  # Fortran's


def test_a_step_that_is_not_read_whole_or_cannot_be_right_is_refused(tmp_path):
    for text in (
        *("DT= 0,01 SEC", "DT= 1.0-02 SEC", "DT= 0.0.1", "DT= .0100x", "DT= 1.0D-02x SEC"),
        *("DT= ...", "DT= 1/100", "DT= .01 NOMINAL", "DT= 10", "DT= .01 MIN"),
        "DT= .01 SEC, RATE= 200 HZ",
    ):
        refused("step", read, written(tmp_path, f"NPTS= 40, {text}"))
    for text in ("NPTS= 4O", "NPTS= 1,040", "NPTS= 40.5", "NPTS= 39"):
        refused("NPTS", read, written(tmp_path, f"{text}, DT= .01 SEC"))


def test_a_header_says_its_unit_in_many_ways(tmp_path):
    for text, factor in (
        ("ACCELERATION DATA IN UNITS OF (CM/S/S)", IN_GAL),
        ("ACCELERATION TIME SERIES IN UNITS OF G. FILTER POINTS: HP=0.05 Hz LP=25.0 Hz", 1.0),
        ("Units: cm/sec^2", IN_GAL),
        ("Units: sec, cm/s^2", IN_GAL),
        ("UNIT = gal", IN_GAL),
        ("UNITS OF %G", 100.0),
        ("Units [mm/s2]", 10.0 * IN_GAL),
        ("UNITS OF {CM/S/S}", IN_GAL),
        ("UNITS OF CM/S/S (GAL)", IN_GAL),
        ("UNITS OF G/10", 10.0),
        ("40 points of accel data equally spaced at .010 sec, in g/10. (8f10.6)", 10.0),
        ("UNITS: IN/S2", GRAVITY),
        ("units=cm/sec2(04),Format=(8f10.3)", IN_GAL),
        ("Acceleration (cm per sec per sec); units of velocity: cm/s", IN_GAL),
        ("UNITS OF TIME: SEC\nUNITS: CM/S**2", IN_GAL),
        ("Peak acceleration (cm/s/s): 294", 1.0),
    ):
        check(read(written(tmp_path, f"{text}\n{NPTS}", factor)))


def test_a_unit_that_cannot_be_read_is_never_taken_for_g(tmp_path):
    words = r"header says 'UNITS OF.* is no acceleration"
    for unit in ("CM/S", "COUNTS", "1/100 G", "G X 1000", "(G)*10", "(unknown)", ""):
        path = written(tmp_path, f"ACCELERATION IN UNITS OF {unit}\n{NPTS}")
        refused(words, read, path)
        if unit in ("", "(unknown)"):
            check(read_ground(path, unit="g"))
        else:  # it says something else than g
            refused(words, read_ground, path, unit="g")
    refused("'VELOCITY', and not", read, written(tmp_path, f"VELOCITY TIME SERIES\n{NPTS}"))
    refused("'V/g', and not", read, written(tmp_path, f"Accelerometer, 1.25 V/g\n{NPTS}"))
    path = written(tmp_path, f"UNITS OF G\nUnits: cm/s^2\n{NPTS}")
    refused(r"header says 'UNITS OF G' and 'Units: cm/s", read, path)


KNET = """Station Code      MADEUP1
Record Time       2011/03/11 14:46:36
Sampling Freq(Hz) 100Hz
Dir.              E-W
Scale Factor      FACTOR
Max. Acc. (gal)   288.1
Memo."""


def test_counts_are_multiplied_by_their_factor(tmp_path):
    def counts(factor):
        return written(tmp_path, KNET.replace("FACTOR", factor), COUNTS, name="quake.EW")

    for factor in ("3920(gal)/6182761", "3.92D3 (gal) / 6182761", "39.2(m/s^2)/6182761"):
        check(read(counts(factor)))
    for factor in ("3920/6182761", "3920(gal)/61x", "0.001", "3920(gal)/0", ""):
        words = r"header says 'Scale Factor.*which cannot be read"
        refused(words, read, f"{counts(factor)}:0.01s:gal")


def test_a_line_of_numbers_above_the_values_is_a_header(tmp_path):
    for lead in ("40 0.0100 656", "0.0100 40", "40 1.0D-02", "40\n0.01", "NPTS, DT\n40, .01"):
        check(read(written(tmp_path, f"UNITS: gal\n{lead}", IN_GAL)))
    path = written(tmp_path, "UNITS: gal\n41 0.0100 656", IN_GAL)
    refused("looks like a number of values and a step", read, path)


def test_what_is_given_may_not_contradict_the_file(tmp_path):
    path = written(tmp_path, f"UNITS OF G\n{NPTS}")
    check(read_ground(path, step=0.01, unit="g"))
    refused(r"the file's step is 0\.01 s, and 0\.005 s", read_ground, path, step=0.005)
    words = r"header says 'UNITS OF G', and 'cm/s\^2' was given"
    refused(words, read_ground, path, unit="cm/s^2")
    path = written(tmp_path, NPTS.replace(".0100", ".0039"))
    assert read_ground(path, step=1 / 256).step == 0.0039  # a header rounds
    path = table(tmp_path, "time_s,acceleration_g")
    check(read_ground(path, step=0.01, unit="g"))
    refused(r"quake\.csv: the file's step is 0\.01 s, and 0\.02 s", read_ground, path, step=0.02)
    refused(r"'acceleration_g' .*'g', and 'm/s\^2' was given", read_ground, path, unit="m/s^2")


def test_an_impossible_peak_is_asked_about(tmp_path):
    for header, scale in (("T", IN_GAL), ("UNITS OF G", IN_GAL), ("T", 1e-4), ("UNITS OF G", 1e-4)):
        path = written(tmp_path, f"{header}\n{NPTS}", scale)
        for source in (path, f"{path}:g"):
            refused(r"peak would be .* g, and ground motions have", read, source)
        assert np.allclose(read_ground(path, meant=True).acceleration, scale * MOVES * GRAVITY)
        check(read_ground(path, scale=1.0 / scale))
    check(read(f"{written(tmp_path, NPTS, IN_GAL)}:gal"))
    path = written(tmp_path, NPTS, 9.0)  # 2.6 g
    refused("2 g where no unit is stated: give the unit", read, path)
    assert np.allclose(read(f"{path}:g").acceleration, 9.0 * MOVES * GRAVITY)


# --- files of agencies, and what is no ground motion

BLOCK = "\n".join("".join(f"{v:10.2f}" for v in row) for row in IN_GAL * MOVES.reshape(-1, 8))
WHOLE = "\n".join([" 2016 11 13 11 2 560 0 4"] * 5)
REALS = "\n".join(["  200.0  0.70  0.00  0.00  0.00  0.00  0.00  1.00"] * 5)
GEONET = """Corrected accelerogram 2016 Lab
Site X  Cusp file: 2016
Number of points  40    Duration 0.40 sec
Instrument corrected data at 0.010 sec intervals
Acceleration:  peak  2884.7 mm/s/s at  0.2 sec"""
COSMOS = """Corrected acceleration  (Format v01.20 with 13 text lines)
 100 Integer-header values follow on  10 lines, Format= (10I8)"""
CSMIP = "40 points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.2)"
SMC = "2 CORRECTED ACCELEROGRAM\n*\nXX01A"
BHRC = """* VOL1DS FILE: 1 (BHRC)
NO. OF POINTS =  40   DURATION = 0.4
UNITS ARE SECONDS AND G/10"""
SAC = "\n".join(["-12345.00 -12345.00 -12345.00 -12345.00 -12345.00"] * 4)


@pytest.mark.parametrize(
    ("name", "lines", "words"),
    [
        ("quake.V1A", (GEONET, WHOLE, REALS, BLOCK), "NPTS = 40, and there are 120 .*GeoNet"),
        ("quake.V2A", (GEONET, WHOLE, REALS, BLOCK, BLOCK), "file of GeoNet"),
        ("quake.V2c", (COSMOS, WHOLE, " 100 Real-header values", REALS, BLOCK), "file of COSMOS"),
        ("quake.V2", (WHOLE, CSMIP, BLOCK, CSMIP.replace("accel", "veloc"), BLOCK), "of CSMIP"),
        ("quake.smc", (SMC, WHOLE, "1.7E+38 1.7E+38 1.7E+38", BLOCK), "another layout.*SMC"),
        ("quake.V1", (BHRC, WHOLE, BLOCK), "NPTS = 40, and there are 80 values.*BHRC"),
        ("quake.sac", (SAC, BLOCK), "another layout.*SAC"),
        ("quake.txt", (WHOLE, BLOCK), "row '2016 11 13 .* is of another layout"),
        ("quake.txt", ("x\n-1.25-1.50-1.75", BLOCK), "which run together"),
        *(
            ("quake.txt", (count, BLOCK, BLOCK), "NPTS = 40, and there are 80 values")
            for count in (
                *("Number of points  40", "NO. OF POINTS = 40", "NDATA: 40", "# of points: 40"),
                *("40 points of accel data", "  40 acceleration pts", "Points: 40", "40 samples"),
                *("Number of samples 40", "Length: 40 samples", "N_POINTS = 40"),
            )
        ),
        ("quake.txt", ("Max. Acc. (gal)  28.8", BLOCK), "'Max. Acc.*28.8'.* 0.0294 g, .* 0.296 g"),
        ("quake.VT2", (BLOCK,), "'.VT2', and not that the numbers are accelerations"),
        ("quake.txt", ("DATA_TYPE: VELOCITY", BLOCK), "'VELOCITY', and not"),
        ("quake.txt", ("SLIST, INTEGER, Counts", BLOCK), "'Counts', and not"),
    ],
)
def test_numbers_that_are_no_accelerations_are_refused_whatever_unit_is_given(
    tmp_path, name, lines, words
):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    refused(words, read_ground, path, step=0.01, unit="cm/s^2")


def test_an_agencys_header_above_the_acceleration_alone_is_read(tmp_path):
    path = tmp_path / "quake.txt"
    for header in (GEONET, CSMIP, f"TIMESERIES X, 40 samples, 100 sps, SLIST\n{CSMIP}"):
        path.write_text(f"{header}\n{BLOCK}\n")
        ground = read_ground(path, unit="cm/s^2")
        assert ground.step == 0.01
        assert np.allclose(ground.acceleration / GRAVITY, MOVES, atol=1e-5)


@pytest.mark.parametrize("periods", [0.01 * np.arange(1.0, 101.0), np.geomspace(0.01, 10.0, 100)])
def test_a_spectrum_is_no_ground_motion(tmp_path, periods):
    spectrum = 0.5 * np.exp(-((np.log(periods) + 1.2) ** 2))
    for head in ("Period (s),Sa (g)", "T [s],PSA [g]", "period_s,acc_g", "T,Sa\ns,g"):
        path = tmp_path / "quake.csv"
        rows = (f"{t:.4f},{a:.5f}" for t, a in zip(periods, spectrum, strict=True))
        path.write_text("\n".join([head, *rows, ""]))
        refused("not a spectrum", read, path)
    path = tmp_path / "quake.txt"
    for columns in ((periods, spectrum), (periods, spectrum, spectrum), (1 / periods, spectrum)):
        np.savetxt(path, np.column_stack(columns))
        refused("columns of a spectrum", read, f"{path}:0.01s:g")
    np.savetxt(path, spectrum)
    refused("not a spectrum", read, f"{path}:0.01s:g")
    path.write_text("\n".join(f"{a + 0.4}" for a in MOVES))  # an offset
    refused("values with an offset", read, f"{path}:0.01s:g")


# --- values


def test_columns_of_time_and_acceleration_are_not_read_as_one(tmp_path):
    path, moves = tmp_path / "a.txt", np.sin(np.arange(40.0))
    for digits, separator, width in ((2, "  ", 2), (4, ", ", 2), (2, ";", 3), (4, "  ", 3)):
        rows = [
            [f"{0.02 * i:.{digits}f}", *[f"{a:.4f}"] * (width - 1)] for i, a in enumerate(moves)
        ]
        path.write_text("time accel\n" + "\n".join(map(separator.join, rows)))
        words = "looks like columns of time and acceleration: save"
        refused(words, read_ground, path, step=0.02)
    rows = "\n".join(f"{a:.4f} {-a:.4f} {a / 2:.4f}" for a in moves)
    for header in ("UNITS: g\nN-S E-W U-D", "NUMBER OF DATA: 40\nUNITS: g"):
        path.write_text(f"{header}\n{rows}\n")
        refused("columns of 3 components", read_ground, path, step=0.02)


def test_accelerations_in_rows_are_read_along_the_rows(tmp_path):
    path, moves = tmp_path / "a.txt", np.sin(np.arange(30.0)).round(4)
    ramp = 0.1 * np.arange(-14.5, 15.0).round(1)
    for width in (1, 2, 3, 5):
        for values, header, step in ((moves, "", 0.02), (ramp, "NPTS= 30, DT= .02 SEC\n", None)):
            # the header says that all of them are accelerations
            lines = (" ".join(map(str, row)) for row in values.reshape(-1, width))
            path.write_text(header + "\n".join(lines))
            assert np.allclose(read_ground(path, step=step).acceleration / GRAVITY, values)


def test_no_value_is_left_out_or_split_in_silence(tmp_path):
    path = tmp_path / "a.txt"
    for text, sentence in (
        ("0.12345-0.23456\n0.1 0.2\n0.3 0.4\n", "line 1: expected numbers, got '0.12345-0.23456'"),
        ("ouch 0.2 0.3\n0.1 0.2 0.3\n", "line 1: expected numbers, got 'ouch'"),
        ("0.1 0.2 0.3\n0.1 0.2 ouch\n", "line 2: expected numbers, got 'ouch'"),
        ("0,0123\n0,0345\n-0,0456\n", "decimal commas"),
        ("0.1 1_0\n0.3 0.4\n", "line 1: expected numbers, got '1_0'"),
    ):
        path.write_text(text)
        refused(sentence, read, f"{path}:0.01s:g")


@pytest.mark.parametrize("folder", ["run 10:30", "C:\\gm", "10:30"])
def test_a_path_may_have_colons(tmp_path, monkeypatch, folder):
    monkeypatch.chdir(tmp_path)
    (tmp_path / folder).mkdir()
    for end in ("0.01s", "10 ms", "100Hz", "1.0D-02s", "0.01s:g", "g:0.01s", "0.01s:%g"):
        written(tmp_path / folder, "T", 100.0 if "%" in end else 1.0, name="quake.txt")
        check(read(f"{folder}/quake.txt:{end}"))
    assert parse_ground("C:\\gm\\quake.txt:0.01s") == (Path("C:\\gm\\quake.txt"), 0.01, "")


# --- tables


def test_a_table_has_units_in_its_names_or_in_a_row(tmp_path):
    for head, factor in (
        ("time,acceleration\ns,g", 1.0),
        ("Time,Acceleration\n(sec),[G]", 1.0),
        ("time,acceleration\ns,cm/s2", IN_GAL),
        ("time,acceleration\ns,%g", 100.0),
        ("time_s,Acceleration (CM/SEC/SEC)", IN_GAL),
        ("time_s,acceleration_gal", IN_GAL),
        ("time_s,acc_ms2", 0.01 * IN_GAL),
        ("time,acceleration\ns,mg", 1000.0),
        ("# time acceleration\n# s cm/s2", IN_GAL),
        ("Time [s],Acceleration [g] EW", 1.0),
        ("t,a\ns,m/s2", 0.01 * IN_GAL),
        ("Zeit [s],Beschleunigung [m/s²]", 0.01 * IN_GAL),
    ):
        check(read(table(tmp_path, head, factor=factor)))
    check(read(table(tmp_path, "time,acceleration\nms,g", step=10.0)))
    path = table(tmp_path, "time_s,acceleration\nms,g", step=10.0)
    refused("'time_s' is in 's' by its name and in 'ms' by", read, path)
    refused("file's step is 10 s", read, table(tmp_path, "time,acceleration_g", step=10.0))


def test_times_may_be_rounded_but_no_sample_may_be_lost(tmp_path):
    for form, hertz in (("{:.4f}", 128), ("{:.5g}", 128), ("{:.3g}", 128), ("{:.3f}", 256)):
        path = table(tmp_path, "time_s,acceleration_g", form, step=1 / hertz)
        assert read(path).step == pytest.approx(1 / hertz, rel=5e-3)
        assert read(f"{path}:{1 / hertz}s").step == 1 / hertz
        refused(r"file's step is .* and 0\.01 s was given", read, f"{path}:0.01s")
    path = table(tmp_path, "time_s,acceleration_g", "{:.2f}", step=0.005)  # too coarse
    refused("one even step", read, path)
    assert read(f"{path}:0.005s").step == 0.005
    path = table(tmp_path, "time_s,acceleration_g", "{:.2f}")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:20], *lines[21:]]))
    for source in (path, f"{path}:0.01s"):
        refused("one even step", read, source)
