"""The compiled step against `Model.step`, and what `compile_step` refuses."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.applications.export.compiled import CompiledStep, compile_step
from mfd_bayes.errors import FitError, NotThereError, ReportError
from mfd_bayes.friction.models import MODELS
from tests.export.made import GRID, chosen, made_sets, needs_compiler, stepped

BARS = {"three_stage": 1e-12, "lugre": 1e-12, "bouc_wen": 1e-9, "backlash": 1e-9}
"""Of the peak force, by which C may differ from Python."""

pytestmark = needs_compiler


def record(data_folder, name, rate=64.0, seconds=15.0):
    """Motion of a real record, a part of it; for a model of rates with the trace's velocities."""
    columns = {"force": "force_kip", "displacement": "displacement_in", "time": "time_s"}
    trace = mb.read_record(data_folder / name, columns=columns).trace(rate=rate)
    begin = int(np.argmax(np.abs(trace.velocity) > 0.2 * np.abs(trace.velocity).max()))
    part = slice(begin, begin + int(rate * seconds))
    return trace.time[part], trace.displacement[part], trace.velocity[part]


def with_changing_steps(time, x, v, seed=1):
    """About two thirds of the samples of a motion, by chance: steps of one, two, three samples."""
    rows = np.flatnonzero(np.random.default_rng(seed).uniform(size=time.size) < 0.65)
    return time[rows], x[rows], v[rows]


@cache
def compiled(name):
    """Sets of a model, and their step in C."""
    sets = made_sets(name, 50)
    return sets, CompiledStep(sets)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("file", ["2023_36lb_0.50Hz_1.0in.csv", "2023_36lb_ImperialValleyDBE.csv"])
def test_c_gives_the_forces_of_python(data_folder, name, file):
    """Vectors of the backlash, which is slow, stand alone: in a batch they differ by 1e-9."""
    sets, step = compiled(name)
    alone = name == "backlash"
    sets = chosen(sets, range(10)) if alone else sets
    time, x, v = with_changing_steps(*record(data_folder, file, seconds=3.0 if alone else 15.0))
    for p in (np.full(time.size, 1.0), 1.6 + 1.6 * np.sin(1.3 * time)):
        expected = stepped(sets, time, x, v, p, alone=alone)
        force = np.stack([step.force(row, time, x, v, p) for row in sets.names])
        peak = np.abs(expected).max(axis=1)
        assert np.all(np.abs(force - expected).max(axis=1) <= BARS[name] * peak)
    assert np.ptp(expected, axis=0).max() > 0.1  # the sets differ


@pytest.mark.parametrize("name", MODELS)
def test_a_state_may_be_stepped_again_and_is_not_changed(name):
    step = compiled(name)[1]
    state, force = step.start(1, direction=1), 0.0
    for k in range(40):
        force, state = step.step(state, np.sin(0.2 * k), 20.0 * np.cos(0.2 * k), 0.01)
    first, later = step.step(state, 0.3, 1.0, 0.02)
    step.step(state, 2.0, 8.0, 0.5, 2.0)
    assert step.step(state, 0.3, 1.0, 0.02)[0] == first == later.force != force
    assert later.work != state.work


def test_the_direction_of_the_first_motion_is_the_one_that_is_given():
    sets, step = compiled("three_stage")
    model = sets.model
    forces = []
    for direction in (1, -1):
        state = model.start(sets.theta[:1], sets.start[:1], direction=direction)
        damper = step.start("1", direction)
        for x, v in ((0.0, 0.0), (-0.02, -1.0), (-0.05, -2.0)):
            expected, state = model.step(state, x, v, 0.01)
            force, damper = step.step(damper, x, v, 0.01)
            assert abs(force - expected[0]) <= 1e-12 * max(abs(force), 1.0)
        forces.append(force)
    assert forces[0] != forces[1]


def test_a_run_s_step_is_that_of_its_model(finished_run):
    run = mb.open_run(finished_run.out)
    step = mb.compile_step(run, "1000 psi", draws=10)
    assert step.names[:4] == ("nominal", "lower", "upper", "1")
    trace = run.tests["p1000_f0.5"].trace
    sets = step.sets
    motion = trace.time, trace.displacement, trace.velocity
    expected = stepped(sets, *motion, np.full(trace.samples, 1.2))
    for row, name in enumerate(step.names):
        force = step.force(name, *motion, 1.2)
        assert np.abs(force - expected[row]).max() <= 1e-12 * np.abs(expected[row]).max()
    at_level, same = step.force("nominal", *motion), step.force("nominal", *motion, 1.0)
    np.testing.assert_array_equal(at_level, same)
    assert compile_step(run, 1.0, draws=10).names == step.names


def test_an_actuation_outside_of_the_laws_is_said_and_not_computed():
    step = compiled("lugre")[1]
    _, state = step.step(step.start("1"), 0.0, 1.0, 0.0)
    assert state.tested
    assert not step.step(state, 0.01, 1.0, 0.01, 3.1)[1].tested
    assert step.step(state, 0.01, 1.0, 0.01, float(GRID[-1]) + 1.0)[0] > 0.0
    for level in (-0.1, 6.1, np.nan):
        with pytest.raises(FitError, match="outside of the range of the laws, 0 to 6 ksi"):
            step.step(state, 0.01, 1.0, 0.01, level)
    with pytest.raises(FitError, match="outside of the range"):
        step.force("1", [0.0, 0.1], [0.0, 0.1], [1.0, 1.0], [1.0, 7.0])
    with pytest.raises(FitError, match="dt must be positive"):
        step.step(state, 0.01, 1.0, 0.0)


def test_an_unknown_set_is_named_with_what_there_is():
    step = compiled("lugre")[1]
    with pytest.raises(NotThereError, match=r"no set 'median'.* number of a draw, up to 50"):
        step.start("median")


def test_parameters_that_cannot_be_are_refused():
    sets = made_sets("lugre", 1)
    sets.theta[0, 0] = 0.0
    with pytest.raises(FitError, match="parameters cannot be"):
        CompiledStep(sets).start("1")


def test_without_a_compiler_it_says_what_to_do(monkeypatch, tmp_path, finished_run):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(ReportError, match=r"no compiler of C here.*run\.model\.step"):
        compile_step(mb.open_run(finished_run.out), draws=10)


def test_a_compiler_that_fails_is_quoted(monkeypatch, tmp_path):
    path = tmp_path / "cc"
    path.write_text("#!/bin/sh\necho 'no licence' >&2\nexit 3\n")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    with pytest.raises(ReportError, match=r"failed on the step in C: no licence"):
        CompiledStep(made_sets("lugre", 1))


@pytest.mark.parametrize("name", ["three_stage", "backlash"])
def test_a_device_without_actuation_takes_any(name):
    sets = replace(chosen(made_sets(name, 1), [0]), unit="")
    step = CompiledStep(sets)
    time = np.arange(0.0, 2.0, 0.01)
    motion = time, np.sin(4 * time), 4 * np.cos(4 * time)
    state, expected = sets.model.start(sets.theta, sets.start), []
    for k, (t, x, v) in enumerate(zip(*motion, strict=True)):
        force, state = sets.model.step(state, x, v, t - time[k - 1] if k else 0.0)
        expected.append(force[0])
    for level in (None, -5.0, 1e9):
        force = step.force("1", *motion, level)
        assert np.abs(force - expected).max() <= BARS[name] * np.abs(expected).max()
