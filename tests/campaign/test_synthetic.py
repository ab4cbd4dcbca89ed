"""The synthetic campaign: the paper's whole test matrix, and its truth."""

import numpy as np
import pytest

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.synthetic import Matrix, write_campaign

ONE = Matrix(pressures=(0.0, 1000.0), frequencies=(0.5,), cycles=(2,), held_out=(500.0, 0.5))


def test_the_demo_follows_the_papers_whole_matrix(tmp_path):
    truth = write_campaign(tmp_path, 1)
    tests = load_campaign(tmp_path / "campaign.toml").tests
    calibrated = {test.id for test in tests if test.role == "calibrate"}
    levels = (0, 500, 800, 1200, 1500)
    assert calibrated == {f"p{p}_f{f}" for p in levels for f in ("0.05", "0.5")}
    assert [test.id for test in tests if test.role == "validate"] == ["p1000_f0.5"]
    assert set(truth["tests"]) == {test.id for test in tests}


def test_without_pressure_residual_friction_is_left(tmp_path):
    truth = write_campaign(tmp_path, 1, ONE)
    known, there = truth["population"], truth["tests"]["p0_f0.5"]
    assert known["Fc_fwd_0"] > 0
    assert there["Fc_fwd"] == pytest.approx(known["Fc_fwd_0"], rel=0.25)
    assert there["sigma0"] == pytest.approx(known["sigma0_0"], rel=0.4)
    high = truth["tests"]["p1000_f0.5"]["Fc_fwd"]
    assert high == pytest.approx(known["K_c_fwd"] + known["Fc_fwd_0"], rel=0.25)
    campaign = load_campaign(tmp_path / "campaign.toml")
    assert campaign.settings.laws["Fc_fwd"] == "affine"
    record = campaign.tests[0].read()
    assert record.actuation == 0.0
    sliding = np.abs(record.displacement) < 0.3
    assert np.median(np.abs(record.force[sliding])) == pytest.approx(0.17, abs=0.08)
