"""Parts that are left out: which there are, and as jobs whose scores are stored."""

import json
from dataclasses import asdict

import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.population.setting import Setting
from mfd_bayes.validation.folds import FOLDER, Fold, parts_of


def test_scores_of_an_earlier_version_are_computed_anew(tmp_path):
    fold = Fold("a", "test_1.json", ("a",), ("b", "c"), effort="quick", seed=1)
    file = tmp_path / FOLDER / fold.file
    file.parent.mkdir()
    key = asdict(fold)
    file.write_text(json.dumps({"key": key, "predictions": []}))
    assert fold.stored(tmp_path)
    del key["scores"]  # without whole histories and factors of recalibration
    file.write_text(json.dumps({"key": key, "predictions": []}))
    assert not fold.stored(tmp_path)


def settings(*levels):
    return {f"t{i}": Setting(level) for i, level in enumerate(levels)}


def test_the_level_without_actuation_is_a_part():
    found = parts_of(settings(0.0, 0.03, 0.0, 0.036), "level", "kip", "a.toml")
    assert found == {"0 lbf": ("t0", "t2"), "30 lbf": ("t1",), "36 lbf": ("t3",)}


@pytest.mark.parametrize(("by", "part"), [("level", "30 lbf"), ("test", "t1")])
def test_all_tests_with_an_actuation_cannot_be_left_out(by, part):
    with pytest.raises(CampaignError, match=f"cannot leave out {part}: no other calibrated test"):
        parts_of(settings(0.0, 0.03), by, "kip", "a.toml")
