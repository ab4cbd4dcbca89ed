"""Each fault is named in a record that has it, and nothing in one that has none.

Of the sensors and the clock, of a file's name, and of one test among others.
"""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.data_quality import contradictions, find_faults, inspect_record
from mfd_bayes.units import actuation_factor

GAP = 0.15  # in


def bristle(motion):
    """Force of a bristle that slips at 1 kip."""
    fine = np.interp(np.arange(8 * motion.size) / 8, np.arange(motion.size), motion)
    force = np.zeros(fine.size)
    for n, step in enumerate(np.diff(fine), 1):
        force[n] = force[n - 1] + 40.0 * (step - abs(step) * force[n - 1])
    return force[::8]


def signals(rate=200.0, frequency=0.5, cycles=6, amplitude=1.0, seed=0):
    """Time, displacement and force, (T,) each, with noise."""
    time = np.arange(int(rate * cycles / frequency) + 1) / rate
    motion = amplitude * np.sin(2 * np.pi * frequency * time)
    noise = np.random.default_rng(seed).standard_normal((2, time.size))
    return time, motion + 1e-5 * noise[0], bristle(motion) + 0.01 * noise[1]


def faults(time, motion, force, gap=GAP, velocity=None):
    return find_faults(mb.Trace.from_arrays(time, motion, None, force, velocity), gap)


def names(*arrays, **options):
    return [fault.name for fault in faults(*arrays, **options)]


CLEAN = signals()
NOISE = np.random.default_rng(1).standard_normal(2401)
SHAKE = np.random.default_rng(3).uniform(-1.0, 1.0, 2401)


def stepped(values, step):
    return np.round(values / step) * step


def elastoplastic(motion, stiffness):
    """Force of a slider that slips at 1 kip behind a spring, kip."""
    force = np.zeros(motion.size)
    for n, step in enumerate(np.diff(motion), 1):
        force[n] = np.clip(force[n - 1] + stiffness * step, -1.0, 1.0)
    return force


def ringing(t):
    return 0.3 * np.exp(-((t % 1.0) / 0.1)) * np.sin(2 * np.pi * 40 * t)


FAULTY = {
    "the sign of the force": (lambda t, x, f: (t, x, -f), "force sign", "sign = -1"),
    "the sign of the displacement": (lambda t, x, f: (t, -x, f), "force sign", "sign"),
    "time in ms": (lambda t, x, f: (t / 1000, x, f), "time unit", "in/s"),
    "no force": (lambda t, x, f: (t, x, 0 * f), "no force", "0 kip"),
    "a clipped force": (lambda t, x, f: (t, x, np.minimum(f, 0.9)), "clipping", "0.9 kip"),
    "coarse steps": (lambda t, x, f: (t, stepped(x, 0.02), f), "resolution", "0.02 in"),
    "noise": (lambda t, x, f: (t, x + 0.004 * NOISE, f), "noise", "0.00394 in"),
    "a drift": (lambda t, x, f: (t, x, f + 0.1 * t / t[-1]), "drift", "+0.1"),
    "a drift downward": (lambda t, x, f: (t, x, f - 0.1 * t / t[-1]), "drift", "-0.0"),
    "a zero that steps": (
        lambda t, x, f: (s := signals(cycles=8), (s[0], s[1], s[2] + 0.1 * (s[0] > 8.0)))[1],
        "drift",
        "kip",
    ),
    "dropped samples": (
        lambda t, x, f: [np.delete(values, [700, 701]) for values in (t, x, f)],
        "dropped samples",
        "1 step",
    ),
    "a late force": (lambda t, x, f: (t, x, np.interp(t - 0.04, t, f)), "lag", "behind"),
    "an early force": (lambda t, x, f: (t, x, np.interp(t + 0.025, t, f)), "lag", "before"),
    "a very late force": (lambda t, x, f: (t, x, np.interp(t - 0.25, t, f)), "lag", "about 25"),
    "a later one still": (lambda t, x, f: (t, x, np.roll(f, 88)), "lag", "at least 400"),
    "a very early force": (lambda t, x, f: (t, x, np.interp(t + 0.25, t, f)), "lag", "before"),
    "noise for a force": (lambda t, x, f: (t, x, 2.0 + 1e-3 * NOISE), "no force", "noise only"),
    "a force of another motion": (
        lambda t, x, f: (t, x, 5.0 + np.sin(1.7 * t)),
        "no force",
        "does not follow the motion",
    ),
    "a clipped displacement": (
        lambda t, x, f: (t, np.minimum(x, 0.9), f),
        "displacement clipping",
        "the displacement stays at its largest value, 0.9 in",
    ),
    "uneven time stamps": (
        lambda t, x, f: (np.sort(t + 0.003 * NOISE), x, f),
        "time stamps",
        'time = { rate = "200 Hz" }',
    ),
    "a force in few steps": (
        lambda t, x, f: (t, x, stepped(f, 0.12)),
        "force resolution",
        "the force moves in steps of 0.12 kip",
    ),
    "a force that is held": (
        lambda t, x, f: (t, x, np.repeat(f[::10], 10)[: t.size]),
        "held samples",
        "the force is new only at every 10th sample, every 50 ms",
    ),
    "a block that is written twice": (
        lambda t, x, f: [
            np.append(t, t[-1] + 0.005 * np.arange(1, 201)),
            *(np.concatenate([v[:1000], v[800:1000], v[1000:]]) for v in (x, f)),
        ],
        "repeated block",
        "200 samples from 5 s on are those from 4 s on again",
    ),
    "a displacement that drifts": (
        lambda t, x, f: (t, x + 0.1 * t / t[-1], f),
        "displacement zero",
        "the displacement drifts by +0.1 in",
    ),
    "peaks and valleys": (
        lambda t, x, f: (t[100::200], x[100::200], f[100::200]),
        "peaks and valleys",
        "2 samples a cycle",
    ),
}


@pytest.mark.parametrize("kind", FAULTY)
def test_a_fault_is_named_alone_with_its_figures(kind):
    change, name, words = FAULTY[kind]
    (fault,) = faults(*change(*CLEAN))
    assert fault.name == name
    assert words in str(fault.message)


SOUND = {
    "both signs swapped": lambda t, x, f: (t, -x, -f),
    "no force at all": lambda t, x, f: (t, x, None),
    "a coarse force": lambda t, x, f: (t, x, stepped(f, 0.03)),
    "fine steps": lambda t, x, f: (t, stepped(x, 0.002), f),
    "little noise": lambda t, x, f: (t, x + 0.0004 * NOISE, f),
    "a little drift": lambda t, x, f: (t, x, f + 0.02 * t / t[-1]),
    "a lag of a sample": lambda t, x, f: (t, x, np.interp(t - 0.005, t, f)),
    "viscous friction": lambda t, x, f: (t, x, f + np.cos(np.pi * t)),
    "a clock that trembles": lambda t, x, f: (t + 1e-3 * SHAKE, x, f),
    "a slow test": lambda t, x, f: signals(100.0, 0.05, seed=1),
    "a fast logger": lambda t, x, f: signals(1024.0, 1.0, seed=2),
    "one-sided strokes that grow": lambda t, x, f: (
        t,
        (y := np.linspace(0.8, 1.0, t.size) * (1.0 - np.cos(np.pi * t))),
        bristle(y) + 0.01 * NOISE,
    ),
    "a force that rings": lambda t, x, f: (t, x, f + ringing(t)),
    "Coulomb friction": lambda t, x, f: (
        t,
        np.sin(np.pi * t),
        np.sign(np.cos(np.pi * t)) + 0.01 * NOISE,
    ),
    "Coulomb friction behind a spring": lambda t, x, f: (
        t,
        x,
        elastoplastic(x, 40.0) + 0.01 * NOISE,
    ),
    "a soft spring": lambda t, x, f: (t, x, elastoplastic(x, 5.0) + 0.01 * NOISE),
    "a rest at each end of the stroke": lambda t, x, f: (
        t,
        (y := np.clip(1.4 * np.arcsin(np.sin(np.pi * t)) / np.pi * 2, -1.0, 1.0)),
        elastoplastic(y, 40.0) + 0.01 * NOISE,
    ),
    "equal cycles": lambda t, x, f: (
        t,
        np.resize(np.round(x[:400], 4), t.size),
        np.resize(np.round(f[400:800], 4), t.size),
    ),
    "a pause": lambda t, x, f: (
        t,
        (y := np.sin(np.pi * np.minimum(t, 5.5)) + np.where(t > 7.5, np.sin(np.pi * t) + 1.0, 0.0)),
        bristle(y) + 0.01 * NOISE,
    ),
}


@pytest.mark.parametrize("kind", SOUND)
def test_what_is_no_fault_is_not_named(kind):
    assert names(*SOUND[kind](*CLEAN)) == []


def test_the_samples_of_a_fault_are_given():
    time, motion, force = CLEAN
    (fault,) = faults(time, motion, np.minimum(force, 0.9))
    assert np.all(force[fault.samples] >= 0.9)
    assert fault.samples.size > 0.8 * np.count_nonzero(force >= 0.9)
    assert names(time, motion, np.clip(force, -0.9, 0.9)) == ["clipping", "clipping"]
    for signal in (1, 2):
        arrays, indices = [values.copy() for values in CLEAN], [333, 1000, 1777]
        arrays[signal][indices] += 1.0
        spikes = next(fault for fault in faults(*arrays) if fault.name == "spikes")
        assert spikes.samples.tolist() == indices
        assert "3 isolated samples" in str(spikes.message)
    time, motion, force = signals(rate=20.0)  # of few samples
    force[[0, 90, 91, 200]] = 9.999
    spikes = next(fault for fault in faults(time, motion, force) if fault.name == "spikes")
    assert spikes.samples.tolist() == [0, 90, 91, 200]


def test_some_faults_depend_on_the_gap():
    long = signals(amplitude=10.0)
    long = (long[0], stepped(long[1], 0.05), long[2])
    slow, small = signals(rate=20.0), signals(amplitude=0.07)
    for name, arrays, gap in (
        ("resolution", long, None),
        ("rate", slow, None),
        ("stroke", small, 0.1),
    ):
        assert name in names(*arrays)
        assert name not in names(*arrays, gap=gap)


def test_a_short_record_is_named_and_the_gravest_fault_comes_first():
    time, motion, force = signals(rate=20.0, cycles=1.5)
    order = names(1000 * time, motion, -force)
    assert order[0] == "force sign"
    assert order.index("short record") < order.index("rate")
    assert "short record" in names(*(values[:90] for values in CLEAN))  # without a turn


def test_a_drift_is_seen_although_most_cycles_ramp():
    time = np.arange(0.0, 20.0, 1 / 200)
    size = np.clip(np.minimum(time, 20.0 - time) / 6.5, 0.0, 1.0)
    motion = size * np.sin(np.pi * time)
    force = size * np.tanh(8.0 * np.gradient(motion, time))
    force += 0.002 * np.random.default_rng(0).normal(size=time.size)
    assert "drift" not in names(time, motion, force)
    assert "drift" in names(time, motion, force + 0.8 * time / time[-1])
    returning = force + 0.4 * np.sin(np.pi * time / 20.0)  # it comes back: no drift
    assert "drift" not in names(time, motion, returning)


def test_a_velocity_must_be_that_of_the_displacement():
    time = np.arange(801) / 100.0
    noise = np.random.default_rng(3).normal(0.0, 2e-3, time.size)
    motion = stepped(np.sin(np.pi * time) + noise, 1 / 500)
    velocity = np.pi * np.cos(np.pi * time) + 0.05  # with a zero that is a little off
    for measured, wrong in (
        (velocity, False),
        (1.1 * velocity, False),
        (-velocity, True),
        (25.4 * velocity, True),
        (velocity / 2, True),
        (0.0 * velocity, True),
        (velocity[::-1] ** 2, True),
    ):
        fault_names = names(time, motion, np.sign(velocity), velocity=measured)
        assert ("velocity" in fault_names) == wrong


# --- what inspect says

RATE, CYCLES, CYCLE = 200.0, 10, 400
MOTION = np.cos(2 * np.pi * (np.arange(CYCLES * CYCLE) / CYCLE + 0.1))


def force_of(motion):
    return bristle(motion) + 0.005 * np.random.default_rng(0).normal(size=motion.size)


def write(path, motion, force, rate=RATE, head="time_s,displacement_in,force_kip"):
    table = np.column_stack([np.arange(motion.size) / rate, motion, force])
    np.savetxt(path, table, "%.6g", ",", header=head, comments="")
    return path


def inspected(folder, motion, force):
    """Facts of a record and names of its faults."""
    inspection = inspect_record("a", mb.read_record(write(folder / "a.csv", motion, force)))
    facts = {name: str(text) for name, text in inspection.facts.items()}
    return facts, [fault.name for fault in inspection.faults]


def figures(facts):
    """Number of loops at full stroke, their frequency in Hz and mean energy, and the offset."""
    loops = re.match(r"(\d+).*frequency ([\d.]+)", facts["full loops"])
    numbers = (facts[name].split()[0] for name in ("energy per cycle", "force offset"))
    return int(loops[1]), float(loops[2]), *map(float, numbers)


def test_the_command_counts_cycles_and_names_the_overflow_value(tmp_path, small_pictures):
    motion, force = MOTION.copy(), force_of(MOTION)
    motion[np.flatnonzero(np.diff(np.sign(np.diff(MOTION))) < 0) + 1] -= 0.007
    force[1500] = 1e6
    path = write(tmp_path / "a.csv", motion, force)
    ran = CliRunner().invoke(app, ["inspect", str(path), "-o", str(tmp_path)])
    assert ran.exit_code == 0
    assert re.search(r"turning points +19 \(9.5 cycles\)", ran.stdout)
    assert re.findall(r"warning +([a-z ]+):", ran.stdout) == ["spikes"]
    assert inspected(tmp_path, force_of(MOTION), MOTION)[1] == ["channels"]
    assert inspected(tmp_path, MOTION, -force_of(MOTION))[1] == ["force sign"]


def test_a_tremble_at_the_turns_begins_no_cycle(tmp_path):
    for samples, share, sides in ((1, 0.0035, (1,)), (10, 0.0035, (1, -1)), (10, 0.1, (1, -1))):
        motion = MOTION.copy()
        for side in sides:
            for top in np.flatnonzero(np.diff(np.sign(np.diff(side * MOTION))) < 0) + 1:
                for start in (top - 2 * samples, top, top + 2 * samples):
                    motion[max(start, 0) : max(start, 0) + samples] -= side * 2.0 * share
        loops, frequency, energy, offset = figures(inspected(tmp_path, motion, force_of(MOTION))[0])
        assert (loops, frequency) == (9, pytest.approx(0.5, rel=0.03))
        assert energy == pytest.approx(3.9, rel=0.02 if share <= 0.01 else 0.12)
        assert abs(offset) < 0.06
        noise = 0.3 * share * np.random.default_rng(1).normal(size=MOTION.size)
        assert figures(inspected(tmp_path, MOTION + noise, force_of(MOTION))[0])[0] == 9


def test_small_cycles_of_a_loading_protocol_are_cycles(tmp_path):
    cycle = np.sin(2 * np.pi * np.arange(CYCLE) / CYCLE)
    for order in (1, -1):
        sizes = np.repeat(np.arange(0.1, 1.05, 0.1), 2)[::order]
        motion = np.concatenate([size * cycle for size in sizes])
        loops = inspected(tmp_path, motion, force_of(motion))[0]["full loops"]
        assert loops.startswith("19, 2 of them")


@pytest.mark.parametrize("signal", [0, 1])
def test_overflow_values_are_named_alone_and_left_out(tmp_path, signal):
    sound = figures(inspected(tmp_path, MOTION, force_of(MOTION))[0])
    at_a_turn, midway = list(range(330, 390)), list(range(900, 960))
    for value, rows in ((1e6, [0]), (-9999.0, [700, 701, 702]), (1e6, midway), (1e6, at_a_turn)):
        arrays = [MOTION.copy(), force_of(MOTION)]
        arrays[signal][rows] = value
        facts, warned = inspected(tmp_path, *arrays)
        assert warned == ["spikes"]
        assert figures(facts) == pytest.approx(sound, rel=0.01, abs=0.01)
        assert not re.search(r"e\+|9999", facts["displacement"] + facts["force"])


@pytest.mark.parametrize("lost", [CYCLE // 10, CYCLE // 2])
def test_a_lost_block_and_a_frozen_channel_are_named(tmp_path, lost):
    start = CYCLE * 5 - CYCLE // 3  # in the middle of a stroke
    force = force_of(MOTION)
    rows = np.delete(np.arange(MOTION.size), np.arange(start, start + lost))
    assert "jump" in inspected(tmp_path, MOTION[rows], force[rows])[1]
    for signal in (0, 1) if lost == CYCLE // 2 else (0,):  # a force may slip at one value
        arrays = [MOTION.copy(), force.copy()]
        arrays[signal][start : start + lost] = arrays[signal][start]
        assert "held" in inspected(tmp_path, *arrays)[1]
    assert inspected(tmp_path, MOTION, force)[1] == []


def test_a_zero_that_moves_by_a_tenth_of_the_stroke_is_named(tmp_path):
    for step, duration in ((0.2, 1), (-0.2, CYCLE)):
        ramp = np.clip((np.arange(MOTION.size) - 5 * CYCLE) / duration, 0.0, 1.0)
        assert "displacement zero" in inspected(tmp_path, MOTION + step * ramp, force_of(MOTION))[1]


def columns_of(folder, **columns):
    """Names and texts of what contradicts a file of columns, of which the first are used."""
    path = folder / "run.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.6g", ",", header=",".join(columns), comments="")
    roles = dict(zip(("time", "displacement", "force"), columns, strict=False))
    inspection = inspect_record("a", mb.read_record(path, roles))
    return [(fault.name, str(fault.message)) for fault in inspection.faults]


def test_loops_judge_the_columns_that_are_not_used(tmp_path):
    time, motion, force = CLEAN
    signal = {"time_s": time, "displacement_in": motion, "force_kip": force}
    vertical = 50.0 + np.sin(0.7 * time)
    assert columns_of(tmp_path, **signal, other_s=1e-3 * np.round(1e3 * time) + 5.0) == []
    assert columns_of(tmp_path, **signal, inner_in=0.8 * motion, command_in=1.1 * motion) == []
    assert columns_of(tmp_path, **signal, vertical_kip=vertical) == []
    ((name, words),) = columns_of(tmp_path, **signal, other_s=2.0 * time)
    assert name == "two clocks"
    assert "200 Hz and 100 Hz" in words
    outer = {**signal, "displacement_in": motion + 0.1 * force}
    ((name, words),) = columns_of(tmp_path, **outer, slip_in=motion)
    assert name == "other column"
    assert "'slip_in' and 0.2" in words
    remarks = columns_of(
        tmp_path, time_s=time, displacement_in=motion, p_kip=vertical, q_kip=force, r_kip=vertical
    )
    assert [name for name, _ in remarks] == ["other column", "no force"]
    assert "'q_kip'" in remarks[0][1]


# --- the name of a file


def named(folder, name, actuation=None, column=""):
    """What contradicts the name of a file: 1 in at 0.25 Hz."""
    time = np.arange(0.0, 16.0, 1 / 64)
    motion = np.sin(0.5 * np.pi * time)
    path = write(folder / f"{name}.csv", motion, np.tanh(5 * np.cos(0.5 * np.pi * time)), 64)
    if column:
        head, *rows = path.read_text().splitlines()
        path.write_text("\n".join([f"{head},{column}", *(f"{row},7.0" for row in rows)]) + "\n")
    return [str(f.message) for f in contradictions(mb.read_record(path, actuation=actuation))]


def test_a_name_that_the_record_contradicts_is_named_and_no_other(tmp_path):
    agree = ("36lb_0.25Hz_1.0in", "0p25hz_1in", "25.4mm 0.25 Hz", "test_2in", "amp_1.0in_64Hz")
    nothing = ("harmonic0.03ea1forward", "run3in_lab", "p500_f9", "5in_1in")
    for name, options, words in (
        *((name, {}, "") for name in (*agree, *nothing)),
        ("36lb_0.25Hz_1.5in", {}, "says 1.5in, but the record has an amplitude of 1 in"),
        ("1.0in_0.1Hz", {}, "0.25 Hz"),
        ("30lb_a", {"actuation": "36 lbf"}, "says 30lb, but the campaign has an actuation of 36"),
        ("500psi", {"actuation": "3 MPa"}, "says 500psi"),
        ("5MPa", {"column": "actuation_MPa"}, "but its column has an actuation of 7 MPa"),
        ("36lb_a", {"actuation": "500 psi"}, ""),  # of another kind: not compared
    ):
        remarks = named(tmp_path, name, **options)
        assert len(remarks) == bool(words), name
        assert all(words in sentence for sentence in remarks)


def test_real_records_raise_no_false_alarm(data_folder, tmp_path):
    for path in sorted(data_folder.glob("20*.csv")):
        record = mb.read_record(path)
        assert find_faults(record.trace(), 0.2) == (), path.name
        assert contradictions(record) == (), path.name
    record = mb.read_record(data_folder / "2023_36lb_0.10Hz_1.0in_SI.csv")
    wrong = write(tmp_path / record.path.name, 1.5 * record.displacement, record.force, record.rate)
    (fault,) = contradictions(mb.read_record(wrong))
    assert "says 1.0in, but the record has an amplitude of 1.51 in" in str(fault.message)


# --- one test among others

LEVELS = (20.0, 30.0, 35.0, 60.0, 80.0)
DEVICE = [80, 0, 0, 1, 1, 1.1, 1.1, 0.3, 25, 0.1, 0.12, 1, 0.01, 0.5]


def trace_of(level, seed, *, length=1.0, force=1.0, actuation=1.0, noise=0, theta=None):
    """A damper at a level in lbf; the record is wrong by the factors."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 12.0, 1 / 128)
    x = np.minimum(1.0, time / 2.0) * (1.0 + 0.01 * rng.normal()) * np.sin(np.pi * time)
    slip = 0.4 * level**0.5 * (1.0 + 0.05 * (-1) ** seed)
    values = np.array([theta or DEVICE], dtype=float)
    if theta is None:
        values[:, 3:7] *= slip
    clean = ThreeStage().force(values, mb.Trace.from_arrays(time, x, 0.03))[0]
    clean += 0.15 * slip * x**2  # both directions differ
    noise_rng = np.random.default_rng(100 + seed + 1000 * noise)
    measured = force * (clean + 0.03 * noise_rng.normal(size=time.size))
    return mb.Trace.from_arrays(time, length * x, actuation * level / 1000.0, measured)


def put(name, trace, actuation=None):
    columns = {"displacement": ("x", "in"), "force": ("f", "kip")}
    record = SimpleNamespace(columns=columns, path=Path("a.csv"))
    return Tested.of(name, record, trace, actuation or f"{1e3 * trace.reference_actuation:g} lbf")


def campaign(k=None, **wrong):
    """Five tests; of test k the record is wrong."""
    return [
        put(f"t{level:g}", trace_of(level, n, **(wrong if n == k else {})))
        for n, level in enumerate(LEVELS)
    ]


def compared(tests):
    return [(name, fault.name, str(fault.message)) for name, fault in compare_tests(tests)]


WRONG = [
    ({"length": 25.4}, "unit of displacement", "in mm, not in in"),
    ({"length": 4.0}, "displacement", "times too large"),
    ({"force": 1000.0}, "unit of force", "in lbf, not in kip"),
    ({"force": 4.448}, "unit of force", "in kN, not in kip"),
    ({"force": -1.0}, "force sign", "that of the force"),
    ({"length": -1.0}, "force sign", "that of the displacement"),
    ({"length": -1.0, "force": -1.0}, "both signs", "both swapped"),
    (
        {"theta": [300, 0, 0, 9, 9, 9.5, 9.5, 0.5, 300, 0.02, 0.03, 1, 0.002, 0.5]},
        "another device",
        "another device",
    ),
]


@pytest.mark.parametrize(("wrong", "kind", "words"), WRONG)
def test_the_test_that_is_wrong_is_named_with_its_cause(wrong, kind, words):
    for k in (0, 2, 4) if "theta" not in wrong else (2,):
        ((test, name, sentence),) = compared(campaign(k, **wrong))
        assert (test, name) == (f"t{LEVELS[k]:g}", kind)
        assert words in sentence


def test_tests_of_one_device_are_not_named_and_two_cannot_tell_which_is_wrong():
    assert compared(campaign()) == []
    assert compared([*campaign(), put("t0", trace_of(35.0, 7, actuation=0.0))]) == []
    assert compared(campaign(0, length=25.4)[:2]) == []
    assert compared(campaign(1, force=-1.0)[:2]) == []
    ((test, name, _),) = compared(campaign(1, force=-1.0)[:3])
    assert (test, name) == ("t30", "force sign")


def test_an_actuation_that_is_wrong_by_ten_or_in_another_unit_is_named():
    for k, actuation in ((4, 10.0), (2, 0.1)):
        ((test, name, sentence),) = compared(campaign(k, actuation=actuation))
        assert (test, name) == (f"t{LEVELS[k]:g}", "actuation")
        assert "by a factor of ten" in sentence
    tests = campaign()
    tests[2] = put("t35", trace_of(35.0, 2, actuation=224.8089), "35 kN")
    ((test, _, sentence),) = compared(tests)
    assert test == "t35"
    assert "35 lbf, not 35 kN" in sentence


@pytest.mark.parametrize(("i", "j"), [(0, 4), (1, 3), (0, 3)])
def test_two_exchanged_actuations_are_named_both(i, j):
    levels = dict(enumerate(LEVELS)) | {i: LEVELS[j], j: LEVELS[i]}
    pairs = enumerate(LEVELS)
    tests = [put(f"r{n}", trace_of(level, n, actuation=levels[n] / level)) for n, level in pairs]
    remarks = compared(tests)
    assert [(name, kind) for name, kind, _ in remarks] == [(f"r{k}", "actuation") for k in (i, j)]
    assert f"its actuation and that of r{j}" in remarks[0][2]
    assert all("probably exchanged" in sentence for *_, sentence in remarks)


def test_an_exchange_that_nothing_tells_is_not_named():
    for levels in ((20, 35), (35, 20, 60), (20, 30, 35, 60, 80)):
        loads = sorted(levels)  # of the loops
        pairs = enumerate(zip(levels, loads, strict=True))
        tests = [put(f"r{n}", trace_of(level, n, actuation=to / level)) for n, (to, level) in pairs]
        assert compared(tests) == []


SESSION = ((20, 0.97), (25, 1.62), (35, 2.06), (70, 2.48), (80, 2.86))
"""Tension, lbf, and slip force, kip, of five tests of a real session, which follow no law well."""


@pytest.mark.parametrize(
    ("k", "actuation", "force", "words"),
    [
        (0, "", 1.0, ""),
        (2, "35 kN", 1.0, "35 lbf, not 35 kN"),
        (4, "8 lbf", 1.0, "by a factor of ten"),
        (2, "", 4.448, "in kN, not in kip"),
        (4, "", 4.448, "in kN, not in kip"),
    ],
)
def test_a_mistake_among_five_scattered_tests_is_named(k, actuation, force, words):
    tests = []
    for n, (level, slip) in enumerate(SESSION):
        text = actuation if n == k and actuation else f"{level} lbf"
        number, unit = text.split()
        ratio = float(number) * actuation_factor(unit)[0] * 1000.0 / level
        size = slip / (0.4 * level**0.5) * (force if n == k else 1.0)
        tests.append(put(f"t{n}", trace_of(level, n, force=size, actuation=ratio), text))
    remarks = compared(tests)
    assert [name for name, *_ in remarks] == ([f"t{k}"] if words else [])
    assert all(words in sentence for *_, sentence in remarks)


def test_a_test_with_half_of_its_neighbours_force_is_named():
    for levels, sizes, odd in (
        ((35, 35, 35), (1.0, 1.0, 0.5), ["r2"]),
        ((30, 35, 40), (1.0, 0.5, 1.0), ["r1"]),
        ((35, 35), (1.0, 0.5), []),  # nothing tells which
        ((35, 35, 35), (1.0, 0.8, 1.2), []),
        ((20, 35, 80), (1.0, 1.4, 2.0), []),
    ):
        pairs = zip(levels, sizes, strict=True)
        tests = [put(f"r{n}", trace_of(p, n, force=factor)) for n, (p, factor) in enumerate(pairs)]
        assert [name for name, _, _ in compared(tests)] == odd


# --- one measurement in two files


def sampled_anew(trace, rate, begin, end):
    duration = trace.time[-1]
    grid = np.arange(begin * duration, end * duration, 1.0 / rate)
    motion, force = (np.interp(grid, trace.time, v) for v in (trace.displacement, trace.force))
    return mb.Trace.from_arrays(grid - grid[0], motion, 0.035, force)


def test_a_record_that_was_cut_or_sampled_anew_is_named_once():
    trace = trace_of(35.0, 2)
    for rate, begin, end in ((128, 0.0, 1.0), (100, 0.21, 0.9), (64, 0.137, 0.8)):
        again = put("again", sampled_anew(trace, rate, begin, end))
        for tests in ([put("first", trace), again], [*campaign(), again]):
            ((name, kind, sentence),) = compared(tests)
            assert (name, kind) == ("again", "duplicate")
            share = re.search(r"in (\d+)% of the longer", sentence)
            assert (float(share[1]) if share else 100) == pytest.approx(100 * (end - begin), abs=2)


def test_a_test_that_was_repeated_is_no_duplicate():
    trace = trace_of(35.0, 2)
    for variant in (
        trace_of(35.0, 3),
        trace_of(35.0, 2, noise=1, force=1.02),  # as near as a copy, but of other noise
        trace_of(35.0, 2, force=1.05),
    ):
        assert compared([put("a", trace), put("b", variant)]) == []
    smooth = np.sin(np.pi * trace.time) + 0.2 * np.sin(0.4 * np.pi * trace.time)
    quiet = mb.Trace.from_arrays(trace.time, trace.displacement, 0.035, smooth)
    tests = [put("a", quiet), put("b", sampled_anew(quiet, 250, 0.0, 1.0))]
    assert [kind for _, kind, _ in compared(tests)] == ["duplicate"]
