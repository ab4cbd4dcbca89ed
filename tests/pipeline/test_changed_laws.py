"""A finished run whose campaign gets another law."""

import shutil
from pathlib import Path

import pytest

import mfd_bayes as mb
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign

pytestmark = pytest.mark.slow


def test_another_law_samples_the_population_and_no_test(finished_run, tmp_path):
    assert finished_run.code == 0, finished_run.stderr
    out = Path(shutil.copytree(finished_run.out, tmp_path / "out"))
    campaign = shutil.copytree(finished_run.campaign.parent, tmp_path / "campaign")
    path = campaign / "campaign.toml"
    text = path.read_text()
    path.write_text(text.replace("[columns]", '[laws]\nsigma0 = "constant"\n\n[columns]', 1))
    before = {p: p.read_bytes() for p in out.glob("tests/*/posterior.nc")}
    steps = []
    calibrate(plan_campaign(path, Options(effort="quick", resume=True)), out, steps.append)
    assert {step.id for step in steps if step.stage == "kept"} == {p.parent.name for p in before}
    assert {step.id for step in steps if step.stage == "sampling"} == {"population"}
    assert {p: p.read_bytes() for p in before} == before
    run = mb.open_run(out)
    assert run.population.design.laws["sigma0"] == "constant"
    assert run.manifest.settings.laws["sigma0"] == "constant"
