"""`mfd-bayes accept` and `mfd_bayes.accept`: a device's records against a finished run."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.applications.acceptance.judgement import guard_band
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values
from tests.command_line import here, write_csv


@pytest.fixture(scope="module")
def production(tmp_path_factory):
    """Function that writes records of tests at 1000 psi, with their forces times a factor."""
    folder = tmp_path_factory.mktemp("production")

    def write(name: str, factor: float = 1.0, seed: int = 0):
        rng = np.random.default_rng(seed)
        values = draw_values(1.0, Matrix(pressures=(500.0,)).laws, rng)
        time, x, force = draw_record(values, 0.5, 3, rng)
        return write_csv(folder / name, time, x, factor * force)

    return write


@pytest.fixture(scope="module")
def record(production):
    return mb.read_record(production("good.csv"), actuation="1000 psi")


@pytest.fixture(scope="module")
def batch(out, production, tmp_path_factory):
    """A good device and one of twice the force, judged by the command: its folder and table."""
    folder = tmp_path_factory.mktemp("batch") / "qc"
    records = production("good.csv"), production("strong.csv", 2.0, seed=1)
    ended = here("accept", out, *records, "--actuation", "1000 psi", "-o", folder)
    assert ended.exit_code == 1, ended.output
    return folder, pd.read_csv(folder / "acceptance.csv", comment="#")


def test_a_good_device_is_not_rejected_and_a_wrong_one_is(batch, production):
    _, table = batch
    verdicts = table.groupby("device")["device_verdict"].unique().map(list)
    assert verdicts["strong"] == ["rejected"]
    assert verdicts["good"] != ["rejected"]
    strong = table[table["device"] == "strong"].set_index("name")
    assert strong.loc["slip_fwd", "verdict"] == "beyond the limit"
    assert strong.loc["slip_fwd", "effect"] == pytest.approx(100.0, abs=45.0)
    record = mb.read_record(production("strong.csv", 2.0, seed=1))
    energy = np.trapezoid(record.force, record.displacement) / 3.0  # of three cycles
    assert strong.loc["energy_per_cycle", "measured"] == pytest.approx(energy, rel=0.05)
    gap = strong.loc["gap"]
    assert gap["effect_lower"] < 0.0 < gap["effect_upper"]  # its gap is as wide as the others'


def test_chatter_is_no_change_of_the_slip_force(run, production):
    """A sample at mid-stroke may lie anywhere in chatter; a mean over the window does not."""
    quiet = mb.read_record(production("quiet.csv", seed=3), actuation="1000 psi")
    x, force = quiet.displacement, quiet.force
    forward = np.gradient(x, quiet.time) > 0.0
    chatter = 0.7 * np.where(forward, 1.0, -1.0) * np.cos(2.0 * np.pi * x / 0.15 + np.pi)
    loud = replace(quiet, force=force + chatter * (np.abs(force) > 1.0))
    (steady,), (chattering,) = (mb.accept(run, record) for record in (quiet, loud))
    for name in ("slip_fwd", "slip_bwd"):
        sizes = [device.rows.loc[name, "measured"] for device in (steady, chattering)]
        assert sizes[1] == pytest.approx(sizes[0], rel=0.1)
        assert chattering.rows.loc[name, "verdict"] != "beyond the limit"


def test_a_force_read_in_another_unit_is_asked_for(run, production):
    for name, factor, expected in (("kN.csv", 4.448, True), ("strong.csv", 1.3, False)):
        record = mb.read_record(production(name, factor), actuation="1000 psi")
        (device,) = mb.accept(run, record)
        assert device.verdict == "rejected"
        sentence = "is its unit wrong? It was read in kip, and in kN"
        assert (sentence in device.sentence) is expected, device.sentence


def test_bounds_are_those_of_the_data_sheet_and_what_they_hold_does_not_differ(run):
    """An unaltered record of the calibrated device: one interval in accept and in the sheet."""
    sheet = datasheet(run).rows.query("cycle == 0").set_index(["condition", "quantity"])
    names = {"energy_per_cycle": "energy", "effective_damping": "effective_damping"}
    for test in run.manifest.settings.test:
        if test.role != "calibrate":
            continue
        path = Path(run.folder).parent / "campaign" / test.file
        (device,) = mb.accept(run, mb.read_record(path, actuation=test.actuation))
        level = test.actuation.split()[0]
        for name, quantity in names.items():
            row = device.rows.loc[name]
            condition = next(c for c, q in sheet.index if c.startswith(f"{level} "))
            bounds = sheet.loc[(condition, quantity), ["lower", "upper"]].to_numpy(float).ravel()
            assert row[["lower", "upper"]].to_numpy(float) == pytest.approx(bounds, rel=0.03)
        in_bounds = device.rows["measured"].between(device.rows["lower"], device.rows["upper"])
        assert (device.rows.loc[in_bounds, "verdict"] != "differs").all()
        assert (device.rows.loc[in_bounds, "p_value"] > 0.05).all()
        assert device.verdict != "rejected"


@pytest.mark.parametrize(
    ("records", "options", "words"),
    [
        *(
            (value, {}, "records must be one Record or several")
            for value in ("good.csv", Path("good.csv"), None, 5, np.ones(9), ["good.csv"], [None])
        ),
        ("trace", {}, "records must be one Record or several"),
        ("record", {"device": None}, "device must be a name"),
        ("record", {"device": [5]}, "device must be a name"),
        ("record", {"limits": "all"}, "limits must be shares"),
        ("record", {"uncertainty": 0.3}, "uncertainty must be a share"),
        ("record", {"uncertainty": "1 %"}, "uncertainty must be a share"),
        ("constant", {}, "the force is the same throughout"),
    ],
)
def test_what_is_no_record_with_a_force_is_refused_in_one_sentence(
    run, record, records, options, words
):
    cases = {"trace": record.trace(), "record": record}
    cases["constant"] = replace(record, force=np.full_like(record.force, 2.0))
    with pytest.raises(mb.MfdError, match=words):
        mb.accept(
            run, cases.get(records, records) if isinstance(records, str) else records, **options
        )
    with pytest.raises(mb.MfdError, match="run must be a Run"):
        mb.accept("out", record)


def test_each_device_has_a_page_to_file(batch):
    folder, _ = batch
    page = (folder / "strong.html").read_text(encoding="utf-8")
    assert re.search(r"strong\.csv, SHA-256 [0-9a-f]{64}", page)
    for text in ("Rejected", "1000 psi", "Signature", "data:image/png;base64,"):
        assert text in page
    for text in ("guard band", "<br>risk 0.0"):
        assert text in page
    assert "http" not in re.sub(r'http-equiv="[^"]*"', "", page)  # it loads nothing
    assert (folder / "acceptance.png").stat().st_size > 1000


def test_several_records_of_a_device_tell_more(run, production):
    records = [
        mb.read_record(production(f"r{seed}.csv", seed=seed), actuation="1000 psi")
        for seed in range(3)
    ]
    (single,) = mb.accept(run, records[0], device="no. 17")
    (three,) = mb.accept(run, records, device="no. 17")
    wide, narrow = (d.rows["effect_upper"] - d.rows["effect_lower"] for d in (single, three))
    assert narrow["slip_fwd"] < 0.95 * wide["slip_fwd"]
    assert (three.device, len(three.comparisons)) == ("no. 17", 3)
    assert [d.device for d in mb.accept(run, records)] == ["r0", "r1", "r2"]


def test_wide_limits_are_kept_and_narrow_ones_are_not_shown(run, record):
    """Two one-sided tests: a limit that the record cannot resolve is neither kept nor passed."""
    (wide,) = mb.accept(run, record, limits={"slip": 0.9, "energy": 0.9})
    (narrow,) = mb.accept(run, record, limits={"slip": 0.001})
    assert wide.verdict == "accepted"
    assert narrow.verdict == "cannot tell"
    assert np.isnan(wide.rows.loc["gap", "limit"])  # only what was given is limited
    lower, upper = wide.rows.loc["slip_fwd", ["effect_lower", "effect_upper"]] / 100.0
    (at_end,) = mb.accept(run, record, limits={"slip": max(-lower, upper)})
    assert 0.04 < at_end.rows.loc["slip_fwd", "beyond_limit"] < 0.11  # intervals of 90 %


def stating(run, uncertainty):
    """The run whose campaign states the uncertainty of its load cell."""
    settings = run.manifest.settings
    force = settings.columns.force.model_copy(update={"uncertainty": uncertainty})
    columns = settings.columns.model_copy(update={"force": force})
    settings = settings.model_copy(update={"columns": columns})
    return replace(run, manifest=run.manifest.changed(settings=settings))


def test_a_common_load_cell_cancels_and_another_widens_what_has_a_force_in_it(run, record):
    (exact,) = mb.accept(run, record)
    (common,) = mb.accept(stating(run, 0.1), record)
    pd.testing.assert_frame_equal(common.rows, exact.rows)
    (other,) = mb.accept(stating(run, 0.1), record, uncertainty=0.1)
    (alone,) = mb.accept(run, record, uncertainty=0.1)
    sds = [
        np.log1p(0.01 * d.rows["effect_upper"]) - np.log1p(0.01 * d.rows["effect_lower"])
        for d in (exact, alone, other)
    ]
    for name in ("slip_fwd", "peak_bwd", "energy_per_cycle", "effective_stiffness"):
        for device, gains in ((1, 0.1), (2, 0.1 * np.sqrt(2.0))):
            expected = np.hypot(sds[0][name], 2.0 * 1.645 * gains)
            assert sds[device][name] == pytest.approx(expected, rel=0.15), name
    bands = [d.comparisons[0].expected.fan.widest for d in (exact, other)]
    assert np.mean(bands[1].upper - bands[1].lower) > 1.1 * np.mean(bands[0].upper - bands[0].lower)
    for name in ("gap", "effective_damping"):
        assert sds[2][name] == sds[0][name]
    assert (other.rows["detectable"] >= exact.rows["detectable"]).drop("loop")[:2].all()
    # several records of one device have the load cell in common, and do not narrow it
    (three,) = mb.accept(run, [record] * 3, device="no. 17", uncertainty=0.1)
    widths = three.rows["effect_upper"] - three.rows["effect_lower"]
    assert widths["energy_per_cycle"] > 100.0 * 2.0 * 1.645 * 0.1 * 0.85


def test_a_level_at_the_guard_band_is_beyond_the_limit_with_five_per_cent(run, record, production):
    (device,) = mb.accept(run, record)
    row = device.rows.loc["slip_fwd"]
    half = 0.5 * np.log1p(row["effect_upper"] / 100.0) - 0.5 * np.log1p(row["effect_lower"] / 100.0)
    limit = 0.01 * row["limit"]
    nearest = max((1.0 + limit) * -np.expm1(-half), (1.0 - limit) * np.expm1(half))
    assert 0.01 * row["guard_band"] == pytest.approx(nearest, rel=0.15)
    effect = np.random.default_rng(1).normal(0.0, 0.03, 20_000)
    guard = guard_band(effect, 0.15)
    upper, lower = np.log1p(0.15 - guard), np.log1p(guard - 0.15)
    residual = effect - np.median(effect)
    beyond = [np.mean(np.abs(np.expm1(level + residual)) > 0.15) for level in (upper, lower)]
    assert max(beyond) == pytest.approx(0.05, abs=0.001)  # the nearer limit, and less at the other
    assert min(beyond) < 0.05


def test_risks_stand_beside_the_verdicts_that_may_be_wrong(batch):
    _, table = batch
    within, beyond = (table["verdict"] == f"{side} the limit" for side in ("within", "beyond"))
    assert beyond.any()
    risk = table["beyond_limit"]
    pd.testing.assert_series_equal(
        table["p_wrong_acceptance"], risk.where(within), check_names=False
    )
    pd.testing.assert_series_equal(
        table["p_wrong_rejection"], (1.0 - risk).where(beyond), check_names=False
    )
    assert (table["guard_band"].notna() == table["limit"].notna()).all()
    inside = table["effect"].abs() <= table["limit"] - table["guard_band"]
    assert inside.any()
    assert (risk[inside] <= 0.06).all()  # the farther limit adds a little


def test_what_cannot_be_judged_is_refused(out, production, tmp_path):
    valid, swapped = production("good.csv"), production("swapped.csv", -1.0)
    for path, words, offender in (
        (valid, ("--limit", "slop=15 %"), "slop"),
        (valid, ("--limit", "slip=150 %"), "slip"),
        (valid, ("--device", "a", "--device", "b"), "device"),
        (valid, ("--actuation", "5 kip"), "--actuation"),
        (valid, ("--date", "5.3.2024"), "--date"),
        (valid, ("--cycles", "-1"), "--cycles"),
        (valid, ("--uncertainty", "25 %"), "--uncertainty"),
        (valid, ("--uncertainty", "load cell"), "--uncertainty"),
        (swapped, (), "sign"),
    ):
        options = ("--actuation", "1000 psi", "-o", tmp_path / "qc", *words)
        outcome = here("accept", out, path, *options)
        assert outcome.exit_code == 2, words
        assert offender in outcome.stderr
        assert not (tmp_path / "qc").exists()


def drifting(run):
    """The run with a slip force that falls by the date, 2020 to 2024."""
    population, d = run.population, len(run.population.design.names)
    tested = [
        replace(s, covariates=s.covariates | {"date": year})
        for s, year in zip(population.design.settings, np.linspace(2020, 2024, 99), strict=False)
    ]
    tested[-1] = replace(tested[-1], covariates=tested[-1].covariates | {"date": 2024.0})
    design = replace(population.design, dependence={"Fc_fwd": ("date",)}, settings=tuple(tested))
    draws = population.draws
    z = np.insert(draws.z, d, -0.3, axis=-1)
    alternatives = population.alternatives
    alternatives = replace(alternatives, z=np.insert(alternatives.z, d, -0.3, axis=-1))
    run = replace(run)
    run.__dict__["population"] = replace(
        population, design=design, draws=replace(draws, z=z), alternatives=alternatives
    )
    return run


def test_a_quantity_that_follows_the_date_needs_the_date(run, record):
    """A run with drift judges no record whose date it does not know, and predicts with a remark."""
    run = drifting(run)
    with pytest.raises(mb.MfdError, match="date"):
        mb.accept(run, record)
    trace, medians = replace(record.trace(32.0), force=None), {}
    for year in (None, 2020.0, 2024.0):
        conditions = {"date": year} if year else {}
        band = run.predict(trace, "mean", conditions=conditions)
        assert any("date" in remark for remark in band.remarks) == (year is None)
        medians[year] = np.median(band.values["Fc_fwd"])
    assert medians[2024.0] == medians[None]
    assert np.log(medians[2020.0] / medians[2024.0]) == pytest.approx(0.3, abs=0.01)


def test_tests_that_scatter_more_than_the_population_says_widen_the_intervals(run, record):
    entries = dict(run.manifest.tests)
    for name, factor in zip(run.tests, (0.6, 1.5, 0.7, 1.4, 0.6, 1.5) * 9, strict=False):
        measured = dict(entries[name].measured)
        measured["slip_fwd"] = [factor * value for value in measured["slip_fwd"]]
        entries[name] = entries[name].model_copy(update={"measured": measured})
    wild = replace(run, manifest=run.manifest.model_copy(update={"tests": entries}))
    (narrow,), (wide,) = (mb.accept(source, record, draws=400) for source in (run, wild))
    widths = [
        float(np.log(d.rows.loc["slip_fwd", "upper"] / d.rows.loc["slip_fwd", "lower"]))
        for d in (narrow, wide)
    ]
    assert widths[1] > 2.0 * widths[0]
    assert any("slip force forward" in remark for remark in wide.remarks)
