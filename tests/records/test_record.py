import hashlib
from fractions import Fraction

import numpy as np
import pytest

from mfd_bayes.errors import RecordError, UnitError
from mfd_bayes.records.file_name_check import contradictions
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.motion import turning_points
from mfd_bayes.records.record import read_record
from mfd_bayes.records.resampling import MOST_SAMPLES, decimate, default_rate

RATE = 200.0
TIME = np.arange(2001) / RATE
MOTION = np.sin(np.pi * TIME)  # 0.5 Hz, 1 in
FORCE = 2.0 + np.cos(np.pi * TIME)


def write(folder, name="a.csv", **columns):
    columns = columns or {"time_s": TIME, "displacement_in": MOTION, "force_kip": FORCE}
    path = folder / name
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
    return path


def refused(path, *args, error=RecordError, **options):
    with pytest.raises(error) as caught:
        read_record(path, *args, **options)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_headers_say_roles_and_units(tmp_path):
    path = write(tmp_path)
    record = read_record(path, actuation="30 lb")
    np.testing.assert_allclose(record.time, TIME, rtol=1e-14)
    np.testing.assert_allclose(record.force, FORCE, rtol=1e-14)
    assert record.actuation == pytest.approx(0.03)
    assert record.actuation_unit == "kip"
    assert record.columns["force"] == ("force_kip", "kip")
    assert record.rate == pytest.approx(RATE)
    assert record.jitter < 1e-9
    assert record.turning_points == 10
    assert record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_given_columns_and_units_win_over_the_header(tmp_path):
    path = write(tmp_path, t=TIME * 1000, x_in=MOTION * 25.4, load=FORCE, extra_kip=FORCE * 0)
    names = {"time": "t", "displacement": "x_in", "force": "load"}
    record = read_record(path, names, {"time": "ms", "displacement": "mm", "force": "kip"})
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    np.testing.assert_allclose(record.displacement, MOTION, atol=1e-12)
    assert record.actuation is None
    assert record.velocity is None


def test_a_measured_actuation_is_clipped_at_zero(tmp_path):
    pressure = np.where(TIME < 5, -0.01, 500.0)
    columns = {"time_s": TIME, "displacement_in": MOTION, "pressure_psi": pressure}
    record = read_record(write(tmp_path, **columns), {"actuation": "pressure_psi"})
    assert record.actuation_unit == "ksi"
    assert record.actuation.min() == 0
    assert record.actuation.max() == pytest.approx(0.5)
    assert np.all(record.trace(rate=20).actuation >= 0)


def test_a_negative_measured_actuation_is_refused(tmp_path):
    path = write(tmp_path, time_s=TIME, displacement_in=MOTION, actuation_psi=-1 + 0 * TIME)
    assert "negative on average" in refused(path)


def test_an_actuation_given_twice_is_refused(tmp_path):
    path = write(tmp_path, time_s=TIME, displacement_in=MOTION, p_psi=TIME)
    assert "'5 psi' and as a column" in refused(path, {"actuation": "p_psi"}, actuation="5 psi")


def test_swapped_units_are_a_dimension_error(tmp_path):
    units = {"displacement": "kip", "force": "in"}
    message = refused(write(tmp_path), None, units, error=UnitError)
    assert "'displacement_in'" in message
    assert "measures force" in message


def test_a_column_without_a_unit_says_so(tmp_path):
    path = write(tmp_path, time=TIME, displacement_in=MOTION)
    assert "give the unit of time" in refused(path)
    assert read_record(path, units={"time": "s"}).time[-1] == 10


def test_a_row_of_units_gives_units_that_nothing_else_does(tmp_path):
    path = write(tmp_path, Time=TIME, Disp=MOTION * 25.4, Force=FORCE)
    names, *rows = path.read_text().splitlines()
    path.write_text("\n".join([names, "Sec,mm,Kips", *rows]))
    roles = {"time": "Time", "displacement": "Disp", "force": "Force"}
    record = read_record(path, roles)
    assert record.columns == {
        "time": ("Time", "Sec"),
        "displacement": ("Disp", "mm"),
        "force": ("Force", "Kips"),
    }
    np.testing.assert_allclose(record.displacement, MOTION, atol=1e-12)
    np.testing.assert_allclose(record.force, FORCE, rtol=1e-12)
    given = read_record(path, roles, {"displacement": "in"})
    np.testing.assert_allclose(given.displacement, MOTION * 25.4, rtol=1e-12)


def test_missing_and_ambiguous_roles_are_refused(tmp_path):
    assert "t, x" in refused(write(tmp_path, t=TIME, x=MOTION))
    path = write(tmp_path, time_s=TIME, displacement_in=MOTION, displacement_mm=MOTION)
    assert "displacement_in, displacement_mm" in refused(path)
    assert "unknown role" in (message := refused_role(path))
    assert "velocity" in message


def refused_role(path):
    with pytest.raises(RecordError) as caught:
        read_record(path, {"speed": "time_s"})
    return str(caught.value)


def test_a_missing_named_column_lists_those_there_are(tmp_path):
    names = {"time": "time_s", "displacement": "x"}
    message = refused(write(tmp_path), names, {"displacement": "in"})
    assert "missing column 'x'" in message
    assert "time_s, displacement_in, force_kip" in message


def test_too_few_samples_are_refused(tmp_path):
    path = write(tmp_path, time_s=TIME[:19], displacement_in=MOTION[:19])
    assert "19 samples" in refused(path)


def test_time_that_does_not_increase_is_refused_with_its_line(tmp_path):
    time = TIME.copy()
    time[100] = time[99]
    assert "line 102" in refused(write(tmp_path, time_s=time, displacement_in=MOTION))


def test_of_a_time_with_a_gap_the_longest_piece_is_used_and_said(tmp_path):
    time = TIME + np.where(TIME > 3, 1.5, 0)
    record = read_record(write(tmp_path, time_s=time, displacement_in=MOTION))
    assert (record.time[0], record.time[-1]) == (4.505, 11.5)
    np.testing.assert_array_equal(record.displacement, MOTION[TIME > 3])
    assert record.gap == (
        "time has a gap of 1.505 s before line 603, after 3 s; the longest unbroken piece is used, "
        "4.505 s to 11.5 s, 61% of the record"
    )
    assert contradictions(record)[0].name == "gap in time"
    assert read_record(write(tmp_path)).gap == ""


def test_of_a_time_with_gaps_the_piece_inside_the_window_is_used(tmp_path):
    time = TIME + np.where(TIME > 6, 1.5, 0) + np.where(TIME > 9, 4.0, 0)
    path = write(tmp_path, time_s=time, displacement_in=MOTION)
    assert read_record(path).time[-1] == 6.0
    assert "2 gaps, the longest of 4.005 s" in read_record(path).gap
    inside = read_record(path, fit="7 s to 10.5 s")
    assert (inside.time[0], inside.time[-1]) == (7.505, 10.5)


def test_a_record_of_short_pieces_alone_is_refused(tmp_path):
    time = np.arange(300) // 10 * 5.0 + np.arange(300) % 10 * 0.01
    path = write(tmp_path, time_s=time, displacement_in=np.sin(time))
    assert "fewer than the 20 samples" in refused(path)


def test_pauses_of_a_logger_are_said_in_words(tmp_path):
    time = TIME + 0.02 * np.cumsum(np.arange(TIME.size) % 400 == 399)
    record = read_record(write(tmp_path, time_s=time, displacement_in=MOTION))
    assert "the logger pauses" in record.clock.words()
    assert "for up to 0.025 s" in record.clock.words()
    even = read_record(write(tmp_path)).clock.words()
    assert even == "200 Hz, jitter 0.00% of a step"


def test_constant_displacement_is_refused(tmp_path):
    assert "constant" in refused(write(tmp_path, time_s=TIME, displacement_in=0 * TIME))


def test_fewer_than_two_turning_points_are_refused(tmp_path):
    path = write(tmp_path, time_s=TIME, displacement_in=np.sin(np.pi * TIME / 10))
    assert "1 turning points" in refused(path)


def test_text_in_a_cell_is_refused(tmp_path):
    path = write(tmp_path)
    path.write_text(path.read_text().replace("2.5,", "off,", 1))
    assert "'off'" in refused(path)


def test_a_fit_window_is_checked_and_is_the_default_of_trace(tmp_path):
    path = write(tmp_path)
    record = read_record(path, fit="2 s to 6 s")
    trace = record.trace()
    assert (trace.time[0], trace.time[-1]) == (2, 6)
    assert record.trace(window=(0, 10)).samples == TIME.size
    assert "0 samples" in refused(path, fit="20 s to 30 s")
    assert "turning points" in refused(path, fit="2 s to 3 s")


def test_a_trace_without_rate_or_gap_has_every_sample(tmp_path):
    record = read_record(write(tmp_path))
    for trace in (record.trace(), record.trace(rate=RATE), record.trace(rate=1e6)):
        np.testing.assert_array_equal(trace.time, record.time)
        np.testing.assert_array_equal(trace.force, record.force)


@pytest.mark.parametrize("rate", [20.0, 25.0, 40.0, 64.0, 150.0])
def test_decimation_has_no_delay_and_no_edge_transient(tmp_path, rate):
    trace = read_record(write(tmp_path)).trace(rate=rate)
    assert np.diff(trace.time) == pytest.approx(1 / rate)
    assert trace.time[0] == 0
    assert trace.time[-1] <= TIME[-1] < trace.time[-1] + 1.001 / rate
    np.testing.assert_allclose(trace.displacement, np.sin(np.pi * trace.time), atol=2e-3)
    np.testing.assert_allclose(trace.force, 2 + np.cos(np.pi * trace.time), atol=6e-3)


def test_a_window_is_the_same_cut_of_the_decimated_record(tmp_path):
    record = read_record(write(tmp_path))
    whole, part = record.trace(rate=20), record.trace(rate=20, window=(2.0, 6.0))
    assert (part.time[0], part.time[-1]) == (2.0, 6.0)
    np.testing.assert_allclose(part.force, whole.force[40:121], atol=1e-12)


@pytest.mark.parametrize("share", [1.0, 1.02, 1.2, 1.7, 3.3])
def test_a_tone_above_the_new_nyquist_is_down_by_40_db(share):
    tone = np.sin(2 * np.pi * 32 * share * np.arange(8192) / 1024 + 0.7)
    low = decimate(tone, Fraction(64, 1024), 0, tone.size - 1)
    assert np.max(np.abs(low[20:-20])) < 0.01
    # The negative control: without the filter the tone is folded back whole.
    assert np.max(np.abs(tone[::16])) > 0.5


def test_a_tone_well_below_the_new_nyquist_passes_whole():
    time = np.arange(8192) / 1024
    tone = np.sin(2 * np.pi * 20 * time)
    low = decimate(tone, Fraction(64, 1024), 0, tone.size - 1)
    np.testing.assert_allclose(low[20:-20], tone[::16][20:-20], atol=0.01)


def test_uneven_time_is_interpolated_before_decimation(tmp_path):
    rng = np.random.default_rng(1)
    time = np.sort(TIME + rng.uniform(-0.4, 0.4, TIME.size) / RATE)
    path = write(tmp_path, time_s=time, displacement_in=np.sin(np.pi * time))
    record = read_record(path)
    assert record.jitter > 0.1
    trace = record.trace(rate=40)
    assert np.ptp(np.diff(trace.time)) < 1e-9
    assert trace.time[0] >= time[0]
    assert trace.time[-1] <= time[-1]
    np.testing.assert_allclose(trace.displacement, np.sin(np.pi * trace.time), atol=2e-3)


@pytest.mark.parametrize("rate", [0, -1, np.nan, 1e-6, 1.5])
def test_rates_that_leave_no_trace_are_refused(tmp_path, rate):
    with pytest.raises(RecordError, match=r"rate, in Hz, must be .* above 0|fewer than 20"):
        read_record(write(tmp_path)).trace(rate=rate)


def test_windows_with_too_few_samples_are_refused(tmp_path):
    record = read_record(write(tmp_path))
    for window in ((0, 0.05), (30, 40)):
        with pytest.raises(RecordError, match="at least 20"):
            record.trace(window=window)
    for none in ((5, 4), (np.nan, 1), ("2", "30"), (0,), (), 5, "0 s to 3 s"):
        with pytest.raises(RecordError, match="two times in s, the earlier one first"):
            record.trace(window=none)


def test_default_rate_puts_20_samples_into_a_crossing():
    time = np.arange(10_241) / 1024
    motion = np.sin(np.pi * time)
    turns = turning_points(motion, 1e-3)
    rate = default_rate(time, motion, turns, 0.2)
    crossing = np.arccos(0.8) / np.pi
    assert 20 / crossing <= rate < 1.1 * 20 / crossing
    assert 1024 / rate == pytest.approx(round(1024 / rate))


def test_default_rate_keeps_40_samples_per_half_cycle_and_the_cap():
    time = np.arange(10_241) / 1024
    motion = np.sin(np.pi * time)
    turns = turning_points(motion, 1e-3)
    wide = default_rate(time, motion, turns, 5.0)
    assert 40 <= wide < 42
    assert default_rate(time, motion, turns, 1e-6) == pytest.approx(1024 / 2)
    time = np.arange(30_721) / 1024
    motion = np.sin(np.pi * time)
    turns = turning_points(motion, 1e-3)
    assert time.size * default_rate(time, motion, turns, 1e-6) / 1024 <= MOST_SAMPLES == 6000


def test_every_real_record_is_read_with_few_turning_points(data_folder):
    for path in sorted(data_folder.glob("20*.csv")):
        record = read_record(path)
        assert record.rate == pytest.approx(512 if "SI" in path.name else 1024, rel=1e-4)
        assert record.jitter < 0.01
        limit = 200 if "DBE" in path.name else 20
        assert 10 <= record.turning_points <= limit


def test_the_record_in_metres_and_newtons_comes_out_in_inches_and_kips(data_folder):
    record = read_record(data_folder / "2023_36lb_0.10Hz_1.0in_SI.csv", actuation="36 lb")
    metres, newtons = np.loadtxt(record.path, delimiter=",", skiprows=1, usecols=(1, 2)).T
    np.testing.assert_allclose(record.displacement, metres / 0.0254, rtol=1e-12)
    np.testing.assert_allclose(record.force, newtons / 4448.2216152605, rtol=1e-12)
    assert record.actuation == pytest.approx(0.036)
    # The other records of its session at 1.0 in move within 0.5 % of it, and the slowest of them
    # has its range of force within 0.9 %. Their displacement is the actuator's, not the drum's.
    assert np.max(np.abs(record.displacement)) == pytest.approx(1.0, abs=0.01)
    for rate in ("0.25", "0.50", "1.00"):
        like = read_record(data_folder / f"2023_36lb_{rate}Hz_1.0in.csv")
        assert np.ptp(record.displacement) == pytest.approx(np.ptp(like.displacement), rel=0.005)
    like = read_record(data_folder / "2023_36lb_0.25Hz_1.0in.csv")
    assert np.ptp(record.force) == pytest.approx(np.ptp(like.force), rel=0.02)


@pytest.mark.parametrize("rate", ["0.50", "1.00"])
def test_a_record_without_tension_is_read_and_dissipates_least(data_folder, rate):
    record = read_record(data_folder / f"2023_0lb_{rate}Hz_1.0in.csv", actuation="0 lb")
    assert record.actuation == 0.0
    assert record.trace().actuation == 0.0
    tensioned = read_record(data_folder / f"2023_30lb_{rate}Hz_1.0in.csv")
    assert np.ptp(record.displacement) == pytest.approx(np.ptp(tensioned.displacement), rel=0.005)
    residual, energy = (np.median(find_loops(r.trace()).energy) for r in (record, tensioned))
    assert 0.0 < residual < 0.35 * energy


def test_a_real_record_is_decimated_without_delay_or_transient(data_folder):
    record = read_record(data_folder / "2022_80lb_0.50Hz_1.0in.csv", actuation="80 lb")
    trace = record.trace(rate=64)
    original = np.interp(trace.time, record.time, record.displacement)
    np.testing.assert_allclose(trace.displacement, original, atol=2e-3)
    lags = np.arange(-8, 9)
    force = record.force - record.force.mean()
    low = np.interp(record.time, trace.time, trace.force - record.force.mean())
    match = [np.dot(np.roll(low, lag), force) for lag in lags]
    assert lags[int(np.argmax(match))] == 0
    assert trace.force[0] == pytest.approx(record.force[0], abs=0.03)
    assert np.max(np.abs(trace.force[:20] - record.force[:320:16])) < 0.05


def test_a_real_record_gets_a_rate_that_resolves_its_gap(data_folder):
    record = read_record(data_folder / "2023_30lb_0.25Hz_1.0in.csv")
    trace = record.trace(gap=0.2)
    assert 30 < 1 / (trace.time[1] - trace.time[0]) < 110
    assert trace.samples < 3000
    assert trace.turning_points.size == record.turning_points


@pytest.mark.parametrize("left", [1, 2, 3, 40])
def test_what_a_window_leaves_out_is_told_by_its_ends_and_turns(tmp_path, left):
    time = np.arange(400) / 100
    motion = np.sin(2 * np.pi * time)
    path = write(tmp_path, time_s=time, displacement_in=motion)
    record = read_record(path, fit=(time[left], time[-1 - left]))
    before, after = record.around(record.trace())
    assert (before[0], before[-1]) == pytest.approx((motion[0], motion[left - 1]))
    assert (after[0], after[-1]) == pytest.approx((motion[-left], motion[-1]))
    assert max(before) == pytest.approx(motion[:left].max())
    assert record.around(record.trace(), since=time[left - 1])[0] == ()
    assert read_record(path).around(record.trace()) == ((), ())


@pytest.mark.parametrize("rate", [256.0, 400.0, 600.0])
def test_rounded_time_stamps_do_not_change_the_rate(tmp_path, rate):
    time = np.arange(4000) / rate
    path = write(tmp_path, time_s=np.round(time, 3), displacement_in=np.sin(2 * np.pi * time))
    record = read_record(path)
    assert record.rate == pytest.approx(rate, rel=1e-3)
    assert record.trace(0.875 * rate).samples == pytest.approx(3500, abs=2)
