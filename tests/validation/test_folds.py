"""Parts that are left out, as jobs whose scores are stored."""

import json
from dataclasses import asdict

from mfd_bayes.validation.folds import FOLDER, Fold


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
