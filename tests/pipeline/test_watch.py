"""A test that is followed while it runs: what each cycle tells, and when it is long enough."""

import re
import threading
import time

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app

CYCLES, SLIP = 4, "Fc_fwd"


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


@pytest.fixture(scope="module")
def tests(run):
    """The motion, and ten simulated measurements of it: their forces and their slip forces."""
    at = np.arange(0.0, (CYCLES + 0.5) / 0.5, 0.02)
    motion = mb.Trace.from_arrays(at, np.sin(np.pi * at), 1.0)
    band = run.predict(motion, "observation", draws=10, seed=4)
    return motion, band.draws, band.values[SLIP]


def write(path, motion, force, stop=None):
    columns = {"time_s": motion.time, "displacement_in": motion.displacement, "force_kip": force}
    pd.DataFrame(columns).iloc[:stop].to_csv(path, index=False)
    return path


def watch(run, path, *options):
    words = ("watch", path, "--run", run.folder, "--actuation", "1000 psi", *options)
    return CliRunner().invoke(app, [str(word) for word in words])


def test_each_cycle_says_what_it_told(run, tests, tmp_path):
    motion, forces, _ = tests
    ended = watch(run, write(tmp_path / "a.csv", motion, forces[0]), "--wait", "0 s")
    assert ended.exit_code == 0, ended.output
    lines = ended.stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == [f"cycle {k}" for k in range(1, CYCLES + 1)]
    for line in lines:
        assert re.search(r"Fc_fwd [\d.]+ kip \([\d.]+ to [\d.]+ kip; \d+ % of new tests", line)
        assert "gap_width" in line
        assert "does not fit" not in line
        assert " wide; " in line


def test_a_stated_share_decides_when_a_test_is_long_enough(run, tests, tmp_path):
    motion, forces, _ = tests
    path = write(tmp_path / "a.csv", motion, forces[0])
    soon = watch(run, path, "--wait", "0 s", "--narrowing", "90 %").stdout
    never = watch(run, path, "--wait", "0 s", "--narrowing", "0.001 %").stdout
    assert "enough after cycle 2" in soon
    assert "enough after cycle 1" not in soon
    assert "enough" not in never


@pytest.mark.slow
def test_a_file_that_grows_is_followed_to_its_end(run, tests, tmp_path):
    motion, forces, _ = tests
    path = write(tmp_path / "a.csv", motion, forces[1], 140)
    whole = write(tmp_path / "whole.csv", motion, forces[1]).read_text()

    def grow():
        time.sleep(2.0)
        begun = path.read_text()
        path.write_text(whole[: len(begun) + 1000].rstrip("\n")[:-3])  # ends within a number
        time.sleep(2.0)
        path.write_text(whole)

    writer = threading.Thread(target=grow)
    writer.start()
    growing = watch(run, path, "--wait", "4 s")
    writer.join()
    assert growing.exit_code == 0, growing.output
    assert len(growing.stdout.splitlines()) == CYCLES
    # the same as of the finished file, but for the draws of the band
    of_whole = watch(run, whole_file := tmp_path / "whole.csv", "--wait", "0 s").stdout
    assert whole_file.is_file()
    assert growing.stdout.split("band")[0] == of_whole.split("band")[0]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--actuation", "36 lbf"), "--actuation"),
        (("--narrowing", "much"), "--narrowing"),
        (("--wait", "3 in"), "--wait"),
    ],
)
def test_what_cannot_be_used_is_named(run, tests, tmp_path, options, named):
    motion, forces, _ = tests
    ended = watch(run, write(tmp_path / "a.csv", motion, forces[0]), *options)
    assert ended.exit_code == 2
    assert named in ended.stderr


def test_a_record_without_a_full_cycle_is_refused(run, tests, tmp_path):
    motion, forces, _ = tests
    ended = watch(run, write(tmp_path / "a.csv", motion, forces[0], 90), "--wait", "0 s")
    assert ended.exit_code == 2
    assert "full cycle" in ended.stderr


def after_cycles(run, motion, force):
    """Estimates after each cycle of a record."""
    follower = run.follow(1.0, amplitude=1.0, velocity=np.pi)
    begin, known = 0, []
    for number, end in enumerate(motion.cycle_turns[2::2], start=1):
        part = slice(begin, end + 1)
        rows = motion.time[part], motion.displacement[part], None, force[part]
        follower.update(*rows)
        begin = end + 1
        known.append(follower.estimates(number)[SLIP])
    return known


def test_the_force_of_a_stronger_device_does_not_fit(run, tests, tmp_path):
    motion, forces, _ = tests
    stronger = watch(run, write(tmp_path / "a.csv", motion, 2.0 * forces[0]), "--wait", "0 s")
    assert "does not fit this device" in stronger.stdout.splitlines()[-1]
    assert "enough" not in stronger.stdout


@pytest.mark.slow
def test_intervals_narrow_and_hold_the_slip_force_of_the_test(run, tests):
    motion, forces, slips = tests
    inside, narrower = 0, []
    for force, slip in zip(forces[:8], slips, strict=False):
        first, *_, last = after_cycles(run, motion, force)
        narrower.append((last.upper - last.lower) / (first.upper - first.lower))
        assert last.narrowing < first.narrowing
        inside += last.lower <= slip <= last.upper
    # of eight intervals of 95 %, fewer than four hold their value with a probability of 2e-5
    assert inside >= 4
    assert np.median(narrower) < 0.95  # one may widen: another slip force widens an interval too
