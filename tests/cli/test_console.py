"""What a command prints: nothing from a file is markup or a command to the terminal."""

from types import SimpleNamespace

import pytest

from mfd_bayes.cli.console import LISTED, clean, print_checks, print_end, say
from mfd_bayes.evaluation.views import Judgement
from mfd_bayes.messages import Message
from mfd_bayes.runs.unit_system import US
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


def view_of(count, bad=(), checks=()):
    """A view of some tests, of which those with the numbers `bad` are not usable."""
    reasons, usable = (Message("the sign is swapped"),), Use.USABLE
    return SimpleNamespace(
        judgements=[
            Judgement(f"p{i}", Use.NOT_USABLE, reasons, 9.0)
            if i in bad
            else Judgement(f"p{i}", usable, (), 0.1)
            for i in range(count)
        ],
        checks=checks,
        warnings=[Finding("p0", "lag", Message("it is late"))],
        verdict=Use.NOT_USABLE if bad else usable,
        sentences=(Message("It is so."),),
        systems=(US,),
        metric=False,
    )


def test_a_table_shows_names_as_they_are(capsys):
    check = SimpleNamespace(
        test="[red]p[/red]", check=":smile:", feature="\x1b[31mk3", status="pass"
    )
    vars(check).update(observed=1.0, unit="1", limit="<= 1", tolerance=float("nan"))
    print_checks(view_of(0, checks=[check]), every=True)
    out = capsys.readouterr().out
    assert "[red]p[/red]" in out
    assert ":smile:" in out
    assert "\x1b" not in out


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
    print_end(view_of(3, bad=[1]), tmp_path, quiet=True)
    assert capsys.readouterr().out == "NOT USABLE: It is so.\n"


def test_of_many_tests_only_those_that_are_not_usable_are_listed(capsys, tmp_path):
    print_end(view_of(LISTED + 1, bad=[3]), tmp_path)
    assert capsys.readouterr().out.splitlines()[1:4] == [
        f"{LISTED} of {LISTED + 1} tests are usable without more",
        "  p3   not usable: the sign is swapped",
        "NOT USABLE: It is so.",
    ]
