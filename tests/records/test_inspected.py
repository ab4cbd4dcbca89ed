"""What the command inspect says of records with cycles that tremble and with faults of sensors."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.records.record import read_record
from mfd_bayes.records.summary import inspect_record

RATE, FREQUENCY, CYCLES = 200.0, 0.5, 10
TIME = np.arange(int(RATE * CYCLES / FREQUENCY)) / RATE
MOTION = np.cos(2 * np.pi * (FREQUENCY * TIME + 0.1))
CYCLE = int(RATE / FREQUENCY)


def force_of(motion, seed=0):
    """Force, kip, of a bristle that slips at 1 kip, with the noise of a load cell."""
    fine = np.interp(np.arange(8 * motion.size) / 8, np.arange(motion.size), motion)
    force = np.zeros(fine.size)
    for n, step in enumerate(np.diff(fine), 1):
        force[n] = force[n - 1] + 40.0 * (step - abs(step) * force[n - 1])
    force = force[::8]
    return force + 0.005 * np.random.default_rng(seed).normal(size=motion.size)


def write(folder, motion, force):
    """A file of a record."""
    head = "time_s,displacement_in,force_kip"
    table = np.column_stack([np.arange(motion.size) / RATE, motion, force])
    np.savetxt(folder / "a.csv", table, "%.6g", ",", header=head, comments="")
    return folder / "a.csv"


def inspected(folder, motion, force):
    """What inspect finds in a record, as it prints it."""
    found = inspect_record("a", read_record(write(folder, motion, force)))
    facts = [f"  {name:20s} {text}" for name, text in found.facts.items()]
    return "\n".join(facts + [f"  warning {f.name}: {f.message!s}" for f in found.faults])


def warned(said):
    """Names of the warnings."""
    return re.findall(r"^ +warning +([a-z ]+):", said, re.MULTILINE)


def figures(said):
    """Number of loops at full stroke, their frequency in Hz and mean energy, and the offset."""
    loops = re.search(r"full loops +(\d+).*frequency ([\d.]+)", said)
    energy = re.search(r"energy per cycle +([\d.]+)", said)
    offset = re.search(r"force offset +(\S+)", said)
    return int(loops[1]), float(loops[2]), float(energy[1]), float(offset[1])


def test_the_command_counts_cycles_and_names_the_overflow_value(tmp_path):
    motion, force = MOTION.copy(), force_of(MOTION)
    top = np.flatnonzero(np.diff(np.sign(np.diff(MOTION))) < 0) + 1
    motion[top] -= 0.007
    force[1500] = 1e6
    path = write(tmp_path, motion, force)
    ran = CliRunner().invoke(app, ["inspect", str(path), "-o", str(tmp_path)])
    assert ran.exit_code == 0
    assert re.search(r"turning points +19 \(9.5 cycles\)", ran.stdout)
    assert warned(ran.stdout) == ["spikes"]
    assert figures(ran.stdout)[:2] == (9, 0.5)


# --- cycles


@pytest.mark.parametrize("samples", [1, 4, 10])
@pytest.mark.parametrize("share", [0.0035, 0.01, 0.04, 0.1])
@pytest.mark.parametrize("sides", [(1,), (1, -1)], ids=["one end", "both ends"])
def test_a_tremble_at_the_turns_begins_no_cycle(tmp_path, samples, share, sides):
    motion = MOTION.copy()
    for side in sides:
        for top in np.flatnonzero(np.diff(np.sign(np.diff(side * MOTION))) < 0) + 1:
            for first in (top - 2 * samples, top, top + 2 * samples):
                motion[max(first, 0) : max(first, 0) + samples] -= side * 2.0 * share
    loops, frequency, energy, offset = figures(inspected(tmp_path, motion, force_of(MOTION)))
    assert loops == 9
    assert frequency == pytest.approx(FREQUENCY, rel=0.03)
    assert energy == pytest.approx(3.9, rel=0.02 if share <= 0.01 else 0.12)
    assert abs(offset) < 0.06


def test_noise_of_the_displacement_begins_no_cycle(tmp_path):
    noise = np.random.default_rng(1).normal(size=MOTION.size)
    for by in (0.003, 0.03):
        loops, frequency, _, _ = figures(inspected(tmp_path, MOTION + by * noise, force_of(MOTION)))
        assert (loops, frequency) == (9, pytest.approx(FREQUENCY, rel=0.01))


@pytest.mark.parametrize("order", [1, -1], ids=["growing", "decaying"])
def test_small_cycles_of_a_loading_protocol_are_cycles(tmp_path, order):
    sizes = np.repeat(np.arange(0.1, 1.05, 0.1), 2)[::order]
    one = np.sin(2 * np.pi * np.arange(CYCLE) / CYCLE)
    motion = np.concatenate([size * one for size in sizes])
    found = re.search(
        r"full loops +(\d+), (\d) of them", inspected(tmp_path, motion, force_of(motion))
    )
    assert int(found[1]) == 19
    assert found[2] == "2" if order > 0 else "1"


# --- faults


def test_a_sound_record_has_no_warning(tmp_path):
    assert warned(inspected(tmp_path, MOTION, force_of(MOTION))) == []


@pytest.mark.parametrize("signal", ["displacement", "force"])
@pytest.mark.parametrize("value", [1e6, -9999.0])
@pytest.mark.parametrize("at", [[700], [0], [700, 701, 702], list(range(900, 960)), [50, 700, 701]])
def test_overflow_values_are_named_alone_and_left_out(tmp_path, signal, value, at):
    motion, force = MOTION.copy(), force_of(MOTION)
    sound = figures(inspected(tmp_path, motion, force))
    {"displacement": motion, "force": force}[signal][at] = value
    said = inspected(tmp_path, motion, force)
    assert warned(said) == ["spikes"]
    assert "correct or delete these rows" in said
    assert figures(said) == pytest.approx(sound, rel=0.01, abs=0.01)
    assert not re.search(r"(displacement|force) +\S* to \S*(e\+|9999)", said)


@pytest.mark.parametrize("lost", [CYCLE // 10, CYCLE // 4, CYCLE // 2])
def test_a_lost_block_whose_time_is_numbered_anew_is_named(tmp_path, lost):
    first = CYCLE * 5 - CYCLE // 3  # in the middle of a stroke
    kept = np.delete(np.arange(MOTION.size), np.arange(first, first + lost))
    said = inspected(tmp_path, MOTION[kept], force_of(MOTION)[kept])
    assert "jump" in warned(said)
    assert "samples were lost" in said


@pytest.mark.parametrize("held", [CYCLE // 10, CYCLE // 2, 4 * CYCLE])
@pytest.mark.parametrize("signal", ["displacement", "force"])
def test_a_frozen_channel_is_named(tmp_path, signal, held):
    motion, force = MOTION.copy(), force_of(MOTION)
    values, first = {"displacement": motion, "force": force}[signal], 5 * CYCLE - CYCLE // 3
    values[first : first + held] = values[first]
    said = inspected(tmp_path, motion, force)
    assert "held" in warned(said)
    assert f"the {signal} holds one value from" in said


def test_a_pause_of_the_test_is_not_frozen(tmp_path):
    motion = np.insert(MOTION, [3 * CYCLE] * CYCLE, MOTION[3 * CYCLE])
    assert warned(inspected(tmp_path, motion, force_of(motion))) == []


def test_a_drift_of_a_tenth_of_the_slip_force_is_named(tmp_path):
    for drift in (0.1, -0.1):
        said = inspected(tmp_path, MOTION, force_of(MOTION) + drift * TIME / TIME[-1])
        assert warned(said) == ["drift"]
    stepped = force_of(MOTION) + 0.1 * (np.arange(MOTION.size) > MOTION.size / 2)
    assert warned(inspected(tmp_path, MOTION, stepped)) == ["drift"]


@pytest.mark.parametrize("over", [1, CYCLE // 20, CYCLE])
@pytest.mark.parametrize("by", [0.2, -0.2])
def test_a_zero_that_moves_by_a_tenth_of_the_stroke_is_named(tmp_path, by, over):
    since = np.clip((np.arange(MOTION.size) - 5 * CYCLE) / over, 0.0, 1.0)
    said = inspected(tmp_path, MOTION + by * since, force_of(MOTION))
    assert "displacement zero" in warned(said)


def test_one_sided_and_growing_motions_have_no_moving_zero(tmp_path):
    size = np.repeat(np.linspace(0.8, 1.0, CYCLES), CYCLE)
    one_sided = size * (1.0 - np.cos(2 * np.pi * FREQUENCY * TIME))
    assert warned(inspected(tmp_path, one_sided, force_of(one_sided))) == []


def test_swapped_channels_are_not_called_a_wrong_sign(tmp_path):
    said = inspected(tmp_path, force_of(MOTION), MOTION)
    assert warned(said) == ["channels"]
    assert "displacement and force seem swapped" in said
    assert warned(inspected(tmp_path, MOTION, -force_of(MOTION))) == ["force sign"]
