"""A building file makes the program read in its own folder alone."""

import numpy as np
import pytest

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.building import read_building
from mfd_bayes.response.history import histories_of

ROWS = "time_s,pressure_ksi\n0,1.0\n10,1.2\n"
OUTSIDE = ["../{}", "sub/../../{}", "link_{}", "absolute"]


@pytest.fixture
def folder(tmp_path):
    """A folder with a matrix and a history in it, beside it, and by a link to those beside it."""
    inner = tmp_path / "building"
    (inner / "sub").mkdir(parents=True)
    for place in (tmp_path, inner, inner / "sub"):
        np.savetxt(place / "M.csv", np.eye(1), delimiter=",")
        (place / "valve.csv").write_text(ROWS)
    for name in ("M.csv", "valve.csv"):
        (inner / f"link_{name}").symlink_to(tmp_path / name)
    return inner


def building(folder, matrix="M.csv", history="valve.csv"):
    path = folder / "b.toml"
    path.write_text(
        f'[matrices]\nmass = "M.csv"\nstiffness = "{matrix}"\n[[damper]]\nstorey = 1\n'
        f'actuation = {{ file = "{history}", column = "pressure_ksi", unit = "ksi" }}\n'
    )
    return read_building(path)


def named(form, name, folder):
    return str(folder.parent / name) if form == "absolute" else form.format(name)


@pytest.mark.parametrize("form", OUTSIDE)
def test_a_matrix_outside_the_folder_is_refused(folder, form):
    words = r"matrices\.stiffness in .*b\.toml: the file '.*M\.csv' lies outside the folder"
    with pytest.raises(BuildingError, match=words):
        building(folder, matrix=named(form, "M.csv", folder))


@pytest.mark.parametrize("form", OUTSIDE)
def test_a_history_outside_the_folder_is_refused(folder, form):
    words = r"the actuation of storey 1: the file '.*valve\.csv' lies outside the folder"
    with pytest.raises(BuildingError, match=words):
        histories_of(building(folder, history=named(form, "valve.csv", folder)))


@pytest.mark.parametrize("form", ["{}", "sub/{}", "./{}", "sub/../{}"])
def test_files_in_the_folder_are_read(folder, form, monkeypatch):
    found = building(folder, form.format("M.csv"), form.format("valve.csv"))
    ((_, time, level),) = histories_of(found)
    assert (time[-1], level[-1]) == (10.0, 1.2)
    monkeypatch.chdir(folder)  # where the folder has no name
    assert read_building("b.toml").freedoms == 1
    assert len(histories_of(read_building("b.toml"))) == 1


def test_a_name_that_no_file_has_is_one_sentence(folder):
    with pytest.raises(BuildingError, match=r"stiffness in .*cannot be found"):
        building(folder, matrix="a\\u0000b")
