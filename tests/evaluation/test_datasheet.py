"""The data sheet of a run: one row for each condition, quantity, direction and cycle."""

from pathlib import Path

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.errors import MfdError
from mfd_bayes.evaluation.properties import datasheet, parse_condition
from tests.run_folders import FORCE, MOTION, write_run

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


def test_measured_cycles_of_harmonic_tests_stand_beside_their_bounds(tmp_path):
    write_run(tmp_path / "out")
    sheet = datasheet(open_run(tmp_path / "out"))
    rows = sheet.rows
    levels = ["500 psi", "700 psi", "1000 psi"]  # of tests a, c, which is held out, and b
    assert list(dict.fromkeys(rows["condition"])) == [f"{level}, 1 in, 1 Hz" for level in levels]
    assert rows["tested"].all()
    area = np.sum(0.5 * (FORCE[1:41] + FORCE[:40]) * np.diff(MOTION[:41])) / 2  # two periods
    expected = {"slip_force": 2.0, "peak_force": 2.0, "effective_stiffness": 2.0, "energy": area}
    expected["effective_damping"] = area / (2 * np.pi * 2.0)
    for condition, part in rows.groupby("condition"):
        for quantity, value in expected.items():
            own = part[part["quantity"] == quantity]
            for column in ("measured_low", "measured", "measured_high"):
                np.testing.assert_allclose(own[column], value, rtol=0.02, err_msg=quantity)
            outside = (own["measured"] < own["lower"]) | (own["measured"] > own["upper"])
            assert (own["n_outside"] == own["n_cycles"] * outside).all(), (condition, quantity)
        energy = part[part["quantity"] == "energy"]
        assert energy["cycle"].tolist() == [0, 1, 2]
        assert energy["n_cycles"].tolist() == [2, 1, 1]
    whole = rows[rows["cycle"] == 0]
    outside, cycles = whole["n_outside"].sum(), whole["n_cycles"].sum()
    assert 0 < outside < cycles
    assert str(sheet.verdict[1]).startswith(f"{outside} of {cycles} measured values")


@pytest.mark.parametrize(
    "text", ["35 lbf", "500 psi, 1 in", "500 psi, 1 in, 0.5 Hz, 3 cycles", "35 lbf, 1 in, 0.5 Hz"]
)
def test_a_condition_that_is_none_is_refused(text):
    with pytest.raises(MfdError, match=text.split(",")[0]):
        parse_condition(text, "ksi")
