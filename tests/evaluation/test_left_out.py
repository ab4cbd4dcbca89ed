import math
from dataclasses import replace

import pytest

from mfd_bayes.evaluation.crossvalidate import left_out_view
from mfd_bayes.runs.scores import CampaignCrossValidation, Prediction, Score


def scored(width, crps):
    return Score((0.5, 0.8, 0.9), width, interval_score=1.5 * width, crps=crps, rrse=0.3)


def prediction(test, part, width):
    return Prediction(part, test, score=scored(width, 0.2), fitted=scored(0.5, 0.1))


STORED = CampaignCrossValidation(
    "level", (prediction("a", "500 psi", 1.0), prediction("b", "1000 psi", 2.0))
)


def test_predictions_stand_beside_fitted_tests_and_are_averaged():
    found = left_out_view(STORED)
    first, second = found.rows
    assert (first["test"], first["part"], first["coverage_95"]) == ("a", "500 psi", 0.9)
    assert (first["fitted_width"], first["width_ratio"], second["width_ratio"]) == (0.5, 2.0, 4.0)
    assert first["crps_ratio"] == pytest.approx(2.0)
    assert (found.mean["test"], found.mean["part"]) == ("mean", "")
    assert found.mean["width_95"] == pytest.approx(1.5)
    assert found.mean["interval_score"] == pytest.approx(2.25)
    assert found.sentence == (
        "Of 2 tests, each predicted from those of the other levels, the 95 % bands hold 90.0 % of "
        "the force, the 50 % bands 50.0 %; they are on average 3.0 times as wide as those of the "
        "fitted tests."
    )


def test_whole_histories_that_were_held_are_counted():
    first, second = STORED.predictions
    known = replace(first, whole=True), replace(second, whole=False)
    found = left_out_view(replace(STORED, predictions=known))
    assert [row["whole_95"] for row in found.rows] == [1.0, 0.0]
    assert found.mean["whole_95"] == 0.5
    assert found.sentence.endswith("hold the whole force of 1 of 2 tests.")
    older = left_out_view(STORED)
    assert math.isnan(older.mean["whole_95"])
    assert "whole" not in older.sentence


def test_a_test_left_out_is_predicted_from_the_others():
    assert "each predicted from the others" in left_out_view(replace(STORED, by="test")).sentence


def test_a_fitted_band_without_width_has_no_ratio():
    flat = replace(prediction("a", "500 psi", 1.0), fitted=scored(0.0, 0.0))
    (row,) = left_out_view(replace(STORED, predictions=(flat,))).rows
    assert math.isnan(row["width_ratio"])
    assert math.isnan(row["crps_ratio"])


def test_a_campaign_without_cross_validation_has_no_such_view():
    assert left_out_view(None) is None
