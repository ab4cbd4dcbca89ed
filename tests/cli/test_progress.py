"""The progress of a long command, on terminals of several sizes and without one."""

import io
import math
import re
import time
from dataclasses import dataclass

import pytest
from rich.console import Console

from mfd_bayes.cli.progress import Board, _line, watch
from mfd_bayes.jobs.job import Progress, Step


@dataclass
class Clock:
    """A clock that is set by hand."""

    time: float = 0.0

    def __call__(self):
        return self.time


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def board(clock):
    return Board(now=clock)


def sampled(steps=300, seconds=10.0, share=0.5, limit=2400):
    return Progress(steps, limit, 1.0123, 432.1, seconds, share)


def lines_of(board, width=80, height=24):
    console = Console(
        file=io.StringIO(), width=width, height=height, force_terminal=True, markup=False
    )
    console.print(board)
    text = re.sub(r"\x1b\[[0-9;]*m", "", console.file.getvalue())  # colours are ours
    return [line.rstrip() for line in text.splitlines()]


def announce(board, count):
    names = [f"p{500 + i}_f0.25" for i in range(count)]
    for name in names:
        board.hear(Step(name, "waiting"))
    return names


def finish(board, clock, name, seconds=10.0):
    board.hear(Step(name, "finding modes"))
    clock.time += seconds
    board.hear(Step(name, "done", sampled(seconds=seconds)))


@pytest.mark.parametrize("width", [80, 200])
def test_a_test_has_a_row_with_its_figures(board, clock, width):
    first, second, third = announce(board, 3)
    finish(board, clock, first, 75.0)
    board.hear(Step(second, "sampling", sampled(steps=300, seconds=10.0, share=0.5)))
    clock.time += 3.0
    top, head, *rows = lines_of(board, width)
    assert head.split() == ["test", "stage", "steps", "R-hat", "ESS", "steps/s", "time", "left"]
    assert rows[0].split() == [first, "done", "300", "1.012", "432", "4.0", "1:15"]
    assert rows[1].split() == [second, "sampling", "300", "1.012", "432", "30", "0:03", "0:07"]
    assert rows[2].split() == [third, "waiting"]
    assert top.startswith("1 of 3 done, 1 running, 1 waiting, 1:18 so far, about")


def test_diagnostics_that_are_not_measured_yet_are_blank(board, clock):
    (name,) = announce(board, 1)
    early = Progress(240, 2400, math.nan, math.nan, 10.0, 0.5)
    board.hear(Step(name, "sampling", early))
    assert lines_of(board)[2].split() == [name, "sampling", "240", "24", "0:00", "0:10"]
    lines = list(map(_line, (Step("a", "sampling", early), Step("a", "sampling", sampled()))))
    assert lines[0] == "a: sampling, 240 steps, 24 steps/s, at most 90 s left"
    assert "R-hat 1.012, ESS 432" in lines[1]
    stuck = Progress(240, 2400, math.nan, 432.1, 10.0, 0.5)  # a quantity that never moved
    assert "R-hat nan, ESS 432" in _line(Step("a", "sampling", stuck))


@pytest.mark.parametrize("count", [50, 500])
@pytest.mark.parametrize(("width", "height"), [(80, 24), (200, 50), (40, 8)])
def test_many_tests_stay_inside_the_terminal(board, clock, count, width, height):
    names = announce(board, count)
    for name in names[:40]:
        finish(board, clock, name)
    for name in names[40:43]:
        board.hear(Step(name, "finding modes"))
    lines = lines_of(board, width, height)
    assert len(lines) <= height
    assert all(len(line) <= width for line in lines)
    shown = [name for name in names if any(line.startswith(name[:4]) for line in lines)]
    assert set(names[40:43]) <= set(shown)  # all that run,
    if height > 8:
        assert names[39] in shown  # and the last that ended,
    assert names[-1] not in shown or count <= height  # but not what waits
    assert lines[0].startswith(f"40 of {count} done, 3 running")
    if len(shown) < count:
        assert lines[-1].startswith("and ")
        assert lines[-1].endswith(f"{count - 43} waiting") or width == 40


def test_tests_that_run_are_summed_up_where_there_are_too_few_lines(board):
    for name in announce(board, 64):
        board.hear(Step(name, "finding modes"))
    lines = lines_of(board, 80, 24)
    assert len(lines) <= 24
    assert lines[-1] == "and 45 running"


def test_tests_of_an_earlier_session_count_as_done(board):
    (first, second) = announce(board, 2)
    board.hear(Step(first, "kept"))
    assert lines_of(board)[0].startswith("1 of 2 done, 1 waiting")
    board.hear(Step(second, "failed", message="no mass"))
    assert lines_of(board)[0].startswith("1 of 2 done, 1 failed")


def test_work_that_is_no_test_has_a_row_but_is_not_counted(board):
    (first,) = announce(board, 1)
    board.hear(Step(first, "kept"))
    board.hear(Step("report", "figures"))
    lines = lines_of(board)
    assert lines[0].startswith("1 of 1 done, 0:00 so far")
    assert lines[-1].split()[:2] == ["report", "figures"]


def test_nothing_is_drawn_before_the_first_test_begins(board):
    assert lines_of(board) == []
    announce(board, 5)
    assert lines_of(board) == []


def left_of(board):
    found = re.search(r"about (.*) left", lines_of(board)[0])
    if not found:
        return math.nan
    parts = [int(part) for part in found.group(1).split(":")]
    return sum(part * 60**i for i, part in enumerate(reversed(parts)))


def test_the_time_left_is_shown_as_soon_as_it_can_be_estimated(board, clock):
    names = announce(board, 10)
    board.hear(Step(names[0], "finding modes"))
    board.hear(Step(names[1], "finding modes"))
    assert math.isnan(left_of(board))
    clock.time = 30.0
    board.hear(Step(names[0], "done", sampled()))
    board.hear(Step(names[1], "done", sampled()))
    board.hear(Step(names[2], "finding modes"))
    board.hear(Step(names[3], "finding modes"))
    assert left_of(board) == 120  # eight of half a minute each, two at a time
    clock.time = 45.0
    assert left_of(board) == 105


def test_the_time_left_never_exceeds_the_limit_of_steps(board, clock):
    (name,) = announce(board, 1)
    board.hear(Step(name, "sampling", sampled(steps=2000, seconds=100.0, share=0.1, limit=2400)))
    assert left_of(board) == 20
    clock.time = 300.0
    assert left_of(board) == 0


def test_a_test_that_begins_again_says_so_and_goes_on(board, clock):
    (name,) = announce(board, 1)
    board.hear(Step(name, "finding modes"))
    board.hear(Step(name, "begins again:", message="its process was killed by SIGKILL"))
    row = lines_of(board, 200)[2]
    assert "begins again: its process" in row
    finish(board, clock, name)
    assert lines_of(board)[0].startswith("1 of 1 done")


@pytest.mark.parametrize("width", [80, 200])
def test_names_are_neither_markup_nor_commands_to_the_terminal(board, width):
    board.hear(Step("[red]a[/red]\x1b[2J\x1b]0;title\x07\n[/]", "sampling [bold]", sampled()))
    text = "\n".join(lines_of(board, width))
    assert "[red]a[/red]" in text
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", text)
    assert len(text.splitlines()) == 3


def told(capsys, *, quiet):
    with watch(quiet=quiet) as observe:
        observe(Step("a", "waiting"))
        observe(Step("b", "kept"))
        observe(Step("a", "sampling", sampled(steps=1200, seconds=10.0)))
        observe(Step("a", "begins again:", message="its process was killed"))
        observe(Step("a", "failed", message="no\x1b[2J [b]mass[/b]"))
        observe(Step("c", "done", sampled()))
    return capsys.readouterr()


def test_without_a_terminal_steps_are_lines(capsys):
    out, err = told(capsys, quiet=False)
    assert err == ""
    assert out.splitlines() == [
        "b: done before",
        "a: sampling, 1200 steps, R-hat 1.012, ESS 432, 120 steps/s, at most 10 s left",
        "a: begins again: its process was killed",
        "a: failed no [b]mass[/b]",
        "c: done, 300 steps, R-hat 1.012, ESS 432, 30 steps/s",
    ]


def test_after_a_silence_a_line_says_what_is_at_work(capsys, monkeypatch):
    monkeypatch.setattr("mfd_bayes.cli.progress.SILENCE", 0.05)
    with watch() as observe:
        observe(Step("a", "done"))
        time.sleep(0.3)
        assert capsys.readouterr().out == "a: done\n"
        observe(Step("b", "in the earthquake"))
        time.sleep(1.0)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "b: in the earthquake"
    assert 2 <= len(lines) <= 20
    assert re.fullmatch(r"b: in the earthquake, at work for [01] s", lines[1])


def test_quiet_prints_only_failures_and_restarts(capsys):
    out, err = told(capsys, quiet=True)
    assert out == ""
    assert err.splitlines() == [
        "a: begins again: its process was killed",
        "a: failed no [b]mass[/b]",
    ]
