"""One hostile name, from a campaign file through everything that shows it."""

import csv
import io
import json
import re
from dataclasses import replace

import pytest

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft.toml import commented, quoted
from mfd_bayes.cli.console import say
from mfd_bayes.errors import CampaignError
from mfd_bayes.reporting import html, tables
from mfd_bayes.reporting.exports import export_tables
from mfd_bayes.reporting.figures.loops import draw_overview
from mfd_bayes.reporting.html import render
from mfd_bayes.reporting.tables import report_tables

NAME = (
    "=cmd|' /C calc'!A0<script>alert(1)</script><img src=x onerror=alert(1)>{{7*7}}"
    "\x1b[31m\x1b]0;owned\x07\u202egpj.exe\u2066\u200b$\\input{/etc/passwd}%$\r\n@SUM(1)"
)
UNSEEN = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
TEST = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'


@pytest.fixture
def hostile(tmp_path, campaign):
    """A report whose every free text is the name that a campaign file gave."""
    (tmp_path / "a.csv").write_text("time_s\n")
    path = tmp_path / "campaign.toml"
    text = "".join(f"\\U{ord(c):08X}" for c in NAME)
    path.write_text(f'[campaign]\ntitle = "{text}"\n{TEST}')
    name = load_campaign(path).title
    assert name == NAME
    rows = tuple(replace(row, note=name) for row in campaign.law_rows)
    first = campaign.tests[0]
    first = replace(first, rows=tuple(replace(row, note=name) for row in first.rows))
    return replace(
        campaign,
        title=name,
        sentence=name,
        tests=(first, *campaign.tests[1:]),
        failures={"a": name},
        law_rows=rows,
        checks=tuple(replace(c, target=name) for c in campaign.checks),
        remarks=(name,),
        provenance={"file " + name: name},
    )


def test_pages_show_it_as_text(hostile):
    for page in render(hostile, {}).values():
        assert page.encode()
        assert not UNSEEN.search(page)
        assert "<script>alert" not in page
        assert "<img src=x" not in page
        assert "{{7*7}}" in page  # no template of a template
        assert "&lt;script&gt;alert(1)" in page


def test_pages_that_show_what_turns_text_around_are_found(hostile, monkeypatch):
    monkeypatch.setattr(html, "_finalize", lambda value: value)
    monkeypatch.setattr(html, "page_environment", html.page_environment.__wrapped__)  # made anew
    assert any(UNSEEN.search(page) for page in render(hostile, {}).values())


def formulas(text):
    cells = [cell for line in csv.reader(io.StringIO(text)) for cell in line]
    return [cell for cell in cells if cell.lstrip().startswith(("=", "+", "@"))]


def test_tables_hold_no_formula_and_no_controls(hostile):
    shown = 0
    for text in report_tables(hostile).values():
        assert not UNSEEN.search(text)
        assert formulas(text) == []
        shown += "/C calc" in text
    assert shown


def test_formulas_in_tables_are_found(hostile, monkeypatch):
    monkeypatch.setattr(tables, "_FORMULA", ("never",))
    assert any(formulas(text) for text in report_tables(hostile).values())


def test_exports_hold_it_as_text(hostile):
    for name, text in export_tables(hostile).items():
        assert not UNSEEN.search(text)
        if name.endswith(".json"):
            assert json.loads(text)["title"] == NAME
        else:
            assert all("\\input{/etc" not in line.partition("%")[0] for line in text.splitlines())


def test_a_surrogate_of_a_strangers_manifest_is_written(hostile):
    odd = replace(hostile, title="\ud800", remarks=("\udcff",))
    for files in (render(odd, {}), report_tables(odd), export_tables(odd)):
        assert all(text.encode() for text in files.values())


def test_figures_draw_it(hostile):
    figure = draw_overview(hostile.title, hostile.tests)
    figure.canvas.draw()
    assert not UNSEEN.search(figure.get_suptitle())


def test_the_terminal_shows_one_line(hostile, tmp_path, capsys):
    (tmp_path / "b.toml").write_text('[campaign]\n"' + "\\u001b[31m\\u202e" + '" = 1\n' + TEST)
    with pytest.raises(CampaignError) as caught:
        load_campaign(tmp_path / "b.toml")
    for words in (hostile.title, caught.value):
        say(words)
        shown = capsys.readouterr().out
        assert shown.count("\n") == 1
        assert not UNSEEN.search(shown)


def test_a_first_campaign_file_keeps_it_a_string(tmp_path):
    import tomllib

    text = f"[campaign]\ntitle = {quoted(NAME)}  {commented(NAME)}\n"
    assert tomllib.loads(text) == {"campaign": {"title": NAME}}
    assert not UNSEEN.search(commented(NAME))
