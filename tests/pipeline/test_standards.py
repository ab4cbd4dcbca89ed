"""A standard in a campaign: what the report, the commands and Python say of it."""

import csv
import re
from dataclasses import replace

import pytest

import mfd_bayes as mb
from mfd_bayes.errors import CampaignError
from tests.command_line import refusal, said


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


def test_the_report_says_requirement_by_requirement_what_is_met(finished_run, run):
    table, rows = mb.conformity_table(run), rows_of(finished_run.out / "conformity.csv")
    assert [row["verdict"] for row in rows] == [str(v) for v in table["verdict"]]
    cycles = table[table["requirement"].str.startswith("each cycle")]
    assert set(cycles["verdict"]) == {"not tested"}  # tests of one full cycle
    means = table[table["requirement"].str.startswith("mean of the test")]
    assert set(means["test"]) == {"p1000_f0.5"}
    assert set(means["verdict"]) <= {"meets", "fails"}
    assert means["probability"].between(0.0, 1.0).all()
    expected = [
        "meets" if abs(v) <= x else "fails"
        for v, x in zip(means["value"], means["limit"], strict=True)
    ]
    assert [str(v) for v in means["verdict"]] == expected
    for name in ("report.html", "datasheet.html"):
        page = (finished_run.out / name).read_text("utf-8")
        assert re.search(r"Of 6 requirements of ASCE/SEI 7-22, chapter 18: \d meets", page)
        assert "prototypes of each type and size" in page
        assert "not compared with the licensed text" in page
    every = rows_of(finished_run.out / "cycles.csv")
    assert {row["quantity"] for row in every} >= {"slip_force", "force_at_max_displacement"}


def test_without_a_design_there_is_nothing_to_compare_with(run):
    with pytest.raises(CampaignError, match=r"has no \[design\] that names a standard"):
        mb.conformity_table(replace(run, manifest=run.manifest.changed(standard=None)))


def test_missing_tests_are_listed_in_the_order_of_the_standard(finished_run):
    printed = said("next", finished_run.out, "--protocol", "asce7-22")
    amplitudes = re.findall(r" 500 psi, (\S+) in, 0.501 Hz", printed)
    assert amplitudes == ["0.33", "0.67", "1"]  # the tests have two cycles
    assert "prototypes of each type and size" in printed
    european = said("next", finished_run.out, "--protocol", "en15129")
    assert "any frequency" in european
    sentence = refusal("next", finished_run.out, "--protocol", "asce7-23")
    assert "expected asce7-16, asce7-22, en15129, ntc2018" in sentence


def test_bounding_properties_of_the_standard_stand_beside_the_posteriors(finished_run, tmp_path):
    path = tmp_path / "bands.csv"
    motion = ("--sine", "1 in, 0.5 Hz, 3 cycles", "--actuation", "1000 psi", "--design")
    said("predict", finished_run.out, *motion, "-o", path)
    rows = [r for r in rows_of(tmp_path / "bands_design.csv") if r["basis"] == "standard"]
    # of one full cycle each no cycle deviates: what is left is 0.9 and 1.1 of the specification,
    # and the least and the largest factor of the standard
    assert {row["property"] for row in rows} >= {"slip_fwd", "slip_bwd", "energy_per_cycle"}
    for row in rows:
        assert (row["lower_ratio"], row["upper_ratio"]) == ("0.85", "1.2")
        for bound, factor in (("lower", 0.85), ("upper", 1.2)):
            value = factor * float(row["nominal"])
            assert float(row[bound]) == pytest.approx(value, rel=1e-4)
    factors = rows_of(finished_run.out / "factors.csv")
    assert {(f["lambda_min"], f["lambda_max"]) for f in factors} == {("0.85", "1.2")}
    assert {(f["composed_min"], f["composed_max"]) for f in factors} == {("0.9", "1.1")}
