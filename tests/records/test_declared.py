"""Names of files that say another amplitude, frequency or actuation than their records show."""

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.campaign.draft import campaign_text, doubts, draft_campaign
from mfd_bayes.cli.commands import app
from mfd_bayes.records.file_name_check import contradictions
from mfd_bayes.records.record import read_record
from mfd_bayes.records.summary import inspect_record


def record_of(folder, name, *, amplitude=1.0, rate=0.25, actuation=None):
    """Four cycles at 64 Hz, in inches and kip."""
    time = np.arange(0.0, 4.0 / rate, 1 / 64)
    motion = amplitude * np.sin(2 * np.pi * rate * time)
    table = np.column_stack([time, motion, np.tanh(5 * np.cos(2 * np.pi * rate * time))])
    head = "time_s,displacement_in,force_kip"
    path = folder / f"{name}.csv"
    np.savetxt(path, table, delimiter=",", header=head, comments="")
    return read_record(path, actuation=actuation)


AGREEING = (
    *("36lb_0.25Hz_1.0in", "0p25hz_1in", "25.4mm 0.25 Hz", "test_2in", "2.0in_stroke", "1.08in"),
    *(
        "amp_1.0in_64Hz",
        "harmonic0.03ea1forward",
        "run3in_lab",
        "p500_f9",
        "2023-08-10_9",
        "5in_1in",
    ),
)


@pytest.mark.parametrize("name", AGREEING)
def test_a_name_that_agrees_or_says_nothing_is_not_named(tmp_path, name):
    assert contradictions(record_of(tmp_path, name)) == ()


@pytest.mark.parametrize(
    ("name", "said", "shown"),
    [
        ("36lb_0.25Hz_1.5in", "1.5in", "an amplitude of 1 in (a stroke of 2 in)"),
        ("40mm", "40mm", "an amplitude of 1 in"),
        ("amp_2.0in", "2.0in", "an amplitude of 1 in"),
        ("1in_peak-to-peak", "1in", "a stroke of 2 in"),
        ("1.0in_0.1Hz", "0.1Hz", "0.25 Hz"),
        ("0.3Hz", "0.3Hz", "0.25 Hz"),
    ],
)
def test_a_name_that_its_motion_contradicts_is_named(tmp_path, name, said, shown):
    record = record_of(tmp_path, name)
    (fault,) = contradictions(record)
    assert str(fault.message).startswith(f"the name of {name}.csv says {said}, but the record")
    assert shown in str(fault.message)
    assert str(fault.message) in [
        str(other.message) for other in inspect_record("a", record).faults
    ]


@pytest.mark.parametrize(
    ("name", "actuation", "shown"),
    [
        ("36lb_a", "36 lbf", ""),
        ("0.16kN", "36 lbf", ""),
        ("36lb_a", "500 psi", ""),  # of another kind: not compared
        ("30lb_a", "36 lbf", "says 30lb, but the campaign has an actuation of 36 lbf"),
        ("500psi", "3 MPa", "says 500psi, but the campaign has an actuation of 3 MPa"),
        ("3.5MPa", "500 psi", ""),
        ("0.03kip_b", "60 lbf", "says 0.03kip, but the campaign"),
    ],
)
def test_an_actuation_that_the_name_does_not_have_is_named(tmp_path, name, actuation, shown):
    found = contradictions(record_of(tmp_path, name, actuation=actuation))
    assert len(found) == bool(shown)
    assert all(shown in str(fault.message) for fault in found)


@pytest.mark.parametrize(("unit", "level"), [("MPa", 7.0), ("kPa", 7000.0), ("kN", 4.0)])
def test_an_actuation_of_a_column_is_told_in_the_unit_of_the_column(tmp_path, unit, level):
    name = "3kN" if unit == "kN" else "5MPa"
    path = record_of(tmp_path, name).path
    head, *rows = path.read_text().splitlines()
    lines = [f"{head},actuation_{unit}", *(f"{row},{level:g}" for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    (fault,) = contradictions(read_record(path))
    assert str(fault.message).endswith(f"but its column has an actuation of {level:g} {unit}")


def test_a_motion_without_a_full_loop_is_not_compared(tmp_path):
    path = tmp_path / "5.0in_3Hz.csv"
    time = np.linspace(0.0, 1.0, 200)
    table = np.column_stack([time, np.sin(2 * np.pi * time), np.cos(2 * np.pi * time)])
    np.savetxt(path, table, delimiter=",", header="time_s,displacement_in,force_kip", comments="")
    assert contradictions(read_record(path)) == ()


def test_names_of_real_records_agree_and_the_old_wrong_one_is_named(data_folder, tmp_path):
    files = sorted(data_folder.glob("202*.csv"))
    assert len(files) > 20
    for path in files:
        assert contradictions(read_record(path)) == (), path.name
    right = data_folder / "2023_36lb_0.10Hz_1.0in_SI.csv"
    head, *rows = right.read_text().splitlines()
    assert head.split(",")[1] == "displacement_m"
    table = np.array([row.split(",") for row in rows], dtype=float)
    table[:, 1] *= 1.5
    wrong = tmp_path / right.name
    np.savetxt(wrong, table, delimiter=",", header=head, comments="", fmt="%.9g")
    (fault,) = contradictions(read_record(wrong))
    assert str(fault.message).startswith(
        f"the name of {right.name} says 1.0in, but the record has an "
    )
    assert "amplitude of 1.51 in" in str(fault.message)


def test_inspect_init_and_a_dry_run_show_it(tmp_path):
    record_of(tmp_path, "36lb_0.25Hz_1.5in")
    record_of(tmp_path, "36lb_0.25Hz_1.0in", amplitude=1.02)
    sentence = (
        "the name of 36lb_0.25Hz_1.5in.csv says 1.5in, but the record has an amplitude of 1 in"
    )
    wrong, right = (str(tmp_path / f"36lb_0.25Hz_{a}in.csv") for a in ("1.5", "1.0"))
    run = CliRunner().invoke
    assert sentence in run(app, ["inspect", wrong, "-o", str(tmp_path)]).stdout
    assert "the name of" not in run(app, ["inspect", right, "-o", str(tmp_path)]).stdout
    (found,) = [doubt for doubt in doubts(draft_campaign(tmp_path)) if "the name of" in doubt]
    assert sentence in found
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(campaign_text(draft_campaign(tmp_path)), encoding="utf-8")
    dry = run(app, ["calibrate", str(campaign), "-o", str(tmp_path / "out"), "--dry-run"])
    assert dry.exit_code == 0, dry.output
    shown = " ".join((dry.stdout + dry.stderr).split())
    assert sentence in shown
    assert shown.count("the name of") == 1
