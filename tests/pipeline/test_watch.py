"""A test that is followed while it runs: what each cycle tells, and when it is long enough."""

import re
import threading
import time

import numpy as np
import pytest

import mfd_bayes as mb
from tests.command_line import here, refusal, write_csv

CYCLES, SLIP = 3, "Fc_fwd"


@pytest.fixture(scope="module")
def tests(run):
    """The motion, and ten simulated measurements of it, the most usual one first: forces, slips."""
    times = np.arange(0.0, (CYCLES + 0.5) / 0.5, 0.02)
    motion = mb.Trace.from_arrays(times, np.sin(np.pi * times), 1.0)
    band = run.predict(motion, "observation", draws=10, seed=4)
    # one of ten may be so unlike the rest that it is said not to fit
    order = np.argsort(np.abs(band.draws - np.median(band.draws, axis=0)).mean(axis=1))
    return motion, band.draws[order], band.values[SLIP][order]


@pytest.fixture
def words(out, tests, tmp_path):
    def words(force, *options, samples=None):
        columns = (column[:samples] for column in (tests[0].time, tests[0].displacement, force))
        path = write_csv(tmp_path / "a.csv", *columns)
        return ("watch", path, "--run", out, "--actuation", "1000 psi", "--wait", "0 s", *options)

    return words


def test_each_cycle_says_what_it_told(words, tests):
    ended = here(*words(tests[1][0], "--narrowing", "0.001 %"))
    assert ended.exit_code == 0, ended.output
    lines = ended.stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == [f"cycle {k}" for k in range(1, CYCLES + 1)]
    for line in lines:
        assert re.search(r"Fc_fwd [\d.]+ kip \([\d.]+ to [\d.]+ kip; \d+ % of new tests", line)
        assert "slip_to_slip" in line
        assert "does not fit" not in line
        assert " wide; " in line
        assert "enough" not in line


def test_a_stated_share_or_another_device_ends_a_test(words, tests):
    printed = here(*words(tests[1][0], "--narrowing", "90 %")).stdout
    assert "enough after cycle 2" in printed
    assert "enough after cycle 1" not in printed
    printed = here(*words(2.0 * tests[1][0])).stdout
    assert "does not fit this device" in printed.splitlines()[-1]
    assert "enough" not in printed


def test_what_cannot_be_used_is_named(words, tests):
    force = tests[1][0]
    for options, named in (
        (("--actuation", "36 lbf"), "--actuation"),
        (("--narrowing", "much"), "--narrowing"),
        (("--wait", "3 in"), "--wait"),
    ):
        assert named in refusal(*words(force, *options))
    assert "full cycle" in refusal(*words(force, samples=90))


@pytest.mark.slow
def test_a_file_that_grows_is_followed_to_its_end(words, tests):
    force = tests[1][1]
    of_whole = here(*words(force)).stdout
    content = words(force)[1].read_text()
    watched = words(force, "--wait", "4 s", samples=140)
    path = watched[1]

    def grow():
        time.sleep(2.0)
        head = path.read_text()
        path.write_text(content[: len(head) + 1000].rstrip("\n")[:-3])  # ends within a number
        time.sleep(2.0)
        path.write_text(content)

    writer = threading.Thread(target=grow)
    writer.start()
    growing = here(*watched)
    writer.join()
    assert growing.exit_code == 0, growing.output
    assert len(growing.stdout.splitlines()) == CYCLES
    # the same as of the finished file, but for the draws of the band
    assert growing.stdout.split("band")[0] == of_whole.split("band")[0]
