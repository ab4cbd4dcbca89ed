"""Parts that are left out: which there are, and as jobs whose scores are stored."""

import json
from dataclasses import asdict, replace

import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.crossvalidate import FOLDER, Fold, folds_of, parts_of
from mfd_bayes.population.settings import Setting
from mfd_bayes.runs.manifest import with_keys
from mfd_bayes.runs.run import open_run
from tests.run_folders import write_run


def test_scores_of_another_fold_are_computed_anew(tmp_path):
    fold = Fold("a", "test_1.json", ("a",), ("b", "c"), effort="quick", seed=1)
    file = tmp_path / FOLDER / fold.file
    file.parent.mkdir()
    key = asdict(fold)
    file.write_text(json.dumps({"key": key, "predictions": []}))
    assert fold.stored(tmp_path)
    other = replace(fold, rests_on="other laws")
    assert not other.stored(tmp_path)


def test_folds_of_a_run_rest_on_its_laws_and_posteriors(tmp_path):
    write_run(tmp_path / "out")
    run = open_run(tmp_path / "out")
    first, second = folds_of(run, "test", "quick")
    assert first.rests_on == second.rests_on != ""
    laws = {**run.manifest.settings.laws, "sigma0": "constant"}
    settings = run.manifest.settings.model_copy(update={"laws": laws})
    manifest = with_keys(run.manifest.changed(settings=settings), run.priors)
    other = replace(run, manifest=manifest)
    assert folds_of(other, "test", "quick")[0].rests_on != first.rests_on


def settings(*levels):
    return {f"t{i}": Setting(level) for i, level in enumerate(levels)}


def test_the_level_without_actuation_is_a_part():
    found = parts_of(settings(0.0, 0.03, 0.0, 0.036), "level", "kip", "a.toml")
    assert found == {"0 lbf": ("t0", "t2"), "30 lbf": ("t1",), "36 lbf": ("t3",)}


@pytest.mark.parametrize(("by", "part"), [("level", "30 lbf"), ("test", "t1")])
def test_all_tests_with_an_actuation_cannot_be_left_out(by, part):
    with pytest.raises(CampaignError, match=f"cannot leave out {part}: no other calibrated test"):
        parts_of(settings(0.0, 0.03), by, "kip", "a.toml")
