"""Traces and records: what is read of arrays and of a file, cut, thinned, and what is refused."""

import hashlib
import os
from fractions import Fraction

import numpy as np
import pandas as pd
import pint
import pytest

import mfd_bayes as mb
from mfd_bayes.errors import FitError, MfdError, real_number, real_numbers
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import Source, Subtracted, checked_window
from mfd_bayes.units import parse_mass, parse_quantity

RATE = 200.0
TIME = np.arange(2001) / RATE
MOTION = np.sin(np.pi * TIME)  # 0.5 Hz, 1 in
FORCE = 2.0 + np.cos(np.pi * TIME)
UNIT = pint.UnitRegistry()


def write(folder, **columns):
    columns = columns or {"time_s": TIME, "displacement_in": MOTION, "force_kip": FORCE}
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(folder / "a.csv", table, "%.17g", ",", header=header, comments="")
    return folder / "a.csv"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("record"))


@pytest.fixture(scope="module")
def record(path):
    return mb.read_record(path, actuation="30 lb")


def refused(named, function, *args, **options):
    with pytest.raises(MfdError, match=named) as caught:
        function(*args, **options)
    assert "\n" not in str(caught.value)


# --- traces of arrays

BAD_ARRAYS = (
    np.ma.masked_greater(MOTION, 0.5),
    MOTION + 1j,
    MOTION.astype(str),
    np.array([*MOTION[:-1], "a"], dtype=object),
    np.full(MOTION.shape, np.datetime64("2020-01-01")),
    MOTION * UNIT.mm,
    np.where(TIME < 2, 1.0, np.nan),
    np.column_stack([MOTION, MOTION]),
    [[1.0], [1.0, 2.0]],
    MOTION[1:],
)


@pytest.mark.filterwarnings("ignore::pint.UnitStrippedWarning")
def test_arrays_that_make_no_trace_are_refused_and_not_cast():
    for name in ("displacement", "actuation", "force", "velocity"):
        for values in BAD_ARRAYS:
            arrays = {"displacement": MOTION, name: values}
            refused(name, mb.Trace.from_arrays, TIME, **arrays)
    for arrays, named in (
        ({"time": [0, 1], "displacement": [0, 1]}, "3 samples"),
        ({"time": [0, 1, 1]}, "sample 2"),
        ({"actuation": [0, -1, 0]}, "sample 1"),
        *(({"actuation": v}, "actuation") for v in (-1, np.inf, True, 800 * UNIT.psi)),
        *(({"hysteresis": v}, "hysteresis") for v in (True, "0.1", [0.1], np.nan, -1.0)),
    ):
        inputs = {"time": [0, 1, 2], "displacement": [0, 1, 0]} | arrays
        refused(named, mb.Trace.from_arrays, **inputs)


def test_a_trace_has_its_own_arrays_and_the_velocity_of_its_motion():
    motion = MOTION.copy()
    trace = mb.Trace.from_arrays(TIME, motion, 0.5 + 0 * TIME, FORCE)
    motion[:] = 0
    assert trace.displacement[100] == pytest.approx(1.0)
    np.testing.assert_allclose(trace.velocity, np.pi * np.cos(np.pi * TIME), atol=0.03)
    arrays = [trace.turning_points, *vars(trace).values(), *vars(trace.path).values()]
    arrays = [values for values in arrays if isinstance(values, np.ndarray)]
    assert len(arrays) > 12
    assert not any(values.flags.writeable for values in arrays)
    assert (trace.varying, trace.reference_actuation) == (True, 0.5)
    level = mb.Trace.from_arrays(TIME, MOTION, 0.8)
    assert (level.varying, level.reference_actuation) == (False, 0.8)
    assert np.isnan(mb.Trace.from_arrays(TIME, MOTION).reference_actuation)


# --- turning points


def turns(motion, hysteresis=None):
    time = np.arange(len(motion)) / 100
    return mb.Trace.from_arrays(time, motion, hysteresis=hysteresis).turning_points


def test_turning_points_are_the_extremes_beyond_the_hysteresis():
    np.testing.assert_allclose(TIME[turns(MOTION)], np.arange(0.5, 10, 1), atol=1e-9)
    assert mb.Trace.from_arrays(TIME, -MOTION).direction == -1
    ripple = MOTION + 1e-3 * np.sin(2 * np.pi * 40 * TIME)
    assert turns(ripple, 0.01).size == 10 < turns(ripple, 1e-5).size
    assert turns(np.array([0, 1, 1, 1, 0, 0, 1, 1.0]), 0.1).tolist() == [3, 5]


def test_noise_of_a_sensor_makes_no_turns_and_a_smooth_small_motion_does():
    time = np.arange(1200) / 100
    clean = 20.0 * np.sin(2 * np.pi * 0.25 * time)
    noisy = clean + 0.02 * np.random.default_rng(3).standard_normal(time.size)
    assert turns(noisy).size == turns(clean).size == 6
    coarse = np.arange(240) / 20
    small = np.where(coarse < 6.0, 1.0, 0.004)  # 0.4 % of the stroke, 10 samples a turn
    assert turns(small * np.sin(2 * np.pi * coarse)).size >= 22


# --- numbers, windows and paths


def test_a_number_is_taken_in_every_form_and_what_is_none_is_refused(record):
    for value in (2, np.float32(2), np.array(2.0), Fraction(4, 2)):
        assert real_number("x", value, FitError, (0.0, np.inf)) == 2.0
        np.testing.assert_array_equal(real_numbers("x", [value, 1]), [2.0, 1.0])
    for value in (True, "2", [2.0], np.nan, np.inf, 10**400, 2j, -1.0):
        refused("x must be", real_number, "x", value, FitError, (0.0, np.inf))
        refused("gap", record.trace, gap=value)


def test_a_window_is_two_times_in_every_form(record, path):
    for window in (5, (0, True), ("0", "4"), {0, 4}, ([0], 4), (4, 0), b"04", ()):
        refused("two times", record.trace, window=window)
        refused("two times", mb.read_record, path, window=window)
        refused("given", checked_window, window, "given", FitError)
    expected = record.trace(window=(0, 4)).time
    assert expected[-1] == 4.0
    for window in ([0, 4], np.array([0, 4]), (-np.inf, 4), "0 s to 4000 ms"):
        fitted = mb.read_record(path, window=window)
        np.testing.assert_array_equal(fitted.trace().time, expected)
    assert fitted.trace(window=(0, 10)).samples == TIME.size


def test_paths_columns_units_and_quantities_are_of_their_kind(path, tmp_path):
    for value in (None, 5, b"a", ["a"], "a\0b"):
        refused("path must be a path", mb.read_record, value)
    os.mkfifo(tmp_path / "a.csv")
    for name, named in ((f"{5000 * 'a'}.csv", "aaa"), (tmp_path, "folder"), ("a.csv", "pipe")):
        refused(named, read_table, tmp_path / name)
    for value in (["time_s"], 5, pd.Series({"time": "time_s"}), ""):
        refused("columns", mb.read_record, path, columns=value)
        refused("units", mb.read_record, path, units=value)
        refused("number and a unit", parse_quantity, value, "force")
        refused("number and a unit", parse_mass, value)


# --- records of files


def test_headers_say_roles_and_units(record, path):
    np.testing.assert_allclose(record.time, TIME, rtol=1e-14)
    np.testing.assert_allclose(record.force, FORCE, rtol=1e-14)
    assert (record.actuation, record.actuation_unit) == (pytest.approx(0.03), "kip")
    assert record.columns["force"] == ("force_kip", "kip")
    assert record.rate == pytest.approx(RATE)
    assert record.clock.words() == "200 Hz, jitter 0.00% of a step"
    assert record.turning_points == 10
    assert record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_unit_is_that_of_the_name_or_of_the_row_of_units(tmp_path):
    for name, row, unit in (
        ("force_kN", "", "kN"),
        ("Force [kN]", "", "kN"),
        ("force", "Kips", "Kips"),
        ("axial_force", "kN", "kN"),
        ("force_1", "kN", "kN"),
        ("force_kips", "Kip", "kips"),
        ("force_kN", "lbf", None),
        ("force_kN", "segments", None),
        ("force", "", None),
    ):
        path = write(tmp_path, Time=TIME, Disp=MOTION, **{name: FORCE})
        names, *rows = path.read_text().splitlines()
        path.write_text("\n".join([names, f"s,mm,{row or '-'}", *rows]))
        roles = {"time": "Time", "displacement": "Disp", "force": name}
        if unit is None:
            refused(f"'{name}'.*give the unit of force", mb.read_record, path, roles)
        else:
            assert mb.read_record(path, roles).columns["force"] == (name, unit)
        assert mb.read_record(path, roles, {"force": "lbf"}).columns["force"][1] == "lbf"


COLUMNS, FIVE = {"time_s": TIME, "displacement_in": MOTION}, {"actuation": "5 psi"}
STILL_TIME = np.where(np.arange(TIME.size) == 100, TIME[99], TIME)
PIECES = np.arange(300) // 10 * 5.0 + np.arange(300) % 10 * 0.01


def test_what_is_no_record_is_refused_in_one_sentence(tmp_path):
    for columns, options, named in (
        (COLUMNS | {"actuation_psi": -1 + 0 * TIME}, {}, "actuation"),
        (COLUMNS | {"p_psi": TIME}, {"columns": {"actuation": "p_psi"}} | FIVE, "'5 psi'"),
        (COLUMNS, {"units": {"displacement": "kip"}}, "'displacement_in'"),
        (COLUMNS, {"columns": {"force": "time_s", "time": "time_s"}}, "time_s"),
        ({"t": TIME, "x": MOTION}, {}, "t, x"),
        (COLUMNS | {"displacement_mm": MOTION}, {}, "displacement_mm"),
        (COLUMNS, {"columns": {"speed": "time_s"}}, "'speed'"),
        (COLUMNS, {"columns": {"time": "time_s", "displacement": "x"}}, "'x'"),
        ({"time_s": TIME[:19], "displacement_in": MOTION[:19]}, {}, "19 samples"),
        (COLUMNS | {"time_s": STILL_TIME}, {}, "line 102"),
        ({"time_s": PIECES, "displacement_in": np.sin(PIECES)}, {}, "20 samples"),
        (COLUMNS | {"displacement_in": 0 * TIME}, {}, "constant"),
        (COLUMNS | {"displacement_in": np.sin(TIME / 3.2)}, {}, "1 turning points"),
        (COLUMNS, {"window": "20 s to 30 s"}, "0 samples"),
        (COLUMNS, {"window": "2 s to 3 s"}, "turning points"),
    ):
        refused(named, mb.read_record, write(tmp_path, **columns), **options)


def test_of_a_time_with_gaps_the_longest_piece_inside_the_window_is_used(tmp_path):
    time = TIME + np.where(TIME > 6, 1.5, 0) + np.where(TIME > 9, 4.0, 0)
    path = write(tmp_path, time_s=time, displacement_in=MOTION)
    record = mb.read_record(path)
    assert record.time[-1] == 6.0
    assert "2 gaps, the longest of 4.005 s" in record.gap
    assert "39% of the record" in record.gap
    piece = mb.read_record(path, window="7 s to 10.5 s")
    assert (piece.time[0], piece.time[-1]) == (7.505, 10.5)
    np.testing.assert_array_equal(piece.displacement, MOTION[(TIME > 6) & (TIME <= 9)])
    paused = TIME + 0.02 * np.cumsum(np.arange(TIME.size) % 400 == 399)
    words = mb.read_record(write(tmp_path, time_s=paused, displacement_in=MOTION)).clock.words()
    assert "pauses 5 times, for up to 0.025 s" in words


@pytest.mark.parametrize("rate", [256.0, 600.0])
def test_rounded_time_stamps_do_not_change_the_rate(tmp_path, rate):
    time = np.round(np.arange(4000) / rate, 3)
    path = write(tmp_path, time_s=time, displacement_in=np.sin(2 * np.pi * time))
    record = mb.read_record(path)
    assert record.rate == pytest.approx(rate, rel=1e-3)
    assert record.trace(0.875 * rate).samples == pytest.approx(3500, abs=2)


# --- traces of a record


def test_a_trace_without_rate_or_gap_has_every_sample(record):
    for trace in (record.trace(), record.trace(rate=RATE), record.trace(rate=1e6)):
        np.testing.assert_array_equal(trace.time, record.time)
        np.testing.assert_array_equal(trace.force, record.force)
    for rate in (0, -1, np.nan, 1e-6, 1.5):
        refused("Hz", record.trace, rate=rate)


@pytest.mark.parametrize("rate", [20.0, 150.0])
@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_decimation_has_no_delay_and_no_edge_transient(tmp_path, rate, uneven):
    rng = np.random.default_rng(1)
    time = np.sort(TIME + uneven * rng.uniform(-1.0, 1.0, TIME.size) / RATE)
    columns = {"displacement_in": np.sin(np.pi * time), "force_kip": 2 + np.cos(np.pi * time)}
    record = mb.read_record(write(tmp_path, time_s=time, **columns))
    trace = record.trace(rate=rate)
    assert np.diff(trace.time) == pytest.approx(1 / rate, rel=1e-3)
    np.testing.assert_allclose(trace.displacement, np.sin(np.pi * trace.time), atol=2e-3)
    np.testing.assert_allclose(trace.force, 2 + np.cos(np.pi * trace.time), atol=6e-3)
    if rate == 20.0 and not uneven:
        segment = record.trace(rate=rate, window=(2.0, 6.0))
        np.testing.assert_allclose(segment.force, trace.force[40:121], atol=1e-12)


def test_a_tone_above_the_new_nyquist_is_down_by_40_db_and_one_below_passes(tmp_path):
    time = np.arange(8192) / 1024
    for hertz, lower, upper in ((38.4, 0.0, 0.01), (105.6, 0.0, 0.01), (20.0, 0.98, 1.02)):
        tone = np.sin(2 * np.pi * hertz * time + 0.7)
        assert np.max(np.abs(tone[::16])) > 0.5  # without a filter it would be folded back
        motion = np.sin(np.pi * time)
        path = write(tmp_path, time_s=time, displacement_in=motion, force_kip=tone)
        low = mb.read_record(path).trace(rate=64).force[20:-20]
        assert lower <= np.max(np.abs(low)) <= upper


def test_the_default_rate_resolves_the_gap_and_the_half_cycles_below_the_cap(tmp_path):
    def rate_of(gap, samples=10_241):
        time = np.arange(samples) / 1024
        path = write(tmp_path, time_s=time, displacement_in=np.sin(np.pi * time))
        trace = mb.read_record(path).trace(gap=gap)
        assert trace.samples <= 6001
        return 1.0 / np.diff(trace.time).mean()

    crossing = np.arccos(0.8) / np.pi
    assert 20 / crossing <= rate_of(0.2) * 1.001 < 1.1 * 20 / crossing
    assert 39.9 <= rate_of(5.0) < 42
    assert rate_of(1e-6) == pytest.approx(1024 / 2)


@pytest.mark.parametrize("margin", [1, 3, 40])
def test_what_a_window_leaves_out_is_given_by_its_ends_and_turns(tmp_path, margin):
    time = np.arange(400) / 100
    motion = np.sin(2 * np.pi * time)
    path = write(tmp_path, time_s=time, displacement_in=motion)
    record = mb.read_record(path, window=(time[margin], time[-1 - margin]))
    head, tail = record.around(record.trace())
    assert (head[0], head[-1]) == pytest.approx((motion[0], motion[margin - 1]))
    assert (tail[0], tail[-1]) == pytest.approx((motion[-margin], motion[-1]))
    assert max(head) == pytest.approx(motion[:margin].max())
    assert record.around(record.trace(), since=time[margin - 1])[0] == ()
    for trace, begin in ((None, 0.0), (record.trace(), "a"), (record.trace(), np.nan)):
        refused("trace|since", record.around, trace, begin)


# --- signals that are made of more than a column

N = 4448.2216152605  # in a kip
OMEGA = 2.0 * np.pi
TRAVEL = 20.0 * np.sin(OMEGA * TIME)  # mm
FRICTION = 7.0 * np.tanh(3.0 * np.cos(OMEGA * TIME))  # N
PRESSURE = 3.0 + 0.2 * np.sin(3.0 * TIME)  # bar
INERTIA = -3.0 * OMEGA**2 * TRAVEL / 1000.0  # N, of 3 kg
INSIDE = slice(40, -40)


def force_of(path, **options):
    columns = {"time": "time_s", "displacement": "stroke_mm", "force": Source("load_N", **options)}
    return mb.read_record(path, columns).force * N


def test_a_pressure_on_an_area_is_taken_off(tmp_path):
    load = FRICTION + PRESSURE * 51.87
    path = write(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=load, p_bar=PRESSURE)
    for minus in (Subtracted("p_bar", None, "518.7 mm^2"), Subtracted(4, "bar", "5.187 cm^2")):
        np.testing.assert_allclose(force_of(path, minus=minus), FRICTION, atol=1e-8)
    assert np.max(np.abs(force_of(path) - FRICTION)) > 100.0  # the negative control


@pytest.mark.parametrize("mass", ["3 kg", "29.41995 N"])
def test_inertia_is_taken_off_on_either_side_of_a_gap_in_time(tmp_path, mass):
    for late in (0.0, 1000.0):
        time = TIME + np.where(TIME > 4.0, late, 0.0)
        path = write(tmp_path, time_s=time, stroke_mm=TRAVEL, load_N=FRICTION + INERTIA)
        expected = FRICTION[TIME > 4.0] if late else FRICTION
        force = force_of(path, minus_mass=mass)
        np.testing.assert_allclose(force[INSIDE], expected[INSIDE], atol=0.01)
        assert np.max(np.abs(force_of(path) - expected)) > 2.0


def test_inertia_is_that_of_the_motion_in_spite_of_noise_and_uneven_times(tmp_path):
    rng = np.random.default_rng(2)
    time = np.sort(TIME + rng.uniform(-0.2, 0.2, TIME.size) / RATE)
    motion = 20.0 * (np.sin(OMEGA * time) + 3e-4 * rng.normal(size=time.size))
    path = write(tmp_path, time_s=time, stroke_mm=motion, load_N=0.0 * time)
    force = force_of(path, minus_mass="50 kg")[INSIDE]
    exact = (OMEGA**2 * np.sin(OMEGA * time))[INSIDE]
    assert np.sqrt(np.mean((force - exact) ** 2)) < 0.05 * OMEGA**2


def test_a_tare_is_what_the_column_reads_at_zero_or_its_mean_over_a_window(tmp_path):
    path = write(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION + 2.0)
    for tare in ("2 N", "0 s to 10 s"):
        np.testing.assert_allclose(force_of(path, tare=tare), FRICTION, atol=0.01)
    turned = Source("stroke_mm", sign=-1)
    force = Source("load_N", sign=-1, tare="2 N")
    record = mb.read_record(path, {"time": "time_s", "displacement": turned, "force": force})
    np.testing.assert_allclose(record.force * N, -FRICTION, atol=1e-8)
    np.testing.assert_allclose(record.displacement * 25.4, -TRAVEL, atol=1e-8)


def test_an_arm_makes_travel_of_an_angle_and_force_of_a_torque(tmp_path):
    angle, torque = np.degrees(TRAVEL / 101.6), (FRICTION + 5.0) * 0.1016
    path = write(tmp_path, time_s=TIME, turn=angle, torque=torque)
    columns = {
        "time": "time_s",
        "displacement": Source("turn", "deg", arm="4 in"),
        "force": Source("torque", "N*m", arm="4 in", tare="0.508 N*m"),
    }
    turned = mb.read_record(path, columns)
    assert turned.columns["displacement"] == ("turn", "in")
    assert turned.columns["force"] == ("torque", "N")
    # and a travel that was measured at another radius is scaled
    path = write(tmp_path, time_s=TIME, stroke_mm=TRAVEL * 2.5, load_N=FRICTION / 2.5)
    radii = {"arm": "4 in", "measured_at": "254 mm"}
    columns = {"displacement": Source("stroke_mm", **radii), "force": Source("load_N", **radii)}
    for record in (turned, mb.read_record(path, {"time": "time_s", **columns})):
        np.testing.assert_allclose(record.displacement * 25.4, TRAVEL, atol=1e-8)
        np.testing.assert_allclose(record.force * N, FRICTION, atol=1e-8)


def test_parts_that_cannot_be_are_refused(tmp_path):
    path = write(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION, p_bar=PRESSURE)
    for role, options, named in (
        ("force", {"minus_mass": "3 mm"}, "minus_mass"),
        ("force", {"minus_mass": "-3 kg"}, "'-3 kg'"),
        ("force", {"minus": Subtracted("p_bar")}, "pressure"),
        ("force", {"minus": Subtracted("p_bar", None, "3 mm")}, "times 3 mm"),
        ("force", {"minus": Subtracted("q_bar", None, "3 mm^2")}, "'q_bar'"),
        ("force", {"tare": "20 s to 30 s"}, "20 s to 30 s"),
        ("force", {"tare": "3 mm"}, "tare"),
        ("force", {"measured_at": "3 mm"}, "arm"),
        ("displacement", {"arm": "4 in"}, "angle"),
        ("displacement", {"arm": "0 in", "measured_at": "4 in"}, "radius"),
    ):
        names = {"time": "time_s", "displacement": "stroke_mm", "force": "load_N"}
        columns = {r: Source(n, **(options if r == role else {})) for r, n in names.items()}
        refused(named, mb.read_record, path, columns)


def test_a_clock_that_starts_again_outside_the_window_is_left_out_and_said(tmp_path):
    time, restarted = np.arange(400) / 40.0, np.arange(30) / 40.0
    x = np.sin(np.pi * np.concatenate([time, restarted]))

    def read(clock, fit):
        path = tmp_path / "a.csv"
        table = np.column_stack([clock, x, x])
        header = "time_s,displacement_in,force_kip"
        np.savetxt(path, table, delimiter=",", header=header, comments="")
        return mb.read_record(path, window=fit)

    record = read(np.concatenate([time, restarted]), "0 s to 8 s")
    assert record.time.size == 400
    assert "line 402" in record.doubts[0]
    read(np.concatenate([time, restarted + 9.0]), "0 s to 8 s")
    for clock, fit in (
        (np.concatenate([time, restarted]), None),
        (np.concatenate([time[:200], time[190:390], restarted]), "0 s to 8 s"),  # inside the window
        (np.concatenate([time[:200], time[:230]]), "0 s to 4 s"),  # which of two?
    ):
        with pytest.raises(mb.MfdError, match="does not increase"):
            read(clock, fit)
