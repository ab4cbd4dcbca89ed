"""The command line refuses wrong input with one sentence, and writes nothing then."""

from pathlib import Path

import numpy as np
import pytest

from tests.command_line import contents, here, refusal, said, write_csv

PRIORS = Path(__file__).parents[2] / "priors" / "mfd.toml"
ENTRY = """\
[[test]]
id = "p500"
file = "p500.csv"
actuation = "500 psi"
role = "calibrate"
"""
FORCE = 'force = { name = "force_kip", unit = "kip" }'
CAMPAIGN = f"""\
[campaign]
title = "Small"
priors = "mfd"

[columns]
time = {{ name = "time_s", unit = "s" }}
displacement = {{ name = "displacement_in", unit = "in" }}
{FORCE}

[laws]

{ENTRY}"""


def signals(cycles=2):
    """Time, displacement and force of some cycles with a gap, (3, 100 · cycles + 1)."""
    time = np.arange(100 * cycles + 1) / 50.0
    motion = np.sin(np.pi * time)
    return np.stack(
        [time, motion, np.tanh(40 * np.gradient(motion, time)) + 0.01 * np.cos(37 * time)]
    )


def faulty():
    """A record with a swapped sign, a spike and dropped samples."""
    columns = signals()
    columns[2] *= -1
    columns[2, 100] += 5
    return np.delete(columns, [60, 61], axis=1)


@pytest.fixture
def folder(tmp_path):
    """Campaign of one test, in a folder of its own."""
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    write_csv(campaign / "p500.csv", *signals())
    (campaign / "campaign.toml").write_text(CAMPAIGN)
    return campaign


def change(folder, target, replacement, name="campaign.toml"):
    text = (folder / name).read_text()
    assert target in text
    (folder / name).write_text(text.replace(target, replacement, 1))


def assert_refused(folder, *words, command="calibrate", arguments=()):
    """Refuse with one sentence that has all the words, and write nothing."""
    snapshot = contents(folder.parent)
    quick = ("-o", folder.parent / "out", "--jobs", 1, "--effort", "quick")
    sentence = refusal(command, folder / "campaign.toml", *quick, *arguments)
    for word in words:
        assert word in sentence
    assert contents(folder.parent) == snapshot


def accepted(folder):
    """What a dry run says, which accepts the campaign and writes nothing."""
    snapshot = contents(folder.parent)
    outcome = here("calibrate", folder / "campaign.toml", "--dry-run")
    assert outcome.exit_code == 0, outcome.output
    assert "nothing was written" in outcome.stdout
    assert contents(folder.parent) == snapshot
    return outcome.stdout


# --- records, campaign files and priors


def column(number, values):
    columns = signals()
    columns[number] = values
    return columns


TIME = signals()[0]
RECORDS = [
    (column(1, 0.25), ("displacement", "constant")),
    (column(2, 0.0), ("zero throughout",)),
    (column(2, 1e12 * signals()[2]), ("too large to use",)),
    (column(0, np.where(TIME == 4.0, 2.0**64, TIME)), ("too large to use",)),  # an overflow
    (column(0, np.where(TIME == 0.18, 0.16, TIME)), ("does not increase at line 11",)),
    (signals()[:, :60], ("1 turning point", "at least 2")),
    (signals()[:, :10], ("10 samples", "at least 20")),
]


def test_a_record_that_cannot_be_used_is_refused(folder):
    for columns, words in RECORDS:
        write_csv(folder / "p500.csv", *columns)
        assert_refused(folder, "p500", *words)
    assert_refused(folder, "p500", *words, arguments=("--dry-run",))


def test_a_cell_that_is_no_number_is_named_by_line_and_column(folder):
    text = write_csv(folder / "p500.csv", *signals()).read_text().splitlines()
    for row, name in (("0.3,１２,0.9", "displacement_in"), ("0.3,0.8,", "force_kip")):
        (folder / "p500.csv").write_text("\n".join([*text[:16], row, *text[17:]]))
        assert_refused(folder, "p500.csv", "line 17", name, "expected a finite number")


CAMPAIGNS = [
    ('role = "calibrate"', 'window = "9 s to 20 s"', ("p500.csv", "4 s", "window")),
    ('priors = "mfd"', 'priors = "mdf"', ("'mdf'", "brfd", "mfd")),
    ('priors = "mfd"', "priors = mfd", ("campaign.toml", "not valid TOML", "line 3")),
    ('actuation = "500 psi"', 'actuation = "1,000 psi"', ("without thousands separators",)),
    ('priors = "mfd"', 'rate = "600 rpm"', ("has an angle",)),
    ('priors = "mfd"', f"rate = {'9' * 5000}", ("a number of thousands of digits",)),
    ('"force_kip", unit', '"displacement_in", unit', ("given for displacement and force",)),
    ("[[test]]", "[test]", ("begins with [[test]], in two brackets",)),
    ('actuation = "500 psi"', 'actuation = "1e999 psi"', ("not finite",)),
    ('file = "p500.csv"', 'file = "p600.csv"', ("p600.csv", "p500", "does not exist")),
    ('"displacement_in", unit = "in"', '"displacement_in", unit = "kip"', ("measures force",)),
]


def test_a_fault_in_the_campaign_is_named(folder):
    for target, replacement, words in CAMPAIGNS:
        (folder / "campaign.toml").write_text(CAMPAIGN)
        change(folder, target, replacement)
        assert_refused(folder, *words)


def own_priors(folder, target, replacement):
    (folder / "own.toml").write_text(PRIORS.read_text())
    change(folder, target, replacement, "own.toml")
    (folder / "campaign.toml").write_text(CAMPAIGN.replace('"mfd"', '"own.toml"'))


def test_a_fault_in_the_priors_is_named(folder):
    for target, replacement, words in (
        ('"80 kip/in"', '"80 kip"', ("sigma0", "median", "stiffness")),
        ('parameters = ["sigma0"]', "parameters = []", ("[scatter]", "sigma0")),
        ('"1.5 kip"', '"1e30 kip"', ("'p500'", "no mass at any start")),
    ):
        own_priors(folder, target, replacement)
        assert_refused(folder, "own.toml", *words)


def test_a_campaign_file_that_is_not_there_is_named_with_one_like_it(folder, tmp_path):
    output = ("-o", tmp_path / "out")
    assert "'campaign.toml'?" in refusal("calibrate", folder / "campagn.toml", *output)
    assert str(folder / "campaign.toml") in refusal("calibrate", folder, *output)
    (folder / "campaign.toml").unlink()
    assert_refused(folder, "campaign.toml", "No such file")


# --- run folders


@pytest.mark.parametrize("name", ["mine.csv", "campaign/mine.csv"])
def test_a_demo_does_not_replace_what_is_not_its_own(tmp_path, name):
    """In a folder as a demo leaves it that is interrupted in its first moments."""
    (tmp_path / "campaign").mkdir()
    for file_name in ("p0_f0.05.csv", ".p500_f0.05.csv.ab12cd.part", "campaign.toml"):
        (tmp_path / "campaign" / file_name).write_text("time_s")
    (tmp_path / ".owner").write_text("")
    (tmp_path / name).write_text("mine")
    snapshot = contents(tmp_path / "campaign")
    assert "is not a run folder" in refusal("demo", tmp_path, "--quick", "--force")
    assert (tmp_path / name).read_text() == "mine"
    assert contents(tmp_path / "campaign") == snapshot


def test_a_folder_without_a_finished_run_is_refused(tmp_path):
    run_folder = tmp_path / "out"
    options = ("--sine", "1 in, 1 Hz, 2 cycles", "--actuation", "1 ksi", "-o", tmp_path / "b.csv")
    assert str(run_folder) in refusal("report", run_folder)
    assert not run_folder.exists()
    assert len(refusal("check", "9" * 5000)) < 500
    run_folder.mkdir()
    for command, content in ((("check",), "{"), (("predict", *options), '{"status": "running"}')):
        (run_folder / "manifest.json").write_text(content)
        snapshot = contents(tmp_path)
        assert str(run_folder) in refusal(command[0], run_folder, *command[1:])
        assert contents(tmp_path) == snapshot


# --- a first campaign


def test_init_writes_a_campaign_that_a_dry_run_accepts_and_keeps_one_that_is_there(folder):
    (folder / "campaign.toml").unlink()
    write_csv(folder / "1000psi_quake.csv", *signals())
    (folder / "notes.txt").write_text("rain")
    printed = said("init", folder)
    for word in (
        *("left out: notes.txt: ", "unsure: p500: psi is assumed", "tests 2, 1 left out"),
        *('role = "validate" is suggested', "mfd-bayes inspect"),
    ):
        assert word in printed
    accepted(folder)
    (folder / "campaign.toml").write_text(CAMPAIGN)
    assert "--force" in refusal("init", folder)
    assert (folder / "campaign.toml").read_text() == CAMPAIGN
    said("init", folder, "--force")
    assert (folder / "campaign.toml").read_text() != CAMPAIGN


# --- looking


def test_inspect_tells_what_a_file_and_a_campaign_hold(folder, tmp_path):
    for path in (folder / "p500.csv", folder / "campaign.toml"):
        outcome = here("inspect", path, "-o", tmp_path / f"look_{path.suffix}")
        assert outcome.exit_code == 0, outcome.output
        for fact in (
            *("force_kip [kip]", "50 Hz", "201 over 4 s", "turning points", "4 (2 cycles)"),
            *("1: amplitude 1 in, frequency 0.5 Hz", "kip, samples at a peak: 1", "force offset"),
        ):
            assert fact in outcome.stdout
        assert ("500 psi" in outcome.stdout) == (path.suffix == ".toml")
        (picture,) = (tmp_path / f"look_{path.suffix}").iterdir()
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert str(picture) in outcome.stdout
        assert "warning" not in outcome.stdout or path.suffix == ".toml"


@pytest.mark.usefixtures("small_pictures")
def test_inspect_warns_of_what_would_spoil_a_fit(folder, tmp_path):
    write_csv(folder / "p500.csv", *faulty())
    for path in (folder / "p500.csv", folder / "campaign.toml"):
        printed = here("inspect", path, "-o", tmp_path / "look").stdout
        for name in ("force sign", "spikes", "dropped samples"):
            assert f"warning              {name}: " in printed
    late = signals()
    late[0, 60:] += 1.0
    write_csv(folder / "p500.csv", *late)
    printed = said("inspect", folder / "p500.csv", "-o", tmp_path / "piece")
    for words in ("gap in time: time has a gap of 1.02 s before line 62", "is used, 2.2 s to 5 s"):
        assert words in printed
    quake = write_csv(tmp_path / "quake.csv", *signals()[:2])  # without force
    said("inspect", quake, "-o", tmp_path / "quake")


def test_prior_check_draws_what_the_priors_allow_and_refuses_what_it_cannot(folder, tmp_path):
    printed = said("prior-check", folder / "campaign.toml", "-o", tmp_path / "look")
    assert "p500: " in printed
    assert "95 % prior band" in printed
    (picture,) = (tmp_path / "look").iterdir()
    assert picture.read_bytes().startswith(b"\x89PNG")
    own_priors(folder, '"1.5 kip"', '"1e400 kip"')
    refusal("prior-check", folder / "campaign.toml", "-o", tmp_path / "no")
    (folder / "campaign.toml").write_text(CAMPAIGN.replace(FORCE, ""))
    refusal("prior-check", folder / "campaign.toml", "-o", tmp_path / "no")
    assert not (tmp_path / "no").exists()


# --- parts that are left out, and models that are compared


def test_what_cannot_be_left_out_is_refused(folder):
    monday = '\nsession = "Monday"'
    again = '[[test]]\nid = "again"\nfile = "p500.csv"\nactuation = "700 psi"'
    for criterion, text, words in (
        ("month", CAMPAIGN, ("--by", "test, level, session", "'month'")),
        ("test", CAMPAIGN, ("campaign.toml", "two tests")),
        ("session", CAMPAIGN + again, ("no calibrated test", "session =")),
        ("session", f"{CAMPAIGN.rstrip()}{monday}\n{again}{monday}", ("two sessions",)),
    ):
        (folder / "campaign.toml").write_text(text)
        assert_refused(folder, *words, command="crossvalidate", arguments=("--by", criterion))


def test_what_cannot_be_compared_is_refused(folder):
    compare = {"command": "compare", "arguments": ("--models", "three_stage,lugre,bouc_wen")}
    assert_refused(folder, "'p500'", "at least 3 cycles, got 2", **compare)
    write_csv(folder / "p500.csv", *signals(4))
    (folder.parent / "out" / "lugre").mkdir(parents=True)
    assert_refused(folder, "lugre", "--resume", "--force", **compare)
    (folder.parent / "out" / "lugre").rmdir()
    text = PRIORS.read_text()
    left_out = text[text.index("[parameters.Fy_fwd]") : text.index("[parameters.Fy_bwd]")]
    own_priors(folder, left_out, "")
    assert_refused(folder, "own.toml", "Fy_fwd", **compare)
    accepted(folder)  # the campaign's own model needs no such prior
