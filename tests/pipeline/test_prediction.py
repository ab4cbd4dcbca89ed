"""The command predict on a small synthetic campaign, tested at 500, 1000 and 1500 psi."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from tests.run_folders import write_run

TIME = np.arange(401) / 100.0


@pytest.fixture(scope="module")
def out(finished_run) -> Path:
    """Run folder of the campaign."""
    assert finished_run.code == 0, finished_run.stderr
    return finished_run.out


@pytest.fixture(scope="module")
def run(out):
    return mb.open_run(out)


@pytest.fixture(scope="module")
def tested(run):
    """Tested range of the run, by condition."""
    return {span.name: span for span in run.tested}


@pytest.fixture
def ask(out, tmp_path):
    """Outcome of a prediction into bands.csv, by its further options."""

    def predict(*options):
        arguments = ("predict", out, "--actuation", "700 psi", "-o", tmp_path / "bands.csv")
        return CliRunner().invoke(app, [str(a) for a in (*arguments, "--force", *options)])

    return predict


def written(path, amplitude, frequency, force=None):
    """File of a harmonic motion, in in, with a force, kip, if it is given."""
    motion = amplitude * np.sin(2.0 * np.pi * frequency * TIME)
    columns, head = [TIME, motion], "time_s,displacement_in"
    if force is not None:
        columns, head = [*columns, force], f"{head},force_kip"
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return path


@pytest.mark.usefixtures("small_pictures")
def test_far_outside_what_was_tested_it_refuses_without_extrapolate(ask, tested, tmp_path):
    stroke = tested["stroke"].highest
    motion = written(tmp_path / "fast.csv", 0.5 * stroke, 2.0)
    refused = ask("--motion", motion)
    assert refused.exit_code == 2
    (sentence,) = refused.stderr.splitlines()
    assert "the speed" in sentence
    assert "the frequency, 2 Hz, lies far outside the tested range" in sentence
    assert "give --extrapolate" in sentence
    assert not (tmp_path / "bands.csv").exists()
    allowed = ask("--motion", motion, "--extrapolate")
    assert allowed.exit_code == 0, allowed.output
    assert "warning: the speed" in allowed.stderr
    assert "# warning: the frequency, 2 Hz" in (tmp_path / "bands.csv").read_text()


def test_the_tested_range_is_in_the_report(out):
    table = pd.read_csv(out / "tested_range.csv").set_index("condition")
    assert list(table.index) == ["stroke", "speed", "frequency", "actuation"]
    assert table.loc["actuation", ["smallest", "largest"]].tolist() == [0.5, 1.5]
    page = (out / "report.html").read_text()
    head = page[: page.index('<nav aria-label="Contents">')]
    assert 'data-value="1.5" data-unit="actuation in ksi"' in head


@pytest.mark.usefixtures("small_pictures")
def test_a_harmonic_motion_needs_no_file(ask, tmp_path, tested):
    amplitude = 0.5 * tested["stroke"].highest
    outcome = ask("--sine", f"{amplitude:g} in, 0.5 Hz, 3 cycles")
    assert outcome.exit_code == 0, outcome.output
    table = pd.read_csv(tmp_path / "bands.csv", comment="#")
    assert table["displacement_in"].max() == pytest.approx(amplitude, rel=1e-4)
    assert table["time_s"].iloc[-1] == pytest.approx(8.0)  # half a cycle leads in, and one out
    derived = pd.read_csv(tmp_path / "bands_derived.csv", comment="#").set_index("quantity")
    assert derived.loc["energy_per_cycle", "note"] == "over 3 full cycles at full stroke"
    assert derived.loc["c_eq", "note"] == "over 3 full cycles at full stroke"


@pytest.mark.usefixtures("small_pictures")
def test_a_harmonic_motion_starts_without_a_jump(ask, tmp_path):
    for cycles in ["1", "2.3"]:
        """At full speed out of rest a viscous part would give a peak at time 0."""
        assert ask("--sine", f"1 in, 0.5 Hz, {cycles} cycles").exit_code == 0
        table = pd.read_csv(tmp_path / "bands.csv", comment="#")
        x, step = table["displacement_in"].to_numpy(), 1.0 / (400 * 0.5)
        speed, top = np.diff(x) / step, np.pi
        assert abs(speed[0]) < 0.01 * top
        assert np.max(np.abs(np.diff(speed))) < 0.02 * top
        assert np.max(np.abs(speed)) == pytest.approx(top, rel=1e-3)
        assert np.argmax(table["upper_kip"]) > 0


def test_a_motion_that_cannot_be_meant_is_refused(ask, tmp_path):
    for options, words in [
        ((), "give one motion"),
        (("--sine", "1 in, 0.5 Hz, 3 cycles", "--motion", "a.csv"), "give one motion"),
        (("--sine", "1 in, 0.5 Hz"), "reads '1 in, 0.5 Hz, 3 cycles'"),
        (("--sine", "1 in, 0.5 Hz, 1000 cycles"), "1 to 100 cycles"),
        (("--sine", "1 in, 0.5 Hz, 3 cycles", "--compare"), "need a --motion file"),
    ]:
        outcome = ask(*options)
        assert outcome.exit_code == 2
        assert words in outcome.stderr
        assert not (tmp_path / "bands.csv").exists()


def test_compare_prints_coverage_and_error_and_keeps_every_measured_sample(ask, tmp_path, tested):
    motion = tmp_path / "motion.csv"
    force = np.sign(np.cos(np.pi * TIME))
    written(motion, 0.5 * tested["stroke"].highest, 0.5, force)
    outcome = ask("--motion", motion, "--compare", "--kind", "observation")
    assert outcome.exit_code == 0, outcome.output
    table = pd.read_csv(tmp_path / "bands.csv", comment="#")
    np.testing.assert_allclose(table["force_kip"], force)  # not thinned: TIME has 401 samples
    inside = (force >= table["lower_kip"]) & (force <= table["upper_kip"])
    said = f"holds {100 * inside.mean():.1f} % of the 401 measured samples"
    assert said in outcome.stdout
    assert "RRSE" in outcome.stdout
    assert (
        f"# compared: the 95 % band of kind observation {said}"
        in (tmp_path / "bands.csv").read_text()
    )
    assert (tmp_path / "bands_history.png").read_bytes().startswith(b"\x89PNG")


def with_rest(source, path, rest, by=1.0):
    """A record with so many seconds of rest before and after it, and its force times a factor."""
    record = pd.read_csv(source).to_numpy()[:, :3]
    step = record[1, 0] - record[0, 0]
    n = round(rest / step)
    ends = (np.repeat(record[[k]], n, axis=0) for k in (0, -1))
    before, after = ends
    long = np.concatenate([before, record, after])
    long[:, 0] = step * np.arange(len(long))
    long[:, 2] *= by
    np.savetxt(path, long, "%.9g", ",", header="time_s,displacement_in,force_kip", comments="")
    return path


@pytest.fixture
def held_out(finished_run):
    """Record of the test that was held out, at 1200 psi."""
    return finished_run.campaign.parent / "p1200_f0.5.csv"


def compared(ask, motion):
    outcome = ask("--motion", motion, "--actuation", "1200 psi", "--compare", *OBSERVATION)
    assert outcome.exit_code == 0, outcome.output
    return outcome


OBSERVATION = ("--kind", "observation", "--quiet")


@pytest.mark.usefixtures("small_pictures")
def test_samples_at_rest_do_not_count_in_the_coverage(ask, tmp_path, held_out):
    motion = tmp_path / "motion.csv"
    said = [
        compared(ask, with_rest(held_out, motion, rest, by)).stdout
        for rest, by in ((0.0, 1.5), (20.0, 1.5))
    ]
    shares = [float(re.search(r"holds ([\d.]+) % of the", text)[1]) for text in said]
    assert shares[0] < 60.0
    assert shares[1] == pytest.approx(shares[0], abs=3.0)  # 0 kip in 40 s of rest is no success
    full = [float(re.search(r"([\d.]+) % at full stroke", text)[1]) for text in said]
    assert full[1] == pytest.approx(full[0], abs=3.0)


@pytest.mark.usefixtures("small_pictures")
def test_a_measurement_outside_the_prediction_is_said_in_a_sentence(ask, tmp_path, held_out):
    motion = tmp_path / "motion.csv"
    wrong = compared(ask, with_rest(held_out, motion, 0.0, 1.5)).stderr
    assert "the prediction does not agree with the measurement" in wrong
    assert "measured values lie outside their 95 % intervals, offset and noise" in wrong
    assert "energy_per_cycle, " in wrong
    assert "not 95 %" in wrong
    right = compared(ask, with_rest(held_out, motion, 0.0)).stderr  # the control
    assert "does not agree" not in right


def test_a_prediction_is_given_in_the_other_system_of_units(ask, tmp_path):
    tables = {}
    for units in ("us", "si"):
        outcome = ask("--sine", "1 in, 0.5 Hz, 2 cycles", "--units", units)
        assert outcome.exit_code == 0, outcome.output
        derived = pd.read_csv(tmp_path / "bands_derived.csv", comment="#").set_index("quantity")
        tables[units] = pd.read_csv(tmp_path / "bands.csv", comment="#"), derived
    (us, us_derived), (si, si_derived) = tables.values()
    np.testing.assert_allclose(si["displacement_mm"], 25.4 * us["displacement_in"], atol=1e-6)
    np.testing.assert_allclose(si["median_kN"], 4.4482216 * us["median_kip"], rtol=1e-6)
    assert si_derived.loc["energy_per_cycle", "unit"] == "kN*mm"
    ratio = si_derived.loc["peak_fwd", "upper"] / us_derived.loc["peak_fwd", "upper"]
    assert ratio == pytest.approx(4.4482216, rel=1e-5)


@pytest.mark.usefixtures("small_pictures")
def test_design_prints_mean_and_bounding_properties(ask, tmp_path):
    outcome = ask("--sine", "1 in, 0.5 Hz, 3 cycles", "--design", "--probability", 0.8)
    assert outcome.exit_code == 0, outcome.output
    assert "Mean and bounding properties" in outcome.stdout
    assert "exceeded with a probability of 10 %" in outcome.stdout
    assert "too narrow" not in outcome.stderr  # three levels
    table = pd.read_csv(tmp_path / "bands_design.csv", comment="#")
    rows = table.set_index(["property", "basis"])
    for what in ("slip_fwd", "slip_bwd", "energy_per_cycle", "peak_fwd"):
        mean, again = rows.loc[what, "device"], rows.loc[what, "new_test"]
        assert mean["lambda_min"] < 1.0 < mean["lambda_max"]
        assert again["lambda_min"] < mean["lambda_min"]  # scatter comes on top
        assert again["lambda_max"] > mean["lambda_max"]
        assert again["upper"] == pytest.approx(again["lambda_max"] * again["nominal"], rel=1e-4)
        assert "not known" in rows.loc[(what, "another_device"), "note"]
    derived = pd.read_csv(tmp_path / "bands_derived.csv", comment="#").set_index("quantity")
    for what in ("energy_per_cycle", "peak_fwd", "peak_bwd"):  # of the same draws
        bounds = rows.loc[(what, "new_test"), ["lower", "upper"]].to_numpy(float)
        assert derived.loc[what, ["lower", "upper"]].to_numpy(float) == pytest.approx(bounds)


def laws_of(out, name, what):
    """Rows of the figure of the laws of one quantity and one kind of band."""
    rows = pd.read_csv(out / "figures" / "laws.csv")
    rows = rows[(rows["quantity"] == name) & (rows["what"] == f"{what}, 95 %")]
    return rows.set_index(rows.filter(like="actuation").columns[0])[["lower", "median", "upper"]]


@pytest.mark.usefixtures("small_pictures")
def test_figure_of_laws_and_design_call_one_thing_mean_property(ask, out, tmp_path):
    """The device at this actuation: its law and the effect of its level, without scatter."""
    level = 1.0
    motion = "1 in, 0.5 Hz, 3 cycles"
    said = ask("--sine", motion, "--actuation", f"{level} ksi", "--design", "--quiet")
    assert said.exit_code == 0, said.output
    rows = pd.read_csv(tmp_path / "bands_design.csv", comment="#")
    for basis, what in (("device", "mean property"), ("new_test", "this device tested again")):
        for slip in ("fwd", "bwd"):
            row = rows[(rows["property"] == f"slip_{slip}") & (rows["basis"] == basis)].iloc[0]
            drawn = laws_of(out, f"Fc_{slip}", what).loc[level]
            middle = laws_of(out, f"Fc_{slip}", "mean property").loc[level]["median"]
            # the slip force at mid-stroke is more than the law's: it has a viscous part
            near = {"abs": 0.25 * (row["lambda_max"] - row["lambda_min"])}
            assert drawn["lower"] / middle == pytest.approx(row["lambda_min"], **near)
            assert drawn["upper"] / middle == pytest.approx(row["lambda_max"], **near)


def test_the_bands_of_a_law_are_nested_and_smooth(out):
    for name in ["Fc_fwd", "sigma0"]:
        inner, outer = (
            laws_of(out, name, what) for what in ("mean property", "this device tested again")
        )
        assert np.all(outer["lower"] <= inner["lower"])
        assert np.all(outer["upper"] >= inner["upper"])
        between = outer[(outer.index > 0.51) & (outer.index < 0.99)]  # a kink is at a tested level
        width = (between["upper"] - between["lower"]).to_numpy()
        spikes = [np.diff(between[bound].to_numpy(), 2) for bound in ("lower", "upper")]
        assert np.mean(np.abs(spikes) / width[1:-1]) < 0.02


@pytest.mark.usefixtures("small_pictures")
def test_with_another_run_both_give_half_of_the_draws(ask, out, tmp_path):
    """Here both are the same run under two noises, so that the band is about the same."""
    other = Path(shutil.copytree(out, tmp_path / "other"))
    text = (other / "manifest.json").read_text()
    assert '"noise": "ou"' in text
    (other / "manifest.json").write_text(text.replace('"noise": "ou"', '"noise": "iid"'))
    motion = written(tmp_path / "slow.csv", 0.5, 0.5)
    alone = ask("--motion", motion)
    band = pd.read_csv(tmp_path / "bands.csv", comment="#")
    together = ask("--motion", motion, "--with", other)
    assert (alone.exit_code, together.exit_code) == (0, 0), together.output
    both = pd.read_csv(tmp_path / "bands.csv", comment="#")
    width = (band["upper_kip"] - band["lower_kip"]).mean()
    assert (both["upper_kip"] - both["lower_kip"]).mean() == pytest.approx(width, rel=0.15)
    assert "three_stage (ou) and three_stage (iid) in equal parts" in together.stdout
    derived = pd.read_csv(tmp_path / "bands_derived.csv", comment="#")
    assert "energy_per_cycle" in set(derived["quantity"])
    assert not {"gap_width", "C_fwd"} & set(derived["quantity"])  # each model has its own


@pytest.mark.usefixtures("no_figures")
def test_a_report_is_asked_for_in_other_units_and_forms(tmp_path):
    out = tmp_path / "out"
    write_run(out, small=True)
    CliRunner().invoke(app, ["report", str(out), "--units", "si", "--excel"])
    assert "N/mm" in (out / "parameters.csv").read_text()
    assert (out / "tables.xlsx").is_file()


def test_a_sine_in_customary_units_needs_no_library_that_is_slow_to_load(out, tmp_path):
    code = (
        "import sys\n"
        "from mfd_bayes.cli.commands import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('loaded', sorted({'pint', 'pandas', 'scipy.optimize', 'xarray'} & set(sys.modules)))"
    )
    asked = ["--sine", "1 in, 0.5 Hz, 3 cycles", "--actuation", "1000 psi"]
    arguments = ["predict", out, *asked, "-o", tmp_path / "b.csv"]
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (tmp_path / "b.csv").is_file(), done.stderr
    assert done.stdout.splitlines()[-1] == "loaded []"
