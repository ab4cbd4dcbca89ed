"""The progress of a long command, in lines and on a terminal."""

import os
import re
import select
import struct
import subprocess
import sys
import time

import pytest

from mfd_bayes.cli.console import show_progress
from mfd_bayes.jobs.job import Progress, Step

SAMPLED = Progress(1200, 2400, 1.0123, 432.1, 10.0, 0.5)


def steps():
    yield Step("a", "waiting")
    yield Step("b", "kept")
    yield Step("a", "sampling", SAMPLED)
    yield Step("a", "begins again:", message="its worker was lost")
    yield Step("processes", "note:", message="one was killed")
    yield Step("a", "failed", message="no\x1b[2J [b]mass[/b]")
    yield Step("c", "done", SAMPLED)


ALARMS = [
    "a: begins again: its worker was lost",
    "processes: note: one was killed",
    "a: failed no [b]mass[/b]",
]


def test_without_a_terminal_steps_are_lines_and_quiet_prints_only_what_must_be_known(capsys):
    for quiet in [False, True]:
        with show_progress(quiet=quiet) as observe:
            for step in steps():
                observe(step)
        lines = [
            "b: done before",
            "a: sampling, 1200 steps, R-hat 1.012, ESS 432, 120 steps/s, at most 10 s left",
            *ALARMS,
            "c: done, 1200 steps, R-hat 1.012, ESS 432, 120 steps/s",
        ]
        out, err = capsys.readouterr()
        assert (out.splitlines(), err.splitlines()) == (([], ALARMS) if quiet else (lines, []))


def test_after_a_silence_a_line_says_what_is_at_work_and_what_is_missing(capsys, monkeypatch):
    monkeypatch.setattr("mfd_bayes.cli.console.SILENCE", 0.05)
    with show_progress() as observe:
        observe(Step("a", "done"))
        time.sleep(0.3)
        assert capsys.readouterr().out == "a: done\n"
        observe(Step("b", "sampling", Progress(9, 10, 1.1, 5.0, 1.0, missing="R-hat of k3")))
        time.sleep(0.5)
    lines = capsys.readouterr().out.splitlines()
    assert 2 <= len(lines) <= 20
    assert re.fullmatch(r"b: sampling, at work for [01] s, needs R-hat of k3", lines[1])


# --- on a terminal

termios = pytest.importorskip("termios")
pty = pytest.importorskip("pty")
fcntl = pytest.importorskip("fcntl")

# What a calibration tells its observer, a test after the other.
DRIVER = """\
import sys
import time

from mfd_bayes.cli.commands import settle_environment
from mfd_bayes.cli.options import mistakes
from mfd_bayes.cli.console import show_progress
from mfd_bayes.jobs.job import Progress, Step
from mfd_bayes.jobs.signals import end_on_signals

TESTS, PAUSE, LAST = {tests}, {pause}, {last}
settle_environment()
hint, quiet = mistakes("mfd-bayes go on"), "--quiet" in sys.argv
with end_on_signals(), hint, show_progress(quiet=quiet) as observe:
    names = [f"p{{500 + k}}[red]_f0.25" for k in range(TESTS)]
    for name in names:
        observe(Step(name, "waiting"))
    for name in names:
        observe(Step(name, "finding modes"))
        time.sleep(PAUSE)
        observe(Step(name, "sampling", Progress(100, 2400, 1.05, 50.0, 1.0, 0.3, "more ESS")))
        time.sleep(LAST if name == names[-1] else PAUSE)
        observe(Step(name, "done", Progress(300, 300, 1.0123, 432.1, 3.0)))
print("over")
"""


class Terminal:
    """A command in its own terminal, and its output so far."""

    def __init__(self, folder, tests=3, pause=0.05, last=0.05, options=(), term="xterm-256color"):
        driver = folder / "driver.py"
        driver.write_text(DRIVER.format(tests=tests, pause=pause, last=last))
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))

        def take():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        plain = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            [sys.executable, str(driver), *options],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=plain | {"TERM": term, "PYTHONPATH": os.pathsep.join(sys.path)},
            preexec_fn=take,
        )
        os.close(theirs)
        self.written = ""

    def read(self, until=None, seconds=30.0):
        """Output so far; reads on until a text comes or the output ends."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and (until is None or until not in self.written):
            if not select.select([self._ours], [], [], 0.1)[0]:
                continue
            try:
                data = os.read(self._ours, 65536)
            except OSError:  # Linux says so where the other side is closed
                break
            if not data:
                break
            self.written += data.decode()
        return self.written

    def type(self, text):
        os.write(self._ours, text.encode())

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._ours)


@pytest.fixture
def terminal(tmp_path):
    opened = []

    def start(**how):
        opened.append(Terminal(tmp_path, **how))
        return opened[-1]

    yield start
    for each in opened:
        each.close()


def lines_of(written):
    """All lines that were ever drawn, without colours and movements."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written)
    return [line.rstrip() for line in re.split(r"[\r\n]+", text) if line.strip()]


def test_a_terminal_shows_bars_and_keeps_a_line_of_each_test(terminal):
    tests = 3
    calibration = terminal(tests=tests, pause=0.3)
    written = calibration.read()
    assert calibration.process.wait(timeout=10) == 0
    lines = lines_of(written)
    for k in range(tests):
        done = f"p{500 + k}[red]_f0.25: done, 300 steps, R-hat 1.012, ESS 432, 100 steps/s"
        assert lines.count(done) == 1
    assert any("sampling, R-hat 1.050, ESS 50, needs" in line for line in lines)
    assert any(re.match(rf"all .* {tests} of {tests} done", line) for line in lines)
    assert lines[-1] == "over"
    assert all(len(line) <= 80 for line in lines if "━" in line)
    assert written.rindex("\x1b[?25h") > written.rindex("\x1b[?25l")  # the cursor is back


def test_ctrl_c_leaves_the_bars_and_says_how_to_resume(terminal):
    calibration = terminal(last=60.0)
    calibration.read(until="sampling")
    calibration.type("\x03")
    written = calibration.read()
    assert calibration.process.wait(timeout=10) == 130
    bars, _, words = written.rpartition("\x1b[0m\x1b[?25h")
    assert "sampling" in bars
    assert re.sub(r"\s+", " ", words).strip() == (
        "mfd-bayes: interrupted; what is finished is kept, go on with: mfd-bayes go on"
    )


def test_quiet_draws_nothing_and_a_terminal_without_a_cursor_gets_lines(terminal):
    assert terminal(options=["--quiet"]).read() == "over\r\n"
    written = terminal(term="dumb").read()
    assert "\x1b" not in written
    assert "p500[red]_f0.25: done, 300 steps" in written
