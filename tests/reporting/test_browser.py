"""The report in a real browser: what a reader sees, reaches, reads aloud and prints."""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.reporting.page import find_browser, print_page, publish
from mfd_bayes.reporting.symbols import number

playwright = pytest.importorskip(
    "playwright.sync_api", reason='no playwright: pip install "mfd_bayes[browser]"'
)
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-core")
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium: install Debian's chromium")

HOSTILE = '"><img src=x onerror="window.hit=1"><script>window.hit=1</script>'
TEST = "tests/p800_f0.25/page.html"
PAGES = ("report.html", "datasheet.html", TEST)
MODEL = "Bokeh.documents[0].get_model_by_name"


@pytest.fixture(scope="session")
def report(published) -> Path:
    return published / "report.html"


@pytest.fixture(scope="session")
def chromium() -> Iterator:
    with playwright.sync_playwright() as started:
        quiet = ["--disable-gpu", "--disable-background-networking", "--disable-sync"]
        browser = started.chromium.launch(
            executable_path=BROWSER, args=quiet, chromium_sandbox=os.geteuid() != 0
        )
        yield browser
        browser.close()


class Watched:
    """A page, what it asked for, and what its console said."""

    def __init__(self, browser, path: Path, width: int = 1400, scheme: str = "light"):
        size = {"width": width, "height": 900}
        context = browser.new_context(viewport=size, color_scheme=scheme, accept_downloads=True)
        self.page = context.new_page()
        self.asked, self.errors = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", self.hear)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(path.as_uri())
        if self.page.query_selector("#explorer"):
            self.page.wait_for_selector("#explorer[data-ready]")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.page.context.close()

    def hear(self, message):
        if message.type in ("error", "warning"):
            self.errors.append(message.text)

    @property
    def violations(self) -> list[tuple[str, str]]:
        """Faults of accessibility, with everything open."""
        for details in self.page.query_selector_all("details"):
            details.evaluate("element => element.open = true")
        faults = axe.Axe().run(self.page).response["violations"]
        return [(v["id"], v["nodes"][0]["html"]) for v in faults]


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (1400, "dark"), (380, "light")])
def test_pages_ask_for_nothing_fail_nowhere_and_are_accessible(
    chromium, report, name, width, scheme
):
    with Watched(chromium, report.parent / name, width, scheme) as watched:
        assert watched.errors == []
        folder = (report.parent / name).parent.as_uri()
        urls = [url for url in watched.asked if not url.startswith(("data:", "blob:"))]
        assert [url for url in urls if not url.startswith(folder)] == []
        assert name == TEST or len(urls) == 1
        overflow = "document.documentElement.scrollWidth - innerWidth"
        assert watched.page.evaluate(overflow) <= 0
        assert watched.violations == []


def test_axe_can_find_something(chromium, report, tmp_path):
    text = report.read_text(encoding="utf-8").replace(' alt="', ' data-alt="')
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    with Watched(chromium, tmp_path / "report.html") as watched:
        assert "image-alt" in {name for name, _ in watched.violations}


def test_units_change_at_a_click_in_tables_sentences_and_plots(chromium, report):
    with Watched(chromium, report) as watched:
        page = watched.page
        head, cell = page.locator(".properties thead"), page.locator(".properties td").nth(6)
        assert "800 psi" in head.inner_text()
        assert cell.inner_text() == "1.00"
        original = page.locator("body").inner_text()
        page.check("#units-si")
        assert "5.52 MPa" in head.inner_text()
        assert cell.inner_text() == "4.45"
        assert "within 20.3 mm" in page.inner_text("ul.verdict")
        assert page.evaluate(f"{MODEL}('plot-x').below[0].axis_label") == "displacement, mm"
        highest = page.evaluate(f"{MODEL}('plot-x').x_range.end")
        assert highest == pytest.approx(25.4 * 1.08, rel=0.02)
        page.check("#units-us")  # the script writes numbers as Python does
        assert page.locator("body").inner_text() == original
        assert watched.errors == []
        for value in (0.9999, 1234.4, 123456.0, 1.25e-7, 0.00012345, -2.5, 0.0, 9.999e5, 99.95):
            for digits in (3, 4):
                assert page.evaluate(f"written({value!r}, {digits})") == number(value, digits)


def test_names_from_files_run_nothing(chromium, campaign, datasheet, tmp_path, no_figures):
    rows = tuple(row | {"note": HOSTILE} for row in campaign.tests[0].rows)
    test = replace(campaign.tests[0], rows=rows)
    view = replace(campaign, title=HOSTILE, tests=(test, campaign.tests[1]))
    view = replace(view, provenance={HOSTILE: HOSTILE}, remarks=(HOSTILE,))
    publish(view, ReportOptions(tmp_path), 1, print, sheet=datasheet)
    for name in PAGES:
        with Watched(chromium, tmp_path / name) as watched:
            assert watched.page.evaluate("window.hit") is None
            assert watched.errors == []
            assert HOSTILE in watched.page.title()


def test_the_data_sheet_prints_on_one_page(report):
    assert find_browser()
    pages = []
    for page in (report.with_name("datasheet.html"), report):
        printed = print_page(page)
        assert printed.startswith(b"%PDF")
        assert re.search(rb"/MediaBox\s*\[\s*0 0 59[45]\.?\d* 84[12]\.?\d*\s*\]", printed)  # A4
        pages.append(len(re.findall(rb"/Type\s*/Page\b", printed)))
    assert pages[0] == 1
    assert pages[1] >= 2  # the control
