"""Everything that a reader is given of a run, written into its folder."""

import base64
import re
from dataclasses import replace

import pytest

from mfd_bayes.jobs.job import Step
from mfd_bayes.reporting.publication import Drawing, publish
from mfd_bayes.runs.systems import SI, US


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_report_holds_every_figure_and_its_table(campaign, images, tmp_path):
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
    for module in ("reporting.publication", "reporting.html"):
        monkeypatch.setattr(f"mfd_bayes.{module}.ONE_PAGE", 2)
    quick = replace(campaign.tests[0], marginals=(), chains={}, corner=(), identifiability=None)
    tests = [
        replace(quick, id=name, rows=tuple(replace(row, subject=name) for row in quick.rows))
        for name in ("t0", "t1")
    ]
    view = replace(campaign, tests=(*tests, campaign.tests[1]))
    publish(view, tmp_path / "one", 1, lambda _: None)
    publish(view, tmp_path / "two", 2, lambda _: None)
    one, two = files(tmp_path / "one"), files(tmp_path / "two")
    assert one == two
    assert sum(name.endswith("/loops.png") for name in one) == 3
    page = one["tests/t0/report.html"].decode()
    sizes = re.findall(r'src="loops\.png" width="(\d+)"', page)
    assert len(sizes) == 1
    assert int(sizes[0]) > 300


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
