"""Loops and what is read off them: their definitions, and one number everywhere."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from mfd_bayes import Trace, read_record
from mfd_bayes.cli.commands import app
from mfd_bayes.records.cycles import (
    MeasuredCycles,
    cycle_values,
    features_of,
    measured_cycles,
    scales_of,
)
from mfd_bayes.records.loops import OFF_CENTRE, WINDOW, find_loops

FORWARD, BACKWARD, SLOPE, GAP = 2.0, 2.5, 25.0, 0.3
TIME = np.arange(0.0, 8.0, 1 / 500)


def ellipse(cycles=6, force=True, grow=0.0):
    """Trace of amplitude 1 in at 0.5 Hz whose force is a circle about 0.2 kip, with a drift."""
    time = np.arange(int(200 * cycles) + 1) / 100.0
    angle, drift = np.pi * time, grow * time / time[-1]
    load = 0.2 + (1 + drift) * np.cos(angle) + drift
    return Trace.from_arrays(time, np.sin(angle), force=load if force else None)


def drawn_loop(cycles=5, ramp=0):
    """A loop of straight lines: no force in the gap, a build-up, then slip."""
    time = np.arange(0.0, cycles / 0.5, 1 / 256)
    size = np.minimum(1.0, time / max(ramp / 0.5, 1e-9)) if ramp else 1.0
    x = size * np.sin(np.pi * time)
    force, travel, way = np.zeros(time.size), 0.0, 1.0
    for n in range(1, time.size):
        step = x[n] - x[n - 1]
        if step * way < 0:
            way, travel = -way, 0.0
        travel += abs(step)
        level = FORWARD if way > 0 else BACKWARD
        force[n] = way * np.clip(SLOPE * (travel - GAP + level / SLOPE), 0.0, level)
    return Trace.from_arrays(time, x, 0.03, force)


def test_drifts_compare_the_first_strong_loops_with_the_last():
    steady, growing = find_loops(ellipse()), find_loops(ellipse(grow=0.5))
    assert steady.energy_drift == pytest.approx(0.0, abs=1e-9)
    assert steady.offset_drift == pytest.approx(0.0, abs=1e-9)
    assert growing.energy_drift == pytest.approx(0.30, abs=0.05)
    assert growing.offset_drift == pytest.approx(0.33, abs=0.05)
    time = np.arange(1001) / 100.0
    ramped = np.minimum(time / 6, 1) * np.sin(np.pi * time)
    loops = find_loops(Trace.from_arrays(time, ramped, force=np.cos(np.pi * time)))
    assert 0 < np.count_nonzero(loops.strong) < loops.strong.size
    assert loops.energy_drift is None


def test_without_a_force_or_a_full_loop_there_is_less():
    loops = find_loops(ellipse(force=False))
    assert loops.period.size == 5
    assert loops.energy is loops.energy_drift is loops.offset_drift is None
    loops = find_loops(ellipse(cycles=1))
    assert loops.bounds.size == loops.period.size == loops.energy.size == loops.strong.size == 0
    time = np.arange(100) / 50
    for force in (None, np.ones(100)):
        read = features_of(Trace.from_arrays(time, time, 0.03, force))
        names = ("slip", "build_up_slope", "gap", "energy_per_cycle")
        assert np.isnan([read[name] for name in names]).all()


@pytest.mark.parametrize(("offset", "ramp"), [(0.0, 0), (0.4, 0), (0.0, 3)])
def test_a_loop_of_straight_lines_is_read_as_it_was_drawn(offset, ramp):
    trace = drawn_loop(8, ramp)
    shifted = Trace.from_arrays(trace.time, trace.displacement, 0.03, trace.force + offset)
    read = features_of(shifted)
    assert read["slip_fwd"] == pytest.approx(FORWARD + offset)
    assert read["slip_bwd"] == pytest.approx(BACKWARD - offset)
    assert read["slip"] == pytest.approx(0.5 * (FORWARD + BACKWARD))
    loops, read = find_loops(trace), features_of(trace)
    assert read["build_up_slope"] == pytest.approx(SLOPE, rel=0.02)
    assert read["gap"] == pytest.approx(GAP, rel=0.02)
    assert read["energy_per_cycle"] == pytest.approx(loops.energy[loops.strong].mean())
    for size in (1.0, 1e-3):  # a device of any size
        arrays = size * trace.displacement, 0.03, size * (trace.force + offset)
        scales = scales_of(Trace.from_arrays(trace.time, *arrays))
        measured = scales.force / size, scales.build_up, scales.length / size, scales.stroke / size
        assert measured == pytest.approx((2.25, SLOPE, GAP, 2.0), rel=0.05)


@settings(deadline=None)
@given(
    amplitude=st.floats(0.1, 5.0),
    frequency=st.sampled_from([0.5, 1.0, 2.0]),
    stiffness=st.floats(0.0, 20.0),
    damping=st.floats(0.05, 2.0),
    zero=st.floats(-3.0, 3.0),
)
def test_a_spring_and_a_dashpot_have_their_textbook_values(
    amplitude, frequency, stiffness, damping, zero
):
    w = 2.0 * np.pi * frequency
    x, v = amplitude * np.sin(w * TIME), amplitude * w * np.cos(w * TIME)
    trace = Trace.from_arrays(TIME, x + zero, force=stiffness * x + damping * v, velocity=v)
    cycles = measured_cycles(trace)
    assert cycles.full_stroke.all()
    np.testing.assert_allclose(cycles.stroke, 2.0 * amplitude, rtol=1e-3)
    np.testing.assert_allclose(cycles.frequency, frequency, rtol=5e-3)
    values = cycles.of_test()
    assert values["energy_per_cycle"] == pytest.approx(np.pi * damping * w * amplitude**2, rel=1e-2)
    assert values["c_eq"] == pytest.approx(damping, rel=1e-2)
    centre = -zero / amplitude  # of the window, over the amplitude, or at mid-stroke
    centre = 0.0 if abs(centre) > 2.0 * OFF_CENTRE else centre
    window = centre + 2.0 * WINDOW * np.linspace(-1.0, 1.0, 101)
    dashpot = damping * w * amplitude * np.sqrt(1.0 - window**2).mean()
    spring, size = stiffness * amplitude * centre, (stiffness + damping * w) * amplitude
    if abs(abs(zero / amplitude) - 2.0 * OFF_CENTRE) > 0.01:
        assert values["slip_fwd"] == pytest.approx(dashpot + spring, abs=1e-2 * size)
        assert values["slip_bwd"] == pytest.approx(dashpot - spring, abs=1e-2 * size)
    close = {"rel": 5e-3, "abs": 0.02 * damping * w}
    assert values["effective_stiffness"] == pytest.approx(stiffness, **close)


def test_the_damping_of_a_rectangular_loop_and_a_record_without_values():
    x = np.sin(np.pi * TIME)
    force = 2.0 * np.sign(np.cos(np.pi * (TIME + 1e-9)))
    values = measured_cycles(Trace.from_arrays(TIME, x, force=force)).of_test()
    expected = 4.0 / np.pi / values["effective_stiffness"]
    assert values["effective_damping"] == pytest.approx(expected, rel=1e-2)
    assert measured_cycles(Trace.from_arrays(TIME, x)) is None
    partial = measured_cycles(Trace.from_arrays(TIME[:300], x[:300], force=x[:300]))
    assert partial.time.size == 0
    assert np.isnan(partial.of_test()["energy_per_cycle"])
    assert partial.of_test()["peak_fwd"] == x[:300].max()


def test_a_coulomb_loop_dissipates_four_times_force_times_amplitude():
    x, omega, friction = 1.3, 0.5 * np.pi, np.array([0.5, 2.0])
    time = np.arange(0.0, 14.0, 0.005)  # three and a half periods
    motion = x * np.sin(omega * time)
    trace = Trace.from_arrays(time, motion, velocity=x * omega * np.cos(omega * time))
    values = cycle_values(trace, friction[:, None] * np.sign(trace.velocity))
    assert values["energy"].shape == (2, 3)
    np.testing.assert_allclose(values["energy"], np.tile(4.0 * friction[:, None] * x, 3), rtol=1e-3)
    equivalent = 4.0 * friction / (np.pi * omega * x)  # Chopra, Coulomb damping
    np.testing.assert_allclose(values["c_eq"], np.tile(equivalent[:, None], 3), rtol=1e-3)
    for name in ("peak_fwd", "peak_bwd"):
        np.testing.assert_array_equal(values[name], np.tile(friction[:, None], 3))
    decaying = Trace.from_arrays(time, motion * np.exp(-0.1 * time))
    for moved in (trace, decaying):  # a dashpot is equivalent to itself
        dashpot = cycle_values(moved, 0.7 * moved.velocity[None])
        np.testing.assert_allclose(dashpot["c_eq"], 0.7, rtol=1e-3)


@pytest.mark.parametrize(
    ("chatter", "zero", "pattern"),
    [
        (0.0, 0.0, "at zero displacement$"),
        (0.8, 0.0, "at zero displacement$"),
        (0.0, 0.1, r"at zero displacement; at mid-stroke 2 kip and 2.5 kip$"),
        (0.0, 5.0, "at mid-stroke, where zero displacement is not$"),
    ],
)
def test_a_slip_force_is_a_mean_about_zero_displacement(tmp_path, chatter, zero, pattern):
    """Chatter to a fifth leaves the mean; a sensor's zero is not always the device's."""
    trace = drawn_loop(8)
    slipping = np.isin(np.abs(trace.force), (FORWARD, BACKWARD))
    waves = 1.0 - chatter * np.cos(2.0 * np.pi * trace.displacement / 0.11) * slipping
    path = tmp_path / "test.csv"
    columns = np.column_stack([trace.time, trace.displacement + zero, waves * trace.force])
    names = "time_s,displacement_in,force_kip"
    np.savetxt(path, columns, delimiter=",", header=names, comments="")
    outcome = CliRunner().invoke(app, ["inspect", str(path), "-o", str(tmp_path), "--units", "us"])
    text = " ".join(outcome.stdout.split())
    line = re.search(r"slip force (.*?) peak force", text)[1]
    assert re.search(pattern, line), line
    slips = [float(n) for n in re.findall(r"([\d.]+) kip (?:forward|backward)", line)]
    assert slips == pytest.approx((FORWARD, BACKWARD), rel=0.1 if chatter else 1e-3)
    errors = re.search(r"standard errors ([\d.e-]+) kip and ([\d.e-]+) kip", line).groups()
    assert max(map(float, errors)) < 0.05


TITLES = {
    "peak force": ("peak_fwd", "peak_bwd"),
    "energy per cycle": ("energy_per_cycle",),
    "slip force": ("slip_fwd", "slip_bwd"),
    "effective stiffness": ("effective_stiffness",),
    "effective damping": ("effective_damping",),
    "equivalent damping": ("c_eq",),
    "gap": ("gap",),
    "build-up slope": ("build_up_slope",),
}
"""What inspect calls the values, by the titles of its lines."""


def test_inspect_shows_the_measured_values_of_shared_records(data_folder, tmp_path, small_pictures):
    for path in sorted(data_folder.glob("20*.csv"))[::6]:
        record = read_record(path)
        cycles = measured_cycles(record.trace())
        forward, backward = (np.nanmax(cycles.values[f"peak_{side}"]) for side in ("fwd", "bwd"))
        assert forward <= cycles.largest_fwd == record.force.max(), path
        assert backward <= cycles.largest_bwd == -record.force.min(), path
        content = cycles.to_content()
        for name, value in MeasuredCycles.from_content(content).to_content().items():
            np.testing.assert_array_equal(content[name], value, err_msg=name)
        arguments = ["inspect", str(path), "-o", str(tmp_path), "--units", "us"]
        output, values = CliRunner().invoke(app, arguments).stdout, cycles.of_test()
        for title, names in TITLES.items():
            line = re.search(rf"^  {title} +(.*)$", output, re.MULTILINE)
            if line is None:
                assert np.isnan(values[names[0]]), (path, title)
                continue
            numbers = re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", line[1])[: len(names)]
            assert [float(n) for n in numbers] == [float(f"{values[n]:.4g}") for n in names], path
