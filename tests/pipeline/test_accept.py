"""`mfd-bayes accept` and `mfd_bayes.accept`: a device's records against a finished run."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values
from mfd_bayes.evaluation.properties import properties_of
from mfd_bayes.records.loops import measured_cycles

COLUMNS = ("time_s", "displacement_in", "force_kip")


@pytest.fixture(scope="module")
def production(tmp_path_factory):
    """Function that writes records of tests at 1000 psi, with their forces times a factor."""
    folder = tmp_path_factory.mktemp("production")

    def write(name: str, factor: float = 1.0, seed: int = 0, **changed: float):
        rng = np.random.default_rng(seed)
        values = draw_values(1.0, Matrix(pressures=(500.0,)).laws, rng)
        values |= {key: values[key] * by for key, by in changed.items()}
        time, x, force = draw_record(values, 0.5, 3, rng)
        frame = pd.DataFrame(np.transpose([time, x, factor * force]), columns=COLUMNS)
        frame.to_csv(folder / name, index=False)
        return folder / name

    return write


def accept(run, *words):
    command = [sys.executable, "-m", "mfd_bayes", "accept", run, *words]
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def batch(finished_run, production, tmp_path_factory):
    """A good device and one of twice the force, judged by the command."""
    folder = tmp_path_factory.mktemp("batch") / "qc"
    records = production("good.csv"), production("strong.csv", 2.0, seed=1)
    return folder, accept(finished_run.out, *records, "--actuation", "1000 psi", "-o", folder)


def test_a_good_device_is_not_rejected_and_a_wrong_one_is(batch):
    folder, ended = batch
    assert ended.returncode == 1, ended.stderr
    table = pd.read_csv(folder / "acceptance.csv", comment="#")
    verdicts = table.groupby("device")["device_verdict"].unique().map(list)
    assert verdicts["strong"] == ["rejected"]
    assert verdicts["good"] != ["rejected"]
    strong = table[table["device"] == "strong"].set_index("name")
    assert strong.loc["slip_fwd", "verdict"] == "beyond the limit"
    assert strong.loc["slip_fwd", "effect"] == pytest.approx(100.0, abs=45.0)
    gap = strong.loc["gap"]
    assert gap["effect_lower"] < 0.0 < gap["effect_upper"]  # its gap is as wide as the others'


def test_each_device_has_a_page_to_file(batch):
    folder, _ = batch
    page = (folder / "strong.html").read_text(encoding="utf-8")
    assert re.search(r"strong\.csv, SHA-256 [0-9a-f]{64}", page)
    for text in ("Rejected", "1000 psi", "Signature", "data:image/png;base64,"):
        assert text in page
    assert "http" not in re.sub(r'http-equiv="[^"]*"', "", page)  # it loads nothing
    assert (folder / "acceptance.png").stat().st_size > 1000


def test_the_table_is_about_the_record(batch, production):
    """Measured values are those of the record itself, and nominal ones those of the run."""
    folder, _ = batch
    table = pd.read_csv(folder / "acceptance.csv", comment="#")
    energy = table[table["name"] == "energy_per_cycle"].set_index("device")
    record = mb.read_record(production("strong.csv", 2.0, seed=1), actuation="1000 psi")
    x, force = record.displacement, record.force
    total = np.trapezoid(force, x) / 3.0  # of three cycles
    assert energy.loc["strong", "measured"] == pytest.approx(total, rel=0.05)
    assert energy["nominal"].nunique() == 1


def test_several_records_of_a_device_tell_more(finished_run, production):
    run = mb.open_run(finished_run.out)
    records = [
        mb.read_record(production(f"r{seed}.csv", seed=seed), actuation="1000 psi")
        for seed in range(3)
    ]
    (one,) = mb.accept(run, records[0], device="no. 17")
    (three,) = mb.accept(run, records, device="no. 17")
    wide, narrow = (d.rows["effect_upper"] - d.rows["effect_lower"] for d in (one, three))
    assert narrow["slip_fwd"] < 0.95 * wide["slip_fwd"]
    assert three.device == "no. 17"
    assert len(three.comparisons) == 3
    apart = mb.accept(run, records)
    assert [d.device for d in apart] == ["r0", "r1", "r2"]


def test_wide_limits_are_kept_and_narrow_ones_are_not_shown(finished_run, production):
    """Two one-sided tests: a limit that the record cannot resolve is neither kept nor passed."""
    run = mb.open_run(finished_run.out)
    record = mb.read_record(production("good.csv"), actuation="1000 psi")
    (wide,) = mb.accept(run, record, limits={"slip": 0.9, "energy": 0.9})
    (narrow,) = mb.accept(run, record, limits={"slip": 0.001})
    assert wide.verdict == "accepted"
    assert narrow.verdict == "cannot tell"
    assert np.isnan(wide.rows.loc["gap", "limit"])  # only what was given is limited


@pytest.mark.parametrize(
    ("words", "offender"),
    [
        (["--limit", "slop=15 %"], "slop"),
        (["--limit", "slip"], "slip"),
        (["--limit", "slip=150 %"], "slip"),
        (["--device", "a", "--device", "b"], "device"),
        (["--actuation", "5 kip"], "--actuation"),
    ],
)
def test_refusals(finished_run, production, tmp_path, words, offender):
    told = [] if "--actuation" in words else ["--actuation", "1000 psi"]
    ended = accept(finished_run.out, production("good.csv"), *told, "-o", tmp_path / "qc", *words)
    assert ended.returncode == 2
    assert offender in ended.stderr
    assert not (tmp_path / "qc").exists()


def test_a_swapped_sign_is_said(finished_run, production, tmp_path):
    record = production("swapped.csv", -1.0)
    ended = accept(finished_run.out, record, "--actuation", "1 ksi", "-o", tmp_path / "qc")
    assert ended.returncode == 2
    assert "sign" in ended.stderr


def drifting(run, **changed):
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
    other = population.alternatives
    other = replace(other, z=np.insert(other.z, d, -0.3, axis=-1))
    run = replace(run, **changed)
    run.__dict__["population"] = replace(
        population, design=design, draws=replace(draws, z=z), alternatives=other
    )
    return run


def test_a_quantity_that_follows_the_date_needs_the_date(finished_run, production):
    """A run with drift judges no record whose date it does not know, and predicts with a remark."""
    run = drifting(mb.open_run(finished_run.out))
    record = mb.read_record(production("good.csv"), actuation="1000 psi")
    with pytest.raises(mb.MfdError, match="date"):
        mb.accept(run, record)
    trace, medians = replace(record.trace(32.0), force=None), {}
    for year in (None, 2020.0, 2024.0):
        conditions = {"date": year} if year else {}
        for source in (run, drifting(mb.open_run(finished_run.out), conditions=conditions)):
            how = {"conditions": conditions} if source is run else {}
            band = source.predict(trace, "device", **how)
            assert any("date" in remark for remark in band.remarks) == (year is None)
            medians.setdefault(year, []).append(np.median(band.values["Fc_fwd"]))
    assert medians[2024.0] == medians[None]
    assert medians[2020.0][0] == medians[2020.0][1]
    assert np.log(medians[2020.0][0] / medians[2024.0][0]) == pytest.approx(0.3, abs=0.01)
    follower = run.follow(1.0, conditions={"date": 2020.0})
    follower.update(trace.time[:40], trace.displacement[:40], None, record.trace(32.0).force[:40])
    assert not any("date" in r for r in follower.band(later(trace)).remarks)


def later(trace):
    return mb.Trace.from_arrays(trace.time[40:], trace.displacement[40:])


@pytest.mark.parametrize(
    "words", [["--date", "5.3.2024"], ["--temperature", "warm"], ["--cycles", "-1"]]
)
def test_conditions_of_a_record_are_read_as_in_a_campaign(
    finished_run, production, tmp_path, words
):
    told = ["--actuation", "1000 psi", "-o", tmp_path / "qc", *words]
    ended = accept(finished_run.out, production("good.csv"), *told)
    assert ended.returncode == 2
    assert words[0] in ended.stderr


def test_slope_and_gap_are_those_of_the_record_and_its_rate(finished_run, tmp_path):
    """A record that is thinned to the rate of the calibrated tests has a blunt build-up."""
    rng = np.random.default_rng(3)
    values = draw_values(1.0, Matrix(pressures=(500.0,)).laws, rng)
    frame = pd.DataFrame(np.transpose(draw_record(values, 1.0, 4, rng)), columns=COLUMNS)
    frame.to_csv(tmp_path / "fast.csv", index=False)
    run = mb.open_run(finished_run.out)
    record = mb.read_record(tmp_path / "fast.csv", actuation="1000 psi")
    (judged,) = mb.accept(run, record, draws=400)
    whole, thin = replace(record.trace(), force=None), record.trace(50.0)
    band, own = run.predict(whole, "device", draws=400), measured_cycles(record).of_test()
    for name in ("build_up_slope", "gap"):
        assert judged.rows.loc[name, "measured"] == pytest.approx(own[name])
        fine = np.median(properties_of(whole, band.draws)[name])
        assert judged.rows.loc[name, "nominal"] == pytest.approx(fine, rel=0.03)
    blunt = measured_cycles(thin).of_test()["build_up_slope"]
    assert blunt < 0.95 * own["build_up_slope"]  # the control


def test_tests_that_scatter_more_than_the_population_says_widen_the_intervals(
    finished_run, production
):
    run = mb.open_run(finished_run.out)
    record = mb.read_record(production("good.csv"), actuation="1000 psi")
    entries = dict(run.manifest.tests)
    for name, by in zip(run.tests, (0.6, 1.5, 0.7, 1.4, 0.6, 1.5) * 9, strict=False):
        measured = dict(entries[name].measured)
        measured["slip_fwd"] = [by * value for value in measured["slip_fwd"]]
        entries[name] = entries[name].model_copy(update={"measured": measured})
    wild = replace(run, manifest=run.manifest.model_copy(update={"tests": entries}))
    (usual,), (wide,) = (mb.accept(one, record, draws=400) for one in (run, wild))
    widths = [
        float(np.log(d.rows.loc["slip_fwd", "upper"] / d.rows.loc["slip_fwd", "lower"]))
        for d in (usual, wide)
    ]
    assert widths[1] > 2.0 * widths[0]
    assert any("slip force forward" in remark for remark in wide.remarks)
