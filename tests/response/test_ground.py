"""Ground motions are read in every layout, and mistakes name file and line."""

import os
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.ground import Ground, ground_of, parse_ground, read_ground
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


def test_a_still_ground_is_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("0\n0\n0\n")
    with pytest.raises(BuildingError, match="does not move"):
        read_ground(path, step=0.1)


def test_what_follows_a_file_is_its_step_and_unit():
    assert parse_ground("a.txt:10ms:cm/s^2") == (Path("a.txt"), pytest.approx(0.01), "cm/s^2")
    with pytest.raises(BuildingError, match=r"expected FILE, FILE:0\.01s"):
        parse_ground("a.txt:fast")


@pytest.mark.parametrize("step", ["...", "-", "e"])
def test_a_header_whose_step_is_no_number_does_not_say_it(tmp_path, step):
    path = tmp_path / "a.AT2"
    path.write_text(PEER.replace("DT=   .0100", f"DT= {step}"))
    with pytest.raises(BuildingError, match="does not say its step"):
        read_ground(path)


@pytest.mark.parametrize("step", [0.0, -0.02, np.nan, "0.02", None, True, [0.02]])
def test_a_step_is_a_number_above_zero(step, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("0.1 0.2 0.3")
    for made in (Ground, ground_of):
        with pytest.raises(BuildingError, match="step of a ground motion must be a finite number"):
            made("g", step, np.ones(5))
    with pytest.raises(BuildingError, match="step"):
        read_ground(path, step=step)


@pytest.mark.parametrize(
    "values", ["x", ["a"], None, [1.0], [[1.0, 2.0]], [1.0, np.nan], [0.0, 0.0], 5.0]
)
def test_a_ground_motion_is_a_row_of_finite_numbers_that_are_not_all_zero(values):
    for made in (Ground, ground_of):
        with pytest.raises(BuildingError, match="g: "):
            made("g", 0.02, values)


def test_a_ground_motion_has_numbers_of_its_own():
    given = np.array([1.0, -2.0, 1.5])
    for made in (Ground, ground_of):
        ground = made("g", 0.02, given)
        assert not np.shares_memory(ground.acceleration, given)
        with pytest.raises(ValueError, match="read-only"):
            ground.acceleration[0] = 9.0
        assert ground.scaled(2.0).peak == 4.0


@pytest.mark.parametrize("by", ["2", None, np.nan, [2.0]])
def test_a_ground_motion_is_scaled_by_a_number(by):
    ground = Ground("g", 0.02, [1.0, -2.0, 1.5])
    with pytest.raises(BuildingError, match="factor must be a finite number"):
        ground.scaled(by)
    with pytest.raises(BuildingError, match="peak must be a finite number above 0"):
        ground.with_peak(by)


@pytest.mark.parametrize("path", [None, 5, b"a.txt", ["a.txt"], "a\0b"])
def test_what_is_no_path_of_a_ground_motion_is_refused(path):
    with pytest.raises(BuildingError, match="ground must be a path"):
        read_ground(path)


def test_a_unit_is_text_and_a_wrong_end_of_a_path_is_named():
    for unit in (5, None, ["g"]):
        with pytest.raises(BuildingError, match="unit must be text"):
            read_ground("a.txt", unit=unit)
    with pytest.raises(BuildingError, match=r"^ground 'a\.txt:0\.02': expected FILE"):
        parse_ground("a.txt:0.02", of="ground")


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
    ramp = np.arange(1.0, 31.0)  # the header says that all of them are accelerations
    lines = (" ".join(map(str, row)) for row in ramp.reshape(-1, width))
    path.write_text("NPTS= 30, DT= .02 SEC\n" + "\n".join(lines))
    assert np.allclose(read_ground(path).acceleration / GRAVITY, ramp)


@pytest.mark.parametrize("header", ["CM/S/S", "cm/sec/sec.", "CM/S2", "CM/SEC**2", "cm/s^2", "GAL"])
def test_a_header_says_the_unit_of_its_values(tmp_path, header):
    path = tmp_path / "a.AT2"
    path.write_text(PEER.replace("UNITS OF G", f"UNITS OF {header}"))
    for unit in ("", "cm/s^2"):
        ground = read_ground(path, unit=unit)
        assert ground.acceleration[0] == pytest.approx(0.01 / 2.54)
    with pytest.raises(BuildingError, match=r"a\.AT2: the header says 'UNITS OF .*, and 'g' was"):
        read_ground(path, unit="g")


def test_a_header_whose_unit_is_no_acceleration_is_refused(tmp_path):
    path = tmp_path / "a.VT2"
    path.write_text(PEER.replace("UNITS OF G", "UNITS OF CM/S"))
    with pytest.raises(BuildingError, match=r"'UNITS OF CM/S', which is no acceleration"):
        read_ground(path)
    assert read_ground(path, unit="g").acceleration[0] == pytest.approx(0.01 * GRAVITY)


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
