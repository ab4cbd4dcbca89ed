"""The pages of a report as HTML: what stands in them, and that no text is a command."""

import base64
import csv
import hashlib
import io
import json
import re
import tomllib
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise

import pytest

from mfd_bayes.console import say
from mfd_bayes.evaluation.assessment import FREE_EXPONENT, PREDICTIVE, Check, Judgement
from mfd_bayes.messages import Measure, Message
from mfd_bayes.reporting.figures import draw_overview
from mfd_bayes.runs.findings import CheckStatus, Finding, Fitness
from mfd_bayes.runs.manifest import (
    ComparedEstimate,
    ComparedSheet,
    ComparedValue,
    Comparison,
    ComparisonRow,
)
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.store.files import commented, quoted

OWN = "tests/p800_f0.25/page.html"
PAGES = ("report.html", "datasheet.html", OWN, "tests/held/page.html")
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


@pytest.fixture(scope="module")
def pages(published):
    return {name: (published / name).read_text("utf-8") for name in PAGES}


@pytest.fixture(scope="module")
def text(pages):
    return pages["report.html"]


@pytest.mark.parametrize("name", PAGES)
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
    assert {a["href"][1:] for a in page.all("a") if a["href"][0] == "#"} <= set(identities)
    assert all(len(i["alt"]) > 20 and int(i["width"]) > 100 for i in page.all("img"))
    (policy,) = (m["content"] for m in page.all("meta") if "Content-Security" in str(m))
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    hashes = {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts}
    assert hashes == set(re.findall(r"'sha256-([^']+)'", policy))
    assert "default-src 'none'" in policy
    for pattern in ('src="http', "src='http", "@import", "stylesheet", "url(http"):
        assert pattern not in re.sub("<script.*?</script>", "", text, flags=re.DOTALL)


def test_the_summary_has_its_pictures_and_its_sections_in_order(text, published):
    shared = [path.read_bytes() for path in (published / "figures").glob("*.png")]
    assert len(Page(text).all("img")) == len(shared) == 3
    assert all(base64.b64encode(png).decode() in text for png in shared)
    assert 'href="figures/overview.csv"' in text
    order = re.findall(r'<h2 id="([\w-]+)"', text)
    assert order == ["datasheet", "loops", "laws", "held-out", "unknown", "truth", "repeat"]


def test_a_number_stands_once_with_its_unit(text, campaign, written, datasheet):
    units = json.loads(re.search(r'id="units">(.*?)</script>', text)[1])
    assert set(re.findall(r'data-unit="([^"]+)"', text)) <= set(units)
    assert units["kip"] == {"us": [1.0, "kip"], "si": [SI.factor("kip"), "kN"]}
    assert units["actuation in ksi"]["us"] == [1000.0, "psi"]
    assert '<span data-value="0.8" data-unit="kip" data-digits="3">0.800</span>' in text
    metric = written(replace(campaign, metric=True), datasheet)["report.html"]
    assert '<span data-value="0.8" data-unit="kip" data-digits="3">3.56</span>' in metric
    assert re.findall(r'value="(us|si)" checked', text + metric) == ["us", "si"]


def test_the_data_sheet_marks_what_lies_outside(pages):
    for name in ("report.html", "datasheet.html"):
        assert pages[name].count('<td class="outside">') == 1
        content = seen(pages[name])
        assert "1.35 ✗" in content
        assert "800 psi ± 1 in 0.5 Hz" in content
        assert "no test was made there" in content
        assert "Temperature: no record has one." in content
    assert "force at zero displacement" in seen(pages["datasheet.html"])


def test_only_what_misses_is_listed(campaign, text, written):
    assert "What misses" not in text
    jump = Message("{jump} too far", {"jump": Measure.of(0.8, unit="in")})
    warned = (Finding("a", "force sign", jump), Finding("b", "lag", Message("late")))
    judged = (Judgement("c", Fitness.NOT_USABLE, (Message("sign <swapped>"),), 9.0),)
    bad = replace(campaign, warnings=warned, judgements=judged, failures={"d": "no draws"})
    bad = replace(bad, verdict=Fitness.NOT_USABLE, sentences=(Message("R̂ is 1.2."),))
    page = written(bad)["report.html"]
    head = seen(page[: page.index('<nav aria-label="Contents">')])
    for words in (
        *("a: 0.8 in too far", "b: late", "c: sign <swapped>", "d: no result. no draws"),
        *("✗ not usable", "R̂ is 1.2."),
    ):
        assert words in head


def test_the_page_of_a_test_holds_all_that_the_summary_leaves_out(campaign, written):
    test = campaign.tests[0]
    bad = Check(test.id, PREDICTIVE, "energy", 3.3, 4.1, CheckStatus.FAIL, "kip*in")
    k3 = {"test": test.id, "name": "k3", "unit": "kip/in"}
    k3 |= {"lower": 0.8, "median": 1.0, "upper": 1.2}
    test = replace(
        test,
        checks=(*test.checks, bad),
        loop_estimates=(k3 | {"value": 14.25, "tolerance": 0.3, "missed": True},),
        modes=({"k3": 20.5, "share": 0.6}, {"k3": 41.5, "share": 0.4}),
    )
    files = written(replace(campaign, tests=(test, campaign.tests[1])))
    page = seen(files[OWN])
    for words in (
        *("2 of 3 checks pass", "3.30 4.10 ✗ fail", "14.2 yes"),
        *("2 sets of parameters", "60.0 %", "20.5 41.5", "1 of 2 directions", "r = −0.84"),
        *("mfd-bayes report OUT --tests", "over 2 full cycles"),
    ):
        assert words in page, words
    assert "Held out: predicted from the other tests" in seen(files["tests/held/page.html"])


def test_what_was_compared_is_shown_for_all_tests_and_for_each(campaign, text, written):
    assert "Which model or noise" not in text
    values = {"ou": (2.0, 1.0, 3.0), "staged": (4.0, 3.0, 5.0), "mixture": (3.5, 1.5, 4.5)}
    score = {"cycles": 6, "elpd": 30.0, "elpd_se": 2.0, "p_loo": 3.0, "worst_k": 0.5, "bad": 0.0}
    score |= {"unsettled": 0.0, "difference_se": 1.5, "rrse": 0.1, "log_evidence": 8.0}
    score |= {"log_evidence_se": 0.1, "evidence_k": 0.4, "evidence_trusted": True}
    comparison = Comparison(
        tuple(
            ComparisonRow(subject=subject, model=noise, difference=difference, **score)
            for subject in ("p800_f0.25", "all")
            for noise, difference in (("staged", 0.0), ("ou", -4.0))
        ),
        "The records favour staged over ou.",
        tuple(
            ComparedEstimate("p800_f0.25", "k3", "kip/in", noise, median - 2.0, median, median + 3)
            for noise, median in (("staged", 42.2), ("ou", 31.0))
        ),
        ComparedSheet(
            tuple(
                ComparedValue("800 psi, 1 in", quantity, "", "kip", values, difference)
                for quantity, difference in (("slip_force", 1.2), ("peak_force", 0.4))
            ),
            {"ou": 0.25, "staged": 0.75},
            "One does.",
        ),
    )
    files = written(replace(campaign, comparison=comparison))
    page = seen(files["report.html"])
    assert "One does. The data sheet under each model" in page
    assert "slip force kip 2.001.00–3.00 4.003.00–5.00 3.501.50–4.50" in page
    table = (
        files["report.html"].partition("The data sheet under each model")[2].split("</table>")[0]
    )
    assert [row.count('class="outside"') for row in table.split("<tr>")[-2:]] == [3, 0]
    assert "The records favour staged over ou." in page
    assert "staged 30.00 0.000 ± 1.5 8.000 ± 0.10 0.100" in page
    assert "ou 30.00 −4.000 ± 1.5" in page
    page = seen(files[OWN])
    assert "kip/in staged 40.2 42.2 45.2" in page
    assert "kip/in ou 29.0 31.0 34.0" in page
    assert "Under each model" not in seen(files["tests/held/page.html"])


def test_laws_are_compared_in_words(campaign, text, written):
    assert "F<sub>c,fwd</sub>: the power law predicts best, but only just." in text
    assert "Every level held out in turn" in text
    exponent = Check("laws", FREE_EXPONENT, "Fc_fwd", 1.1, 1.0, CheckStatus.NOTE, note="0.9 to 1.4")
    page = written(replace(campaign, checks=(exponent,)))["report.html"]
    assert "? cannot tell</span> F<sub>c,fwd</sub>: exponent 1.100 (0.9 to 1.4)" in page


@pytest.fixture
def hostile(campaign):
    """A report whose every free text is the name that a campaign file gave."""
    name, (test, validation) = NAME, campaign.tests
    checks = (Check(name, name, name, 0.0, 1.0, CheckStatus.NOTE, note=name),)
    test = replace(test, rows=tuple(row | {"note": name} for row in test.rows), checks=checks)
    message = Message("{text}", {"text": name})
    return replace(
        campaign,
        title=name,
        sentences=(message,),
        verdict=Fitness.WITH_CARE,
        tests=(test, replace(validation, id=f"h{name.split('/')[0]}")),
        failures={"a": name},
        warnings=(Finding(name, name, message),),
        law_rows=tuple(row | {"note": name, "name": name} for row in campaign.law_rows),
        truth=tuple(row | {"name": name, "test": name} for row in campaign.truth),
        checks=checks,
        remarks=(name,),
        provenance={"file " + name: name},
    )


def test_pages_and_tables_show_hostile_names_as_text(hostile, datasheet, written):
    texts = written(hostile, datasheet)
    for name, text in texts.items():
        assert not UNSEEN.search(text), name
        if name.endswith(".html"):
            Page(text)
            assert "<script>alert" not in text
            assert "<img src=x" not in text
        elif name.endswith(".csv"):
            cells = [cell for line in csv.reader(io.StringIO(text)) for cell in line]
            assert not [c for c in cells if c.lstrip().startswith(("=", "+", "@"))]
        elif name.endswith(".json"):
            assert json.loads(text)["title"] == NAME
        else:
            assert all("\\input{/etc" not in line.partition("%")[0] for line in text.splitlines())
    assert "{{7*7}}{x}" in texts["report.html"]  # no template of a template
    written(replace(hostile, title="\ud800", remarks=("\udcff",)))  # that no file can hold


def test_figures_the_terminal_and_a_first_campaign_show_hostile_names_as_text(hostile, capsys):
    figure = draw_overview(hostile.title, hostile.tests)
    figure.canvas.draw()
    assert not UNSEEN.search(figure.get_suptitle())
    say(hostile.title)
    output = capsys.readouterr().out
    assert output.count("\n") == 1
    assert not UNSEEN.search(output)
    drafted = f"[campaign]\ntitle = {quoted(NAME)}  {commented(NAME)}\n"
    assert tomllib.loads(drafted) == {"campaign": {"title": NAME}}
    assert not UNSEEN.search(commented(NAME))
