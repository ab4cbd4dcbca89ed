"""The command line refuses wrong input with one sentence, and writes nothing then."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes
from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline import commands as pipeline

COMMAND = Path(sys.executable).parent / "mfd-bayes"
COMMANDS = (
    "demo",
    "calibrate",
    "crossvalidate",
    "compare",
    "report",
    "predict",
    "check",
    "init",
    "inspect",
    "prior-check",
)
PRIORS = Path(__file__).parents[2] / "priors" / "mfd.toml"
CAMPAIGN = """\
[campaign]
title = "Small"
priors = "mfd"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }

[laws]

[[test]]
id = "p500"
file = "p500.csv"
actuation = "500 psi"
role = "calibrate"
"""


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def signals():
    """Time, displacement and force of two cycles with a gap, (201, 3)."""
    time = np.arange(201) / 50.0
    motion = np.sin(np.pi * time)
    force = np.tanh(4 * np.gradient(motion, time)) + 0.01 * np.cos(37 * time)
    return np.column_stack([time, motion, force])


def write_csv(path, table, header="time_s,displacement_in,force_kip"):
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6f")


@pytest.fixture
def folder(tmp_path):
    """Campaign of one test, in a folder of its own."""
    home = tmp_path / "campaign"
    home.mkdir()
    write_csv(home / "p500.csv", signals())
    (home / "campaign.toml").write_text(CAMPAIGN)
    return home


def change(folder, old, new):
    """Replace a text in the campaign file."""
    path = folder / "campaign.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def contents(place):
    return {str(p): p.read_bytes() if p.is_file() else None for p in place.rglob("*")}


def sentence_of(outcome):
    """The sentence of a command that was refused with exit code 2."""
    assert outcome.exit_code == 2, (outcome.output, outcome.exception)
    assert "Traceback" not in outcome.output
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    return sentence


def assert_refused(folder, *words, arguments=()):
    """Refuse to calibrate with one sentence that has all the words, and write nothing."""
    out = folder.parent / "out"
    before = contents(folder.parent)
    quick = ("--jobs", 1, "--effort", "quick")
    outcome = here("calibrate", folder / "campaign.toml", "-o", out, *quick, *arguments)
    sentence = sentence_of(outcome)
    for word in words:
        assert word in sentence
    assert not out.exists()
    assert contents(folder.parent) == before


# --- records


def edit_line(folder, number, text):
    path = folder / "p500.csv"
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


def test_a_campaign_without_fault_is_accepted(folder):
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


@pytest.mark.parametrize("cell", ["nan", "inf", "fast", ""])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_cell_that_is_no_number_is_named_by_line_and_column(folder, cell, place):
    cells = ["0.3", "0.8", "0.9"]
    cells[place] = cell
    edit_line(folder, 17, ",".join(cells))
    column = ("time_s", "displacement_in", "force_kip")[place]
    assert_refused(folder, "p500.csv", "line 17", column, "expected a finite number")


def test_time_that_does_not_increase_is_named_by_line(folder):
    edit_line(folder, 30, "0.1,0.5,0.5")
    assert_refused(folder, "p500.csv", "line 30", "time", "does not increase")


@pytest.mark.usefixtures("small_pictures")
def test_of_a_time_with_a_gap_the_longest_piece_is_used_and_named_by_line(folder, tmp_path):
    table = signals()
    table[60:, 0] += 1.0
    write_csv(folder / "p500.csv", table)
    outcome = here("inspect", folder / "p500.csv", "-o", tmp_path / "look")
    assert outcome.exit_code == 0
    for words in ("gap in time: time has a gap of 1.02 s before line 62", "is used, 2.2 s to 5 s"):
        assert words in outcome.stdout


def test_a_motion_that_stands_still_is_refused(folder):
    table = signals()
    table[:, 1] = 0.25
    write_csv(folder / "p500.csv", table)
    assert_refused(folder, "p500.csv", "displacement", "constant")


def test_a_motion_with_one_turning_point_is_refused(folder):
    write_csv(folder / "p500.csv", signals()[:60])
    assert_refused(folder, "p500.csv", "1 turning point", "at least 2")


def test_too_few_samples_are_refused(folder):
    write_csv(folder / "p500.csv", signals()[:10])
    assert_refused(folder, "p500.csv", "10 samples", "at least 20")


@pytest.mark.parametrize("content", ["", "\n\n", "# only a remark\n"])
def test_an_empty_file_is_refused(folder, content):
    (folder / "p500.csv").write_text(content)
    assert_refused(folder, "p500.csv", "empty")


def test_a_file_with_a_header_alone_is_refused(folder):
    (folder / "p500.csv").write_text("time_s,displacement_in,force_kip\n")
    assert_refused(folder, "p500.csv", "no data")


def test_a_missing_column_is_named_with_those_there_are(folder):
    write_csv(folder / "p500.csv", signals(), "time_s,displacement_in,load")
    assert_refused(folder, "p500.csv", "'force_kip'", "time_s, displacement_in, load")


def test_swapped_units_are_a_dimension_error(folder):
    change(folder, '"displacement_in", unit = "in"', '"displacement_in", unit = "kip"')
    assert_refused(folder, "p500.csv", "'displacement_in'", "'kip'", "measures force", "length")


def test_swapped_columns_are_a_dimension_error(folder):
    change(folder, 'name = "force_kip", unit = "kip"', 'name = "displacement_in"')
    change(folder, 'name = "displacement_in", unit = "in"', 'name = "force_kip"')
    assert_refused(folder, "'force_kip'", "measures force", "displacement")


def test_an_unknown_unit_is_refused_with_examples(folder):
    change(folder, 'unit = "kip"', 'unit = "kipp"')
    assert_refused(folder, "p500.csv", "'kipp'", "unknown", "'kN'")


def test_a_test_without_force_cannot_be_calibrated(folder):
    change(folder, 'force = { name = "force_kip", unit = "kip" }', "")
    assert_refused(folder, "p500", "force")


def test_a_validation_test_is_checked_too(folder):
    entry = CAMPAIGN[CAMPAIGN.index("[[test]]") :]
    with (folder / "campaign.toml").open("a") as file:
        file.write(entry.replace("p500", "held").replace("calibrate", "validate"))
    write_csv(folder / "held.csv", signals()[:60])
    assert_refused(folder, "held.csv", "turning point")


# --- campaign files


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("title =", "titel =", ("'titel'", "'title'", "[campaign]")),
        ("actuation =", "actuaton =", ("'actuaton'", "'actuation'", "p500")),
        ("[laws]", '[laws]\nFc_fwdd = "affine"', ("'Fc_fwdd'", "'Fc_fwd'", "[laws]")),
        ("[laws]", "[law]", ("'law'", "'laws'")),
        ('role = "calibrate"', 'role = "calibration"', ("role", "'p500'", "'calibration'")),
        ('role = "calibrate"', 'role = "validate"', ("no test with role 'calibrate'",)),
        ('priors = "mfd"', 'priors = "mdf"', ("'mdf'", "brfd", "mfd")),
        ('priors = "mfd"', 'noise = "white"', ("noise", "'white'", "'ou'")),
        ('priors = "mfd"', 'model = "maxwell"', ("model", "'maxwell'", "'three_stage'")),
        ('priors = "mfd"', 'rate = "64 s"', ("rate", "measures time", "'Hz'")),
        ('actuation = "500 psi"', 'actuation = "500"', ("p500", "unit")),
        ('actuation = "500 psi"', 'actuation = "500 in"', ("length", "pressure")),
        ('actuation = "500 psi"', 'actuation = "0 psi"', ("actuation above zero",)),
        ('actuation = "500 psi"', "", ("actuation", "missing")),
        ('file = "p500.csv"', 'file = "p600.csv"', ("p600.csv", "p500", "does not exist")),
        ('id = "p500"', 'id = "../p500"', ("id", "../p500")),
        ('role = "calibrate"', 'fit = "9 s to 20 s"', ("p500.csv", "4 s", "window")),
        ('role = "calibrate"', 'fit = "3 s to 1 s"', ("fit", "end after it starts")),
        ("[laws]", '[laws]\nFs_fwd = "affine"', ("laws.Fs_fwd", "Fc_fwd", "'affine'")),
        (
            "[laws]",
            '[laws]\nFc_fwd = "affine"\nFs_fwd = "power"',
            ("laws.Fs_fwd", "'affine'", "'power'"),
        ),
        ("[laws]", '[laws]\nsigma0 = "cubic"', ("laws.sigma0", "'cubic'", "'affine'")),
        ("[laws]", '[dependence]\nFc_fwd = ["speed"]', ("dependence.Fc_fwd", "'speed'")),
        ("[laws]", '[dependence]\nd_2 = ["velocity"]', ("'d_2'", "'d2'", "[dependence]")),
    ],
)
def test_a_fault_in_the_campaign_is_named(folder, old, new, words):
    change(folder, old, new)
    assert_refused(folder, *words)


def test_laws_that_follow_each_other_are_accepted(folder):
    change(folder, "[laws]", '[laws]\nFc_fwd = "power"\nFs_fwd = "power"')
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('role = "calibrate"', 'session = "Monday"'),
        ("[laws]", '[dependence]\nFc_fwd = ["velocity"]\nd2 = ["velocity", "amplitude"]'),
        ("[laws]", '[laws]\nsigma0 = "compare"\nFc_bwd = "compare"\nFs_bwd = "compare"'),
    ],
)
def test_sessions_dependences_and_compared_laws_are_accepted(folder, old, new):
    change(folder, old, new)
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


def test_invalid_toml_is_named_by_line(folder):
    change(folder, 'priors = "mfd"', "priors = mfd")
    assert_refused(folder, "campaign.toml", "not valid TOML", "line 3")


def test_two_tests_of_one_id_are_refused(folder):
    entry = CAMPAIGN[CAMPAIGN.index("[[test]]") :]
    with (folder / "campaign.toml").open("a") as file:
        file.write(entry)
    assert_refused(folder, "campaign.toml", "two tests", "'p500'")


def test_a_campaign_that_is_not_there_is_named(folder):
    (folder / "campaign.toml").unlink()
    assert_refused(folder, "campaign.toml", "No such file")


@pytest.mark.parametrize("way", ["dots", "absolute", "link"])
def test_a_file_outside_the_campaigns_folder_is_refused(folder, way):
    outside = folder.parent / "p500.csv"
    (folder / "p500.csv").rename(outside)
    if way == "link":
        (folder / "p500.csv").symlink_to(outside)
    else:
        file = "../p500.csv" if way == "dots" else str(outside)
        change(folder, 'file = "p500.csv"', f'file = "{file}"')
    assert_refused(folder, "p500.csv", "'p500'", "outside the campaign's folder")


# --- priors


def own_priors(folder, old, new):
    text = PRIORS.read_text()
    assert old in text
    (folder / "own.toml").write_text(text.replace(old, new, 1))
    change(folder, 'priors = "mfd"', 'priors = "own.toml"')


def test_priors_of_the_users_own_are_accepted(folder):
    own_priors(folder, "80 kip/in", "90 kip/in")
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


@pytest.mark.parametrize("old", ["1.5 kip", "80 kip/in", "0.1 in"])
def test_a_prior_without_mass_at_any_start_is_refused(folder, old):
    own_priors(folder, f'"{old}"', f'"1e30 {old.split()[1]}"')
    assert_refused(folder, "own.toml", "'p500'", "no mass at any start")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('family = "lognormal"', 'family = "log"', ("sigma0", "'log'", "lognormal")),
        ('"80 kip/in"', '"80 kip"', ("sigma0", "median", "stiffness")),
        ('"80 kip/in"', "80", ("sigma0", "median", "unit")),
        ("[parameters.k3]", "[parameters.k4]", ("k4", "unknown parameter")),
        ("[scatter.bristle]", "[scatters.bristle]", ("scatters", "own.toml")),
        ('parameters = ["sigma0"]', "parameters = []", ("[scatter]", "sigma0")),
        ('title = "MFD', "title = MFD", ("own.toml", "not valid TOML")),
    ],
)
def test_a_fault_in_the_priors_is_named(folder, old, new, words):
    own_priors(folder, old, new)
    assert_refused(folder, "own.toml", *words)


def test_a_missing_prior_is_named(folder):
    text = PRIORS.read_text()
    start = text.index("[parameters.k3]")
    cut = text[:start] + text[text.index("[parameters.d2]") :]
    (folder / "own.toml").write_text(cut)
    change(folder, 'priors = "mfd"', 'priors = "own.toml"')
    assert_refused(folder, "own.toml", "k3")


# --- run folders


@pytest.mark.parametrize("options", [(), ("--force",), ("--resume",)])
def test_a_folder_with_other_things_is_refused_and_kept(folder, options):
    out = folder.parent / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    arguments = ("-o", out, "--jobs", 1, *options)
    sentence = sentence_of(here("calibrate", folder / "campaign.toml", *arguments))
    assert str(out) in sentence
    assert contents(out) == {str(out / "thesis.txt"): b"years of work"}


@pytest.mark.parametrize("options", [(), ("--force",), ("--resume",)])
def test_a_file_in_the_place_of_the_run_folder_is_refused(folder, options):
    out = folder.parent / "out"
    out.write_text("a file")
    arguments = ("-o", out, "--jobs", 1, *options)
    sentence = sentence_of(here("calibrate", folder / "campaign.toml", *arguments))
    assert str(out) in sentence
    assert out.read_text() == "a file"


def test_a_run_folder_below_a_file_is_refused(folder):
    out = folder / "p500.csv" / "out"
    sentence = sentence_of(here("calibrate", folder / "campaign.toml", "-o", out, "--jobs", 1))
    assert str(out) in sentence


def begun(folder, *names):
    """A folder as a demo leaves it that is interrupted in its first moments."""
    (folder / "campaign").mkdir(parents=True)
    for name in ("p0_f0.05.csv", ".p500_f0.05.csv.ab12cd.part", *names):
        (folder / "campaign" / name).write_text("time_s,displacement_in,force_kip\n")
    (folder / ".owner.json").write_text("{}")


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("p500_f0.05.csv", "demo {} --quick --seed 3 --force"),
        ("campaign.toml", "calibrate {}/campaign/campaign.toml -o {} --effort quick --seed 3"),
    ],
)
def test_a_demo_says_how_to_go_on_from_its_first_moments(tmp_path, monkeypatch, written, said):
    begun(tmp_path, "campaign.toml")

    def write(folder, _):
        assert [path.name for path in folder.iterdir()] == ["p0_f0.05.csv"]
        (folder / written).write_text("")
        raise MemoryError

    monkeypatch.setattr(pipeline, "write_campaign", write)
    assert "exists: give --force" in sentence_of(here("demo", tmp_path, "--quick"))
    outcome = here("demo", tmp_path, "--quick", "--seed", 3, "--force")
    assert f"go on with: mfd-bayes {said.format(tmp_path, tmp_path)}" in outcome.stderr


@pytest.mark.parametrize("name", ["mine.csv", "campaign/mine.csv", "campaign/p500_f0.5.csv/a"])
def test_a_demo_does_not_replace_a_campaign_that_is_not_its_own(tmp_path, name):
    begun(tmp_path, "campaign.toml")
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    sentence = sentence_of(here("demo", tmp_path, "--quick", "--force"))
    assert "is not a run folder" in sentence
    assert (tmp_path / name).read_text() == "mine"
    assert (tmp_path / "campaign" / "campaign.toml").is_file()


@pytest.mark.parametrize("options", [(), ("--force",)])
def test_a_demo_does_not_replace_what_is_no_run(tmp_path, options):
    (tmp_path / "thesis.txt").write_text("years of work")
    sentence = sentence_of(here("demo", tmp_path, "--quick", *options))
    assert str(tmp_path) in sentence
    assert contents(tmp_path) == {str(tmp_path / "thesis.txt"): b"years of work"}


@pytest.mark.parametrize("command", ["report", "check", "predict"])
@pytest.mark.parametrize("kind", ["missing", "empty", "text", "unfinished"])
def test_a_folder_without_a_finished_run_is_refused(folder, command, kind):
    out = folder.parent / "out"
    if kind != "missing":
        out.mkdir()
    if kind in ("text", "unfinished"):
        (out / "manifest.json").write_text("{" if kind == "text" else '{"status": "running"}')
    before = contents(folder.parent)
    more = ("--motion", folder / "p500.csv", "--actuation", "1 ksi", "-o", folder / "bands.csv")
    sentence = sentence_of(here(command, out, *(more if command == "predict" else ())))
    assert str(out) in sentence
    assert contents(folder.parent) == before


# --- looking without calibrating


def test_a_dry_run_names_the_tests_and_writes_nothing(folder):
    before = contents(folder.parent)
    out = folder.parent / "out"
    outcome = here("calibrate", folder / "campaign.toml", "-o", out, "--dry-run")
    assert outcome.exit_code == 0, outcome.output
    assert "p500 (201 samples)" in outcome.stdout
    assert "nothing was written" in outcome.stdout
    assert contents(folder.parent) == before


def test_a_dry_run_says_what_a_test_at_zero_does_not_tell(folder):
    with (folder / "campaign.toml").open("a") as file:
        file.write('\n[[test]]\nid = "idle"\nfile = "p500.csv"\nactuation = "0 psi"\n')
    before = contents(folder.parent)
    dry = ("calibrate", folder / "campaign.toml", "-o", folder.parent / "out", "--dry-run")
    outcome = here(*dry)
    assert outcome.exit_code == 0, outcome.output
    (line,) = [x for x in outcome.stdout.splitlines() if x.startswith("warning: laws: ")]
    assert "from idle nothing is learned about Fc_fwd (proportional), Fc_bwd (prop" in line
    assert contents(folder.parent) == before
    friction = "".join(f'F{kind}_{side} = "affine"\n' for kind in "cs" for side in ("fwd", "bwd"))
    change(folder, "[laws]", f"[laws]\n{friction}")
    assert "warning: laws" not in here(*dry).stdout


def test_a_dry_run_finds_the_same_faults(folder):
    write_csv(folder / "p500.csv", signals()[:60])
    assert_refused(folder, "turning point", arguments=("--dry-run",))


def faulty():
    """Signals of a force whose sign is swapped, with a spike and a hole in time."""
    table = signals()
    table[:, 2] *= -1
    table[100, 2] += 5
    return np.delete(table, [60, 61], axis=0)


def test_warnings_of_a_dry_run_are_a_line_each_and_no_error(folder):
    write_csv(folder / "p500.csv", faulty())
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("warning: p500: ")]
    for word in ("negative work", "isolated sample", "samples were dropped"):
        assert sum(word in line for line in lines) == 1
    write_csv(folder / "p500.csv", signals())
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert "negative work" not in outcome.stdout


@pytest.mark.usefixtures("small_pictures")
def test_inspect_warns_of_what_would_spoil_a_fit(folder, tmp_path):
    write_csv(folder / "p500.csv", faulty())
    for path in (folder / "p500.csv", folder / "campaign.toml"):
        outcome = here("inspect", path, "-o", tmp_path / "look")
        assert outcome.exit_code == 0, outcome.output
        for name in ("force sign", "spikes", "dropped samples"):
            assert f"warning              {name}: " in outcome.stdout
    write_csv(folder / "p500.csv", signals())
    assert "warning" not in here("inspect", folder / "p500.csv", "-o", tmp_path / "look").stdout


@pytest.mark.usefixtures("small_pictures")
def test_inspect_tells_loops_and_peaks(folder, tmp_path):
    outcome = here("inspect", folder / "p500.csv", "-o", tmp_path / "look")
    facts = ("1: amplitude 1 in, frequency 0.5 Hz", "kip, samples at a peak: 1", "force offset")
    for fact in facts:
        assert fact in outcome.stdout


# --- a first campaign


def test_init_writes_a_campaign_that_a_dry_run_accepts(folder):
    (folder / "campaign.toml").unlink()
    write_csv(folder / "1000psi_quake.csv", signals())
    (folder / "notes.txt").write_text("rain")
    outcome = here("init", folder)
    assert outcome.exit_code == 0, outcome.output
    for word in ("left out: notes.txt: ", "unsure: p500: psi is assumed", "tests 2, 1 left out"):
        assert word in outcome.stdout
    assert 'role = "validate" is suggested' in outcome.stdout
    assert "mfd-bayes inspect" in outcome.stdout
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


def test_init_says_what_is_missing_and_so_does_the_campaign(folder):
    (folder / "campaign.toml").unlink()
    (folder / "p500.csv").rename(folder / "first.csv")
    outcome = here("init", folder)
    assert outcome.exit_code == 0, outcome.output
    assert "FIXME: first: add actuation" in outcome.stdout
    assert "warning: " in outcome.stdout
    assert_refused(folder, "'first'.actuation is missing", arguments=("--dry-run",))


def test_init_keeps_an_existing_campaign(folder):
    before = contents(folder)
    assert "--force" in sentence_of(here("init", folder))
    assert contents(folder) == before
    assert here("init", folder, "--force").exit_code == 0
    assert contents(folder) != before


@pytest.mark.parametrize("way", ["missing", "file", "empty"])
def test_init_refuses_a_folder_without_tests(tmp_path, way):
    place = tmp_path / "here"
    if way == "file":
        place.write_text("a file")
    elif way == "empty":
        place.mkdir()
    before = contents(tmp_path)
    assert str(place) in sentence_of(here("init", place))
    assert contents(tmp_path) == before


def test_inspect_tells_what_a_file_holds(folder, tmp_path):
    outcome = here("inspect", folder / "p500.csv", "-o", tmp_path / "look")
    assert outcome.exit_code == 0, outcome.output
    facts = ("time_s [s]", "displacement_in [in]", "force_kip [kip]", "50 Hz", "201 over 4 s")
    for fact in (*facts, "turning points", "4 (2 cycles)"):
        assert fact in outcome.stdout
    (picture,) = (tmp_path / "look").iterdir()
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in outcome.stdout


def test_inspect_tells_what_a_campaign_holds(folder, tmp_path):
    outcome = here("inspect", folder / "campaign.toml", "-o", tmp_path / "look")
    assert outcome.exit_code == 0, outcome.output
    for fact in ("p500", "force_kip [kip]", "50 Hz", "turning points", "500 psi"):
        assert fact in outcome.stdout
    (picture,) = (tmp_path / "look").glob("*.png")
    assert "p500" in picture.name
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_inspect_takes_a_motion_without_force(tmp_path):
    write_csv(tmp_path / "quake.csv", signals()[:, :2], "time_s,displacement_in")
    outcome = here("inspect", tmp_path / "quake.csv", "-o", tmp_path)
    assert outcome.exit_code == 0, outcome.output
    assert list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "t,x\n0,1\n1,2\n", ("no column for time", "t, x", "rename it")),
        ("a.csv", "", ("a.csv", "empty")),
        ("a.xls", "x", ("'.xls'", ".xlsx")),
        ("a.xlsx", "PK", ("a.xlsx", "not an Excel workbook")),
        ("a.tdms", "TDMS", ("a.tdms", "not a TDMS file")),
        ("a.json", "{", ("a.json", "not valid JSON")),
        ("a.mat", "MATLAB", ("a.mat", "MATLAB")),
        ("a.toml", "[campaign", ("a.toml", "not valid TOML")),
    ],
)
def test_inspect_refuses_what_it_cannot_read(tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    sentence = sentence_of(here("inspect", tmp_path / name, "-o", tmp_path / "look"))
    for word in words:
        assert word in sentence
    assert not (tmp_path / "look").exists()


def test_inspect_names_a_file_that_is_not_there(tmp_path):
    sentence = sentence_of(here("inspect", tmp_path / "no.csv", "-o", tmp_path / "look"))
    assert "no.csv" in sentence
    assert not (tmp_path / "look").exists()


def test_prior_check_draws_what_the_priors_allow(folder, tmp_path):
    outcome = here("prior-check", folder / "campaign.toml", "-o", tmp_path / "look")
    assert outcome.exit_code == 0, outcome.output
    assert "p500" in outcome.stdout
    assert "95 % prior band" in outcome.stdout
    (picture,) = (tmp_path / "look").iterdir()
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("fault", ["force", "mass"])
def test_prior_check_refuses_what_it_cannot_draw(folder, tmp_path, fault):
    if fault == "force":
        change(folder, 'force = { name = "force_kip", unit = "kip" }', "")
    else:
        own_priors(folder, '"1.5 kip"', '"1e400 kip"')
    sentence_of(here("prior-check", folder / "campaign.toml", "-o", tmp_path / "look"))
    assert not (tmp_path / "look").exists()


# --- parts, left out


def assert_not_left_out(folder, by, *words):
    """Refuse to cross-validate with one sentence that has all the words, and write nothing."""
    before = contents(folder.parent)
    arguments = ("-o", folder.parent / "out", "--by", by, "--effort", "quick", "--jobs", 1)
    sentence = sentence_of(here("crossvalidate", folder / "campaign.toml", *arguments))
    for word in words:
        assert word in sentence
    assert contents(folder.parent) == before


def add_test(folder, **keys):
    """Another test of the campaign's own record."""
    entry = CAMPAIGN[CAMPAIGN.index("[[test]]") :].replace('id = "p500"', f'id = "{keys["id"]}"')
    entry = entry.replace("500 psi", keys.get("actuation", "500 psi"))
    with (folder / "campaign.toml").open("a") as file:
        file.write(entry + "".join(f'{k} = "{keys[k]}"\n' for k in keys if k == "session"))


def test_a_part_is_a_test_a_level_or_a_session(folder):
    assert_not_left_out(folder, "month", "--by", "test, level, session", "'month'")


def test_one_test_is_not_left_out(folder):
    assert_not_left_out(folder, "test", "campaign.toml", "two tests")


def test_one_level_is_not_left_out(folder):
    add_test(folder, id="again", actuation="502 psi")
    assert_not_left_out(folder, "level", "campaign.toml", "two levels")


def test_sessions_that_are_not_declared_are_asked_for(folder):
    add_test(folder, id="again")
    assert_not_left_out(folder, "session", "no calibrated test", "session =")
    change(folder, 'role = "calibrate"', 'role = "calibrate"\nsession = "Monday"')
    assert_not_left_out(folder, "session", "two sessions")


# --- models, compared


def assert_not_compared(folder, *words, models="three_stage,lugre,bouc_wen"):
    """Refuse to compare with one sentence that has all the words, and write nothing."""
    before = contents(folder.parent)
    out = folder.parent / "out"
    arguments = ("--models", models, "--effort", "quick", "--jobs", 1)
    sentence = sentence_of(here("compare", folder / "campaign.toml", "-o", out, *arguments))
    for word in words:
        assert word in sentence
    assert contents(folder.parent) == before


@pytest.mark.parametrize("models", ["three_stage", "lugre,lugre", "lugre,maxwell", ","])
def test_models_to_compare_are_two_that_are_known(folder, models):
    assert_not_compared(folder, "--models", "three_stage, lugre, bouc_wen", models=models)


def test_a_record_of_too_few_cycles_is_not_compared(folder):
    assert_not_compared(folder, "'p500'", "at least 3 cycles, got 2")


def test_priors_that_lack_a_model_are_named_only_where_it_is_compared(folder):
    time = np.arange(401) / 50.0
    motion = np.sin(np.pi * time)
    write_csv(folder / "p500.csv", np.column_stack([time, motion, np.cos(np.pi * time)]))
    own_priors(folder, "[parameters.Fy_fwd]", "[parameters.Fy_fwd]")
    text = (folder / "own.toml").read_text()
    entry = text[text.index("[parameters.Fy_fwd]") : text.index("[parameters.Fy_bwd]")]
    (folder / "own.toml").write_text(text.replace(entry, ""))
    assert_not_compared(folder, "own.toml", "Fy_fwd")
    outcome = here("calibrate", folder / "campaign.toml", "-o", folder / "out", "--dry-run")
    assert outcome.exit_code == 0, outcome.output


def test_a_folder_that_exists_is_not_compared_into(folder):
    time = np.arange(401) / 50.0
    motion = np.sin(np.pi * time)
    write_csv(folder / "p500.csv", np.column_stack([time, motion, np.cos(np.pi * time)]))
    (folder.parent / "out" / "lugre").mkdir(parents=True)
    assert_not_compared(folder, "lugre", "--resume", "--force")


# --- the installed command


def installed(*arguments, **variables):
    return subprocess.run(
        [COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=os.environ | variables,
        timeout=60,
        check=False,
    )


def test_the_installed_command_refuses_bad_input_with_one_sentence(folder):
    edit_line(folder, 17, "0.3,0.8,fast")
    out = folder.parent / "out"
    outcome = installed("calibrate", folder / "campaign.toml", "-o", out)
    assert outcome.returncode == 2
    assert outcome.stdout == ""
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: line 17 of ")
    assert sentence.endswith("column 'force_kip': expected a finite number, found 'fast'")
    assert not out.exists()


def test_the_installed_command_tells_its_version():
    outcome = installed("--version")
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert outcome.stdout == f"mfd-bayes {mfd_bayes.__version__}\n"


def test_the_help_lists_every_command():
    for way in (("--help",), ("-h",)):
        outcome = here(*way)
        assert outcome.exit_code == 0
        for command in COMMANDS:
            assert command in outcome.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("calibrate",),
        ("calibrate", "campaign.toml"),
        ("calibrate", "campaign.toml", "-o", "out", "--effort", "heroic"),
        ("calibrate", "campaign.toml", "-o", "out", "--jobs", "-1"),
        ("calibrate", "campaign.toml", "-o", "out", "--seed", "-1"),
        ("calibrate", "campaign.toml", "-o", "out", "--quick"),
        ("fit",),
    ],
)
def test_a_wrong_call_exits_with_2(arguments):
    outcome = here(*arguments)
    assert outcome.exit_code == 2
    assert outcome.stderr


def test_a_folder_in_place_of_a_file_is_named(tmp_path):
    refused_folder = here("calibrate", tmp_path, "-o", tmp_path / "out")
    assert str(tmp_path / "campaign.toml") in sentence_of(refused_folder)
    assert "is a folder" in sentence_of(here("inspect", tmp_path))


def test_a_mistyped_campaign_file_gets_a_suggestion(tmp_path):
    (tmp_path / "campaign.toml").write_text("")
    outcome = here("calibrate", tmp_path / "campagn.toml", "-o", tmp_path / "out")
    assert f"did you mean {tmp_path / 'campaign.toml'}?" in sentence_of(outcome)


def test_the_effort_of_a_run_is_taken_where_it_is_resumed(tmp_path):
    out = tmp_path / "out"
    shutil.copytree(Path(__file__).parents[1] / "data" / "run", out)
    assert pipeline.effort_of(out, None, resume=True) == "quick"
    assert pipeline.effort_of(out, "thorough", resume=True) == "thorough"
    assert pipeline.effort_of(out, None, resume=False) == "standard"
    assert pipeline.effort_of(tmp_path, None, resume=True) == "quick"  # runs of several models


def test_a_record_that_is_used_twice_is_a_warning(folder):
    path = folder / "campaign.toml"
    again = CAMPAIGN[CAMPAIGN.index("[[test]]") :]
    again = again.replace("p500", "again")
    table = signals()
    write_csv(folder / "again.csv", table * (1, 25.4, 1), "time_s,displacement_mm,force_kip")
    again = again.replace(
        'role = "calibrate"', 'columns.displacement = { name = "displacement_mm", unit = "mm" }'
    )
    path.write_text(f"{CAMPAIGN}\n{again}")
    outcome = here("calibrate", path, "-o", folder / "out", "--dry-run")
    assert "again: same record as p500" in outcome.stdout + outcome.stderr
    table[:, 2] *= 1.1 + 0.1 * np.sin(table[:, 0])
    write_csv(folder / "again.csv", table * (1, 25.4, 1), "time_s,displacement_mm,force_kip")
    outcome = here("calibrate", path, "-o", folder / "out", "--dry-run")
    assert "same record" not in outcome.stdout + outcome.stderr
