"""What a command writes replaces nothing that exists, but for --force and its own earlier files."""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.applications.export.options import ExportOptions
from mfd_bayes.applications.export.samples import export
from mfd_bayes.errors import CampaignError
from tests.command_line import contents, refusal, said, write_csv

CAMPAIGN = """\
[[test]]
id = "p500"
file = "{file}"
actuation = "500 psi"
"""
SINE = ("--sine", "1 in, 0.5 Hz, 2 cycles", "--actuation", "500 psi", "--no-figures", "-q")
TIME = np.arange(201) / 50


@pytest.fixture
def home(small_run, tmp_path):
    """A folder with a run, a motion, a record with its campaign, and a table of another program."""
    shutil.copytree(small_run, tmp_path / "out")
    for name in ("m.csv", "x_derived.csv"):
        force = np.tanh(4 * np.cos(np.pi * TIME))
        write_csv(tmp_path / name, TIME, np.sin(np.pi * TIME), force)
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(file="m.csv"))
    return tmp_path


def refused(folder, words, *command):
    snapshot = contents(folder)
    assert words in refusal(*command)
    assert contents(folder) == snapshot


# --- predictions


def test_a_prediction_is_not_written_over_inputs_or_a_run(home):
    for bands, motion, words in [
        ("m.csv", "m.csv", "is an input of this command"),
        ("x.csv", "x_derived.csv", "is an input of this command"),
        ("out/population.nc", "m.csv", "is a file of the run"),
        ("mine.csv/b.csv", "m.csv", "b.csv"),
    ]:
        options = ("--motion", home / motion, "--actuation", "500 psi", "--no-figures", "--force")
        refused(home, words, "predict", home / "out", *options, "-o", home / bands)
    snapshot = contents(home)
    said("predict", home / "out", *SINE, "-o", home / "out/manifest")  # loses nothing
    assert snapshot.items() <= contents(home).items()


def test_a_prediction_is_not_written_over_what_is_no_file(home):
    path = home / "there" / "band_design.csv"
    path.parent.mkdir()
    options = (*SINE, "--design", "--force", "-o", home / "there/band.csv")
    os.mkfifo(path)
    refused(home, "a device or a pipe", "predict", home / "out", *options)
    path.unlink()
    path.symlink_to(home / "mine.csv")
    refused(home, "link out of its folder", "predict", home / "out", *options)


@pytest.mark.usefixtures("small_pictures")
def test_a_file_that_exists_is_replaced_only_by_force(home):
    bands = home / "new" / "bands.csv"
    sine = ("predict", home / "out", *SINE[:4], "-q", "-o", bands)
    said(*sine)
    names = {"bands.csv", "bands.png", "bands_history.png", "bands_derived.csv"}
    assert {path.name for path in bands.parent.iterdir()} == names
    bands.unlink()
    refused(home, "bands.png exists", *sine)
    refused(home, "give the name of a file", *sine[:-1], bands.parent)
    said(*sine, "--no-figures", "--force")
    assert {path.name for path in bands.parent.iterdir()} == {"bands.csv", "bands_derived.csv"}
    bands.with_name("bands_design.csv").write_text("mine")
    refused(home, "--force", *sine, "--design")
    said(*sine, "--design", "--force")
    assert bands.with_name("bands_design.csv").read_text() != "mine"
    said(*sine, "--force")
    assert not bands.with_name("bands_design.csv").exists()  # bounds of another prediction


def test_an_empty_text_is_no_value_of_an_option_and_no_path(home, monkeypatch):
    monkeypatch.chdir(home)
    snapshot = contents(home)
    for words in [
        ("calibrate", "campaign.toml", "-o", ""),
        ("demo", ""),
        ("check", " "),
        (
            "predict",
            "out",
            "--sine",
            "1 in",
            "--actuation",
            "1 ksi",
            "-o",
            "b.csv",
            "--condition-on",
            "",
        ),
        ("next", "out", "--goal", ""),
    ]:
        assert "got an empty text" in said(*words, code=2)
        assert contents(home) == snapshot


# --- runs


def test_a_run_is_not_replaced_with_its_inputs_in_it(home):
    def lost(campaign, *options):
        for option in options:
            refused(home, "would be lost", "calibrate", campaign, "-o", home / "out", option)

    for name in ("m.csv", "campaign.toml"):
        shutil.copy(home / name, home / "out")
    lost(home / "out" / "campaign.toml", "--force")
    shutil.copy(home / "m.csv", home / "out" / "tests")
    (home / "campaign.toml").write_text(CAMPAIGN.format(file="out/tests/m.csv"))
    lost(home / "campaign.toml", "--force", "--resume")


def test_a_folder_that_cannot_be_used_is_refused_and_kept(home):
    (home / "other").mkdir()
    (home / "other" / "thesis.tex").write_text("x")
    run = ("calibrate", home / "campaign.toml")
    for target, options, words in [
        (".", ("--dry-run",), "exists: give --resume to finish it or --force"),
        ("out", ("--dry-run", "--resume", "--force"), "give either --resume or --force"),
        ("other", ("--resume",), "give another folder by -o"),
        ("other", ("--force",), "exists and"),
        ("mine.csv", ("--force",), "mine.csv"),
    ]:
        refused(home, words, *run, "-o", home / target, *options)
    assert "would calibrate p500 (" in said(*run, "--dry-run")  # which needs no folder
    assert "-o: missing: give the run folder to write" in said(*run, code=2)


# --- buildings and responses


def test_an_earlier_response_goes_and_what_is_anothers_stays(home, monkeypatch):
    folder = home / "response"
    earlier = {"history_2.png", "loops_2.png", "sweep.png", "sweep.csv"}
    theirs = {"sweep_mine.csv", "notes.txt", "history.png"}
    folder.mkdir()
    for name in earlier | theirs:
        (folder / name).write_bytes(b"x")
    storey = '[[storey]]\nweight = "20 kip"\nstiffness = "8 kip/in"\n'
    (home / "b.toml").write_text(f"[building]\n{storey}")
    names = ("time_s", "acceleration_in/s^2")
    write_csv(home / "g.csv", TIME[:50], 100.0 * np.sin(10 * TIME[:50]), names=names)
    run_folder = (home / "out").rename(home / "brake 7")
    monkeypatch.chdir(run_folder)  # whose name the page says all the same
    words = ("respond", ".", "--building", "../b.toml", "--ground", "../g.csv", "--force")
    said(*words, "-o", folder, "--draws", "10", "--jobs", "1")
    written = {path.name for path in folder.iterdir()}
    assert written >= {"report.html", "peaks.csv", "response.json", *theirs}
    assert not written & earlier
    assert "of the device in brake 7, 0 dampers" in (folder / "report.html").read_text()


# --- samples for other programs


@pytest.fixture
def samples(small_run, tmp_path):
    """A folder with samples in columns, with materials, and with files of someone else."""
    folder = tmp_path / "samples"
    export(ExportOptions(small_run, "quofem", folder, "700 psi", 10))
    metadata = json.loads((folder / "about.json").read_text())
    fits = {"misfit": {"BoucWen": [0.1], "../mine": [0.1]}, "best": "BoucWen"}
    (folder / "about.json").write_text(json.dumps(metadata | fits))
    for name in ("BoucWen.tcl", "mine.txt", "../mine.tcl"):
        (folder / name).write_text("mine")
    return folder


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_samples_of_another_actuation_do_not_stay_beside_new_ones(small_run, samples):
    listing = names(samples)
    quofem = {"randomVariables.json", "dakotaTab.out", "sigma0.txt"}
    assert listing >= {*quofem, "BoucWen.tcl"}
    assert "start.txt" not in listing  # the model has no gap
    export(
        ExportOptions(small_run, "csv", samples, "700 psi", 10, force=True)
    )  # another form of the same
    assert names(samples) == listing | {"samples.csv"}
    assert json.loads((samples / "about.json").read_text())["best"] == "BoucWen"
    export(ExportOptions(small_run, "csv", samples, "800 psi", 10, force=True))
    assert names(samples) == {"samples.csv", "about.json", "mine.txt"}
    assert (samples.parent / "mine.tcl").is_file()
    metadata = json.loads((samples / "about.json").read_text())
    assert metadata["actuation"] == {"value": 0.8, "unit": "ksi"}
    assert "misfit" not in metadata


def test_an_actuation_outside_is_warned_of_and_one_far_outside_refused(small_run, samples):
    far = ExportOptions(small_run, "csv", samples, "50000 psi", 10, force=True)
    with pytest.raises(CampaignError, match=r"the actuation, 50000 psi, lies far .* --extrapolate"):
        export(far)
    (remark,) = export(replace(far, extrapolate=True))[1]
    assert "lies far outside the tested range" in remark
    assert json.loads((samples / "about.json").read_text())["remarks"] == [remark]
    assert (
        "outside"
        in export(ExportOptions(small_run, "csv", samples, "700 psi", 10, force=True))[1][0]
    )
    assert export(ExportOptions(small_run, "csv", samples, "500 psi", 10, force=True))[1] == []
    assert "remarks" not in json.loads((samples / "about.json").read_text())
