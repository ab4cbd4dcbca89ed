"""What a command prints: nothing from a file is markup or a command to the terminal."""

from types import SimpleNamespace

import pytest

from mfd_bayes.cli.console import LISTED, clean, open_console, print_checks, print_end, say
from mfd_bayes.evaluation.views import Judgement
from mfd_bayes.messages import Message
from mfd_bayes.runs.verdict import Finding
from mfd_bayes.runs.verdict import Use
from mfd_bayes.runs.verdict import Finding, Use


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("p500_f0.25", "p500_f0.25"),
        ("[red]stop[/red] [link=x]", "[red]stop[/red] [link=x]"),
        ("\x1b[31mred\x1b[0m", "red"),
        ("\x1b[2J\x1b[1;1Htop", "top"),
        ("\x9b31mred", "red"),
        ("\x1b]0;title\x07text", "text"),
        ("\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\", "link"),
        ("\x1bP1;2|sixel\x1b\\after", "after"),
        ("\x1b(0lqqk", "lqqk"),
        ("\x1bcreset", "reset"),
        ("\x1b", ""),
        ("a\r\nb\tc\x08d\x00", "a  b c d "),
        ("\u202egnp.exe", " gnp.exe"),  # turns what follows around
        ("\udcff", " "),  # a file name that is no UTF-8
        ("γ², 95 % ± ü", "γ², 95 % ± ü"),
    ],
)
def test_text_has_no_commands_to_the_terminal(text, shown):
    assert clean(text) == shown
    assert clean(clean(text)) == clean(text)


def test_nested_escape_sequences_are_removed():
    shown = clean("\x1b\x1b[31m[31mx\x1b[\x1b[0m31m")
    assert shown.isprintable()


def test_a_line_is_one_line(capsys):
    say("a\nb\x1b[2J")
    say("c", err=True)
    assert capsys.readouterr() == ("a b\n", "c\n")


def test_a_table_shows_names_as_they_are(capsys):
    check = SimpleNamespace(
        subject="[red]p[/red]", name=":smile:", target="\x1b[31mk3", value=1.0, limit="<= 1"
    )
    check.verdict = "pass"
    check.tolerance = float("nan")
    print_checks(SimpleNamespace(checks=[check], warnings=(), judgements=()), every=True)
    out = capsys.readouterr().out
    assert "[red]p[/red]" in out
    assert ":smile:" in out
    assert "\x1b" not in out


def test_a_console_takes_no_text_for_markup(capsys):
    open_console().print("[bold]a[/bold] :smile:")
    assert capsys.readouterr().out == "[bold]a[/bold] :smile:\n"


def view_of(count, bad=()):
    told = {i: Judgement(f"p{i}", Use.NOT_USABLE, "the sign is swapped", 9.0) for i in bad}
    judged = [told.get(i, Judgement(f"p{i}", Use.USABLE, "", 0.1)) for i in range(count)]
    return SimpleNamespace(
        judgements=judged,
        warnings=[Finding("p0", "lag", Message("it is late"))],
        verdict=Use.NOT_USABLE if bad else Use.USABLE,
        sentence="It is so.",
    )


def test_a_run_ends_with_every_verdict_and_where_to_look(capsys, tmp_path):
    print_end(view_of(2, bad=[1]), tmp_path / "my out")
    assert capsys.readouterr().out.splitlines() == [
        "warning: p0: it is late",
        "  p0  usable",
        "  p1  not usable: the sign is swapped",
        "NOT USABLE: It is so.",
        f"look next at {tmp_path}/my out/report.html; every check: "
        f"mfd-bayes check '{tmp_path}/my out'",
    ]


def test_of_many_tests_only_those_that_are_not_usable_are_listed(capsys, tmp_path):
    print_end(view_of(LISTED + 1, bad=[3]), tmp_path)
    lines = capsys.readouterr().out.splitlines()[1:]
    assert lines[0] == f"{LISTED} of {LISTED + 1} tests are usable without more"
    assert lines[1] == "  p3   not usable: the sign is swapped"
    assert lines[2] == "NOT USABLE: It is so."


def test_quiet_ends_with_the_verdict_alone(capsys, tmp_path):
    print_end(view_of(3, bad=[1]), tmp_path, quiet=True)
    assert capsys.readouterr().out == "NOT USABLE: It is so.\n"
