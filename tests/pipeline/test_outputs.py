"""What a command writes replaces nothing that exists, but for --force."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.errors import StoreError
from mfd_bayes.store.files import write_text
from tests.run_folders import write_run

pytestmark = pytest.mark.usefixtures("small_pictures")

CAMPAIGN = """\
[[test]]
id = "p500"
file = "{file}"
actuation = "500 psi"
"""


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def state(folder):
    """Every file of a folder with its content, and every other thing with its kind."""
    return {
        p.relative_to(folder): p.read_bytes() if p.is_file() else p.lstat().st_mode
        for p in folder.rglob("*")
    }


def refused(outcome, words):
    assert outcome.exit_code == 2, outcome.output
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    assert words in sentence


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A finished run folder that no sampler has seen."""
    folder = tmp_path_factory.mktemp("stored") / "out"
    write_run(folder, small=True)
    return folder


@pytest.fixture
def home(stored, tmp_path):
    """A folder with a run, a motion, a record with its campaign, and a table of another program."""
    shutil.copytree(stored, tmp_path / "out")
    time = np.arange(201) / 50
    motion = np.sin(np.pi * time)
    table = np.column_stack([time, motion, np.tanh(4 * np.cos(np.pi * time))])
    for name in ("m.csv", "x_derived.csv"):
        write_text(tmp_path / name, csv(table))
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(file="m.csv"))
    return tmp_path


def csv(table):
    lines = "".join(",".join(f"{x:.6f}" for x in row) + "\n" for row in table)
    return "time_s,displacement_in,force_kip\n" + lines


def make_device(path):
    os.mknod(path, 0o20666, os.makedev(1, 3))  # as /dev/null


def predict(home, bands, *options, motion="m.csv"):
    asked = ("--motion", home / motion, "--actuation", "500 psi", "-o", home / bands, "-q")
    return here("predict", home / "out", *asked, *options)


def test_a_prediction_is_not_written_over_inputs_or_a_run(home):
    for bands, motion, words in [
        ("m.csv", "m.csv", "is an input of this command"),
        ("x.csv", "x_derived.csv", "is an input of this command"),
        ("out/manifest", "m.csv", None),
        ("out/laws.csv", "m.csv", "is a file of the run"),
        ("out/population.nc", "m.csv", "is a file of the run"),
        ("..", "m.csv", "name of a file"),
    ]:
        before = state(home)
        outcome = predict(home, bands, "--force", motion=motion)
        if words is None:  # a new file in a run folder loses nothing
            assert outcome.exit_code == 0, outcome.output
            assert all(state(home)[name] == content for name, content in before.items())
        else:
            refused(outcome, words)
            assert state(home) == before


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("pipe", "band.csv"),
        ("device", "band_history.png"),
        ("link", "band_design.csv"),
    ],
)
def test_a_prediction_is_not_written_over_what_is_no_file(home, kind, name):
    if kind == "device" and os.geteuid() != 0:
        pytest.skip("only root makes a device")
    (home / "there").mkdir()
    place = home / "there" / name
    make = {"pipe": os.mkfifo, "device": make_device}
    make.get(kind, lambda path: path.symlink_to(home / "mine.csv"))(place)
    before = state(home)
    outcome = predict(home, "there/band.csv", "--design", "--force")
    refused(outcome, "link out of its folder" if kind == "link" else "a device or a pipe")
    assert state(home) == before


@pytest.mark.parametrize("name", ["mine.csv", "mine_design.csv"])
def test_a_file_that_exists_is_replaced_only_by_force(home, name):
    shutil.copy(home / "mine.csv", home / "content")
    (home / "mine.csv").unlink()
    shutil.copy(home / "content", home / name)
    before = state(home)
    refused(predict(home, "mine.csv", "--design"), "--force")
    assert state(home) == before
    assert predict(home, "mine.csv", "--design", "--force").exit_code == 0
    assert (home / name).read_bytes() != before[Path(name)]
    assert predict(home, "mine.csv", "--force").exit_code == 0
    assert not (home / "mine_design.csv").exists()  # bounds of another prediction


def test_a_harmonic_motion_is_predicted_into_a_new_folder(home):
    bands = home / "new" / "bands.csv"
    asked = ("predict", home / "out", "--sine", "1 in, 0.5 Hz, 2 cycles", "--actuation", "500 psi")
    assert here(*asked, "-o", bands, "-q").exit_code == 0
    names = {"bands.csv", "bands.png", "bands_history.png", "bands_derived.csv"}
    assert {path.name for path in bands.parent.iterdir()} == names
    bands.unlink()
    refused(here(*asked, "-o", bands), "bands.png exists")
    refused(here(*asked, "-o", bands.parent), "give the name of a file")
    assert here(*asked, "-o", bands, "-q", "--no-figures", "--force").exit_code == 0
    assert {path.name for path in bands.parent.iterdir()} == {"bands.csv", "bands_derived.csv"}


@pytest.mark.parametrize("name", ["tests/m.csv", "figures/campaign.toml", "campaign.toml"])
def test_a_run_is_not_replaced_with_its_inputs_in_it(home, name):
    place = home / "out" / name
    place.parent.mkdir(exist_ok=True)
    if place.suffix == ".csv":
        shutil.copy(home / "m.csv", place)
        campaign = home / "campaign.toml"
        campaign.write_text(CAMPAIGN.format(file=f"out/{name}"))
    else:
        shutil.copy(home / "m.csv", place.parent)
        shutil.copy(home / "campaign.toml", place)
        campaign = place
    before = state(home)
    options = ("--force", "--resume") if name == "tests/m.csv" else ("--force",)
    for option in options:
        refused(here("calibrate", campaign, "-o", home / "out", option), "would be lost")
    assert state(home) == before


@pytest.mark.parametrize("name", ["report.html"])
def test_a_run_does_not_replace_a_pipe_or_a_link_out_of_its_folder(home, name):
    place = home / "out" / name
    place.unlink(missing_ok=True)
    place.symlink_to(home / "mine.csv")
    outcome = here("calibrate", home / "campaign.toml", "-o", home / "out", "--force")
    refused(outcome, "link out of its folder")
    with pytest.raises(StoreError, match="link out of its folder"):
        write_text(place, "{}")
    assert place.is_symlink()
    assert (home / "mine.csv").read_text() == "a,b\n1,2\n"


def test_an_empty_text_is_no_value_of_an_option_and_no_path(home, monkeypatch):
    for arguments in [
        ("calibrate", "campaign.toml", "-o", ""),
        ("demo", ""),
        ("check", " "),
        ("predict", "out", "--motion", "", "--actuation", "1 ksi", "-o", "b.csv"),
        ("predict", "out", "--sine", "1 in", "--actuation", "1 ksi", "-o", "b.csv", "--given", ""),
        ("next", "out", "--goal", ""),
    ]:
        monkeypatch.chdir(home)
        before = state(home)
        outcome = here(*arguments)
        assert outcome.exit_code == 2, outcome.output
        assert "got an empty text" in " ".join(outcome.stderr.split())
        assert state(home) == before


def test_a_folder_that_cannot_be_used_is_refused_and_kept(home):
    for out, options, said in [
        (".", ("--dry-run",), "exists: give --resume to finish it or --force"),
        ("out", ("--dry-run", "--resume", "--force"), "give either --resume or --force"),
        ("other", ("--resume",), "give another folder by -o"),
        ("other", ("--force",), "exists and"),
    ]:
        (home / "other").mkdir(exist_ok=True)
        (home / "other" / "thesis.tex").write_text("x")
        before = state(home)
        refused(here("calibrate", home / "campaign.toml", "-o", home / out, *options), said)
        assert state(home) == before


def test_a_first_building_has_the_actuation_of_the_campaign_beside_it(home):
    assert here("init", "--building", home).exit_code == 0
    text = (home / "building.toml").read_text()
    assert text.count('actuation = "500 psi"') == 3
    refused(here("init", "--building", home), "building.toml exists: give --force")
    campaign = (home / "campaign.toml").read_text().replace("500 psi", "36 lbf")
    (home / "campaign.toml").write_text(campaign)
    assert here("init", "--building", home, "--force").exit_code == 0
    assert (home / "building.toml").read_text().count('actuation = "36 lbf"') == 3
    (home / "other").mkdir()
    assert here("init", "--building", home / "other").exit_code == 0  # without a campaign
    assert 'actuation = "1000 psi"' in (home / "other" / "building.toml").read_text()


def test_a_dry_run_needs_no_folder_and_a_run_does(home):
    found = here("calibrate", home / "campaign.toml", "--dry-run")
    assert found.exit_code == 0, found.output
    assert "would calibrate p500 (" in found.output
    outcome = here("calibrate", home / "campaign.toml")
    assert outcome.exit_code == 2
    assert "-o: missing: give the run folder to write" in outcome.stderr
    where = home / "no" / "campaign.toml"
    refused(here("calibrate", where, "--dry-run"), f"there is no folder {where.parent}")
