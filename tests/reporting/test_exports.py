"""JSON tables: what they say of themselves, and that every reader can read them."""

import csv
import io
import json
import math
from dataclasses import replace

import pytest

from mfd_bayes.reporting.exports import export_tables
from mfd_bayes.reporting.tables import laws_csv, parameters_csv


def strict(text):
    """Content of a JSON text; NaN and Infinity, which JSON has not, are refused."""

    def refuse(word):
        raise ValueError(word)

    return json.loads(text, parse_constant=refuse)


def test_every_form_is_there(campaign):
    names = {"parameters.json", "laws.json", "parameters.tex", "laws.tex"}
    assert set(export_tables(campaign)) == names


@pytest.mark.parametrize("name", ["parameters.json", "laws.json"])
def test_a_json_table_says_which_interval_it_holds(campaign, name):
    found = strict(export_tables(campaign)[name])
    assert found["interval"] == {
        "kind": "equal-tailed",
        "probability": 0.95,
        "bounds": ["lower", "upper"],
    }
    assert all(row["unit"] for row in found["rows"])


def test_json_and_csv_hold_the_same(campaign):
    found = export_tables(campaign)
    lines = parameters_csv(row for test in campaign.tests for row in test.rows)
    for name, text in (("parameters", lines), ("laws", laws_csv(campaign.law_rows))):
        rows = strict(found[f"{name}.json"])["rows"]
        table = list(csv.DictReader(io.StringIO(text)))
        assert len(rows) == len(table) > 0
        for row, line in zip(rows, table, strict=True):
            assert [row["unit"], row["note"]] == [line["unit"], line["note"]]
            for ours, theirs in (("lower", "q2.5"), ("median", "q50"), ("upper", "q97.5")):
                assert row[ours] == float(line[theirs])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_figures_that_are_not_finite_are_null(campaign, value):
    rows = (replace(campaign.law_rows[0], r_hat=value),)
    text = export_tables(replace(campaign, law_rows=rows))["laws.json"]
    assert strict(text)["rows"][0]["r_hat"] is None
    with pytest.raises(ValueError, match=r"NaN|Infinity"):  # the control
        strict(json.dumps({"r_hat": value}))
