"""The report in a real browser: what a reader sees, reaches, reads aloud and prints."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.figures import to_png
from mfd_bayes.reporting.figures.loops import draw_overview
from mfd_bayes.reporting.html import render
from mfd_bayes.reporting.pdf import find_browser, print_page

playwright = pytest.importorskip(
    "playwright.sync_api", reason='no playwright: pip install "mfd_bayes[browser]"'
)
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core")
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium: install Debian's chromium")

HOSTILE = '"><img src=x onerror="window.hit=1"><script>window.hit=1</script>'
A4 = (794 - 91, 1123 - 106)
"""Width and height of A4 less the page's margins, in CSS pixels."""


@pytest.fixture(scope="session")
def write(draw, tables_behind) -> Callable[..., Path]:
    """Write the pages of a report and the tables behind its figures; returns the first page."""

    def written(folder: Path, view: CampaignView, images: dict[str, bytes] | None = None) -> Path:
        for name, text in (render(view, images or draw(view)) | tables_behind(view)).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        return folder / "report.html"

    return written


@pytest.fixture(scope="session")
def report(write, campaign, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("report"), campaign)


@pytest.fixture(scope="session")
def chromium() -> Iterator:
    with playwright.sync_playwright() as started:
        quiet = ["--disable-gpu", "--disable-background-networking", "--disable-sync"]
        sandbox = os.geteuid() != 0
        browser = started.chromium.launch(
            executable_path=BROWSER, args=quiet, chromium_sandbox=sandbox
        )
        yield browser
        browser.close()


class Watched:
    """A page, what it asked for, and what its console said."""

    def __init__(self, browser, path: Path, width: int = 1440, scheme: str = "light"):
        size = {"width": width, "height": 900}
        context = browser.new_context(viewport=size, color_scheme=scheme, accept_downloads=True)
        self.page = context.new_page()
        self.asked, self.said = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.said.append((message.type, message.text)))
        self.page.on("pageerror", lambda error: self.said.append(("error", str(error))))
        self.page.goto(path.as_uri())
        if self.page.query_selector("#explorer"):
            self.page.wait_for_selector("#explorer[data-ready]")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.page.context.close()

    @property
    def errors(self) -> list[str]:
        return [text for kind, text in self.said if kind in ("error", "warning")]


@pytest.mark.parametrize("width", [380, 1440])
def test_nothing_is_asked_for_and_nothing_fails(chromium, report, width):
    with Watched(chromium, report, width) as found:
        assert found.errors == []
        own = [url for url in found.asked if not url.startswith(("data:", "blob:"))]
        assert own == [report.as_uri()]
        overflow = "document.documentElement.scrollWidth - innerWidth"
        assert found.page.evaluate(overflow) <= 0


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (1440, "dark"), (380, "light")])
def test_axe_finds_nothing(chromium, report, width, scheme):
    with Watched(chromium, report, width, scheme) as found:
        for details in found.page.query_selector_all("details"):
            details.evaluate("element => element.open = true")
        said = axe.Axe().run(found.page).response["violations"]
        assert [(v["id"], v["nodes"][0]["html"]) for v in said] == []


def test_axe_can_find_something(chromium, report, tmp_path):
    text = report.read_text(encoding="utf-8").replace(' alt="', ' data-alt="')
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    with Watched(chromium, tmp_path / "report.html") as found:
        said = axe.Axe().run(found.page).response["violations"]
        assert "image-alt" in {violation["id"] for violation in said}


def test_units_change_at_a_click_in_tables_and_plots(chromium, report):
    with Watched(chromium, report) as found:
        page = found.page
        axis = "Bokeh.documents[0].get_model_by_name('plot-x').below[0].axis_label"
        assert "psi" in page.inner_text(".tested")
        assert page.evaluate(axis) == "displacement, in"
        page.check("#units-si")
        assert "MPa" in page.inner_text(".tested")
        assert "psi" not in page.inner_text(".tested")
        assert page.evaluate(axis) == "displacement, mm"
        highest = "Bokeh.documents[0].get_model_by_name('plot-x').x_range.end"
        assert page.evaluate(highest) == pytest.approx(25.4 * 1.08, rel=0.02)
        assert "MPa" in page.inner_text("#explorer-test option:checked")
        assert found.errors == []


def test_the_explorer_switches_tests_and_tells_stages(chromium, campaign, tmp_path, write):
    test = campaign.tests[0]
    stage = np.full(test.trace.samples, 3, dtype=np.int8)
    view = replace(campaign, tests=(replace(test, stage=stage), campaign.tests[1]))
    with Watched(chromium, write(tmp_path, view)) as found:
        page = found.page
        samples = "Bokeh.documents[0].get_model_by_name('samples').data"
        assert page.evaluate(f"{samples}.stage[0]") == "3, build-up"
        force = page.evaluate(f"Array.from({samples}.force)")
        assert force == pytest.approx(test.trace.force.tolist(), abs=1e-6)
        page.select_option("#explorer-test", "1")
        assert page.evaluate(f"{samples}.stage[0]") == "–"
        assert page.inner_text("#explorer-role") == "predicted, not fitted"


def test_a_sample_is_read_by_pointing_at_it(chromium, report):
    with Watched(chromium, report) as found:
        page = found.page
        page.locator("#explorer-plot").scroll_into_view_if_needed()
        where = page.evaluate(
            """() => {
              const view = Bokeh.index.find_one_by_id
                ? Bokeh.index.find_one_by_id(Bokeh.documents[0].get_model_by_name("plot-t").id)
                : null;
              const data = Bokeh.documents[0].get_model_by_name("samples").data;
              const at = Math.floor(data.t.length / 2);
              const x = view.frame.x_scale.compute(data.t[at]);
              const y = view.frame.y_scale.compute(data.force[at]);
              const box = view.el.getBoundingClientRect();
              return [box.x + x, box.y + y];
            }"""
        )
        page.mouse.move(where[0] - 3, where[1])
        page.mouse.move(*where)
        page.wait_for_timeout(300)
        labels = page.locator(".bk-tooltip-row-label").all_inner_texts()
        values = page.locator(".bk-tooltip-row-value").all_inner_texts()
        read = dict(zip(labels, values, strict=True))
        assert {label.strip(": ") for label in read} >= {"force", "displacement", "stage"}
        assert any(value.endswith("kip") for value in values)


def test_tables_are_sorted_from_the_keyboard(chromium, campaign, tmp_path, write):
    names = ["b", "a10", "a9"]
    rows = [tuple(replace(r, subject=n) for r in campaign.tests[0].rows) for n in names]
    tests = [replace(campaign.tests[0], id=n, rows=r) for n, r in zip(names, rows, strict=True)]
    view = replace(campaign, tests=tuple(tests))
    with Watched(chromium, write(tmp_path, view)) as found:
        page = found.page
        table = page.locator("#parameters ~ .scroll table").first
        head = table.locator("button.sort").first
        shown = table.locator("tbody th")
        head.focus()
        page.keyboard.press("Enter")
        assert shown.all_inner_texts() == ["a9", "a10", "b"]
        page.keyboard.press("Enter")
        assert shown.all_inner_texts() == ["b", "a10", "a9"]
        assert table.locator("th").first.get_attribute("aria-sort") == "descending"


def test_a_picture_can_be_taken_from_the_page_alone(chromium, report, tmp_path):
    alone = tmp_path / "mailed.html"
    shutil.copy(report, alone)
    with Watched(chromium, alone) as found:
        with found.page.expect_download() as waited:
            found.page.click('a[download="overview.png"]')
        taken = Path(waited.value.path()).read_bytes()
        assert taken.startswith(b"\x89PNG")


def test_without_scripts_the_pictures_are_there(chromium, report):
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator("#explorer").is_hidden()
    assert page.locator("figure img").first.is_visible()
    page.check("#units-si")  # style alone does it
    assert "MPa" in page.inner_text(".tested")
    context.close()


def test_names_from_files_run_nothing(chromium, campaign, tmp_path, write):
    rows = tuple(replace(row, note=HOSTILE) for row in campaign.tests[0].rows)
    test = replace(campaign.tests[0], rows=rows)
    view = replace(campaign, title=HOSTILE, sentence=HOSTILE, tests=(test, campaign.tests[1]))
    view = replace(view, provenance={HOSTILE: HOSTILE}, remarks=(HOSTILE,))
    with Watched(chromium, write(tmp_path, view)) as found:
        assert found.page.evaluate("window.hit") is None
        assert found.errors == []
        assert HOSTILE in found.page.inner_text("h1")


def test_figures_are_not_cut_in_print(chromium, report):
    with Watched(chromium, report, A4[0]) as found:
        found.page.emulate_media(media="print")
        sizes = found.page.evaluate(
            """() => [...document.querySelectorAll("figure")]
              .filter((figure) => figure.offsetParent)
              .map((figure) => [figure.scrollWidth, figure.offsetHeight,
                                getComputedStyle(figure).breakInside])"""
        )
        assert sizes
        for width, height, inside in sizes:
            assert width <= A4[0] + 1
            assert height <= A4[1]
            assert inside == "avoid"
        assert found.page.locator(".explorer").is_hidden()


def test_the_pdf_is_one(report):
    assert find_browser()
    printed = print_page(report)
    assert printed.startswith(b"%PDF")
    pages = len(re.findall(rb"/Type\s*/Page\b", printed))
    assert pages >= 3
    assert re.search(rb"/MediaBox\s*\[\s*0 0 594\.\d+ 841\.\d+\s*\]", printed)  # A4


@pytest.fixture(scope="module")
def fifty(campaign, draw, write, tmp_path_factory) -> Path:
    """A campaign of fifty tests, each with its own record of the usual length."""
    some = campaign.tests[0]
    tests = []
    for at in range(50):
        name = f"t{at:02d}"
        rows = tuple(replace(row, subject=name) for row in some.rows)
        tests.append(replace(some, id=name, rows=rows, trace=noisy(some.trace, at)))
    scores = tuple(replace(campaign.scores[0], subject=test.id) for test in tests)
    drawn = draw(replace(campaign, tests=(some,)))
    images = {key: png for key, png in drawn.items() if not key.startswith("tests/")}
    images["overview"] = to_png(draw_overview("loops", tests))
    for test in tests:  # one test's pictures for all: they are as large
        images |= {
            key.replace(some.id, test.id): png for key, png in drawn.items() if some.id in key
        }
    view = replace(campaign, tests=tuple(tests), scores=scores)
    folder = tmp_path_factory.mktemp("fifty")
    for key, png in images.items():
        (folder / key).parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{key}.png").write_bytes(png)
    return write(folder, view, images)


def noisy(trace: Trace, seed: int) -> Trace:
    noise = 0.05 * np.random.default_rng(seed).standard_normal(trace.samples)
    return replace(trace, force=np.asarray(trace.force) + noise)


def test_fifty_tests_stay_small_and_readable(chromium, fifty):
    pages = list(fifty.parent.rglob("*.html"))
    assert len(pages) == 51
    pictures = list(fifty.parent.rglob("*.png"))
    assert sum(file.stat().st_size for file in pages + pictures) < 25e6
    with Watched(chromium, fifty) as found:
        assert found.errors == []
        assert found.page.locator("ul.index a").count() == 50
        assert found.page.locator("#explorer-test option").count() == 50
        said = axe.Axe().run(found.page).response["violations"]
        assert [v["id"] for v in said] == []
        found.page.locator("ul.index a").nth(7).click()
        found.page.wait_for_load_state()
        assert "t07" in found.page.inner_text("h1")
        assert axe.Axe().run(found.page).response["violations"] == []
