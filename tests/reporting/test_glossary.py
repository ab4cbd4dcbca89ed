"""The report and the documentation show the same words with the same meanings."""

import importlib.util
import re
from html import unescape
from pathlib import Path

import pytest

from mfd_bayes.reporting.glossary import read_glossary
from mfd_bayes.reporting.html import render
from mfd_bayes.runs.verdict import Verdict

ROOT = Path(__file__).parents[2]


def words_of_report(campaign):
    page = render(campaign, {})["report.html"]
    section = page[page.index('id="glossary"') :]
    return {
        unescape(n): unescape(t)
        for n, t in re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd></div>", section)
    }


def test_the_report_shows_every_word(campaign):
    known = {term.name: unescape(term.text) for group in read_glossary() for term in group.terms}
    assert words_of_report(campaign) == known
    assert len(known) > 40


@pytest.mark.skipif(not importlib.util.find_spec("mkdocs"), reason='needs the extra "docs"')
def test_the_documentation_shows_the_same_as_the_report(campaign):
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / "docs/hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    page = hooks._fill("glossary", "glossary.md")
    words = dict(re.findall(r"^\*\*(.+?)\*\*: (.+)$", page, re.MULTILINE))
    assert {unescape(n): unescape(t) for n, t in words.items()} == words_of_report(campaign)
    assert "{{ glossary }}" in (ROOT / "docs/pages/report.md").read_text(encoding="utf-8")


def test_texts_hold_no_markup_but_plain_emphasis():
    for group in read_glossary():
        for term in group.terms:
            assert set(re.findall(r"</?(\w+)[^>]*>", term.text)) <= {"em", "sub", "code"}
            assert term.text.endswith(".")


def test_verdicts_are_explained_as_the_report_explains_them():
    (text,) = (t.text for g in read_glossary() for t in g.terms if t.name.startswith("Verdict"))
    for verdict in Verdict:
        first, rest = verdict.message[0].lower(), verdict.message[1:]
        assert f"{verdict.capitalize()}: {first}{rest}" in text


def test_every_word_stands_once():
    names = [term.name for group in read_glossary() for term in group.terms]
    assert len(set(names)) == len(names)
