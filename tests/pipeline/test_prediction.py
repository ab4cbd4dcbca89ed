"""The command predict on a small synthetic campaign, tested at 500, 1000 and 1500 psi."""

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from tests.command_line import here, refusal, write_csv

TIME = np.arange(401) / 100.0
SINE = ("--sine", "1 in, 0.5 Hz, 3 cycles")
OBSERVATION = ("--kind", "observation", "--quiet")


@pytest.fixture
def words(out, tmp_path):
    """Function that gives the words of a prediction into bands.csv, by its further options."""
    start = ("predict", out, "--actuation", "700 psi", "-o", tmp_path / "bands.csv", "--force")
    return lambda *options: (*start, *options)


@pytest.fixture
def ask(words):
    """Function that predicts by some options, and returns the outcome, which is good."""

    def predict(*options):
        outcome = here(*words(*options))
        assert outcome.exit_code == 0, outcome.output
        return outcome

    return predict


@pytest.fixture
def table(tmp_path):
    """Function that reads a table that was written beside the bands, or the bands."""
    return lambda of="": pd.read_csv(tmp_path / f"bands{of}.csv", comment="#")


@pytest.fixture
def motion(tmp_path):
    """File of two cycles of a sine of 1 in with a force of ±1 kip."""
    force = np.sign(np.cos(np.pi * TIME))
    return write_csv(tmp_path / "m.csv", TIME, np.sin(np.pi * TIME), force)


@pytest.fixture
def held_out(finished_run):
    return finished_run.campaign.parent / "p1200_f0.5.csv"


# --- a motion and its bands


def test_predict_writes_a_table_and_pictures(ask, table, motion, tmp_path):
    printed = ask("--motion", motion, "--explain", "--simultaneous").stdout
    for text in (
        *("new_test", "95 %", "What makes the band wide", "scatter of backward slip force"),
        *("start in the gap", "energy_per_cycle"),
    ):
        assert text in printed
    columns = [
        "simultaneous_lower_kip",
        "lower_kip",
        "median_kip",
        "upper_kip",
        "simultaneous_upper_kip",
    ]
    assert (np.diff(table()[columns].to_numpy(), axis=1) >= 0).all()
    expected = np.interp(table()["time_s"], TIME, np.sin(np.pi * TIME))
    np.testing.assert_allclose(expected, table()["displacement_in"], atol=2e-4)
    head = (tmp_path / "bands.csv").read_text().splitlines()[0]
    assert re.match("#.*95 %.*new_test", head)
    for picture in ("bands.png", "bands_history.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    assert table("_derived")["measured"].isna().all()  # the file's force is not taken for it


def test_a_harmonic_motion_needs_no_file_and_starts_without_a_jump(ask, table):
    """At full speed out of rest a viscous part would give a peak at time 0."""
    for cycles in (1, 2.3, 3):
        ask("--sine", f"1 in, 0.5 Hz, {cycles} cycles", "--no-figures")
        x, speed = table()["displacement_in"].to_numpy(), np.pi
        steps = np.diff(x) * 400 * 0.5
        assert x.max() == pytest.approx(1.0, rel=1e-4)
        assert abs(steps[0]) < 0.01 * speed
        assert np.max(np.abs(np.diff(steps))) < 0.02 * speed
        assert np.max(np.abs(steps)) == pytest.approx(speed, rel=1e-3)
        assert np.argmax(table()["upper_kip"]) > 0
    assert table()["time_s"].iloc[-1] == pytest.approx(8.0)  # half a cycle leads in, and one out
    notes = table("_derived").set_index("quantity")["note"]
    assert notes["energy_per_cycle"] == notes["c_eq"] == "over 3 full cycles at full stroke"


def test_with_another_run_both_give_half_of_the_draws(ask, table, out, tmp_path):
    """Here both are the same run under two noises, so that the band is about the same."""
    second_run = Path(shutil.copytree(out, tmp_path / "other"))
    text = (second_run / "manifest.json").read_text()
    (second_run / "manifest.json").write_text(text.replace('"noise": "ou"', '"noise": "iid"'))
    widths = []
    for options in ((), ("--with", second_run)):
        printed = ask(*SINE, *options, "--no-figures").stdout
        widths.append((table()["upper_kip"] - table()["lower_kip"]).mean())
    assert widths[1] == pytest.approx(widths[0], rel=0.15)
    assert "three_stage (ou) and three_stage (iid) in equal parts" in printed
    assert not {"slip_to_slip", "C_fwd"} & set(table("_derived")["quantity"])  # each has its own


# --- what was tested, and what cannot be asked


def test_far_outside_what_was_tested_it_refuses_without_extrapolate(words, ask, tmp_path):
    fast = ("--sine", "1 in, 2 Hz, 3 cycles", "--no-figures")
    sentence = refusal(*words(*fast))
    for text in ("the speed", "the frequency, 2 Hz, lies far outside", "give --extrapolate"):
        assert text in sentence
    assert not (tmp_path / "bands.csv").exists()
    assert "warning: the speed" in ask(*fast, "--extrapolate").stderr
    assert "# warning: the frequency, 2 Hz" in (tmp_path / "bands.csv").read_text()


GIVEN = ("--motion", "m.csv", "--condition-on", "0 s to 1 s")
REFUSED = [
    ((), "give one motion"),
    ((*SINE, "--motion", "m.csv"), "give one motion"),
    (("--sine", "1 in, 0.5 Hz"), "reads '1 in, 0.5 Hz, 3 cycles'"),
    ((*SINE, "--compare"), "need a --motion file"),
    ((*SINE, "--actuation", "5,5 MPa"), "of --actuation"),
    ((*SINE, "--probability", "1.5"), "probability"),
    ((*SINE, "-o", "text.csv/bands.csv"), "bands.csv"),
    (("--motion", "m.csv", "--condition-on", "0 s to 60 s"), "must lie within the record"),
    (("--motion", "m.csv", "--condition-on", "1 ms to 2 ms"), "holds 0 samples"),
    (("--motion", "quiet.csv", "--condition-on", "0 s to 1 s"), "needs a column of the force"),
    ((*GIVEN, "--kind", "mean"), "for the kinds new_test and observation"),
    ((*GIVEN, "--design"), "--design cannot be combined with --condition-on"),
    ((*GIVEN, "--test", "p500_f0.5", "--extrapolate"), "a calibrated test ('p500_f0.5')"),
    ((*GIVEN, "--after", "p500_f0.5"), "cannot be combined with after"),
    ((*SINE, "--after", "p5"), "after must be the id of a test of the run"),
]


@pytest.mark.usefixtures("motion")
def test_a_prediction_that_makes_no_sense_is_refused(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("text.csv").write_text("time_s,displacement_in\n0,0\n0.1,a\n")
    write_csv("quiet.csv", TIME, np.sin(np.pi * TIME))
    for options, offender in REFUSED:
        assert offender in refusal(*words(*options)), options
        assert not Path("bands.csv").exists()


# --- beside a measurement


def test_compare_prints_coverage_and_error_and_keeps_every_measured_sample(
    ask, table, motion, tmp_path
):
    printed = ask("--motion", motion, "--compare", "--kind", "observation").stdout
    bands, force = table(), np.sign(np.cos(np.pi * TIME))
    np.testing.assert_allclose(bands["force_kip"], force)  # not thinned: TIME has 401 samples
    covered = (force >= bands["lower_kip"]) & (force <= bands["upper_kip"])
    share = f"holds {100 * covered.mean():.1f} % of the 401 measured samples"
    assert share in printed
    assert "RRSE" in printed
    comment = f"# compared: the 95 % band of kind observation {share}"
    assert comment in (tmp_path / "bands.csv").read_text()


def test_a_motion_is_read_by_the_columns_that_init_would_take(ask, table, tmp_path):
    content = "Zeit [s];Weg [mm];Kraft [kN]\n" + "\n".join(
        f"{t:.3f};{25.4 * np.sin(np.pi * t):.6f};1" for t in TIME
    )
    (tmp_path / "Versuch.csv").write_text(content.replace(".", ","))
    printed = ask("--motion", tmp_path / "Versuch.csv")
    assert "Weg [mm] [mm]" in printed.stdout + printed.stderr
    np.testing.assert_allclose(table()["displacement_in"], np.sin(np.pi * TIME), atol=1e-6)


def with_rest(source, path, pause, factor=1.0):
    """A record with so many seconds of rest before and after it, and its force times a factor."""
    time, x, force, *_ = pd.read_csv(source).to_numpy().T
    n = round(pause / (time[1] - time[0]))
    x, force = np.pad(x, n, "edge"), np.pad(factor * force, n, "edge")
    return write_csv(path, (time[1] - time[0]) * np.arange(x.size), x, force)


@pytest.mark.usefixtures("small_pictures")
def test_a_measurement_outside_the_prediction_is_said_and_rest_is_no_success(
    ask, tmp_path, held_out
):
    def compared(pause, factor):
        motion = with_rest(held_out, tmp_path / "m.csv", pause, factor)
        return ask("--motion", motion, "--actuation", "1200 psi", "--compare", *OBSERVATION)

    wrong, resting = compared(0.0, 1.5), compared(20.0, 1.5)
    for text in (
        "the prediction does not agree with the measurement",
        "measured values lie outside their 95 % intervals, offset and noise",
        *("energy_per_cycle, ", "not 95 %"),
    ):
        assert text in wrong.stderr
    assert "does not agree" not in compared(0.0, 1.0).stderr  # the control
    for words in (r"holds ([\d.]+) % of the", r"([\d.]+) % at full stroke"):
        short, long = (float(re.search(words, outcome.stdout)[1]) for outcome in (wrong, resting))
        assert long == pytest.approx(short, abs=3.0)  # 0 kip in 40 s of rest is no success
    assert float(re.search(r"holds ([\d.]+) % of the", wrong.stdout)[1]) < 60.0


# --- the force of a part that is given, and a test that was made before


def test_the_given_part_is_marked_and_the_rest_narrower(ask, table, run, held_out, tmp_path):
    options = ("--motion", held_out, "--actuation", "1200 psi", "--condition-on", "0 s to 1 s")
    outcome = ask(*options, "--kind", "observation", "--compare", "--simultaneous")
    printed = " ".join(outcome.stdout.split())
    assert "the force given from 0 s to 1 s" in printed
    assert "# conditioned: 1 where the force was given" in (tmp_path / "bands.csv").read_text()
    narrow = table()
    np.testing.assert_array_equal(narrow.conditioned == 1, narrow.time_s <= 1.0)
    assert np.all(narrow.simultaneous_upper_kip >= narrow.upper_kip)
    tail = narrow.time_s > 1.0
    counted = re.search(r"of the (\d+) measured samples in motion that were not given", printed)
    assert 0.9 * tail.sum() <= int(counted[1]) <= tail.sum()
    trace = mb.read_record(held_out).trace()
    prior = run.predict(mb.Trace.from_arrays(trace.time, trace.displacement, 1.2), "observation")
    width = np.mean((narrow.upper_kip - narrow.lower_kip)[tail])
    assert width < 0.9 * np.mean((prior.upper - prior.lower)[tail])


def test_a_motion_after_a_test_has_a_narrower_band_that_says_so(ask, table, run, tmp_path):
    test, widths = next(iter(run.tests)), []
    small = write_csv(tmp_path / "m.csv", TIME, 0.03 * np.sin(np.pi * TIME))  # inside the gap
    for options in ((), ("--after", test)):
        outcome = ask("--motion", small, *options, "--kind", "observation", "--no-figures")
        widths.append(np.mean(table().upper_kip - table().lower_kip))
    assert widths[1] < 0.8 * widths[0]
    words = f"begun where in its gap test {test} ended"
    assert words in " ".join(outcome.stdout.split())
    assert words in (tmp_path / "bands.csv").read_text()


# --- properties for design, and the laws behind them


@pytest.mark.usefixtures("no_figures")
def test_a_report_is_asked_for_in_other_units_and_forms(small_run, tmp_path):
    shutil.copytree(small_run, tmp_path / "out")
    here("report", tmp_path / "out", "--units", "si", "--excel")
    assert "N/mm" in (tmp_path / "out" / "parameters.csv").read_text()
    assert (tmp_path / "out" / "tables.xlsx").is_file()
