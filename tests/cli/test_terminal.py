"""Long commands in a pseudo-terminal: the table that they draw, and the screen when they end."""

import os
import re
import select
import signal
import struct
import subprocess
import sys
import time

import pytest

termios = pytest.importorskip("termios")
pty = pytest.importorskip("pty")
fcntl = pytest.importorskip("fcntl")

# The command as installed, but for the work: only its news comes, as it would in a calibration.
# In place of the module that works is one that takes no seconds to import.
DRIVER = """\
import sys
import time
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace

import mfd_bayes.pipeline
from mfd_bayes.cli.commands import main
from mfd_bayes.jobs.job import Progress, Step

TESTS, PAUSE, LAST = {tests}, {pause}, {last}


def work(plan, out, observe):
    names = [f"p{{500 + k}}[red]_f0.25" for k in range(TESTS)]
    for name in names:
        observe(Step(name, "waiting"))
    for name in names:
        observe(Step(name, "finding modes"))
        time.sleep(PAUSE)
        observe(Step(name, "sampling", Progress(100, 2400, 1.05, 50.0, 1.0, 0.3)))
        time.sleep(LAST if name == names[-1] else PAUSE)
        observe(Step(name, "done", Progress(300, 300, 1.0123, 432.1, 3.0)))
    tests = [SimpleNamespace(id=name, role="calibrate") for name in names]
    return SimpleNamespace(
        tests=tests, judgements=(), warnings=(), verdict="usable", sentence="It is so."
    )


@dataclass(frozen=True)
class Options:
    seed: int
    jobs: int | None
    scheduler: str | None
    resume: bool
    force: bool
    effort: str = ""
    command: str = ""


commands = ModuleType("mfd_bayes.pipeline.commands")
commands.Options = Options
commands.effort_of = lambda out, effort, *, resume: "quick"
commands.calibrate_plan = work
commands.plan_campaign = lambda *_: SimpleNamespace(
    manifest=SimpleNamespace(warnings=()), system=SimpleNamespace(words=str)
)
commands.is_whole = lambda view: True
sys.modules[commands.__name__] = mfd_bayes.pipeline.commands = commands
main()
"""


class Terminal:
    """A command in its own terminal, and its output so far."""

    def __init__(self, folder, columns, lines, tests=5, pause=0.05, last=0.05, *options):
        driver = folder / "driver.py"
        driver.write_text(DRIVER.format(tests=tests, pause=pause, last=last))
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

        def take():
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        self.process = subprocess.Popen(
            [sys.executable, str(driver), "calibrate", "campaign.toml", "-o", "out", *options],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
            | {"TERM": "xterm-256color"},
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

    def start(*words):
        opened.append(Terminal(tmp_path, *words))
        return opened[-1]

    yield start
    for one in opened:
        one.close()


def screen_of(written, columns, lines):
    """Lines that a terminal shows after an output with rich's movements of the cursor."""
    rows, row, column = [""], 0, 0
    for part in re.findall(r"\x1b\[[0-9;?]*[A-Za-z]|[\r\n]|[^\x1b\r\n]+", written):
        if part == "\n":
            row += 1
            rows += [""] * (row + 1 - len(rows))
        elif part == "\r":
            column = 0
        elif part == "\x1b[2K":
            rows[row] = ""
        elif part.endswith("A") and part.startswith("\x1b["):
            row -= int(part[2:-1])
        elif not part.startswith("\x1b["):
            rows[row] = rows[row][:column].ljust(column) + part + rows[row][column + len(part) :]
            column += len(part)
            assert len(rows[row]) <= columns
    return [line.rstrip() for line in rows][-lines:]


@pytest.mark.parametrize(("columns", "lines", "tests"), [(80, 24, 5), (200, 24, 5), (80, 12, 30)])
def test_a_table_is_drawn_and_its_last_state_stays(terminal, columns, lines, tests):
    one = terminal(columns, lines, tests, 0.5 / tests)
    written = one.read()
    assert one.process.wait(timeout=10) == 0
    screen = [line for line in screen_of(written, columns, 100) if line]
    tables = [i for i, line in enumerate(screen) if line.startswith("test ")]
    assert len(tables) == 1  # every frame was drawn over the one before
    top = screen[tables[0] - 1]
    assert top.startswith(f"{tests} of {tests} done, 0:0")
    last = screen[tables[0] + min(tests, lines - 5)]
    assert last.split()[:5] == [f"p{499 + tests}[red]_f0.25", "done", "300", "1.012", "432"]
    assert screen[-2].startswith("USABLE: It is so.")
    assert "mfd-bayes check out" in screen[-1]
    assert written.rindex("\x1b[?25h") > written.rindex("\x1b[?25l")  # the cursor is back


@pytest.mark.parametrize("delay", [0.0, 0.13, 0.25, 0.4])
def test_ctrl_c_leaves_the_table_and_says_how_to_resume(terminal, delay):
    one = terminal(80, 24, 3, 0.05, 60.0)
    one.read(until="sampling")
    time.sleep(delay)  # at any moment of a frame
    one.type("\x03")
    written = one.read()
    assert one.process.wait(timeout=10) == 130
    table, _, words = written.rpartition("\x1b[0m\x1b[?25h")
    assert "sampling" in table
    assert re.sub(r"\s+", " ", words).strip() == (
        "mfd-bayes: interrupted; what is finished is kept, go on with: "
        "mfd-bayes calibrate campaign.toml -o out --resume"
    )


def test_sigterm_is_named_in_the_last_line(terminal):
    one = terminal(80, 24, 3, 0.05, 60.0)
    one.read(until="sampling")
    one.process.send_signal(signal.SIGTERM)
    written = one.read()
    assert one.process.wait(timeout=10) == 143
    assert "interrupted by SIGTERM" in written.rpartition("\x1b[?25h")[2]


def test_quiet_draws_nothing(terminal):
    one = terminal(80, 24, 3, 0.05, 0.05, "--quiet")
    assert one.read() == "USABLE: It is so.\r\n"
    assert one.process.wait(timeout=10) == 0


def test_a_terminal_that_cannot_move_its_cursor_gets_lines(terminal, monkeypatch):
    monkeypatch.setattr(
        sys.modules[__name__], "DRIVER", "import os\nos.environ['TERM'] = 'dumb'\n" + DRIVER
    )
    one = terminal(80, 24, 2)
    written = one.read()
    assert "\x1b" not in written
    assert "p500[red]_f0.25: done, 300 steps" in written
