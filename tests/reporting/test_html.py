import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest

from mfd_bayes.calibration.identifiability import CONFLICT, Pair, Sensitivity
from mfd_bayes.reporting import figures
from mfd_bayes.reporting.html import is_of_sampler, render
from mfd_bayes.reporting.views import DIRECTIONS, IDENTIFIABILITY, Check

HOSTILE = '"><script>alert(1)</script>{{ 7 * 7 }}'


class Page(HTMLParser):
    """Elements, in order, and the text of headings."""

    VOID = frozenset({"meta", "link", "img", "br"})

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


@pytest.fixture(scope="module")
def images(campaign):
    return figures.draw_all(campaign)


@pytest.fixture(scope="module")
def text(campaign, images):
    return render(campaign, images)


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
    links = [a[k] for _, a in page.elements for k in ("src", "href") if k in a]
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert "@import" not in text
    assert "url(" not in text
    assert not page.all("script")


def test_every_link_has_a_target(page):
    identities = [a["id"] for _, a in page.elements if "id" in a]
    assert len(set(identities)) == len(identities)
    assert {a["href"][1:] for a in page.all("a")} <= set(identities)


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
    assert "✓ Passed" in text
    failed = replace(campaign, verdict="fail", sentence="R̂ is 1.2.")
    assert "✗ Not passed" in render(failed, images)
    assert "R̂ is 1.2." in render(failed, images)


def test_what_the_data_do_not_tell_is_told(text):
    assert "γ<sub>2</sub>/γ<sub>1</sub>" in text
    assert "equal-tailed" in text
    assert re.search(r"hold <strong>2</strong>", text)  # of the informed truths


def test_derived_quantities_stand_beside_what_was_measured(campaign, images, text):
    section = text[text.index('<h2 id="derived">') : text.index('<h2 id="laws">')]
    assert "3.210<small>[3.00, 3.40]</small><small>measured 3.300</small>" in section
    assert "0.2000<small>[0.180, 0.220]</small></td>" in section  # no record shows the gap
    assert '<td title="the motion has no full cycle">–</td>' in section
    assert "nan" not in section
    assert "kip·in" in section
    assert "held out" in section
    bare = tuple(replace(test, derived=()) for test in campaign.tests)
    assert 'id="derived"' not in render(replace(campaign, tests=bare), images)


def test_values_that_are_about_their_prior_are_set_apart(campaign, images):
    test = campaign.tests[0]
    rows = [replace(row, contraction=float("nan"), note="") for row in test.rows]
    rows[0] = replace(rows[0], note="only the ratio reaches the force")
    rows[1] = replace(rows[1], contraction=0.2)
    view = replace(campaign, tests=(replace(test, rows=tuple(rows)),))
    assert render(view, images).count('class="weak"') == 2


def test_names_from_files_are_text(campaign, test_view):
    test = replace(test_view(HOSTILE), actuation=HOSTILE)
    rows = tuple(replace(row, name=HOSTILE, unit=HOSTILE, note=HOSTILE) for row in test.rows)
    known = replace(
        test.identifiability,
        directions=replace(test.identifiability.directions, names=(HOSTILE, HOSTILE)),
        pairs=(Pair(HOSTILE, HOSTILE, 0.8),),
        sensitivities=(Sensitivity(HOSTILE, 0.1, 0.1),),
    )
    checks = tuple(Check(HOSTILE, n, HOSTILE, 0.0, HOSTILE, HOSTILE) for n in ("R-hat", HOSTILE))
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
    written = render(hostile, {"overview": pixels, f"tests/{HOSTILE}/loops": pixels})
    page = Page(written)
    assert not page.all("script")
    assert "<script" not in written
    assert "{{ 7 * 7 }}" in written
    assert len(page.all("img")) == 2


def test_a_campaign_of_held_out_tests_alone(campaign, images):
    view = replace(campaign, tests=campaign.tests[1:], laws=(), law_rows=(), checks=(), truth=())
    view = replace(view, scores=campaign.scores[1:])
    kept = {key: png for key, png in images.items() if "p800" not in key and key != "truth"}
    text = render(view, kept | figures.draw_all(view))
    Page(text)
    assert "No test was calibrated" in text
    assert "Nothing was sampled" in text
    assert 'id="truth"' not in text


def test_a_campaign_without_laws(campaign, images):
    text = render(replace(campaign, laws=(), law_rows=()), images)
    assert "No laws were fitted" in text


def test_a_campaign_without_anything(campaign):
    empty = replace(campaign, tests=(), laws=(), law_rows=(), checks=(), scores=(), truth=())
    assert figures.draw_all(empty) == {}
    Page(render(empty, {}))


def test_checks_of_the_sampler_are_told_from_those_of_the_fit():
    names = {
        "R-hat": True,
        "bulk ESS": True,
        "modes found": True,
        "posterior predictive p-value": False,
    }
    for name, expected in names.items():
        assert is_of_sampler(Check("a", name, "", 1.0, "", "pass")) is expected


def test_failed_checks_stand_out(campaign, images):
    bad = Check("p800_f0.25", "posterior predictive p-value", "energy", 0.0, "0.01", "fail")
    text = render(replace(campaign, checks=(bad,)), images)
    assert "✗ fail" in text
    assert "<b>1 of 1</b> checks failed" in text


def test_one_statistic_is_one_line_whatever_was_observed(campaign, images):
    checks = tuple(
        Check(test, "posterior predictive p-value", f"energy (observed {seen})", 0.0, "a", "fail")
        for test, seen in (("a", "1.5, expected 2"), ("b", "3.5, expected 4"))
    )
    text = render(replace(campaign, checks=checks), images)
    assert len(re.findall(r'scope="row">energy<', text)) == 1
    assert "observed 3.5" in text


def test_what_is_told_elsewhere_is_not_told_twice(campaign, images):
    note = Check("a", "prior variance removed", "k3", 0.1, ">= 0.5", "note")
    text = render(replace(campaign, checks=(note,)), images)
    assert "prior variance removed" not in text
    assert "<b>0 of 0</b> checks failed" in text


def test_what_a_test_informs_is_told(text):
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
    text = render(replace(campaign, tests=(free,)), images)
    assert "2 of 2" in text
    assert text.count('<td class="text">–</td>') == 3  # and no diagnosis of Fc_fwd


def test_checks_of_identifiability_cannot_fail_and_are_not_counted(campaign, images):
    checks = tuple(Check("a", name, "k3", 0.1, "", "pass") for name in IDENTIFIABILITY)
    text = render(replace(campaign, checks=checks), images)
    assert "<b>0 of 0</b> checks failed" in text
    assert not any(name in text for name in IDENTIFIABILITY if name != DIRECTIONS)


def test_the_page_is_the_same_each_time(campaign, images, text):
    assert render(campaign, images) == text


def test_laws_are_scored_and_the_best_is_named(text):
    section = text[text.index('id="laws"') : text.index('id="held-out"')]
    assert "Which law predicts best?" in section
    assert "F<sub>c,fwd</sub>: the power law predicts best, but only just." in section
    assert "the campaign&#39;s" in section or "the campaign's" in section
    assert "−0.3 ± 0.8" in section


def test_what_was_left_out_stands_with_the_tests_held_out(text, campaign, images):
    section = text[text.index('id="held-out"') : text.index('id="unknown"')]
    for words in ("Every level left out in turn", "Of 1 tests", "800 psi", "0.450"):
        assert words in section
    plain = render(replace(campaign, left_out=None, law_choices=()), images)
    assert "left out in turn" not in plain
    assert "Which law predicts best?" not in plain


def test_the_interval_score_stands_between_width_and_crps(text):
    heads = re.findall(r"<th scope=\"col\">([^<]*), kip</th>", text[: text.index('id="laws"')])
    assert heads[:3] == ["Width of 95\N{NO-BREAK SPACE}%", "Interval score", "CRPS"]
