"""Gains of instruments: what is not known of them is in the properties of the device."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.campaign.schema import CampaignFile
from mfd_bayes.evaluation.bounds import (
    bounds_of,
    design_rows,
    drawn_properties,
    places_of,
    with_gains,
)
from mfd_bayes.evaluation.measurement import EXACT, Gains, gains_of, gains_of_another
from mfd_bayes.evaluation.properties import predicted_rows, property_rows
from mfd_bayes.runs.resume import with_keys

LARGE = 0.15


@pytest.fixture(scope="module")
def run(made_run):
    return open_run(made_run)


def column(role, **values):
    return {role: {"name": role, **values}}


def stating(run, columns=None, *tests, measurement=None):
    """The run with columns stated, those of the campaign and of its first tests."""
    content = run.manifest.settings.model_dump(exclude_defaults=True)
    content["columns"] = columns or {}
    content["test"] = [dict(test) for test in content["test"]]
    for test, own_columns in zip(content["test"], tests, strict=False):
        test["columns"] = own_columns
    manifest = run.manifest.changed(settings=CampaignFile.model_validate(content))
    priors = replace(run.priors, measurement=measurement or {})
    return replace(run, manifest=with_keys(manifest, priors), priors=priors)


def log_sd(gain):
    return 0.0 if gain is None else float(np.log(gain).std())


@pytest.mark.parametrize("error", ["unknown", "one sigma"])
def test_an_interval_of_the_slip_force_holds_what_a_wrong_load_cell_misreads(run, error):
    """Twelve records of a load cell that reads 0.5 % wrong, in each of 200 seeds.

    The true gain is drawn from the calibration's distribution, or it is 0.5 % off in each. The
    control: without the statement few intervals hold the truth.
    """
    uncertainty, sd, tests, seeds, n = 0.005, 0.004, 12, 200, 1000
    stated = gains_of(stating(run, column("force", uncertainty=uncertainty)), n)
    hits = {"stated": 0, "not stated": 0}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        gain = np.exp(uncertainty * (rng.standard_normal() if error == "unknown" else 1.0))
        readings = np.log(2.0 / gain) + sd * rng.standard_normal(tests)
        posterior = np.exp(readings.mean() + sd / np.sqrt(tests) * rng.standard_normal(n))
        for name, gains in (("stated", stated), ("not stated", EXACT)):
            (row,) = bounds_of({"mean": gains.applied({"slip_fwd": posterior})}, 0.95)[:1]
            hits[name] += row["lower"] <= 2.0 <= row["upper"]
    tolerance = 4.0 * np.sqrt(0.95 * 0.05 / seeds)
    assert hits["not stated"] / seeds < 0.95 - 2.0 * tolerance
    assert hits["stated"] / seeds > 0.95 - tolerance
    if error == "unknown":
        assert hits["stated"] / seeds < 0.95 + tolerance


def test_gains_are_those_of_the_instruments_that_measured_the_calibrated_tests(run):
    """Tests a and b are calibrated, c is held out."""
    sds = [
        (log_sd(gains.force), log_sd(gains.displacement))
        for gains in (
            gains_of(stating(run, columns, *tests, measurement=prior), 4000)
            for columns, tests, prior in (
                (None, (), None),
                (column("force", uncertainty="1 %"), (), None),
                (column("force"), (), {"force": 0.01, "displacement": 0.02}),
                (column("force", uncertainty="3 %"), (), {"force": 0.01}),
                ({}, (column("force", uncertainty="1 %"),), None),  # of all: the same instrument
                ({}, (column("force", uncertainty="1 %", instrument="2"),), None),  # of a half
                ({}, ({}, {}, column("force", uncertainty="1 %", instrument="2")), None),
            )
        )
    ]
    half = column("force", uncertainty="1 %", instrument="2"), column("force", uncertainty="1 %")
    two = gains_of(stating(run, {}, *half), 4000)
    assert sds[:5] == [
        pytest.approx(pair, rel=0.01)
        for pair in ((0.0, 0.0), (0.01, 0.0), (0.01, 0.02), (0.03, 0.0), (0.01, 0.0))
    ]
    assert sds[5:] == [pytest.approx(pair, rel=0.01) for pair in ((0.005, 0.0), (0.0, 0.0))]
    assert log_sd(two.force) == pytest.approx(0.01 / np.sqrt(2.0), rel=0.05)


def test_an_arm_lengthens_the_travel_and_lowers_the_force_and_leaves_the_energy(run):
    arm = {"arm": "4 in", "arm_uncertainty": "1 %"}
    gains = gains_of(stating(run, column("force", **arm) | column("displacement", **arm)), 1000)
    assert log_sd(gains.displacement) == pytest.approx(0.01, rel=0.01)
    np.testing.assert_allclose(gains.force * gains.displacement, 1.0)
    np.testing.assert_allclose(gains.factor("energy_per_cycle"), 1.0)
    np.testing.assert_allclose(gains.factor("effective_stiffness"), gains.force**2)


def test_another_load_cell_has_a_gain_of_its_own_beside_that_of_the_tests(run):
    stated = stating(run, column("force", uncertainty="3 %"))
    assert log_sd(gains_of_another(stated, 0.04, 4000).force) == pytest.approx(0.05, rel=0.05)
    assert log_sd(gains_of_another(run, 0.04, 4000).force) == pytest.approx(0.04, rel=0.01)


def test_bounds_widen_by_their_units_the_nominal_value_stays_and_properties_move_together(run):
    trace = replace(run.tests["a"].trace, force=None)
    stated = stating(run, column("force", uncertainty=LARGE))
    narrow, wide = (
        {(r["name"], r["basis"]): r for r in design_rows(x, trace)} for x in (run, stated)
    )
    for name in ("slip_fwd", "energy_per_cycle", "effective_damping"):
        before, after = narrow[name, "mean"], wide[name, "mean"]
        widths = [np.log(row["upper"] / row["lower"]) for row in (before, after)]
        assert after["nominal"] == pytest.approx(before["nominal"], rel=0.5 * LARGE**2 + 0.01)
        if name == "effective_damping":
            assert after == before
        else:
            expected = np.hypot(widths[0], 2.0 * 1.96 * LARGE)
            assert widths[1] == pytest.approx(expected, rel=0.1)
            assert after["upper"] / after["nominal"] > before["upper"] / before["nominal"]  # λ
    # of one draw the load cell is the same
    draws = [with_gains(x, drawn_properties(x, trace, places_of(x))) for x in (run, stated)]
    ratios = [d["new_test"]["energy_per_cycle"] / d["new_test"]["slip_fwd"] for d in draws]
    np.testing.assert_allclose(*ratios)


def test_the_properties_of_a_prediction_have_the_gain(run):
    trace, sds = replace(run.tests["a"].trace, force=None), []
    for source in (run, stating(run, column("force", uncertainty=LARGE))):
        rows = predicted_rows(source, trace, source.predict(trace, "mean"))
        sds.append({row["name"]: row["sd"] for row in rows})
    wider = {name for name, sd in sds[1].items() if sd > sds[0][name]}
    same = {name for name, sd in sds[1].items() if sd == sds[0][name]}
    assert {"slip_fwd", "peak_bwd", "total_energy", "C_fwd"} <= wider  # C: over an exact actuation
    assert {"slip_to_slip", "effective_damping"} <= same
    assert wider | same == set(sds[0])


def test_a_gain_that_is_not_known_excuses_no_miss(run):
    """A record that is compared was measured by the tests' instruments."""
    trace, scores = run.tests["a"].trace, (np.arange(1000) + 0.5) / 1000.0 - 0.5
    draws, measured = {"slip_fwd": 2.0 + 0.02 * scores}, {"slip_fwd": 2.5}
    (row,) = property_rows("", "mean", trace, draws, measured, gains=Gains(np.exp(scores)))
    assert row["missed"]
    assert row["lower"] < 2.5 < row["upper"]


def test_stating_an_uncertainty_leaves_all_that_is_stored_as_it_is(run):
    said = {"uncertainty": "1 %", "instrument": "2", "arm_uncertainty": "1 %"}
    keys = [
        stating(run, column("force", arm="4 in", **extra), measurement=prior).manifest.keys
        for extra, prior in (({}, None), (said, None), ({}, {"force": 0.01}))
    ]
    assert keys[0] == keys[1] == keys[2]


def test_exact_gains_change_no_digit():
    values = {"slip_fwd": np.array([1.0, np.nan]), "energy": np.ones((2, 3))}
    assert Gains().applied(values)["slip_fwd"] is values["slip_fwd"]
    assert Gains(np.array([2.0, 3.0])).applied(values)["energy"].tolist() == [[2.0] * 3, [3.0] * 3]
