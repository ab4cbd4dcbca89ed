"""What a command prints: nothing from a file is markup or a command to the terminal."""

from pathlib import Path
from types import SimpleNamespace

from mfd_bayes.cli.console import LINES, WIDTH, clean, print_end
from mfd_bayes.evaluation.views import Check, Judgement
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.runs.folder import Finding, Use, Verdict
from mfd_bayes.runs.unit_system import SI


def test_text_has_no_commands_to_the_terminal():
    for text, shown in [
        ("[red]stop[/red] [link=x]", "[red]stop[/red] [link=x]"),
        ("\x1b[2J\x1b[1;1Htop", "top"),
        ("\x1b]0;title\x07text", "text"),
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


def test_the_end_has_at_most_ten_lines_of_a_hundred_columns(capsys):
    for count, words in ((50, 200), (50, 3), (1, 200), (3, 3)):
        print_end(view_of(count, range(count), "All is lost. " * words), Path("out"))
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) <= LINES == 10
        assert max(map(len, lines)) <= WIDTH == 100
        assert lines[-1] == "look next at out/report.html"
        assert ("more, and every check" in lines[-2]) == (count == 50)
