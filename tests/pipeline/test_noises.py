"""The check of the noise model, from the campaign file to what the commands say of it."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.calibration import result
from mfd_bayes.calibration.noise_sensitivity import quantiles_of
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.summary import assess
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.runs.run import open_run

DATA = Path(__file__).parents[1] / "data" / "run"
TEST = "p500_f0.5"


@pytest.fixture
def campaign(tmp_path):
    time = np.arange(400) / 50
    table = np.column_stack([time, np.sin(np.pi * time), np.tanh(5 * np.cos(np.pi * time))])
    head = "time_s,displacement_in,force_kip"
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=head, comments="")
    test = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'

    def write(key=""):
        path = tmp_path / "campaign.toml"
        path.write_text(f'[campaign]\nmodel = "lugre"\n{key}\n{test}')
        return path

    return write


@pytest.mark.parametrize(
    ("key", "effort", "checks"),
    [
        ("", "quick", False),
        ("", "standard", True),
        ("", "thorough", True),
        ("noise_check = true", "quick", True),
        ("noise_check = false", "standard", False),
    ],
)
def test_the_check_is_as_the_campaign_says_else_not_for_a_first_look(campaign, key, effort, checks):
    plan = plan_campaign(campaign(key), Options(effort=effort))
    assert [task.checks_noise for task in plan.tasks] == [checks]
    assert plan.manifest.settings.campaign.noise_check == ({"": None}.get(key, checks))


def test_a_setting_that_is_no_yes_or_no_is_refused(campaign):
    with pytest.raises(CampaignError, match="noise_check"):
        plan_campaign(campaign('noise_check = "no"'), Options())


@pytest.fixture
def run_with_check(tmp_path, monkeypatch):
    """A run, as if one of its tests had been fitted with other noises."""
    out = Path(shutil.copytree(DATA, tmp_path / "out"))
    load_test = result.load_test

    def load(path):
        stored = load_test(path)
        if path.parent.name != TEST:
            return stored
        posterior = open_posterior(path)
        own = quantiles_of(posterior, stored.values())
        low, middle, high = own["k3"]
        moved = own | {"k3": (low + 9 * (high - low), middle + 9 * (high - low), 10 * high)}
        fits = [
            {"noise": "staged", "error": "", "quantities": {k: list(v) for k, v in moved.items()}}
            | {"how": "walkers", "k": None, "size": 60.0, "seconds": 1.0},
            {"noise": "iid", "error": "no prior for x", "quantities": {}}
            | {"how": "", "k": None, "size": 0.0, "seconds": 1.0},
        ]
        return replace(stored, facts=stored.facts | {"other_noises": fits})

    posteriors = {test.path: test.posterior for test in open_run(out).tests.values()}

    def open_posterior(path):
        return posteriors[path]

    monkeypatch.setattr(result, "load_test", load)
    return out


def test_what_another_noise_moves_stands_with_its_test_and_not_in_the_verdict(run_with_check):
    view = assess(open_run(run_with_check))
    (test,) = [test for test in view.tests if test.id == TEST]
    assert [row.name for row in test.noises if row.decides] == ["k3"]
    (row,) = [row for row in test.rows if row.name == "k3"]
    assert [other.other for other in row.other_noises] == ["staged"]
    assert not [w for w in view.warnings if "noise" in w.name]
    assert "noise" not in " ".join(map(str, view.sentences))
    (other,) = [test for test in view.tests if test.id == "p1000_f0.5"]
    assert other.noises == ()
    assert any("Not fitted under another noise model: p1000_f0.5" in str(r) for r in view.remarks)
