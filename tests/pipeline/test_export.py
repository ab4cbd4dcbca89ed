"""Samples for other programs: what an earlier export left beside them."""

import json

import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.pipeline.export import Export, export
from tests.run_folders import write_run

QUOFEM = {"randomVariables.json", "dakotaTab.out", "start.txt", "sigma0.txt"}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "out"
    write_run(folder)
    return folder


@pytest.fixture
def folder(out, tmp_path):
    """A folder with samples in columns, with materials, and with files of someone else."""
    found = tmp_path / "samples"
    export(out, Export("quofem", found, "700 psi", 10))
    about = json.loads((found / "about.json").read_text())
    fits = {"misfit": {"BoucWen": [0.1], "../mine": [0.1]}, "best": "BoucWen"}
    (found / "about.json").write_text(json.dumps(about | fits))
    for name in ("BoucWen.tcl", "mine.txt", "../mine.tcl"):
        (found / name).write_text("mine")
    return found


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_samples_of_another_actuation_do_not_stay_beside_new_ones(out, folder):
    assert names(folder) >= {*QUOFEM, "BoucWen.tcl"}
    export(out, Export("csv", folder, "800 psi", 10, force=True))
    assert names(folder) == {"samples.csv", "about.json", "mine.txt"}
    assert (folder.parent / "mine.tcl").is_file()
    about = json.loads((folder / "about.json").read_text())
    assert about["actuation"] == {"value": 0.8, "unit": "ksi"}
    assert "misfit" not in about


def test_the_same_samples_in_several_forms_stay_beside_each_other(out, folder):
    before = names(folder)
    export(out, Export("csv", folder, "700 psi", 10, force=True))
    assert names(folder) == before | {"samples.csv"}
    assert json.loads((folder / "about.json").read_text())["best"] == "BoucWen"


def test_files_beside_anothers_about_stay(out, folder):
    for content in ["[]", '{"variables": {"mine": "1"}}']:
        (folder / "about.json").write_text(content)
        before = names(folder)
        export(out, Export("csv", folder, "800 psi", 10, force=True))
        assert names(folder) == before | {"samples.csv"}


def test_an_actuation_outside_what_was_tested_is_warned_of_and_far_outside_refused(out, folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(CampaignError, match=r"the actuation, 50000 psi, lies far .* --extrapolate"):
        export(out, Export("csv", folder, "50000 psi", 10, force=True))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    far = export(out, Export("csv", folder, "50000 psi", 10, force=True, extrapolate=True))
    (remark,) = far[1]
    assert "lies far outside the tested range" in remark
    assert json.loads((folder / "about.json").read_text())["remarks"] == [remark]
    assert "outside" in export(out, Export("csv", folder, "1200 psi", 10, force=True))[1][0]
    assert export(out, Export("csv", folder, "700 psi", 10, force=True))[1] == []
    assert "remarks" not in json.loads((folder / "about.json").read_text())
