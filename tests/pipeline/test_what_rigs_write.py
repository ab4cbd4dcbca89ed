"""What rigs and loggers write: rates, time stamps, signs and units of actuation."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.records.sources import Source

STEP, STROKE, SLIP = 0.05, 12.0, 950.0  # s, mm, N


def loops(samples=240):
    """Displacement, mm, and force, N, of a friction damper at 0.25 Hz."""
    time = STEP * np.arange(samples)
    phase = 2 * np.pi * 0.25 * time
    return time, STROKE * np.sin(phase), SLIP * np.tanh(6 * np.cos(phase) + 2 * np.sin(phase))


def write(path, head, columns, above=""):
    rows = [",".join(str(cell) for cell in row) for row in zip(*columns, strict=True)]
    path.write_text(above + head + "\n" + "\n".join(rows) + "\n")


def command(name, path, *words, code=0):
    if name == "inspect":
        words = (*words, "-o", path.parent)
    words = (name, path, *words)
    outcome = CliRunner().invoke(app, [str(word) for word in words])
    assert outcome.exit_code == code, outcome.output
    return " ".join(outcome.output.split())


def drafted(folder):
    """Words of `init`, the campaign's text, and those of `inspect`."""
    said = command("init", folder)
    return (
        said,
        (folder / "campaign.toml").read_text(),
        command("inspect", folder / "campaign.toml"),
    )


# A rate in place of a column of times


@pytest.mark.parametrize(
    ("above", "rate"),
    [
        ("Sample rate: 20 Hz\n", "20 Hz"),
        ("Sampling Rate (Hz),20\n", "20 Hz"),
        ("Sampling interval: 0,05 s\n", "0.05 s"),
        ("Sample Period: 50 ms\n", "50 ms"),
        ("fs = 20\n", "20 Hz"),
        ("# dt = 0.05 s\n", "0.05 s"),
        ("Scan rate: 0.02 kHz per channel\n", "0.02 kHz"),
        ("Abtastrate: 20 Hz\n", "20 Hz"),
        ("Acquired 2024, at 20 Hz\nSampling Frequency, Hz: 20\n", "20 Hz"),
    ],
)
def test_init_drafts_the_rate_that_a_file_states(tmp_path, above, rate):
    _, *columns = loops()
    write(tmp_path / "a_5bar.csv", "Displacement (mm),Force (N)", columns, above)
    said, text, seen = drafted(tmp_path)
    assert f'time = {{ rate = "{rate}" }}' in text
    assert "FIXME" not in said
    assert "240 over 11.95 s" in seen
    assert "rate 20 Hz" in seen


@pytest.mark.parametrize(
    "above",
    ["", "Test frequency: 20 Hz\n", "Sample rate: 1,000 Hz\n", "fs = 20\nSample rate: 30 Hz\n"],
)
def test_a_rate_that_is_not_stated_is_asked_for(tmp_path, above):
    _, *columns = loops()
    write(tmp_path / "a_5bar.csv", "Displacement (mm),Force (N)", columns, above)
    said = command("init", tmp_path)
    assert "FIXME: columns: the unit of time is unknown; the file has none" in said
    assert 'give its rate: rate = "100 Hz"' in command(
        "inspect", tmp_path / "campaign.toml", code=2
    )


def test_a_counter_gives_way_to_the_rate_that_the_file_states(tmp_path):
    _, *columns = loops()
    columns = [np.arange(240), *columns]
    write(
        tmp_path / "a_5bar.csv", "Scan,Displacement (mm),Force (N)", columns, "Scan rate: 20 Hz\n"
    )
    said, text, seen = drafted(tmp_path)
    assert 'time = { rate = "20 Hz" }' in text
    assert "FIXME" not in said
    assert "240 over 11.95 s" in seen


CAMPAIGN = """[columns]
{columns}
displacement = {{ name = "Displacement (mm)" }}
force = {{ name = "Force (N)" }}
[[test]]
id = "a"
file = "a.csv"
actuation = "5 bar"
{test}
"""


@pytest.mark.parametrize(
    ("columns", "test"),
    [
        ('rate = "20 Hz"', ""),
        ('time = { rate = "20 Hz" }', ""),
        ('time = { rate = "50 ms" }', ""),
        ("", 'rate = "20 Hz"'),
        ('time = { name = "Time (s)" }', 'rate = "20 Hz"'),
        ('rate = "5 Hz"', 'columns.rate = "20 Hz"'),
    ],
)
def test_a_rate_is_given_for_all_tests_or_for_one(tmp_path, columns, test):
    write(tmp_path / "a.csv", "Displacement (mm),Force (N)", loops()[1:])
    (tmp_path / "c.toml").write_text(CAMPAIGN.format(columns=columns, test=test))
    assert "240 over 11.95 s" in command("inspect", tmp_path / "c.toml")


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ('rate = "20"', "'20' has no unit"),
        ('rate = "20 mm"', "unit 'mm' of"),
        ('rate = "0 Hz"', "a rate above 0"),
        ('rate = "20 Hz"\ntime = { name = "t" }', "either by its column or by a rate"),
        ('time = { name = "t", rate = "20 Hz" }', "either by its column or by a rate"),
        ('time = { name = "t", sign = -1 }', "unknown key 'sign'"),
    ],
)
def test_what_is_no_rate_is_refused(tmp_path, columns, said):
    write(tmp_path / "a.csv", "Displacement (mm),Force (N)", loops()[1:])
    (tmp_path / "c.toml").write_text(CAMPAIGN.format(columns=columns, test=""))
    assert said in command("inspect", tmp_path / "c.toml", code=2)


def test_a_record_is_read_at_a_rate(tmp_path):
    time, *columns = loops()
    write(tmp_path / "a.csv", "x_mm,f_N", columns)
    given = {"time": Source(rate="20 Hz"), "displacement": "x_mm", "force": "f_N"}
    record = mb.read_record(tmp_path / "a.csv", columns=given, fit="2 s to 8 s")
    np.testing.assert_allclose(record.time, time, atol=1e-12)
    assert record.trace().time[[0, -1]] == pytest.approx([2.0, 8.0])


# The sign of a column


def test_init_turns_the_force_where_loops_run_backward_and_says_so(tmp_path):
    time, x, force = loops()
    write(tmp_path / "a_5bar.csv", "Time (s),Displacement (mm),Force (N)", [time, x, -force])
    said, text, seen = drafted(tmp_path)
    assert "loops run backward" in said
    assert 'force = { name = "Force (N)", unit = "N", sign = -1 }' in text
    assert "force sign" not in seen
    assert re.search(r"energy per cycle \d", seen)


def test_only_the_tests_that_run_backward_are_turned(tmp_path):
    time, x, force = loops()
    for name, sign in (("a_5bar", 1), ("b_5bar", 1), ("c_9bar", -1)):
        columns = [time, x, sign * force]
        write(tmp_path / f"{name}.csv", "Time (s),Displacement (mm),Force (N)", columns)
    said, text, seen = drafted(tmp_path)
    assert "unsure: c_9bar: its loops run backward" in said
    assert text.count("sign = -1 }") == 1
    assert 'columns.force = { name = "Force (N)", unit = "N", sign = -1 }' in text
    assert "force sign" not in seen


def test_the_warning_of_negative_work_names_the_key(tmp_path):
    time, x, force = loops()
    write(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N)", [time, x, -force])
    campaign = tmp_path / "c.toml"
    time_column = 'time = { name = "Time (s)" }'
    campaign.write_text(CAMPAIGN.format(columns=time_column, test=""))
    assert "write sign = -1 for one of them in [columns]" in command("inspect", campaign)
    turned = campaign.read_text().replace('"Displacement (mm)"', '"Displacement (mm)", sign = -1')
    campaign.write_text(turned)
    assert "force sign" not in command("inspect", campaign)
    campaign.write_text(turned.replace("sign = -1", "sign = 2"))
    assert "a sign is 1 or -1" in command("inspect", campaign, code=2)


def test_a_sign_turns_the_column_before_anything_is_taken_off(tmp_path):
    time, x, force = loops()
    write(tmp_path / "a.csv", "t_s,x_mm,f_N", [time, -x, -(force + 30.0)])
    plain = {"time": "t_s", "displacement": Source("x_mm", sign=-1)}
    turned = Source("f_N", sign=-1, tare="-30 N")
    record = mb.read_record(tmp_path / "a.csv", columns=plain | {"force": turned})
    np.testing.assert_allclose(record.force, force / 4448.2216, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(record.displacement, x / 25.4, rtol=1e-9)


# Actuation in any unit


ACTUATED = """[campaign]
model = "lugre"
[columns]
time = {{ name = "t_s" }}
displacement = {{ name = "x_mm" }}
force = {{ name = "f_N" }}
"""
TEST = '[[test]]\nid = "{0}"\nfile = "{0}.csv"\nactuation = {1}\n'


def actuated(folder, *levels):
    """A campaign whose tests have these actuations."""
    time, x, force = loops()
    text = ACTUATED.format()
    for number, level in enumerate(levels):
        size = float(re.sub(r"[^\d.]", "", level)) if level[0] == '"' else 1.0
        noise = np.random.default_rng(number).normal(0.0, 6.0, time.size)
        columns = [time, x, force * size + noise, np.full(time.size, 1.5)]
        write(folder / f"r{number}.csv", "t_s,x_mm,f_N,drive_A", columns)
        text += TEST.format(f"r{number}", level)
    (folder / "c.toml").write_text(text)
    return folder / "c.toml"


@pytest.mark.parametrize(
    ("level", "shown"),
    [
        ("1 A", "1 A"),
        ("500 mA", "500 mA"),
        ("1.5 amps", "1.5 amps"),
        ("24 V", "24 V"),
        ("3 turns", "3 turns"),
        ("180 deg", "180 deg"),
        ("40 %", "40 %"),
        ("5 clicks", "5 clicks"),
        ("120 N*m", "120 N*m"),
        ("80 ft*lbf", "80 ft*lbf"),
        ("0.2 T", "0.2 T"),
    ],
)
def test_an_actuation_is_said_in_its_own_unit(tmp_path, level, shown):
    assert f" actuation {shown} " in command("inspect", actuated(tmp_path, f'"{level}"'))


@pytest.mark.parametrize("level", ["3 mm", "2 s", "5 Hz", "3 kg", "20 degC", "7 bananas", "0.5 1"])
def test_a_unit_of_no_actuation_is_refused(tmp_path, level):
    said = command("inspect", actuated(tmp_path, f'"{level}"'), code=2)
    assert f"unit '{level.split()[1]}' of '{level}'" in said


def test_actuations_of_one_kind_may_differ_in_unit_and_others_are_refused(tmp_path):
    said = command("inspect", actuated(tmp_path, '"500 mA"', '"1 A"'))
    assert " actuation 0.5 A " in said
    assert " actuation 1 A " in said
    said = command("inspect", actuated(tmp_path, '"1 A"', '"1 V"'), code=2)
    assert "that of test 'r1' is in V or a multiple of it" in said
    said = command("inspect", actuated(tmp_path, '"1 A"', '"5 bar"'), code=2)
    assert "that of test 'r1' is a pressure" in said


def test_a_measured_current_is_an_actuation(tmp_path):
    said = command("inspect", actuated(tmp_path, '{ name = "drive_A" }'))
    assert " actuation 1.5 A (mean of a history)" in said


@pytest.mark.parametrize(
    ("name", "above", "level", "doubt"),
    [
        ("run_0.5A", "", "0.5 A", ""),
        ("run_250mA", "", "250 mA", ""),
        ("run_2A", "", "2 A", "2A is taken for A"),
        ("run_12volts", "", "12 V", ""),
        ("run", "Coil current: 0.75 A\n", "0.75 A", ""),
        ("run_2turns", "", "2 turns", ""),
        ("run_500psi_2A", "", "500 psi", ""),
    ],
)
def test_init_drafts_the_current_of_a_test(tmp_path, name, above, level, doubt):
    write(tmp_path / f"{name}.csv", "Time (s),Displacement (mm),Force (N)", loops(), above)
    said, text, _ = drafted(tmp_path)
    assert f'actuation = "{level}"' in text
    assert (doubt in said) if doubt else ("unsure" not in said)


def test_init_drafts_a_column_of_current(tmp_path):
    columns = [*loops(), np.full(240, 0.8)]
    write(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N),Current (A)", columns)
    said, text, _ = drafted(tmp_path)
    assert "actuation = \"0.8 A\"  # of column 'Current (A)'" in text
    assert "FIXME" not in said
    (tmp_path / "a.csv").rename(tmp_path / "a_500psi.csv")
    (tmp_path / "campaign.toml").unlink()
    command("init", tmp_path, "--force")
    assert 'actuation = "500 psi"' in (tmp_path / "campaign.toml").read_text()


@pytest.mark.slow
def test_laws_tables_and_questions_are_in_the_unit_of_the_actuation(tmp_path):
    campaign = actuated(tmp_path, '"500 mA"', '"1000 mA"')
    command("init", campaign)
    campaign.write_text(
        campaign.read_text().replace("[campaign]", '[campaign]\npriors = "priors.toml"')
    )
    out = tmp_path / "out"
    command("calibrate", campaign, "-o", out, "--effort", "quick", "--jobs", 1, "--seed", 1)
    laws = (out / "laws.csv").read_text()
    assert re.search(r"K_c_fwd,k?N/mA,", laws)
    assert re.search(r"alpha_sigma0,k?N/mm/mA,", laws)
    asked = ("--sine", "12 mm, 0.25 Hz, 2 cycles", "-o", tmp_path / "b.csv")
    command("predict", out, *asked, "--actuation", "0.8 A")
    assert "must be in A or a multiple of it" in command(
        "predict", out, *asked, "--actuation", "500 psi", code=2
    )
    assert "mA, 0.25 Hz" in command("next", out, "-o", tmp_path / "n.csv")
