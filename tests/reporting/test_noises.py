"""A parameter that the noise decides: both values in every form of Table I."""

import csv
import io
import json
from dataclasses import replace

import pytest

from mfd_bayes.evaluation.views import NoiseRow, Row
from mfd_bayes.reporting.conversion import convert_row
from mfd_bayes.reporting.exports import export_tables
from mfd_bayes.reporting.html import render
from mfd_bayes.reporting.latex import parameters_tex
from mfd_bayes.reporting.paper_tables import paper_tables
from mfd_bayes.reporting.tables import noises_csv, parameters_csv
from mfd_bayes.reporting.word import value_lines
from mfd_bayes.runs.systems import SI

OTHER = NoiseRow(
    *("p800_f0.25", "k3", "kip/in", "ou", 23.9, 26.0, 29.0),
    *("staged", 39.0, 42.2, 45.6),
    decides=True,
)
PLAIN = Row("p800_f0.25", "k3", "kip/in", *(26.0, 1.5, 23.9, 26.0, 29.0), 1.0, 900.0, 900.0, 0.9)
MOVED = replace(PLAIN, others=(OTHER,))


@pytest.fixture
def reports(campaign):
    """The report with the parameter as the noise decides it, and as it does not."""

    def with_row(row, noises):
        rows = (row, *(r for r in campaign.tests[0].rows if r.name != row.name))
        test = replace(campaign.tests[0], rows=rows, noises=noises)
        return replace(campaign, tests=(test, *campaign.tests[1:]))

    return with_row(MOVED, (OTHER,)), with_row(PLAIN, ())


def test_csv_json_and_latex_hold_both_values(reports):
    moved, plain = reports
    cells = [
        next(csv.DictReader(io.StringIO(parameters_csv([row]))))["note"] for row in (MOVED, PLAIN)
    ]
    assert cells == ["the noise model decides: staged: 42.2 [39.0, 45.6]", ""]
    told = [json.loads(export_tables(v)["parameters.json"])["rows"][0] for v in reports]
    both = {"noise": "staged", "lower": 39.0, "median": 42.2, "upper": 45.6}
    assert [row["other_noises"] for row in told] == [[both], []]
    assert r"\scriptsize staged: & \scriptsize $42.2$ $[39.0,\,45.6]$" in parameters_tex(moved)
    assert "staged" not in parameters_tex(plain)


def test_the_word_table_holds_both_values(reports):
    values = [paper_tables(view)[0].lines[0].values[0] for view in reports]
    assert [value_lines(row) for row in values] == [
        ("26.0", "[23.9, 29.0]", "staged: 42.2 [39.0, 45.6]"),
        ("26.0", "[23.9, 29.0]"),
    ]


def test_the_page_marks_the_value_and_says_why(reports):
    moved, plain = (render(view, {})["report.html"] for view in reports)
    assert '<small class="missed">staged' in moved
    assert "also fitted under other noise models" in moved
    assert '<small class="missed">staged' not in plain
    assert "also fitted under other noise models" not in plain


def test_both_values_are_in_the_same_units():
    metric = convert_row(MOVED, SI)
    assert metric.others[0].other_median / metric.median == pytest.approx(42.2 / 26.0)
    assert metric.unit == metric.others[0].unit == "kN/mm"
    text = noises_csv([metric.others[0]]).splitlines()[1]
    assert text.startswith("p800_f0.25,k3,kN/mm,ou,")
    assert text.endswith(",yes")
