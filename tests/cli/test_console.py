"""What a command prints: nothing from a file is markup or a command to the terminal."""

from types import SimpleNamespace

import pytest

from mfd_bayes.cli.console import LISTED, clean, open_console, print_checks, print_end, say


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
    print_checks(SimpleNamespace(checks=[check]), every=True)
    out = capsys.readouterr().out
    assert "[red]p[/red]" in out
    assert ":smile:" in out
    assert "\x1b" not in out


def test_a_console_takes_no_text_for_markup(capsys):
    open_console().print("[bold]a[/bold] :smile:")
    assert capsys.readouterr().out == "[bold]a[/bold] :smile:\n"


def view_of(count, failing=(), failures=()):
    tests = [SimpleNamespace(id=f"p{i}", role="calibrate") for i in range(count)]
    tests.append(SimpleNamespace(id="held", role="validate"))
    checks = [
        SimpleNamespace(subject=f"p{i}", name=name, verdict="fail" if i in failing else "pass")
        for i in range(count)
        for name in ("R-hat", "R-hat", "bulk ESS")
    ]
    return SimpleNamespace(
        tests=tests,
        checks=checks,
        failures=dict.fromkeys(failures, "no mass"),
        verdict="fail" if failing else "pass",
        sentence="It is so.",
    )


def test_a_run_ends_with_every_verdict_and_where_to_look(capsys, tmp_path):
    print_end(view_of(2, failing=[1]), tmp_path / "my out")
    assert capsys.readouterr().out.splitlines() == [
        "  p0  pass",
        "  p1  FAIL: R-hat (2), bulk ESS (1)",
        "FAIL: It is so.",
        f"look next at {tmp_path}/my out/report.html; every check: "
        f"mfd-bayes check '{tmp_path}/my out'",
    ]


def test_of_many_tests_only_those_that_fail_are_listed(capsys, tmp_path):
    print_end(view_of(LISTED + 1, failing=[3]), tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{LISTED} of {LISTED + 1} tests pass all checks"
    assert lines[1].split() == ["p3", "FAIL:", "R-hat", "(2),", "bulk", "ESS", "(1)"]
    assert lines[2] == "FAIL: It is so."


def test_quiet_ends_with_the_verdict_alone(capsys, tmp_path):
    print_end(view_of(3, failing=[1]), tmp_path, quiet=True)
    assert capsys.readouterr().out == "FAIL: It is so.\n"
