"""The data sheet of a run: one row for each condition, quantity, direction and cycle."""

from pathlib import Path

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.errors import MfdError
from mfd_bayes.evaluation.datasheet import datasheet, parse_condition

DATA = Path(__file__).parents[1] / "data" / "run"


@pytest.fixture(scope="module")
def sheet():
    run = open_run(DATA)
    return datasheet(run, [parse_condition("700 psi, 0.9 in, 0.4 Hz", run.actuation_unit)])


def test_every_condition_has_every_quantity(sheet):
    rows = sheet.rows[sheet.rows["cycle"] == 0]
    wanted = {"slip_force", "peak_force", "effective_stiffness", "effective_damping"}
    for condition, part in rows.groupby("condition"):
        assert set(part["quantity"]) == wanted | {"energy", "gap"}, condition
        assert set(part.loc[part["quantity"] == "peak_force", "direction"]) == {
            "forward",
            "backward",
        }
    assert set(sheet.formulas) == set(rows["quantity"])


def test_a_condition_that_was_asked_for_has_bounds_and_no_measured_value(sheet):
    asked = sheet.rows[sheet.rows["condition"] == "700 psi, 0.9 in, 0.4 Hz"]
    assert len(asked) == 11  # eight, and the energy of three cycles
    assert not asked["tested"].any()
    assert asked["measured"].isna().all()
    assert (asked["n_cycles"] == 0).all()
    assert (asked["lower"] < asked["nominal"]).all()
    assert (asked["nominal"] < asked["upper"]).all()
    np.testing.assert_allclose(asked["lambda_max"], asked["upper"] / asked["nominal"])


def test_it_says_what_was_tested_and_what_is_not_known(sheet):
    assert len(sheet.verdict) == 3
    assert "2 calibrated, 1 held out" in str(sheet.tested["tests"])
    assert "actuation" in sheet.tested
    assert any("Temperature" in str(message) for message in sheet.not_known)


@pytest.mark.parametrize(
    "text", ["35 lbf", "500 psi, 1 in", "500 psi, 1 in, 0.5 Hz, 3 cycles", "35 lbf, 1 in, 0.5 Hz"]
)
def test_a_condition_that_is_none_is_refused(text):
    with pytest.raises(MfdError, match=text.split(",")[0]):
        parse_condition(text, "ksi")
