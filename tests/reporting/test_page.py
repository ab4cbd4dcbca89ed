"""The pages of a report as HTML: what stands in them, and that no text is a command."""

import base64
import csv
import hashlib
import importlib.util
import io
import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Pair
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.cli.console import say
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.views import (
    FREE_EXPONENT,
    PREDICTIVE,
    Check,
    Judgement,
)
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import figures, page
from mfd_bayes.reporting.figures.loops import draw_overview
from mfd_bayes.reporting.page import read_glossary, render
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import paper_sheets, report_frames, to_csv, to_json, to_latex
from mfd_bayes.runs.manifest import Comparison, ComparisonRow, Finding, Use, Verdict
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.store.files import commented, quoted

ROOT = Path(__file__).parents[2]
PIXEL = figures.to_png(figures.draw_loops("", Trace.from_arrays(np.arange(30.0), np.arange(30.0))))
NAME = (
    "=cmd|' /C calc'!A0<script>alert(1)</script><img src=x onerror=alert(1)>{{7*7}}{x}"
    "\x1b[31m\x1b]0;owned\x07\u202egpj.exe\u2066\u200b$\\input{/etc/passwd}%$\r\n@SUM(1)"
)
UNSEEN = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


class Page(HTMLParser):
    """Elements, in order; every one that opens is closed."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self, text):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, *tags):
        return [attributes for tag, attributes in self.elements if tag in tags]


def seen(text):
    """What a reader sees of a page, in one line."""
    body = re.sub(r"<(script|style).*?</\1>", "", text, flags=re.DOTALL)
    body = re.sub(r"</(td|th|li|p|h\d)>", " ", body)
    return " ".join(unescape(re.sub(r"<[^>]+>", "", body)).split())


def report_tables(view):
    """The texts of a report's tables, by the names of their files."""
    frames, names = report_frames(view), ("parameters", "laws")
    texts = {f"{name}.csv": to_csv(frame) for name, frame in frames.items()}
    texts |= {f"{name}.json": to_json(view.title, name, frames[name]) for name in names}
    sheets = zip(names, paper_sheets(view, Symbols()), strict=True)
    return texts | {f"{name}.tex": to_latex(name, sheet, Symbols()) for name, sheet in sheets}


def first(view, images=None, sheet=None):
    return render(view, images or {}, sheet)["report.html"]


@pytest.fixture(scope="module")
def pages(campaign, images, datasheet):
    return render(campaign, images, datasheet)


@pytest.fixture(scope="module")
def text(pages):
    return pages["report.html"]


def test_there_is_a_page_for_each_test_always(campaign, pages):
    own = {f"tests/{test.id}/page.html" for test in campaign.tests}
    assert set(pages) == {"report.html", "datasheet.html"} | own
    links = {a.get("href") for a in Page(pages["report.html"]).all("a")}
    assert own <= links
    assert "datasheet.html" in links
    shown = Page(pages["tests/p800_f0.25/page.html"])
    names = ("loops", "history", "residuals", "marginals", "corner", "ranks")
    assert [image["src"] for image in shown.all("img")] == [f"{name}.png" for name in names]
    assert "../../report.html" in {a["href"] for a in shown.all("a")}


@pytest.mark.parametrize("name", ["report.html", "datasheet.html", "tests/p800_f0.25/page.html"])
def test_pages_are_whole_safe_and_accessible(pages, name):
    text = pages[name]
    page = Page(text)
    assert page.all("html") == [{"lang": "en"}]
    assert page.all("a")[0]["class"] == "skip"
    assert all("scope" in header for header in page.all("th"))
    boxes = [box for box in page.all("div") if box.get("class") == "scroll"]
    assert len(boxes) == len(page.all("table"))
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in boxes)
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))
    identities = [a["id"] for _, a in page.elements if "id" in a]
    assert len(set(identities)) == len(identities)
    inside = {a["href"][1:] for a in page.all("a") if a["href"].startswith("#")}
    assert inside <= set(identities)
    for image in page.all("img"):
        assert len(image["alt"]) > 20
        assert int(image["width"]) > 100
    (policy,) = (m["content"] for m in page.all("meta") if "Content-Security" in str(m))
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts}
    assert hashes == set(re.findall(r"'sha256-([^']+)'", policy))
    assert "default-src 'none'" in policy
    for call in ('src="http', "@import", "stylesheet", "url(http"):
        assert call not in re.sub("<script.*?</script>", "", text, flags=re.DOTALL)


def test_the_summary_has_its_pictures_and_its_sections_in_order(text, images):
    shared = [png for key, png in images.items() if not key.startswith("tests/")]
    assert len(Page(text).all("img")) == len(shared)
    assert all(base64.b64encode(png).decode() in text for png in shared)
    assert 'href="figures/overview.csv"' in text
    order = re.findall(r'<h2 id="([\w-]+)"', text)
    assert order == ["datasheet", "loops", "laws", "held-out", "unknown", "truth", "repeat"]


def test_a_number_stands_once_with_its_unit(text, campaign, images, datasheet):
    used = json.loads(re.search(r'id="units">(.*?)</script>', text)[1])
    assert set(re.findall(r'data-unit="([^"]+)"', text)) <= set(used)
    assert used["kip"] == {"us": [1.0, "kip"], "si": [SI.factor("kip"), "kN"]}
    assert used["actuation in ksi"]["us"] == [1000.0, "psi"]
    assert '<span data-value="0.8" data-unit="kip" data-digits="3">0.800</span>' in text
    metric = first(replace(campaign, metric=True), images, datasheet)
    assert '<span data-value="0.8" data-unit="kip" data-digits="3">3.56</span>' in metric
    chosen = re.findall(r'value="(us|si)" checked', text + metric)
    assert chosen == ["us", "si"]


def test_the_data_sheet_marks_what_lies_outside(pages):
    for name in ("report.html", "datasheet.html"):
        shown = pages[name]
        assert shown.count('<td class="outside">') == 1
        assert "1.30–1.40 ✗" in seen(shown)
        assert "800 psi ± 1 in 0.5 Hz" in seen(shown)
        assert "no test was made there" in seen(shown)
        assert "Temperature: no record has one." in seen(shown)
    assert "force at zero displacement" in seen(pages["datasheet.html"])


def test_only_what_misses_is_listed(campaign, text):
    assert "What misses" not in text
    warned = (
        Finding(
            "a", "force sign", Message("{jump} too far", {"jump": Quantity.of(0.8, unit="in")})
        ),
        Finding("b", "lag", Message("late")),
    )
    judged = (Judgement("c", Use.NOT_USABLE, (Message("sign <swapped>"),), 9.0),)
    bad = replace(campaign, warnings=warned, judgements=judged, failures={"d": "no draws"})
    bad = replace(bad, verdict=Use.NOT_USABLE, sentences=(Message("R̂ is 1.2."),))
    shown = first(bad)
    head = seen(shown[: shown.index('<nav aria-label="Contents">')])
    for words in ("a: 0.8 in too far", "b: late", "c: sign <swapped>", "d: no result. no draws"):
        assert words in head
    assert "✗ not usable" in head
    assert "R̂ is 1.2." in head


def test_the_page_of_a_test_holds_all_that_the_summary_leaves_out(campaign):
    test = campaign.tests[0]
    bad = Check(test.id, PREDICTIVE, "energy", 3.3, 4.1, Verdict.FAIL, "kip*in")
    k3 = {"test": test.id, "name": "k3", "unit": "kip/in"}
    k3 |= {"lower": 0.8, "median": 1.0, "upper": 1.2}
    other = k3 | {"noise": "ou", "other": "staged", "decides": True}
    other |= {"other_lower": 39.0, "other_median": 42.2, "other_upper": 45.6}
    test = replace(
        test,
        noises=(other,),
        checks=(*test.checks, bad),
        loop_estimates=(k3 | {"value": 14.25, "tolerance": 0.3, "missed": True},),
        modes=({"k3": 20.5, "share": 0.6}, {"k3": 41.5, "share": 0.4}),
    )
    view = replace(campaign, tests=(test, campaign.tests[1]))
    shown = seen(render(view, {})[f"tests/{test.id}/page.html"])
    for words in (
        *("2 of 3 checks pass", "3.30 4.10 ✗ fail", "with staged 42.2 [39.0, 45.6]", "14.2 yes"),
        *("2 sets of parameters", "60.0 %", "20.5 41.5", "1 of 2 directions", "r = −0.84"),
        *("mfd-bayes report OUT --tests", "over 2 full cycles"),
    ):
        assert words in shown, words
    held = seen(render(view, {})["tests/held/page.html"])
    assert "Held out: predicted from the other tests" in held


def test_sections_say_so_where_there_is_nothing(campaign, draw):
    alone = replace(campaign, tests=campaign.tests[1:], laws=(), law_rows=(), checks=(), truth=())
    shown = first(alone, draw(alone))
    assert "No test was calibrated" in shown
    assert "No laws were fitted" in shown
    assert 'id="truth"' not in shown
    none = replace(alone, tests=(), left_out=None, law_choices={})
    assert draw(none) == {}
    shown = first(none)
    Page(shown)
    assert "No test was held out" in shown
    assert "Which law predicts best?" not in shown


def test_laws_and_models_are_compared_in_words(campaign, text):
    assert "F<sub>c,fwd</sub>: the power law predicts best, but only just." in text
    assert "Every level held out in turn" in text
    exponent = Check("laws", FREE_EXPONENT, "Fc_fwd", 1.1, 1.0, Verdict.NOTE, note="0.9 to 1.4")
    row = ComparisonRow(
        *("all", "three_stage", 40, -10.0, 2.0, 9.0, 0.6, 0.1, 0.0, 0.0, 0.0, 0.05),
        *(-12.0, 0.02, 0.4, True),
    )
    view = replace(campaign, checks=(exponent,), comparison=Comparison((row,), "Three stages win."))
    shown = first(view)
    assert "? cannot tell</span> F<sub>c,fwd</sub>: exponent 1.100 (0.9 to 1.4)" in shown
    assert "Three stages win." in shown


@pytest.fixture
def hostile(tmp_path, campaign):
    """A report whose every free text is the name that a campaign file gave."""
    (tmp_path / "a.csv").write_text("time_s\n")
    path = tmp_path / "campaign.toml"
    written = "".join(f"\\U{ord(c):08X}" for c in NAME)
    test = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'
    path.write_text(f'[campaign]\ntitle = "{written}"\n{test}')
    name = load_campaign(path).title
    assert name == NAME
    one = campaign.tests[0]
    study = one.identifiability
    study = replace(
        study,
        directions=replace(study.directions, names=(name, name)),
        pairs=(Pair(name, name, 0.8),),
    )
    checks = (
        *(replace(c, feature=name) for c in one.checks),
        Check(name, name, name, 0.0, 1.0, Verdict.NOTE, note=name),
    )
    rows = tuple(row | {"note": name} for row in one.rows)
    one = replace(one, rows=rows, identifiability=study, checks=checks, actuation=name)
    return replace(
        campaign,
        title=name,
        sentences=(Message("{text}", {"text": name}),),
        verdict=Use.WITH_CARE,
        tests=(one, replace(campaign.tests[1], id=f"h{name.split('/')[0]}")),
        failures={"a": name},
        warnings=(Finding(name, name, Message("{text}", {"text": name})),),
        law_rows=tuple(row | {"note": name, "name": name} for row in campaign.law_rows),
        truth=tuple(row | {"name": name, "test": name} for row in campaign.truth),
        checks=checks,
        remarks=(name,),
        provenance={"file " + name: name},
    )


def test_pages_and_tables_show_hostile_names_as_text(hostile, datasheet):
    written = render(hostile, {"overview": PIXEL}, datasheet)
    for text in written.values():
        assert text.encode()
        Page(text)
        assert not UNSEEN.search(text)
        assert "<script>alert" not in text
        assert "<img src=x" not in text
    assert "{{7*7}}{x}" in written["report.html"]  # no template of a template
    texts = report_tables(hostile)
    for name, text in texts.items():
        assert not UNSEEN.search(text)
        if name.endswith(".csv"):
            cells = [cell for line in csv.reader(io.StringIO(text)) for cell in line]
            assert not [c for c in cells if c.lstrip().startswith(("=", "+", "@"))]
        elif name.endswith(".json"):
            assert json.loads(text)["title"] == NAME
        else:
            assert all("\\input{/etc" not in line.partition("%")[0] for line in text.splitlines())
    assert any("/C calc" in text for text in texts.values())
    odd = replace(hostile, title="\ud800", remarks=("\udcff",))
    for files in (render(odd, {}), report_tables(odd)):
        assert all(text.encode() for text in files.values())


def test_figures_and_the_terminal_show_hostile_names_as_text(hostile, tmp_path, capsys):
    figure = draw_overview(hostile.title, hostile.tests)
    figure.canvas.draw()
    assert not UNSEEN.search(figure.get_suptitle())
    (tmp_path / "b.toml").write_text('[campaign]\n"' + "\\u001b[31m\\u202e" + '" = 1\n')
    with pytest.raises(CampaignError) as caught:
        load_campaign(tmp_path / "b.toml")
    for words in (hostile.title, caught.value):
        say(words)
        shown = capsys.readouterr().out
        assert shown.count("\n") == 1
        assert not UNSEEN.search(shown)


def test_a_first_campaign_file_keeps_a_hostile_name_a_string():
    import tomllib

    text = f"[campaign]\ntitle = {quoted(NAME)}  {commented(NAME)}\n"
    assert tomllib.loads(text) == {"campaign": {"title": NAME}}
    assert not UNSEEN.search(commented(NAME))


def test_the_glossary_holds_plain_sentences_and_every_verdict(text):
    words = {name: t for terms in read_glossary().values() for name, t in terms.items()}
    assert len(words) > 40
    for meaning in words.values():
        assert set(re.findall(r"</?(\w+)[^>]*>", meaning)) <= {"em", "sub", "code"}
        assert meaning.endswith(".")
    (verdicts,) = (meaning for name, meaning in words.items() if name.startswith("Verdict"))
    assert all(f"{verdict.capitalize()}: " in verdicts for verdict in Verdict)
    shown = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd></div>", text))
    assert shown == {name: words[name] for name in page.WORDS}


@pytest.mark.skipif(not importlib.util.find_spec("mkdocs"), reason='needs the extra "docs"')
def test_the_documentation_shows_every_word():
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / "docs/hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    shown = hooks._fill("glossary", "glossary.md")
    words = [name for terms in read_glossary().values() for name in terms]
    assert re.findall(r"^\*\*(.+?)\*\*: ", shown, re.MULTILINE) == words
