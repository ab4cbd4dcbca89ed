"""Everything that a reader is given of a run, written into its folder."""

import base64
import re
from dataclasses import replace

import pytest

from mfd_bayes.errors import ReportError
from mfd_bayes.jobs.job import Step
from mfd_bayes.reporting import publication
from mfd_bayes.reporting.forms import Forms
from mfd_bayes.reporting.publication import Drawing, publish
from mfd_bayes.runs.unit_system import SI, US


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_report_holds_every_figure_and_its_table(campaign, images, tmp_path, monkeypatch):
    of_test = {test.id: f"tests/{test.id}/" for test in campaign.tests}
    shared = [(key, png) for key, png in images.items() if not key.startswith("tests/")]
    monkeypatch.setattr(publication, "draw_shared", lambda view: iter(shared))
    monkeypatch.setattr(
        publication,
        "draw_test",
        lambda test, *_: (item for item in images.items() if item[0].startswith(of_test[test.id])),
    )
    steps = []
    publish(campaign, tmp_path, 2, steps.append)
    found = files(tmp_path)
    for key, png in images.items():
        path = f"{key}.png" if key.startswith("tests/") else f"figures/{key}.png"
        assert found[path] == png
        assert base64.b64encode(png) in found["report.html"]
    for name in (
        "parameters.csv",
        "laws.tex",
        "figures/overview.csv",
        "tests/p800_f0.25/draws.csv",
    ):
        assert found[name]
    assert [step.stage for step in steps] == ["figures", "pages", "done"]
    assert all(isinstance(step, Step) for step in steps)


@pytest.mark.slow
def test_processes_draw_the_figures_of_many_tests_to_the_same_bytes(
    campaign, tmp_path, monkeypatch
):
    for module in ("reporting.forms", "reporting.html"):
        monkeypatch.setattr(f"mfd_bayes.{module}.ONE_PAGE", 2)
    monkeypatch.setattr("mfd_bayes.reporting.publication._ALONE", 2)
    quick = replace(campaign.tests[0], marginals=(), chains={}, corner=(), identifiability=None)
    tests = [
        replace(quick, id=name, rows=tuple(replace(row, subject=name) for row in quick.rows))
        for name in ("t0", "t1")
    ]
    view = replace(campaign, tests=(*tests, campaign.tests[1]))
    forms = Forms(all_tests=True)
    publish(view, tmp_path / "one", 1, lambda _: None, forms)
    publish(view, tmp_path / "two", 2, lambda _: None, forms)
    one, two = files(tmp_path / "one"), files(tmp_path / "two")
    assert one == two
    assert sum(name.endswith("/loops.png") for name in one) == 3
    page = one["tests/t0/report.html"].decode()
    sizes = re.findall(r'src="loops\.png" width="(\d+)"', page)
    assert len(sizes) == 1
    assert int(sizes[0]) > 300


def test_of_many_tests_only_those_asked_for_are_drawn(campaign, tmp_path, monkeypatch):
    for module in ("reporting.forms", "reporting.html"):
        monkeypatch.setattr(f"mfd_bayes.{module}.ONE_PAGE", 1)
    quick = replace(campaign.tests[0], marginals=(), chains={}, corner=(), identifiability=None)
    drawn, left = campaign.tests[1].id, quick.id
    view = replace(campaign, tests=(quick, campaign.tests[1]))
    stale = tmp_path / "tests" / left / "loops.png"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"of an earlier report")
    publish(view, tmp_path, 1, lambda _: None, Forms(tests=(drawn,)))
    pictures = {str(path.relative_to(tmp_path)) for path in tmp_path.glob("tests/*/*.png")}
    assert pictures == {f"tests/{drawn}/{name}.png" for name in ("loops", "history")}
    page = (tmp_path / "tests" / left / "report.html").read_text(encoding="utf-8")
    assert f"mfd-bayes report OUT --tests {left}" in page
    assert "--tests" not in (tmp_path / "tests" / drawn / "report.html").read_text(encoding="utf-8")


def test_a_test_that_is_not_there_is_refused_with_the_nearest_name():
    names = ("p500_f0.05", "p800_f0.05")
    with pytest.raises(ReportError, match=r"no test 'p500_f005'; did you mean 'p500_f0\.05'\?"):
        Forms(tests=("p500_f005",)).check(names)
    Forms(tests=names[:1]).check(names)


@pytest.fixture
def quickly_drawn(monkeypatch):
    """Figures are made as they are, but every picture of one is the same few bytes."""
    monkeypatch.setattr("mfd_bayes.reporting.figures.campaign.to_png", lambda _: b"a picture")


@pytest.mark.usefixtures("quickly_drawn")
@pytest.mark.parametrize("metric", [False, True])
def test_a_picture_with_nothing_to_show_any_more_is_removed(campaign, tmp_path, metric):
    test = campaign.tests[0]
    system = SI if metric else US
    Drawing(test, system, "ksi").run(tmp_path, lambda _: None)
    assert (tmp_path / "tests" / test.id / "corner.png").is_file()
    without = Drawing(replace(test, corner=()), system, "ksi")
    assert without.run(tmp_path, lambda _: None).status == "done"
    left = {path.name for path in (tmp_path / "tests" / test.id).glob("*.png")}
    assert left == {f"{k}.png" for k in ("loops", "history", "residuals", "trace", "marginals")}
    assert f"tests/{test.id}/corner.png" in without.makes
