import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.reporting.figure_data import table_of, tables_of_test


@pytest.fixture(scope="module")
def tables(campaign, tables_behind):
    return tables_behind(campaign)


def read(text):
    head, *rows = csv.reader(io.StringIO(text))
    return [dict(zip(head, row, strict=True)) for row in rows]


def test_every_figure_has_its_table(images, tables):
    assert {table_of(key) for key in images} == set(tables)


def test_the_table_of_a_record_has_every_sample(campaign, tables):
    test = campaign.tests[0]
    rows = read(tables["tests/p800_f0.25/record.csv"])
    assert len(rows) == test.trace.samples
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    np.testing.assert_allclose(column["force_kip"], test.trace.force, rtol=1e-5, atol=1e-9)
    residual = test.trace.force - test.observation.median
    np.testing.assert_allclose(column["residual_kip"], residual, rtol=1e-4, atol=1e-6)
    assert np.all(column["lower_95_kip"] <= column["lower_50_kip"])
    assert column["fitted"].sum() == test.trace.samples - test.first
    held = read(tables["tests/held/record.csv"])
    assert {row["fitted"] for row in held} == {"0"}


def test_the_table_of_a_record_has_stages_where_they_are_known(campaign):
    test = campaign.tests[0]
    staged = replace(
        test, stage=np.full(test.trace.samples, 2, np.int8), travel=np.zeros(test.trace.samples)
    )
    rows = read(dict(tables_of_test(staged))["tests/p800_f0.25/record.csv"])
    assert {row["stage"] for row in rows} == {"2"}


def test_the_table_of_a_record_has_the_band_of_the_model_where_it_is_known(campaign):
    test = campaign.tests[0]
    known = replace(test, device=test.observation)
    for row in read(dict(tables_of_test(known))["tests/p800_f0.25/record.csv"])[:3]:
        assert row["model_lower_95_kip"] == row["lower_95_kip"]
    (row, *_) = read(
        dict(tables_of_test(replace(test, device=None)))["tests/p800_f0.25/record.csv"]
    )
    assert not any(name.startswith("model_") for name in row)


def test_quantiles_and_draws_agree(campaign, tables):
    rows = read(tables["tests/p800_f0.25/marginals.csv"])
    draws = read(tables["tests/p800_f0.25/draws.csv"])
    k3 = np.array([float(row["k3 [kip/in]"]) for row in draws])
    told = next(r for r in rows if (r["quantity"], r["of"]) == ("k3", "posterior"))
    assert float(told["q50"]) == pytest.approx(np.median(k3), rel=1e-4)
    assert {r["of"] for r in rows} == {"prior", "posterior"}


def test_laws_hold_curves_and_tests(tables):
    rows = read(tables["figures/laws.csv"])
    assert {row["what"] for row in rows} == {
        *("mean property, 95 %", "this device tested again, 95 %"),
        *("test a, 95 %", "test b, 95 %"),
    }
    assert all(float(r["lower"]) <= float(r["median"]) <= float(r["upper"]) for r in rows)


def test_the_table_of_chains_has_a_number_for_each(tables):
    rows = read(tables["tests/p800_f0.25/chains.csv"])
    assert {row["chain"] for row in rows} == {"0", "1", "2", "3"}
    assert "Fc_fwd [kip]" in rows[0]


def test_names_are_no_formulas(campaign, tables_behind):
    named = replace(campaign.tests[0], id="=HYPERLINK(1)")
    text = tables_behind(replace(campaign, tests=(named,)))["figures/overview.csv"]
    assert "\n'=HYPERLINK(1)" in text
