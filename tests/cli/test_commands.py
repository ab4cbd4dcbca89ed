"""The command line refuses wrong input with one sentence, and writes nothing then."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app

PRIORS = Path(__file__).parents[2] / "priors" / "mfd.toml"
ENTRY = """\
[[test]]
id = "p500"
file = "p500.csv"
actuation = "500 psi"
role = "calibrate"
"""
CAMPAIGN = f"""\
[campaign]
title = "Small"
priors = "mfd"

[columns]
time = {{ name = "time_s", unit = "s" }}
displacement = {{ name = "displacement_in", unit = "in" }}
force = {{ name = "force_kip", unit = "kip" }}

[laws]

{ENTRY}"""
FORCE = 'force = { name = "force_kip", unit = "kip" }'
HEAD = "time_s,displacement_in,force_kip"


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def signals(cycles=2):
    """Time, displacement and force of some cycles with a gap, (100 · cycles + 1, 3)."""
    time = np.arange(100 * cycles + 1) / 50.0
    motion = np.sin(np.pi * time)
    force = np.tanh(4 * np.gradient(motion, time)) + 0.01 * np.cos(37 * time)
    return np.column_stack([time, motion, force])


def write_csv(path, table, header=HEAD):
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


def append(folder, *entries):
    with (folder / "campaign.toml").open("a") as file:
        file.write("".join(entries))


def edit_line(folder, number, text):
    path = folder / "p500.csv"
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


def contents(place):
    return {str(p): p.read_bytes() if p.is_file() else None for p in place.rglob("*")}


def sentence_of(outcome):
    """The sentence of a command that was refused with exit code 2."""
    assert outcome.exit_code == 2, (outcome.output, outcome.exception)
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    return sentence


def assert_refused(folder, *words, command="calibrate", arguments=()):
    """Refuse with one sentence that has all the words, and write nothing."""
    before = contents(folder.parent)
    quick = ("-o", folder.parent / "out", "--jobs", 1, "--effort", "quick")
    sentence = sentence_of(here(command, folder / "campaign.toml", *quick, *arguments))
    for word in words:
        assert word in sentence
    assert contents(folder.parent) == before


def accepted(folder):
    """What a dry run says, which accepts the campaign and writes nothing."""
    before = contents(folder.parent)
    outcome = here("calibrate", folder / "campaign.toml", "--dry-run")
    assert outcome.exit_code == 0, outcome.output
    assert "nothing was written" in outcome.stdout
    assert contents(folder.parent) == before
    return outcome.stdout


# --- records


def test_a_cell_that_is_no_number_is_named_by_line_and_column(folder):
    for cell, place in [("nan", 0), ("fast", 1), ("", 2)]:
        cells = ["0.3", "0.8", "0.9"]
        cells[place] = cell
        edit_line(folder, 17, ",".join(cells))
        column = HEAD.split(",")[place]
        assert_refused(folder, "p500.csv", "line 17", column, "expected a finite number")


def still(table):
    table[:, 1] = 0.25
    return table


def test_a_record_that_holds_too_little_is_refused(folder):
    for changed, words in [
        (still, ("p500.csv", "displacement", "constant")),
        (lambda table: table[:60], ("p500.csv", "1 turning point", "at least 2")),
        (lambda table: table[:10], ("p500.csv", "10 samples", "at least 20")),
        (lambda table: table[:0], ("p500.csv", "no data")),
    ]:
        write_csv(folder / "p500.csv", changed(signals()))
        assert_refused(folder, *words)
        assert_refused(folder, *words, arguments=("--dry-run",))


def test_warnings_of_a_dry_run_are_a_line_each_and_no_error(folder):
    assert "p500 (201 samples)" in accepted(folder)
    table = signals()
    table[:, 2] *= -1
    table[100, 2] += 5
    write_csv(folder / "p500.csv", np.delete(table, [60, 61], axis=0))
    lines = [x for x in accepted(folder).splitlines() if x.startswith("warning: p500: ")]
    for word in ("negative work", "isolated sample", "samples were dropped"):
        assert sum(word in line for line in lines) == 1


# --- campaign files


def test_a_fault_in_the_campaign_is_named(folder):
    for old, new, words in [
        ("title =", "titel =", ("'titel'", "'title'", "[campaign]")),
        ("[laws]", '[laws]\nFc_fwdd = "affine"', ("'Fc_fwdd'", "'Fc_fwd'", "[laws]")),
        ('role = "calibrate"', 'role = "calibration"', ("role", "'p500'", "'calibration'")),
        ('role = "calibrate"', 'role = "validate"', ("no test with role 'calibrate'",)),
        ('priors = "mfd"', 'priors = "mdf"', ("'mdf'", "brfd", "mfd")),
        ('priors = "mfd"', 'model = "maxwell"', ("model", "'maxwell'", "'three_stage'")),
        ('priors = "mfd"', 'rate = "64 s"', ("rate", "measures time", "'Hz'")),
        ('priors = "mfd"', "priors = mfd", ("campaign.toml", "not valid TOML", "line 3")),
        ('actuation = "500 psi"', 'actuation = "500"', ("p500", "unit")),
        ('actuation = "500 psi"', 'actuation = "0 psi"', ("actuation above zero",)),
        ('file = "p500.csv"', 'file = "p600.csv"', ("p600.csv", "p500", "does not exist")),
        ('id = "p500"', 'id = "../p500"', ("id", "../p500")),
        ('role = "calibrate"', 'fit = "9 s to 20 s"', ("p500.csv", "4 s", "window")),
        ('role = "calibrate"', ENTRY, ("campaign.toml", "two tests", "'p500'")),
        ("[laws]", '[laws]\nFs_fwd = "affine"', ("Fs_fwd", "Fc_fwd", "'affine'")),
        ("[laws]", '[dependence]\nFc_fwd = ["speed"]', ("dependence.Fc_fwd", "'speed'")),
        ('"displacement_in", unit = "in"', '"displacement_in", unit = "kip"', ("measures force",)),
        ('unit = "kip"', 'unit = "kipp"', ("p500.csv", "'kipp'", "unknown", "'kN'")),
        (FORCE, "", ("p500", "force")),
    ]:
        (folder / "campaign.toml").write_text(CAMPAIGN)
        change(folder, old, new)
        assert_refused(folder, *words)


@pytest.mark.parametrize("way", ["dots", "link"])
def test_a_file_outside_the_campaigns_folder_is_refused(folder, way):
    outside = folder.parent / "p500.csv"
    (folder / "p500.csv").rename(outside)
    if way == "link":
        (folder / "p500.csv").symlink_to(outside)
    else:
        file = "../p500.csv" if way == "dots" else str(outside)
        change(folder, 'file = "p500.csv"', f'file = "{file}"')
    assert_refused(folder, "p500.csv", "'p500'", "outside the campaign's folder")


def test_a_campaign_file_that_is_not_there_is_named_with_one_like_it(folder, tmp_path):
    outcome = here("calibrate", folder / "campagn.toml", "-o", tmp_path / "out")
    assert "did you mean 'campaign.toml'?" in sentence_of(outcome)
    outcome = here("calibrate", folder, "-o", tmp_path / "out")
    assert str(folder / "campaign.toml") in sentence_of(outcome)
    (folder / "campaign.toml").unlink()
    assert_refused(folder, "campaign.toml", "No such file")


# --- priors


def own_priors(folder, old, new, end=None):
    """Priors of the user's own: a text replaced, or all from it up to another one."""
    text = PRIORS.read_text()
    old = text[text.index(old) : text.index(end)] if end else old
    assert old in text
    (folder / "own.toml").write_text(text.replace(old, new, 1))
    change(folder, 'priors = "mfd"', 'priors = "own.toml"')


def test_a_fault_in_the_priors_is_named(folder):
    for old, new, words in [
        ('family = "lognormal"', 'family = "log"', ("sigma0", "'log'", "lognormal")),
        ('"80 kip/in"', '"80 kip"', ("sigma0", "median", "stiffness")),
        ("[parameters.k3]", "[parameters.k4]", ("k4", "unknown parameter")),
        ('parameters = ["sigma0"]', "parameters = []", ("[scatter]", "sigma0")),
        ('"1.5 kip"', '"1e30 kip"', ("'p500'", "no mass at any start")),
    ]:
        (folder / "campaign.toml").write_text(CAMPAIGN)
        own_priors(folder, old, new)
        assert_refused(folder, "own.toml", *words)


# --- run folders


def test_a_place_of_other_things_is_refused_and_kept(folder):
    for options in [(), ("--force",), ("--resume",)]:
        out = folder.parent / "out"
        out.mkdir()
        (out / "thesis.txt").write_text("years of work")
        assert_refused(folder, str(out), arguments=options)
        (out / "thesis.txt").rename(folder.parent / "thesis.txt")
        out.rmdir()
        out.write_text("a file")
        assert_refused(folder, str(out), arguments=options)
        below = folder / "p500.csv" / "out"
        arguments = ("-o", below, "--jobs", 1, *options)
        assert str(below) in sentence_of(here("calibrate", folder / "campaign.toml", *arguments))
        out.unlink()


def begun(folder):
    """A folder as a demo leaves it that is interrupted in its first moments."""
    (folder / "campaign").mkdir(parents=True)
    for name in ("p0_f0.05.csv", ".p500_f0.05.csv.ab12cd.part", "campaign.toml"):
        (folder / "campaign" / name).write_text(HEAD)
    (folder / ".owner.json").write_text("{}")


@pytest.mark.parametrize("name", ["mine.csv", "campaign/mine.csv"])
def test_a_demo_does_not_replace_what_is_not_its_own(tmp_path, name):
    begun(tmp_path)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    before = contents(tmp_path / "campaign")
    assert "is not a run folder" in sentence_of(here("demo", tmp_path, "--quick", "--force"))
    assert (tmp_path / name).read_text() == "mine"
    assert contents(tmp_path / "campaign") == before


def test_a_folder_without_a_finished_run_is_refused(folder):
    for command, manifest in [
        ("report", None),
        ("check", "{"),
        ("predict", '{"status": "running"}'),
    ]:
        out = folder.parent / "out"
        if manifest:
            out.mkdir(exist_ok=True)
            (out / "manifest.json").write_text(manifest)
        before = contents(folder.parent)
        more = ("--motion", folder / "p500.csv", "--actuation", "1 ksi", "-o", folder / "bands.csv")
        assert str(out) in sentence_of(here(command, out, *(more if command == "predict" else ())))
        assert contents(folder.parent) == before


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
    accepted(folder)


def test_init_keeps_an_existing_campaign_and_refuses_a_folder_without_tests(folder, tmp_path):
    before = contents(folder)
    assert "--force" in sentence_of(here("init", folder))
    assert contents(folder) == before
    assert here("init", folder, "--force").exit_code == 0
    assert contents(folder) != before
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("a file")
    before = contents(tmp_path)
    for name in ("empty", "file", "missing"):
        assert str(tmp_path / name) in sentence_of(here("init", tmp_path / name))
    assert contents(tmp_path) == before


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
    table = signals()
    table[:, 2] *= -1
    table[100, 2] += 5
    write_csv(folder / "p500.csv", np.delete(table, [60, 61], axis=0))
    for path in (folder / "p500.csv", folder / "campaign.toml"):
        outcome = here("inspect", path, "-o", tmp_path / "look")
        assert outcome.exit_code == 0, outcome.output
        for name in ("force sign", "spikes", "dropped samples"):
            assert f"warning              {name}: " in outcome.stdout
    table = signals()
    table[60:, 0] += 1.0
    write_csv(folder / "p500.csv", table)
    outcome = here("inspect", folder / "p500.csv", "-o", tmp_path / "piece")
    for words in ("gap in time: time has a gap of 1.02 s before line 62", "is used, 2.2 s to 5 s"):
        assert words in outcome.stdout
    write_csv(tmp_path / "quake.csv", signals()[:, :2], "time_s,displacement_in")  # without force
    assert here("inspect", tmp_path / "quake.csv", "-o", tmp_path / "quake").exit_code == 0


def test_prior_check_draws_what_the_priors_allow_and_refuses_what_it_cannot(folder, tmp_path):
    outcome = here("prior-check", folder / "campaign.toml", "-o", tmp_path / "look")
    assert outcome.exit_code == 0, outcome.output
    assert "p500: " in outcome.stdout
    assert "95 % prior band" in outcome.stdout
    (picture,) = (tmp_path / "look").iterdir()
    assert picture.read_bytes().startswith(b"\x89PNG")
    own_priors(folder, '"1.5 kip"', '"1e400 kip"')
    sentence_of(here("prior-check", folder / "campaign.toml", "-o", tmp_path / "no"))
    change(folder, 'priors = "own.toml"', 'priors = "mfd"')
    change(folder, FORCE, "")
    sentence_of(here("prior-check", folder / "campaign.toml", "-o", tmp_path / "no"))
    assert not (tmp_path / "no").exists()


# --- parts, left out, and models, compared


def test_what_cannot_be_left_out_is_refused(folder):
    for by, entries, words in [
        ("month", (), ("--by", "test, level, session", "'month'")),
        ("test", (), ("campaign.toml", "two tests")),
        ("session", ("700 psi",), ("no calibrated test", "session =")),
        ("session", ('700 psi"\nsession = "Monday',), ("two sessions",)),
    ]:
        (folder / "campaign.toml").write_text(CAMPAIGN)
        for level in entries:
            append(folder, ENTRY.replace('"p500"', '"again"').replace("500 psi", level))
        if "session" in "".join(entries):
            change(folder, 'actuation = "500 psi"', 'actuation = "500 psi"\nsession = "Monday"')
        assert_refused(folder, *words, command="crossvalidate", arguments=("--by", by))


def test_what_cannot_be_compared_is_refused(folder):
    compare = {"command": "compare", "arguments": ("--models", "three_stage,lugre,bouc_wen")}
    assert_refused(folder, "'p500'", "at least 3 cycles, got 2", **compare)
    write_csv(folder / "p500.csv", signals(4))
    (folder.parent / "out" / "lugre").mkdir(parents=True)
    assert_refused(folder, "lugre", "--resume", "--force", **compare)
    (folder.parent / "out" / "lugre").rmdir()
    own_priors(folder, "[parameters.Fy_fwd]", "", "[parameters.Fy_bwd]")
    assert_refused(folder, "own.toml", "Fy_fwd", **compare)
    accepted(folder)  # the campaign's own model needs no such prior
