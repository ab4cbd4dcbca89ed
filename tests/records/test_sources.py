"""Signals that are made of more than a column: what the load cell also feels is taken off."""

import numpy as np
import pytest

from mfd_bayes.errors import MfdError, RecordError, UnitError
from mfd_bayes.records.channels import Source, Subtracted, acceleration
from mfd_bayes.records.file_name_check import contradictions
from mfd_bayes.records.record import read_record
from mfd_bayes.records.summary import inspect_record

N = 4448.2216152605  # in a kip
TIME = np.arange(2001) / 200.0
OMEGA = 2.0 * np.pi
TRAVEL = 20.0 * np.sin(OMEGA * TIME)  # mm
FRICTION = 7.0 * np.tanh(3.0 * np.cos(OMEGA * TIME))  # N
PRESSURE = 3.0 + 0.2 * np.sin(3.0 * TIME)  # bar
AREA = 518.7  # mm²
MASS = 3.0  # kg
INERTIA = -MASS * OMEGA**2 * TRAVEL / 1000.0  # N


def written(folder, **columns):
    path = folder / "a.csv"
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.12g", ",", header=",".join(columns), comments="")
    return path


def force_of(path, **parts):
    columns = {"time": "time_s", "displacement": "stroke_mm", "force": Source("load_N", **parts)}
    return read_record(path, columns).force * N


def test_a_pressure_on_an_area_is_taken_off(tmp_path):
    load = FRICTION + PRESSURE * 0.1 * AREA
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=load, p_bar=PRESSURE)
    area = Subtracted("p_bar", None, f"{AREA} mm^2")
    np.testing.assert_allclose(force_of(path, minus=area), FRICTION, atol=1e-8)
    by_number = Subtracted(4, "bar", "5.187 cm^2")
    np.testing.assert_allclose(force_of(path, minus=by_number), FRICTION, atol=1e-8)
    assert np.max(np.abs(force_of(path) - FRICTION)) > 100.0  # the negative control


def test_a_column_of_the_same_kind_is_taken_off_as_it_is(tmp_path):
    path = written(
        tmp_path, time_s=TIME, stroke_mm=TRAVEL + 0.3, base_cm=0.03 + 0 * TIME, load_N=FRICTION
    )
    columns = {
        "time": "time_s",
        "displacement": Source("stroke_mm", minus=Subtracted("base_cm")),
        "force": "load_N",
    }
    np.testing.assert_allclose(read_record(path, columns).displacement * 25.4, TRAVEL, atol=1e-8)


@pytest.mark.parametrize("mass", ["3 kg", "0.003 t", "29.41995 N"])
def test_inertia_is_taken_off(tmp_path, mass):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION + INERTIA)
    inside = slice(40, -40)
    found = force_of(path, minus_mass=mass)
    np.testing.assert_allclose(found[inside], FRICTION[inside], atol=0.01)
    assert np.max(np.abs(force_of(path) - FRICTION)) > 2.0


def test_a_mass_below_zero_is_refused(tmp_path):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION + INERTIA)
    with pytest.raises(UnitError, match=r"minus_mass of .* of 0 or more, got '-3 kg'"):
        force_of(path, minus_mass="-3 kg")


@pytest.mark.parametrize("factor", [0.0, 5e-324])
def test_inertia_needs_times_that_increase(tmp_path, factor):
    time = TIME * factor
    path = written(tmp_path, time_s=time, stroke_mm=TRAVEL, load_N=FRICTION + INERTIA)
    with pytest.raises(RecordError, match=r"time in .*a\.csv"):
        force_of(path, minus_mass="3 kg")


def test_inertia_needs_as_many_samples_as_any_record(tmp_path):
    some = {"time_s": TIME[:3], "stroke_mm": TRAVEL[:3], "load_N": FRICTION[:3]}
    with pytest.raises(RecordError, match="3 samples; at least"):
        force_of(written(tmp_path, **some), minus_mass="3 kg")


def test_the_acceleration_is_that_of_the_motion_in_spite_of_noise_and_uneven_times():
    rng = np.random.default_rng(2)
    time = np.sort(TIME + rng.uniform(-0.2, 0.2, TIME.size) / 200.0)
    motion = np.sin(OMEGA * time) + 3e-4 * rng.normal(size=time.size)
    found = acceleration(time, motion)[40:-40]
    exact = -(OMEGA**2) * np.sin(OMEGA * time)[40:-40]
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.05 * OMEGA**2
    twice = np.gradient(np.gradient(motion, time), time)[40:-40]
    assert np.sqrt(np.mean((twice - exact) ** 2)) > 0.1 * OMEGA**2


@pytest.mark.parametrize("tare", ["2 N", "0 s to 10 s"])
def test_a_tare_is_a_force_or_the_mean_over_a_window(tmp_path, tare):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION + 2.0)
    np.testing.assert_allclose(force_of(path, tare=tare), FRICTION, atol=0.01)


def test_an_arm_makes_travel_of_an_angle_and_force_of_a_torque(tmp_path):
    angle = np.degrees(TRAVEL / 101.6)
    path = written(tmp_path, time_s=TIME, turn=angle, torque=FRICTION * 0.1016)
    columns = {
        "time": "time_s",
        "displacement": Source("turn", "deg", arm="4 in"),
        "force": Source("torque", "N*m", arm="4 in"),
    }
    record = read_record(path, columns)
    np.testing.assert_allclose(record.displacement * 25.4, TRAVEL, atol=1e-8)
    np.testing.assert_allclose(record.force * N, FRICTION, atol=1e-8)
    assert record.columns["displacement"] == ("turn", "in")
    assert record.columns["force"] == ("torque", "N")


def test_a_travel_measured_at_another_radius_is_scaled(tmp_path):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL * 2.5, load_N=FRICTION / 2.5)
    radii = {"arm": "4 in", "measured_at": "254 mm"}
    columns = {
        "time": "time_s",
        "displacement": Source("stroke_mm", **radii),
        "force": Source("load_N", **radii),
    }
    record = read_record(path, columns)
    np.testing.assert_allclose(record.displacement * 25.4, TRAVEL, atol=1e-8)
    np.testing.assert_allclose(record.force * N, FRICTION, atol=1e-8)


def test_what_a_signal_is_made_of_is_said(tmp_path):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION, p_bar=PRESSURE)
    force = Source(
        "load_N", minus=Subtracted("p_bar", None, "5 mm^2"), minus_mass="3 kg", tare="0 s to 2 s"
    )
    record = read_record(path, {"time": "time_s", "displacement": "stroke_mm", "force": force})
    said = "load_N [N] − p_bar × 5 mm^2 − 3 kg × acceleration − its mean over 0 s to 2 s"
    assert record.derived == {"force": said}
    assert inspect_record("a", record).facts["force is made of"].values["text"] == said
    assert record.other_columns == ()
    assert not [f for f in contradictions(record) if f.name == "column unit"]


@pytest.mark.parametrize(
    ("role", "parts", "expected"),
    [
        ("time", {"tare": "2 s"}, "only force and displacement"),
        ("displacement", {"minus_mass": "3 kg"}, "belongs to the force"),
        ("force", {"minus_mass": "3 mm"}, "minus_mass of the force"),
        ("force", {"minus_mass": "heavy"}, "expected a number and a unit"),
        ("force", {"minus": Subtracted("p_bar")}, "measures pressure; force needs a force"),
        ("force", {"minus": Subtracted("p_bar", None, "3 mm")}, "times 3 mm"),
        ("force", {"minus": Subtracted("q_bar", None, "3 mm^2")}, "missing column 'q_bar'"),
        ("force", {"minus": Subtracted(9, None, "3 mm^2")}, "column 9 of"),
        ("force", {"tare": "20 s to 30 s"}, "no sample lies in 20 s to 30 s"),
        ("force", {"tare": "3 mm"}, "tare of the force"),
        ("force", {"measured_at": "3 mm"}, "needs an arm"),
        ("displacement", {"arm": "4 in"}, "is no angle"),
        ("displacement", {"arm": "0 in", "measured_at": "4 in"}, "a radius above 0"),
    ],
)
def test_parts_that_cannot_be_are_refused_in_one_sentence(tmp_path, role, parts, expected):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=FRICTION, p_bar=PRESSURE)
    names = {"time": "time_s", "displacement": "stroke_mm", "force": "load_N"}
    columns = {r: Source(n, **(parts if r == role else {})) for r, n in names.items()}
    with pytest.raises(MfdError) as caught:
        read_record(path, columns)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_force_that_is_nothing_but_what_was_taken_off_is_still_a_record(tmp_path):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load_N=0 * TIME + 2.0)
    with pytest.raises(RecordError, match="column 7"):
        read_record(path, {"time": 7, "displacement": 2})
    assert np.all(force_of(path, tare="2 N") == 0.0)


def test_inertia_is_taken_off_on_either_side_of_a_gap_in_time(tmp_path):
    late = TIME + np.where(TIME > 4.0, 1000.0, 0.0)
    path = written(tmp_path, time_s=late, stroke_mm=TRAVEL, load_N=FRICTION + INERTIA)
    found = force_of(path, minus_mass="3 kg")
    inside = slice(40, -40)
    np.testing.assert_allclose(found[inside], FRICTION[TIME > 4.0][inside], atol=0.01)


@pytest.mark.parametrize(
    ("unit", "arm", "column", "tare"),
    [
        ("N", {"arm": "4 in", "measured_at": "10 in"}, (FRICTION + 5.0) / 2.5, "2 N"),
        ("N*m", {"arm": "4 in"}, (FRICTION + 5.0) * 0.1016, "0.508 N*m"),
    ],
)
def test_a_tare_is_what_the_column_reads_at_zero(tmp_path, unit, arm, column, tare):
    path = written(tmp_path, time_s=TIME, stroke_mm=TRAVEL, load=column)
    columns = {"time": "time_s", "displacement": "stroke_mm"}
    columns["force"] = Source("load", unit, tare=tare, **arm)
    np.testing.assert_allclose(read_record(path, columns).force * N, FRICTION, atol=1e-6)
