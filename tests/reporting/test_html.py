import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from urllib.parse import quote

import numpy as np
import pytest

from mfd_bayes.calibration.identifiability import CONFLICT, Pair, Sensitivity
from mfd_bayes.evaluation.views import (
    COVERAGE,
    DIRECTIONS,
    IDENTIFIABILITY,
    Check,
    Judgement,
    ReadingRow,
)
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import figures
from mfd_bayes.reporting.digest import is_of_sampler
from mfd_bayes.reporting.html import ONE_PAGE, render
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.results import ComparisonRow
from mfd_bayes.runs.verdict import Use, Verdict

PIXEL = figures.to_png(figures.draw_loops("", Trace.from_arrays(np.arange(30.0), np.arange(30.0))))
HOSTILE = '"><script>alert(1)</script>{{ 7 * 7 }}'


class Page(HTMLParser):
    """Elements, in order, and the text of headings."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self, text):
        super().__init__()
        self.elements = []
        self.open = []
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


def first(view, images):
    return render(view, images)["report.html"]


@pytest.fixture(scope="module")
def text(campaign, images):
    return first(campaign, images)


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_every_image_is_embedded_with_alt_and_size(page, images):
    found = page.all("img")
    assert len(found) == len(images)
    assert all(len(image["alt"]) > 20 for image in found)
    assert all(int(image["width"]) > 300 and int(image["height"]) > 150 for image in found)
    embedded = {base64.b64decode(image["src"].split(",", 1)[1]) for image in found}
    assert embedded == set(images.values())


def test_nothing_is_loaded_from_elsewhere(page, text):
    assert all(image["src"].startswith("data:") for image in page.all("img"))
    links = [a["href"] for a in page.all("a", "link")]
    assert links
    assert all(link.startswith(("data:", "#", "figures/", "tests/")) for link in links)
    assert not any("src" in script for script in page.all("script"))
    assert "@import" not in without_scripts(text)
    assert "url(" not in without_scripts(text)


def without_scripts(text):
    return re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)


def test_only_these_scripts_may_run(page, text):
    policy = page.all("meta")[2]["content"]
    allowed = set(re.findall(r"'sha256-([^']+)'", policy))
    written = re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL)
    found = {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in written}
    assert found == allowed
    assert len(found) == 2
    assert "unsafe-inline" not in policy.split("script-src")[1]
    assert "default-src 'none'" in policy


def test_every_picture_can_be_taken_with_its_data(campaign, page, tables_behind):
    tables = {quote(path) for path in tables_behind(campaign)}
    for figure in page.all("img"):
        taken = [a for a in page.all("a") if a.get("data-picture") == figure["id"]]
        assert len(taken) == 1
        assert taken[0]["download"].endswith(".png")
    linked = {a["href"] for a in page.all("a") if a["href"].endswith(".csv")}
    assert linked == tables


def test_the_first_reading_has_no_column_that_cannot_be_identified(text, campaign):
    assert any(row.name == "gamma1" for test in campaign.tests for row in test.rows)
    table = text.split('aria-label="Parameters of all tests"')[1].split("</table>")[0]
    assert "γ<sub>1" not in table
    assert "k<sub>3</sub>" in table


def test_each_kind_of_check_says_what_its_own_value_is(campaign):
    inside = Check(campaign.tests[0].id, COVERAGE, "coverage", 0.5, "near", Verdict.PASS)
    text = first(replace(campaign, checks=(*campaign.checks, inside)), {})
    (told,) = set(re.findall(r"<span>(Share of samples inside a band: [^<]*)</span>", text))
    assert "artificial records" not in told
    assert "share of the measured samples inside the band" in told


def test_every_link_has_a_target(page):
    identities = [a["id"] for _, a in page.elements if "id" in a]
    assert len(set(identities)) == len(identities)
    inside = {a["href"][1:] for a in page.all("a") if a["href"].startswith("#")}
    assert inside
    assert inside <= set(identities)


def test_headings_are_in_order(page):
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_tables_and_page_are_accessible(page):
    assert page.all("html") == [{"lang": "en"}]
    assert all("scope" in header for header in page.all("th"))
    assert page.all("a")[0]["class"] == "skip"
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in scrollers(page))
    assert len(scrollers(page)) == len(page.all("table"))


def scrollers(page):
    return [box for box in page.all("div") if box.get("class") == "scroll"]


def test_the_verdict_is_worded(campaign, images, text):
    assert "✓ Usable" in text
    for use, words in ((Use.WITH_CARE, "! Usable with care"), (Use.NOT_USABLE, "✗ Not usable")):
        other = first(replace(campaign, verdict=use, sentence="R̂ is 1.2."), images)
        assert f"<strong>{words}</strong>" in other
        assert "R̂ is 1.2." in other


def test_every_warning_is_on_the_first_screen(campaign, images):
    told = (Finding("a", "force sign", "the force does negative work"), Finding("b", "lag", "late"))
    page = first(replace(campaign, warnings=told), images)
    screen = page[: page.index('<nav aria-label="Contents">')]
    assert "<li>a: the force does negative work</li>" in screen
    assert "<li>b: late</li>" in screen
    assert '<div class="verdict fail">' in screen
    mild = first(replace(campaign, warnings=told[1:]), images)
    assert '<div class="verdict care">' in mild[: mild.index("<nav aria")]


def test_readings_stand_beside_their_parameters_and_misses_are_marked(campaign, images):
    read = ReadingRow(campaign.tests[0].id, "k3", "kip/in", 14.25, 0.8, 1.0, 1.2, 0.3, missed=True)
    test = replace(campaign.tests[0], readings=(read,))
    page = only(first(replace(campaign, tests=(test,)), images), "us")
    assert '<small class="missed">read off 14.2 !</small>' in page
    agreed = replace(test, readings=(replace(read, missed=False, largest=True),))
    page = only(first(replace(campaign, tests=(agreed,)), images), "us")
    assert "<small>largest 14.2</small>" in page


def test_each_set_of_parameters_of_a_record_with_modes_is_in_a_table(campaign, images, text):
    modes = ({"k3": 20.5, "share": 0.6}, {"k3": 41.5, "share": 0.4})
    test = replace(campaign.tests[0], modes=modes)
    page = only(first(replace(campaign, tests=(test,)), images), "us")
    assert "Sets of parameters that explain a record" in page
    for shown in ("<td>60\u00a0%</td>", "<td>40\u00a0%</td>", "20.50", "41.50"):
        assert shown in page
    assert "Sets of parameters" not in text


def test_tests_are_ranked_with_their_reasons(campaign, images):
    ranked = (Judgement("b", Use.NOT_USABLE, "sign <swapped>", 9.0),)
    page = first(replace(campaign, judgements=ranked), images)
    assert "✗ not usable" in page
    assert "sign &lt;swapped&gt;" in page


def test_the_page_says_what_the_data_do_not_inform(text):
    assert "γ<sub>2</sub>/γ<sub>1</sub>" in text
    assert "equal-tailed" in text
    assert re.search(r"hold <strong>2</strong>", text)  # of the informed truths


def only(text, system):
    """What a reader of one system sees."""
    other = {"us": "si", "si": "us"}[system]
    text = re.sub(rf'<span class="{other}">[^<]*</span>', "", text)
    return re.sub(rf'<span class="{system}">([^<]*)</span>', r"\1", text)


def test_either_system_of_units_is_a_click_away(campaign, images, text):
    us, si = only(text, "us"), only(text, "si")
    assert "actuation 800 psi" in us
    assert "actuation 5.516 MPa" in si
    assert "CRPS, kip" in us
    assert "CRPS, kN" in si
    assert "25.4 mm" in si
    chosen = re.findall(r'id="units-(us|si)" value="\w+" checked', text)
    assert chosen == ["us"]
    metric = first(replace(campaign, metric=True), images)
    assert re.findall(r'id="units-(us|si)" value="\w+" checked', metric) == ["si"]


def test_derived_quantities_are_beside_the_measured_values(campaign, images, text):
    section = text[text.index('<h2 id="derived">') : text.index('<h2 id="laws">')]
    shown = only(section, "us")
    assert "3.210<small>[3.00, 3.40]</small><small>measured 3.300</small>" in shown
    assert "0.2000<small>[0.180, 0.220]</small></td>" in shown  # no record shows the gap
    assert '<td data-value="" title="the motion has no full cycle">–</td>' in section
    assert "nan" not in section
    assert "kip·in" in section
    assert "held out" in section
    bare = tuple(replace(test, derived=()) for test in campaign.tests)
    assert 'id="derived"' not in first(replace(campaign, tests=bare), images)


def test_values_that_the_data_do_not_inform_are_in_italics(campaign, images):
    test = campaign.tests[0]
    rows = [replace(row, contraction=float("nan"), note="") for row in test.rows]
    rows[0] = replace(rows[0], note="only the ratio reaches the force")
    rows[1] = replace(rows[1], contraction=0.2)
    view = replace(campaign, tests=(replace(test, rows=tuple(rows)),))
    assert first(view, images).count('class="weak"') == 2


def test_names_from_files_are_text(campaign, test_view):
    test = replace(test_view(HOSTILE), actuation=HOSTILE)
    rows = tuple(replace(row, name=HOSTILE, unit=HOSTILE, note=HOSTILE) for row in test.rows)
    known = replace(
        test.identifiability,
        directions=replace(test.identifiability.directions, names=(HOSTILE, HOSTILE)),
        pairs=(Pair(HOSTILE, HOSTILE, 0.8),),
        sensitivities=(Sensitivity(HOSTILE, 0.1, 0.1),),
    )
    checks = tuple(
        Check(HOSTILE, n, HOSTILE, 0.0, HOSTILE, Verdict.NOTE) for n in ("R-hat", HOSTILE)
    )
    hostile = replace(
        campaign,
        title=HOSTILE,
        sentence=HOSTILE,
        tests=(
            replace(test, rows=rows, identifiability=known),
            replace(campaign.tests[1], id=f"{HOSTILE}2"),
        ),
        failures={HOSTILE: HOSTILE},
        law_rows=rows,
        checks=checks,
        truth=tuple(replace(row, name=HOSTILE, subject=HOSTILE) for row in campaign.truth),
        provenance={HOSTILE: HOSTILE},
        remarks=(HOSTILE,),
    )
    pixels = figures.to_png(figures.draw_loops(HOSTILE, test.trace))
    written = first(hostile, {"overview": pixels, f"tests/{HOSTILE}/loops": pixels})
    page = Page(written)
    assert len(page.all("script")) == 4  # ours
    assert "<script>alert" not in written
    assert "{{ 7 * 7 }}" in written
    assert len(page.all("img")) == 2


def test_a_campaign_of_held_out_tests_alone(campaign, images, draw):
    view = replace(campaign, tests=campaign.tests[1:], laws=(), law_rows=(), checks=(), truth=())
    view = replace(view, scores=campaign.scores[1:])
    kept = {key: png for key, png in images.items() if "p800" not in key and key != "truth"}
    text = first(view, kept | draw(view))
    Page(text)
    assert "No test was calibrated" in text
    assert "Nothing was sampled" in text
    assert 'id="truth"' not in text


def test_a_campaign_without_laws(campaign, images):
    text = first(replace(campaign, laws=(), law_rows=()), images)
    assert "No laws were fitted" in text


def test_a_campaign_without_anything(campaign, draw):
    empty = replace(campaign, tests=(), laws=(), law_rows=(), checks=(), scores=(), truth=())
    assert draw(empty) == {}
    Page(first(empty, {}))


def test_checks_of_the_sampler_are_separate_from_those_of_the_fit():
    names = {
        "R-hat": True,
        "bulk ESS": True,
        "modes found": True,
        "posterior predictive p-value": False,
    }
    for name, expected in names.items():
        assert is_of_sampler(Check("a", name, "", 1.0, "", Verdict.PASS)) is expected


def test_failed_checks_stand_out(campaign, images):
    bad = Check("p800_f0.25", "posterior predictive p-value", "energy", 0.0, "0.01", Verdict.FAIL)
    text = first(replace(campaign, checks=(bad,)), images)
    assert "✗ fail" in text
    assert "<b>1 of 1</b> checks failed" in text


def test_one_statistic_is_one_line_whatever_was_observed(campaign, images):
    checks = tuple(
        Check(
            test,
            "posterior predictive p-value",
            f"energy (observed {seen})",
            0.0,
            "a",
            Verdict.FAIL,
        )
        for test, seen in (("a", "1.5, expected 2"), ("b", "3.5, expected 4"))
    )
    text = first(replace(campaign, checks=checks), images)
    assert len(re.findall(r'class="sort">energy<', text)) == 1
    assert "observed 3.5" in text


def test_a_p_value_has_no_unit_and_what_was_observed_has_it(campaign, images):
    target, verdict = "residual rms, kip (observed 0.15, expected 0.2)", Verdict.FAIL
    check = Check("a", "posterior predictive p-value", target, 0.004, "0.01 to 0.99", verdict)
    reading = Check("a", "share of samples inside a band", "of 50 %, all", 0.5, "0.4", verdict)
    text = first(replace(campaign, checks=(check, reading), metric=False), images)
    assert re.findall(r'class="sort">(residual rms[^<]*|of 50[^<]*)<', text) == [
        "residual rms",
        "of 50 %, all",  # the control: other values may have a unit
    ]
    assert 'title="observed 0.15 kip, expected 0.2 kip"' in text


def test_checks_with_a_section_of_their_own_are_shown_once(campaign, images):
    note = Check("a", "prior variance removed", "k3", 0.1, ">= 0.5", Verdict.NOTE)
    text = first(replace(campaign, checks=(note,)), images)
    assert "prior variance removed" not in text
    assert "<b>0 of 0</b> checks failed" in text


def test_the_page_shows_the_directions_that_a_test_informs(text):
    assert "1 of 2" in text
    assert "F<sub>c,fwd</sub> with k<sub>3</sub>" in text
    assert "20 times narrower" in text
    assert "F<sub>c,fwd</sub> and k<sub>3</sub> (r = −0.840)" in text
    found = re.search(r"<td>0\.09</td><td>0\.11</td><td class=\"text\">([^<]*)", text)
    assert found.group(1) == CONFLICT


def test_without_trade_offs_there_is_a_dash(campaign, images):
    test = campaign.tests[0]
    known = test.identifiability
    directions = replace(known.directions, curvature=np.array([399.0, 40.0]))
    free = replace(test, identifiability=replace(known, directions=directions, pairs=()))
    text = first(replace(campaign, tests=(free,)), images)
    assert "2 of 2" in text
    assert text.count('<td class="text">–</td>') == 3  # and no diagnosis of Fc_fwd


def test_checks_of_identifiability_cannot_fail_and_are_not_counted(campaign, images):
    checks = tuple(Check("a", name, "k3", 0.1, "", Verdict.PASS) for name in IDENTIFIABILITY)
    text = first(replace(campaign, checks=checks), images)
    assert "<b>0 of 0</b> checks failed" in text
    assert not any(name in text for name in IDENTIFIABILITY if name != DIRECTIONS)


def test_the_page_is_the_same_each_time(campaign, images, text):
    assert first(campaign, images) == text


def test_laws_are_scored_and_the_best_is_named(text):
    section = text[text.index('id="laws"') : text.index('id="held-out"')]
    assert "Which law predicts best?" in section
    assert "F<sub>c,fwd</sub>: the power law predicts best, but only just." in section
    assert "the campaign&#39;s" in section or "the campaign's" in section
    assert "−0.3 ± 0.8" in section


def test_cross_validation_is_in_the_section_of_tests_held_out(text, campaign, images):
    section = text[text.index('id="held-out"') : text.index('id="unknown"')]
    for words in ("Every level left out in turn", "Of 1 tests", "800 psi", "0.450"):
        assert words in section
    plain = first(replace(campaign, left_out=None, law_choices=()), images)
    assert "left out in turn" not in plain
    assert "Which law predicts best?" not in plain


def test_the_interval_score_stands_between_width_and_crps(text):
    section = only(text[: text.index('id="laws"')], "us")
    heads = re.findall(r'class="sort">([^<]*), kip</button>', section)
    assert heads[:3] == ["Width of 95\N{NO-BREAK SPACE}%", "Interval score", "CRPS"]


def test_models_that_were_compared_are_shown(campaign, images, text):
    assert "mfd-bayes compare" in text
    row = ComparisonRow("all", "three_stage", 40, -10.0, 2.0, 9.0, 0.6, 0.1, 0.0, 0.0, 0.0, 0.05)
    view = replace(campaign, comparison=(row,), comparison_sentence="Three stages win.")
    section = first(view, images).split('id="alternatives"')[1]
    assert "Three stages win." in section
    assert "three stage" in section
    assert "mfd-bayes compare" not in section


def many(campaign, number):
    some = campaign.tests[0]
    names = [f"t{at:02d}" for at in range(number)]
    rows = {name: tuple(replace(row, subject=name) for row in some.rows) for name in names}
    tests = tuple(replace(some, id=name, rows=rows[name]) for name in names)
    return replace(campaign, tests=(*tests, campaign.tests[1]))


def test_many_tests_have_a_page_each(campaign):
    view = many(campaign, ONE_PAGE)
    pictures = {f"tests/t00/{name}": PIXEL for name in ("loops", "trace")}
    pages = render(view, pictures | {"overview": PIXEL})
    assert set(pages) == {"report.html", *(f"tests/{t.id}/report.html" for t in view.tests)}
    index, test = Page(pages["report.html"]), Page(pages["tests/t00/report.html"])
    assert len(index.all("img")) == 1
    assert {a["href"] for a in index.all("a")} >= {f"tests/{t.id}/report.html" for t in view.tests}
    assert {image["src"] for image in test.all("img")} == {"loops.png", "trace.png"}
    assert "../../report.html" in {a["href"] for a in test.all("a")}
    assert 'id="test-' not in pages["report.html"]
    for page in pages.values():
        levels = [int(tag[1]) for tag, _ in Page(page).elements if re.fullmatch("h[1-6]", tag)]
        assert all(b <= a + 1 for a, b in pairwise(levels))


def test_fewer_are_one_page(campaign):
    view = many(campaign, ONE_PAGE - 1)
    assert set(render(view, {})) == {"report.html"}
