"""The progress of a long command, in lines and on a terminal."""

import os
import re
import struct
import subprocess
import sys
import time

import pytest

from mfd_bayes.jobs.job import Progress, Step
from mfd_bayes.jobs.progress import show_progress

SAMPLED = Progress(1200, 2400, 1.0123, 432.1, 10.0, 0.5)


@pytest.mark.parametrize("quiet", [False, True])
def test_without_a_terminal_steps_are_lines_and_quiet_prints_what_must_be_known(capsys, quiet):
    steps = (
        Step("a", "waiting"),
        Step("b", "kept"),
        Step("a", "sampling", SAMPLED),
        Step("a", "begins again:", message="its worker was lost"),
        Step("a", "failed", message="no\x1b[2J [b]mass[/b]"),
        Step("c", "done", SAMPLED),
    )
    with show_progress(quiet=quiet) as observe:
        for step in steps:
            observe(step)
    alarms = ["a: begins again: its worker was lost", "a: failed no [b]mass[/b]"]
    lines = [
        "b: done before",
        "a: sampling, 1200 steps, R-hat 1.012, ESS 432, 120 steps/s, at most 10 s left",
        *alarms,
        "c: done, 1200 steps, R-hat 1.012, ESS 432, 120 steps/s",
    ]
    stdout, stderr = capsys.readouterr()
    assert (stdout.splitlines(), stderr.splitlines()) == (([], alarms) if quiet else (lines, []))


def test_after_a_silence_a_line_says_what_is_at_work_and_what_is_missing(capsys, monkeypatch):
    monkeypatch.setattr("mfd_bayes.jobs.progress.SILENCE", 0.05)
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

DRIVER = """\
import sys
import time

from mfd_bayes.cli.commands import settle_environment
from mfd_bayes.cli.streams import mistakes
from mfd_bayes.jobs.progress import show_progress
from mfd_bayes.jobs.job import Progress, Step
from mfd_bayes.jobs.signals import end_on_signals

settle_environment()
hint, quiet = mistakes(lambda: "mfd-bayes go on"), "--quiet" in sys.argv
with end_on_signals(), hint, show_progress(quiet=quiet) as observe:
    names = [f"p{{500 + k}}[red]_f0.25" for k in range(3)]
    for name in names:
        observe(Step(name, "waiting"))
    for name in names:
        observe(Step(name, "finding modes"))
        time.sleep({pause})
        observe(Step(name, "sampling", Progress(100, 2400, 1.05, 50.0, 1.0, 0.3, "more ESS")))
        time.sleep({pause})
        observe(Step(name, "done", Progress(300, 300, 1.0123, 432.1, 3.0)))
print("over")
"""


def on_terminal(folder, *options, pause=0.05, term="xterm-256color"):
    """What a command of three tests writes to a terminal of its own of 80 columns."""
    driver = folder / "driver.py"
    driver.write_text(DRIVER.format(pause=pause))
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = os.environ | {"TERM": term, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment = {k: v for k, v in environment.items() if k not in ("COLUMNS", "LINES")}
    command = [sys.executable, str(driver), *options]
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
    with subprocess.Popen(command, **streams, env=environment, start_new_session=True) as process:
        os.close(theirs)
        written = b""
        try:
            while data := os.read(ours, 65536):
                written += data
        except OSError:  # Linux says so where the other side is closed
            os.close(ours)
    assert process.returncode == 0, written
    return written.decode()


def test_a_terminal_shows_bars_and_keeps_a_line_of_each_test(tmp_path):
    written = on_terminal(tmp_path, pause=0.15)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written)  # without colours and movements
    lines = [line.rstrip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    for k in range(3):
        summary = f"p{500 + k}[red]_f0.25: done, 300 steps, R-hat 1.012, ESS 432, 100 steps/s"
        assert lines.count(summary) == 1
    assert any("sampling, R-hat 1.050, ESS 50, needs" in line for line in lines)
    assert any(re.match("all .* 3 of 3 done", line) for line in lines)
    assert lines[-1] == "over"
    assert all(len(line) <= 80 for line in lines if "━" in line)
    assert written.rindex("\x1b[?25h") > written.rindex("\x1b[?25l")  # the cursor is back


def test_quiet_draws_nothing_and_a_terminal_without_a_cursor_gets_lines(tmp_path):
    assert on_terminal(tmp_path, "--quiet") == "over\r\n"
    written = on_terminal(tmp_path, term="dumb")
    assert "\x1b" not in written
    assert "p500[red]_f0.25: done, 300 steps" in written
