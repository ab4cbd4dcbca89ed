"""Which files a report has, and what of an earlier one goes."""

import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from mfd_bayes.errors import ReportError
from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.reporting.page import check_forms, publish


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_report_holds_every_figure_and_every_table(campaign, published, written, tmp_path):
    pytest.importorskip("docx")
    figures = ("loops", "history", "residuals", "marginals", "corner", "ranks")
    expected = {f"tests/p800_f0.25/{name}.png" for name in figures}
    expected |= {"tests/held/loops.png", "tests/held/history.png"}
    pairs = ((n, f) for n in ("held", "p800_f0.25") for f in ("page.html", "record.csv"))
    expected |= {f"tests/{name}/{file}" for name, file in pairs}
    expected |= {f"figures/{n}.{s}" for n in ("overview", "laws", "truth") for s in ("png", "csv")}
    names = (
        "parameters derived loop_estimates laws law_scores checks scores sensitivity tested_range"
    )
    expected |= {
        f"{name}.csv" for name in (*names.split(), "crossvalidation", "datasheet", "cycles")
    }
    expected |= {f"{name}.{end}" for name in ("parameters", "laws") for end in ("json", "tex")}
    expected |= {"datasheet.tex", "report.html", "datasheet.html", "tables.docx", "tables.xlsx"}
    assert set(files(published)) == expected
    shutil.copytree(published, tmp_path, dirs_exist_ok=True)
    written(campaign)  # pictures with nothing to show any more are removed
    assert not list(tmp_path.glob("tests/*/*.png"))


def test_of_many_tests_only_those_asked_for_are_drawn(campaign, tmp_path, monkeypatch):
    monkeypatch.setattr("mfd_bayes.reporting.page.ALL_DRAWN", 1)
    skipped, plotted = (test.id for test in campaign.tests)
    stale = tmp_path / "tests" / skipped / "loops.png"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"of an earlier report")
    publish(campaign, ReportOptions(tmp_path, tests=(plotted,)), 1, lambda _: None)
    pictures = {str(path.relative_to(tmp_path)) for path in tmp_path.glob("tests/*/*.png")}
    assert pictures == {f"tests/{plotted}/{name}.png" for name in ("loops", "history")}
    pages = {
        n: (tmp_path / "tests" / n / "page.html").read_text("utf-8") for n in (skipped, plotted)
    }
    assert f"mfd-bayes report OUT --tests {skipped}" in pages[skipped]
    assert "--tests" not in pages[plotted]


def test_what_cannot_be_made_is_refused_before_anything_is_written(monkeypatch):
    names = ("p500_f0.05", "p800_f0.05")
    ask = partial(ReportOptions, Path("out"))
    check_forms(ask(tests=names[:1]), names)
    monkeypatch.setattr("mfd_bayes.reporting.page.find_spec", lambda _: None)
    monkeypatch.setattr("shutil.which", lambda _: None)
    for options, offender in (
        (ask(tests=("p500_f005",)), r"no test 'p500_f005'; did you mean 'p500_f0\.05'\?"),
        (ask(word=True), r"mfd_bayes\[word\]"),
        (ask(excel=True), r"mfd_bayes\[excel\]"),
        (ask(pdf=True), "needs a Chromium"),
    ):
        with pytest.raises(ReportError, match=offender):
            check_forms(options, names)


@pytest.mark.slow
def test_processes_draw_the_figures_of_many_tests_to_the_same_bytes(campaign, tmp_path):
    quick = replace(campaign.tests[0], marginals=(), corner=(), identifiability=None)
    tests = [replace(quick, id=f"t{i}") for i in range(4)]
    view = replace(campaign, tests=(*tests, campaign.tests[1]))
    publish(view, ReportOptions(tmp_path / "one"), 1, lambda _: None)
    publish(view, ReportOptions(tmp_path / "two"), 2, lambda _: None)
    serial, parallel = files(tmp_path / "one"), files(tmp_path / "two")
    assert serial == parallel
    sizes = re.findall(r'src="loops\.png" width="(\d+)"', serial["tests/t0/page.html"].decode())
    assert int(sizes[0]) > 300
