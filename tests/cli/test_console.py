"""What a command prints: nothing from a file is markup or a command to the terminal."""

from pathlib import Path
from types import SimpleNamespace

from mfd_bayes.cli.console import LINES, WIDTH, clean, print_checks, print_end
from mfd_bayes.evaluation.views import Check, Judgement
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.runs.folder import Finding, Use, Verdict
from mfd_bayes.runs.unit_system import SI


def test_text_has_no_commands_to_the_terminal():
    for text, shown in [
        ("p500_f0.25", "p500_f0.25"),
        ("[red]stop[/red] [link=x]", "[red]stop[/red] [link=x]"),
        ("\x1b[2J\x1b[1;1Htop", "top"),
        ("\x1b]0;title\x07text", "text"),
        ("\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\", "link"),
        ("\x1b", ""),
        ("a\r\nb\tc\x08d\x00", "a  b c d "),
        ("\u202egnp.exe", " gnp.exe"),  # turns what follows around
        ("\udcff", " "),  # a file name that is no UTF-8
        ("γ², 95 % ± ü", "γ², 95 % ± ü"),
    ]:
        assert clean(text) == shown
        assert clean(clean(text)) == clean(text)


def view_of(count, bad=(), sentence="It is so."):
    judged = [
        Judgement(f"p{i}", Use.NOT_USABLE, (Message("the sign is swapped " * 9),), 9.0)
        if i in bad
        else Judgement(f"p{i}", Use.USABLE, (), 0.1)
        for i in range(count)
    ]
    late = Message("it is {late} late", {"late": Quantity.of(0.8, unit="in")})
    return SimpleNamespace(
        judgements=judged,
        checks=[Check("p0", "R-hat", "k3", 1.2, 1.01, Verdict.FAIL)],
        warnings=[Finding("p0", "lag", late)],
        verdict=Use.NOT_USABLE if bad else Use.USABLE,
        sentences=[Message(sentence)],
        system=SI,
    )


def test_a_table_shows_names_as_they_are(capsys):
    check = Check("[red]p[/red]", ":smile:", "\x1b[31mk3", 1.0, 1.0, Verdict.PASS)
    view = view_of(0)
    view.checks = [check]
    print_checks(view, every=True)
    out = capsys.readouterr().out
    assert "[red]p[/red]" in out
    assert ":smile:" in out
    assert "\x1b" not in out


def test_a_run_ends_with_its_verdict_and_what_misses(capsys, tmp_path):
    print_end(view_of(2, bad=[1]), tmp_path / "my out")
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "NOT USABLE: It is so.",
        "warning: p0: it is 20.3 mm late",
        "fail: p0: R-hat of k3: 1.2 (<= 1.01)",
    ]
    assert lines[3].startswith("not usable: p1: the sign is swapped")
    assert lines[4:] == [
        f"every check: mfd-bayes check '{tmp_path}/my out'",
        f"look next at {tmp_path}/my out/report.html",
    ]


def test_the_end_has_at_most_ten_lines_of_a_hundred_columns(capsys):
    for count, words in ((50, 200), (50, 3), (1, 200), (3, 3)):
        print_end(view_of(count, range(count), "All is lost. " * words), Path("out"))
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) <= LINES == 10
        assert max(map(len, lines)) <= WIDTH == 100
        assert lines[-1] == "look next at out/report.html"
        assert ("more, and every check" in lines[-2]) == (count == 50)
