import csv
import io
from dataclasses import replace

import pytest

from mfd_bayes.evaluation.views import Check
from mfd_bayes.reporting import tables
from mfd_bayes.reporting.tables import (
    checks_csv,
    comparison_csv,
    crossvalidation_csv,
    derived_csv,
    law_scores_csv,
    laws_csv,
    noises_csv,
    parameters_csv,
    predicted_csv,
    readings_csv,
    report_tables,
    scores_csv,
)
from mfd_bayes.runs.folder import discard
from mfd_bayes.runs.verdict import Verdict


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
    assert line["test"] == line["note"] == f"'{text}".replace("\r", " ").replace("\t", " ")
    check = read(checks_csv([Check(text, "a, b", 'say "x"', -1.0, "<= 1", Verdict.PASS)]))[0]
    assert check["subject"] == line["test"]
    assert (check["check"], check["target"], check["value"]) == ("a, b", 'say "x"', "-1")


def test_scores_of_every_test(campaign):
    lines = read(scores_csv(campaign.scores))
    assert [line["role"] for line in lines] == ["calibrate", "validate"]
    assert lines[0]["coverage_95"] == "0.95"
    assert lines[0]["interval_score_95_kip"]


def test_derived_quantities_of_every_test(campaign):
    rows = [row for test in campaign.tests for row in test.derived]
    lines = read(derived_csv(rows))
    head = "test role quantity unit mean sd q2.5 q50 q97.5 measured note"
    assert list(lines[0]) == head.split()
    assert [line["role"] for line in lines] == ["calibrate"] * 3 + ["validate"] * 2
    assert (lines[0]["quantity"], lines[0]["measured"]) == ("energy_per_cycle", "3.3")
    assert (lines[2]["quantity"], lines[2]["measured"]) == ("gap", "")
    assert lines[3]["q50"] == ""  # no full cycle
    head = "quantity unit mean sd lower median upper measured note"
    about, other, *table = predicted_csv(rows, "800 psi", 0.9).splitlines()
    assert "90 % intervals" in about
    assert other.startswith("# actuation 800 psi")
    assert list(read("\n".join(table))[0]) == head.split()


def test_the_table_of_cross_validation_ends_with_the_mean(campaign):
    lines = read(crossvalidation_csv(campaign.left_out))
    assert [(line["part"], line["test"]) for line in lines] == [
        ("800 psi", "p800_f0.25"),
        ("", "mean"),
    ]
    assert (lines[0]["width_95_kip"], lines[0]["interval_score_95_kip"]) == ("0.4", "0.45")
    assert (lines[0]["fitted_width_95_kip"], lines[0]["crps_ratio"]) == ("0.2", "2")


def test_laws_are_scored_best_first(campaign):
    lines = read(law_scores_csv(campaign.law_choices))
    assert [(line["law"], line["chosen"]) for line in lines] == [
        ("power", "no"),
        ("proportional", "yes"),
    ]
    assert (lines[1]["elpd_difference"], lines[1]["weight"]) == ("-0.3", "0.3")
    assert (lines[0]["pareto_k"], lines[1]["pareto_k"]) == ("0.25", "")


def test_a_campaign_that_was_not_cross_validated_has_no_table_of_it(campaign):
    assert "crossvalidation.csv" in report_tables(campaign)
    assert "crossvalidation.csv" not in report_tables(replace(campaign, left_out=None))


def test_a_new_run_in_a_folder_removes_every_table_of_the_old_one(campaign, tmp_path):
    (tmp_path / "manifest.json").write_text("{}")
    for name in report_tables(campaign):
        (tmp_path / name).write_text("")
    discard(tmp_path)
    assert not any(tmp_path.iterdir())


def test_nothing_to_write_leaves_the_header():
    assert read(scores_csv([])) == []
    assert scores_csv([]).startswith("test,role,")


@pytest.mark.parametrize(
    ("make", "columns"),
    [
        (law_scores_csv, "quantity law chosen elpd elpd_se elpd_difference"),
        (scores_csv, "test role coverage_50 coverage_90 coverage_95 width_95_kip"),
        (checks_csv, "subject check target value limit verdict size tolerance"),
        (tables.tested_csv, "condition unit smallest largest"),
        (readings_csv, "test quantity unit read_off q2.5 q50 q97.5 tolerance missed largest"),
        (noises_csv, "test quantity unit noise q2.5 q50 q97.5 other_noise other_q2.5 other_q50"),
        (comparison_csv, "test model cycles elpd elpd_se p_loo worst_pareto_k share_bad_k"),
        (laws_csv, "group constant unit mean sd q2.5 q50 q97.5 ess_bulk ess_tail r_hat"),
    ],
)
def test_other_programs_find_the_columns(make, columns):
    assert make([]).splitlines()[0].split(",")[: len(columns.split())] == columns.split()
