import hashlib
from fractions import Fraction

import numpy as np
import pytest

from mfd_bayes.errors import MfdError, RecordError
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


def test_headers_say_roles_and_units(tmp_path):
    path = write(tmp_path)
    record = read_record(path, actuation="30 lb")
    np.testing.assert_allclose(record.time, TIME, rtol=1e-14)
    np.testing.assert_allclose(record.force, FORCE, rtol=1e-14)
    assert (record.actuation, record.actuation_unit) == (pytest.approx(0.03), "kip")
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
    assert (record.actuation, record.velocity) == (None, None)


def test_a_measured_actuation_is_clipped_at_zero(tmp_path):
    pressure = np.where(TIME < 5, -0.01, 500.0)
    columns = {"time_s": TIME, "displacement_in": MOTION, "pressure_psi": pressure}
    record = read_record(write(tmp_path, **columns), {"actuation": "pressure_psi"})
    assert record.actuation_unit == "ksi"
    assert (record.actuation.min(), record.actuation.max()) == (0, pytest.approx(0.5))
    assert np.all(record.trace(rate=20).actuation >= 0)


def test_a_row_of_units_gives_units_that_nothing_else_does(tmp_path):
    path = write(tmp_path, Time=TIME, Disp=MOTION * 25.4, Force=FORCE)
    names, *rows = path.read_text().splitlines()
    path.write_text("\n".join([names, "Sec,mm,Kips", *rows]))
    roles = {"time": "Time", "displacement": "Disp", "force": "Force"}
    record = read_record(path, roles)
    assert record.columns["displacement"] == ("Disp", "mm")
    np.testing.assert_allclose(record.displacement, MOTION, atol=1e-12)
    given = read_record(path, roles, {"displacement": "in"})
    np.testing.assert_allclose(given.displacement, MOTION * 25.4, rtol=1e-12)


COLUMNS = {"time_s": TIME, "displacement_in": MOTION}
STILL_TIME = np.where(np.arange(TIME.size) == 100, TIME[99], TIME)
PIECES = np.arange(300) // 10 * 5.0 + np.arange(300) % 10 * 0.01


@pytest.mark.parametrize(
    ("columns", "options", "expected"),
    [
        (COLUMNS | {"actuation_psi": -1 + 0 * TIME}, {}, "negative on average"),
        (
            COLUMNS | {"p_psi": TIME},
            {"columns": {"actuation": "p_psi"}, "actuation": "5 psi"},
            "'5 psi' and as a column",
        ),
        (COLUMNS, {"units": {"displacement": "kip"}}, "'displacement_in'"),
        ({"time": TIME, "displacement_in": MOTION}, {}, "give the unit of time"),
        ({"t": TIME, "x": MOTION}, {}, "t, x"),
        (COLUMNS | {"displacement_mm": MOTION}, {}, "displacement_in, displacement_mm"),
        (COLUMNS, {"columns": {"speed": "time_s"}}, "unknown role 'speed'"),
        (
            COLUMNS,
            {"columns": {"time": "time_s", "displacement": "x"}, "units": {"displacement": "in"}},
            "missing column 'x'",
        ),
        ({"time_s": TIME[:19], "displacement_in": MOTION[:19]}, {}, "19 samples"),
        (COLUMNS | {"time_s": STILL_TIME}, {}, "line 102"),
        ({"time_s": PIECES, "displacement_in": np.sin(PIECES)}, {}, "fewer than the 20 samples"),
        (COLUMNS | {"displacement_in": 0 * TIME}, {}, "constant"),
        (COLUMNS | {"displacement_in": np.sin(TIME / 3.2)}, {}, "1 turning points"),
        (COLUMNS, {"fit": "20 s to 30 s"}, "0 samples"),
        (COLUMNS, {"fit": "2 s to 3 s"}, "turning points"),
    ],
)
def test_what_is_no_record_is_refused_in_one_sentence(tmp_path, columns, options, expected):
    with pytest.raises(MfdError) as caught:
        read_record(write(tmp_path, **columns), **options)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_of_a_time_with_gaps_the_longest_piece_inside_the_window_is_used(tmp_path):
    time = TIME + np.where(TIME > 3, 1.5, 0)
    record = read_record(write(tmp_path, time_s=time, displacement_in=MOTION))
    assert (record.time[0], record.time[-1]) == (4.505, 11.5)
    np.testing.assert_array_equal(record.displacement, MOTION[TIME > 3])
    assert record.gap == (
        "time has a gap of 1.505 s before line 603, after 3 s; the longest unbroken piece is used, "
        "4.505 s to 11.5 s, 61% of the record"
    )
    assert contradictions(record)[0].name == "gap in time"
    time = TIME + np.where(TIME > 6, 1.5, 0) + np.where(TIME > 9, 4.0, 0)
    path = write(tmp_path, time_s=time, displacement_in=MOTION)
    assert read_record(path).time[-1] == 6.0
    assert "2 gaps, the longest of 4.005 s" in read_record(path).gap
    inside = read_record(path, fit="7 s to 10.5 s")
    assert (inside.time[0], inside.time[-1]) == (7.505, 10.5)
    assert read_record(write(tmp_path)).gap == ""


def test_pauses_of_a_logger_are_said_in_words(tmp_path):
    time = TIME + 0.02 * np.cumsum(np.arange(TIME.size) % 400 == 399)
    record = read_record(write(tmp_path, time_s=time, displacement_in=MOTION))
    assert "the logger pauses" in record.clock.words()
    assert "for up to 0.025 s" in record.clock.words()
    assert read_record(write(tmp_path)).clock.words() == "200 Hz, jitter 0.00% of a step"


def test_a_fit_window_is_the_default_of_trace(tmp_path):
    record = read_record(write(tmp_path), fit="2 s to 6 s")
    assert tuple(record.trace().time[[0, -1]]) == (2, 6)
    assert record.trace(window=(0, 10)).samples == TIME.size


def test_a_trace_without_rate_or_gap_has_every_sample(tmp_path):
    record = read_record(write(tmp_path))
    for trace in (record.trace(), record.trace(rate=RATE), record.trace(rate=1e6)):
        np.testing.assert_array_equal(trace.time, record.time)
        np.testing.assert_array_equal(trace.force, record.force)


@pytest.mark.parametrize("rate", [20.0, 64.0, 150.0])
@pytest.mark.parametrize("uneven", [0.0, 0.4])
def test_decimation_has_no_delay_and_no_edge_transient(tmp_path, rate, uneven):
    rng = np.random.default_rng(1)
    time = np.sort(TIME + uneven * rng.uniform(-1.0, 1.0, TIME.size) / RATE)
    columns = {"displacement_in": np.sin(np.pi * time), "force_kip": 2 + np.cos(np.pi * time)}
    trace = read_record(write(tmp_path, time_s=time, **columns)).trace(rate=rate)
    assert np.diff(trace.time) == pytest.approx(1 / rate, rel=1e-3)
    assert time[0] <= trace.time[0] < time[0] + 1e-2
    assert trace.time[-1] <= time[-1] < trace.time[-1] + 1.1 / rate
    np.testing.assert_allclose(trace.displacement, np.sin(np.pi * trace.time), atol=2e-3)
    np.testing.assert_allclose(trace.force, 2 + np.cos(np.pi * trace.time), atol=6e-3)


def test_a_window_is_the_same_cut_of_the_decimated_record(tmp_path):
    record = read_record(write(tmp_path))
    whole, part = record.trace(rate=20), record.trace(rate=20, window=(2.0, 6.0))
    assert (part.time[0], part.time[-1]) == (2.0, 6.0)
    np.testing.assert_allclose(part.force, whole.force[40:121], atol=1e-12)


@pytest.mark.parametrize("share", [1.0, 1.2, 3.3])
def test_a_tone_above_the_new_nyquist_is_down_by_40_db_and_one_below_passes(share):
    time = np.arange(8192) / 1024
    tone = np.sin(2 * np.pi * 32 * share * time + 0.7)
    low = decimate(tone, Fraction(64, 1024), 0, tone.size - 1)
    assert np.max(np.abs(low[20:-20])) < 0.01
    # The negative control: without the filter the tone is folded back whole.
    assert np.max(np.abs(tone[::16])) > 0.5
    tone = np.sin(2 * np.pi * 20 * time)
    low = decimate(tone, Fraction(64, 1024), 0, tone.size - 1)
    np.testing.assert_allclose(low[20:-20], tone[::16][20:-20], atol=0.01)


@pytest.mark.parametrize("rate", [0, -1, np.nan, 1e-6, 1.5])
def test_rates_that_leave_no_trace_are_refused(tmp_path, rate):
    with pytest.raises(RecordError, match=r"rate, in Hz, must be .* above 0|fewer than 20"):
        read_record(write(tmp_path)).trace(rate=rate)


def test_the_default_rate_resolves_the_gap_and_the_half_cycles_below_the_cap():
    def rate_of(gap, samples=10_241):
        time = np.arange(samples) / 1024
        motion = np.sin(np.pi * time)
        return default_rate(time, motion, turning_points(motion, 1e-3), gap)

    crossing = np.arccos(0.8) / np.pi
    assert 20 / crossing <= rate_of(0.2) < 1.1 * 20 / crossing
    assert 1024 / rate_of(0.2) == pytest.approx(round(1024 / rate_of(0.2)))
    assert 40 <= rate_of(5.0) < 42
    assert rate_of(1e-6) == pytest.approx(1024 / 2)
    assert 30_721 * rate_of(1e-6, 30_721) / 1024 <= MOST_SAMPLES == 6000


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


# --- real records


def test_every_real_record_is_read_with_few_turning_points(data_folder):
    for path in sorted(data_folder.glob("20*.csv")):
        record = read_record(path)
        assert record.rate == pytest.approx(512 if "SI" in path.name else 1024, rel=1e-4)
        assert record.jitter < 0.01
        assert 10 <= record.turning_points <= (200 if "DBE" in path.name else 20)


def test_the_record_in_metres_and_newtons_comes_out_in_inches_and_kips(data_folder):
    record = read_record(data_folder / "2023_36lb_0.10Hz_1.0in_SI.csv", actuation="36 lb")
    metres, newtons = np.loadtxt(record.path, delimiter=",", skiprows=1, usecols=(1, 2)).T
    np.testing.assert_allclose(record.displacement, metres / 0.0254, rtol=1e-12)
    np.testing.assert_allclose(record.force, newtons / 4448.2216152605, rtol=1e-12)
    assert record.actuation == pytest.approx(0.036)
    # The other records of its session at 1.0 in move within 0.5 % of it.
    assert np.max(np.abs(record.displacement)) == pytest.approx(1.0, abs=0.01)
    like = read_record(data_folder / "2023_36lb_0.25Hz_1.0in.csv")
    assert np.ptp(record.displacement) == pytest.approx(np.ptp(like.displacement), rel=0.005)
    assert np.ptp(record.force) == pytest.approx(np.ptp(like.force), rel=0.02)


def test_a_record_without_tension_is_read_and_dissipates_least(data_folder):
    record = read_record(data_folder / "2023_0lb_0.50Hz_1.0in.csv", actuation="0 lb")
    assert record.actuation == record.trace().actuation == 0.0
    tensioned = read_record(data_folder / "2023_30lb_0.50Hz_1.0in.csv")
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
    gap = record.trace(gap=0.2)
    assert 30 < 1 / (gap.time[1] - gap.time[0]) < 512
    assert gap.turning_points.size == record.turning_points
