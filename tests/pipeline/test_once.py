"""Each command reads a record once, plans once, and a report opens a posterior once."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.calibration import result
from mfd_bayes.campaign import campaign as campaigns
from mfd_bayes.cli.commands import app
from mfd_bayes.evaluation.summary import assess
from mfd_bayes.pipeline import calibrate, compare, crossvalidate, report
from mfd_bayes.pipeline.plan import Options
from mfd_bayes.runs.run import open_run

TESTS = ("a", "b")


class _StopError(Exception):
    """What stands in place of the sampling."""


@pytest.fixture
def campaign(tmp_path):
    time = np.arange(400) / 50
    text = '[campaign]\nmodel = "lugre"\nnoise = "iid"\n'
    for k, name in enumerate(TESTS, start=1):
        table = time, np.sin(np.pi * time), k * np.tanh(5 * np.cos(np.pi * time))
        head, path = "time_s,displacement_in,force_kip", tmp_path / f"{name}.csv"
        np.savetxt(path, np.column_stack(table), delimiter=",", header=head, comments="")
        text += f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{500 * k} psi"\n'
    (tmp_path / "campaign.toml").write_text(text)
    return tmp_path / "campaign.toml"


def counted(monkeypatch, module, name, of):
    """How often a function of a module was called, by what `of` makes of its path."""
    counts, function = Counter(), getattr(module, name)

    def count(path, *args, **kwargs):
        counts[of(path)] += 1
        return function(path, *args, **kwargs)

    monkeypatch.setattr(module, name, count)
    return counts


@pytest.fixture
def reads(monkeypatch):
    """How often each record was read."""
    return counted(monkeypatch, campaigns, "read_record", lambda path: path.stem)


@pytest.fixture
def plans(monkeypatch):
    """Plans that came to be sampled; the first ends the command."""
    sampled = []

    def stop(plan, out, observe):
        sampled.append(plan)
        raise _StopError

    for module in (crossvalidate, compare):
        monkeypatch.setattr(module, "calibrate_locked", stop)
    return sampled


def run(*words):
    return CliRunner().invoke(app, ["calibrate", *map(str, words)])


def test_a_dry_run_reads_each_record_once_and_still_warns(campaign, tmp_path, reads):
    shutil.copy(campaign.parent / "a.csv", campaign.parent / "b.csv")
    outcome = run(campaign, "-o", tmp_path / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output
    assert "same record as a" in outcome.stdout
    assert reads == dict.fromkeys(TESTS, 1)


@pytest.mark.parametrize(
    ("out", "options", "said"),
    [
        (".", ("--dry-run",), "exists: give --resume to finish it or --force"),
        ("out", ("--dry-run", "--resume", "--force"), "give either --resume or --force"),
        ("other", ("--resume",), "give another folder by -o"),
        ("other", ("--force",), "exists and"),
    ],
)
def test_a_folder_that_cannot_be_used_is_refused_and_kept(campaign, out, options, said):
    (campaign.parent / "other").mkdir()
    (campaign.parent / "other" / "thesis.tex").write_text("x")
    outcome = run(campaign, "-o", campaign.parent / out, *options)
    assert outcome.exit_code == 2, outcome.output
    assert said in outcome.stderr
    assert "--force to start" not in outcome.stderr
    assert [path.name for path in (campaign.parent / "other").iterdir()] == ["thesis.tex"]


def test_a_cross_validation_and_a_comparison_are_planned_once(campaign, tmp_path, reads, plans):
    with pytest.raises(_StopError):
        crossvalidate.crossvalidate(campaign, tmp_path / "o", Options(by="test"), lambda _: None)
    assert len(plans) == 1
    assert reads == dict.fromkeys(TESTS, 1)
    reads.clear()
    models = ("lugre", "three_stage")
    with pytest.raises(_StopError):
        compare.compare(campaign, tmp_path / "out", models, Options(), lambda _: None)
    assert reads == dict.fromkeys(TESTS, 2)  # once for each model


def test_a_comparison_of_noises_plans_the_campaigns_model_under_each(campaign, tmp_path, plans):
    options = Options(effort="quick", noises=("staged", "ou"))
    with pytest.raises(_StopError):
        compare.compare(campaign, tmp_path / "out", (), options, lambda _: None)
    (first,) = plans
    assert (first.campaign.model, first.campaign.noise) == ("lugre", "ou")
    assert {task.noise for task in first.tasks} == {"ou"}


def test_a_run_that_was_just_calibrated_is_not_opened_again(campaign, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(calibrate, "calibrate_locked", lambda plan, out, observe: "the run")
    monkeypatch.setattr(calibrate, "write_report", lambda run, *_, **__: seen.append(run))
    monkeypatch.setattr(report, "open_run", lambda _: pytest.fail("opened again"))
    calibrate.calibrate_campaign(campaign, tmp_path / "out", Options(), lambda _: None)
    assert seen == ["the run"]


def test_a_report_opens_each_posterior_a_few_times_at_most(tmp_path, monkeypatch):
    """To infer, to judge and to show the test."""
    out = shutil.copytree(Path(__file__).parents[1] / "data" / "run", tmp_path / "out")
    counts = counted(monkeypatch, result, "load_test", lambda path: path.parent.name)
    opened = open_run(out)
    assess(opened)
    assert set(counts) == set(opened.tests)
    assert max(counts.values()) <= 3
