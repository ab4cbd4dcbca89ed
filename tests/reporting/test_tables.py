import csv
import io
from dataclasses import replace

import pytest

from mfd_bayes.reporting.tables import checks_csv, laws_csv, parameters_csv, scores_csv
from mfd_bayes.reporting.views import Check


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_parameters_have_the_columns_of_the_contract(campaign):
    lines = read(parameters_csv(campaign.tests[0].rows))
    head = "test parameter unit mean sd q2.5 q50 q97.5 ess_bulk ess_tail r_hat contraction note"
    assert list(lines[0]) == head.split()
    assert lines[1]["parameter"] == "k3"
    assert float(lines[1]["q97.5"]) == 1.2


def test_values_that_are_not_defined_are_empty(campaign):
    row = replace(campaign.law_rows[0], r_hat=float("nan"), mean=-1.25e-7)
    line = read(laws_csv([row]))[0]
    assert line["r_hat"] == ""
    assert float(line["mean"]) == -1.25e-7


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"])
def test_no_text_is_a_formula(text, campaign):
    row = replace(campaign.law_rows[0], subject=text, note=text)
    line = read(parameters_csv([row]))[0]
    assert line["test"] == line["note"] == f"'{text}".replace("\r", " ")
    check = read(checks_csv([Check(text, "a, b", 'say "x"', -1.0, "<= 1", "pass")]))[0]
    assert check["subject"] == line["test"]
    assert (check["check"], check["target"], check["value"]) == ("a, b", 'say "x"', "-1")


def test_scores_of_every_test(campaign):
    lines = read(scores_csv(campaign.scores))
    assert [line["role"] for line in lines] == ["calibrate", "validate"]
    assert lines[0]["coverage_95"] == "0.95"


def test_nothing_to_write_leaves_the_header():
    assert read(scores_csv([])) == []
    assert scores_csv([]).startswith("test,role,")
