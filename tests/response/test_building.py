"""Building files: what is read, and one sentence for each mistake."""

from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.building import read_building

GOOD = """
[building]
title = "Six storeys"
damping = { ratio = "2 %" }
[[storey]]
weight = "100 kip"
height = "144 in"
stiffness = "326.32 kip/in"
[[storey]]
mass = "22.7 Mg"
height = "12 ft"
stiffness = "57.15 kN/mm"
[[damper]]
storey = 2
count = 2
actuation = ["900 psi", "1100 psi"]
brace = "500 kip/in"
"""


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Function that reads a text as the file b.toml."""
    monkeypatch.chdir(tmp_path)

    def read(text):
        Path("b.toml").write_text(text)
        return read_building("b.toml")

    return read


def test_units_are_turned_into_kip_in_and_s(made):
    building = made(GOOD)
    assert building.mass[0, 0] == pytest.approx(100 / 386.0886, rel=1e-6)
    assert building.mass[1, 1] == pytest.approx(22700 / 175126.8, rel=1e-4)  # kg in a kip s²/in
    assert building.storeys[1] == pytest.approx(326.3, rel=1e-3)
    assert building.heights[1] == pytest.approx(144)
    assert [d.actuation for d in building.devices] == [0.9, 1.1]
    assert [d.brace for d in building.devices] == [500, 500]


def test_periods_and_shapes_are_those_of_eigh(made):
    building = made(GOOD)
    squares, _ = linalg.eigh(building.stiffness, building.mass)
    assert np.allclose(building.modes.periods, 2 * np.pi / np.sqrt(squares), rtol=1e-12)
    shapes = building.modes.shapes
    assert np.allclose(shapes.T @ building.mass @ shapes, np.eye(2), atol=1e-12)


def test_both_modes_have_the_ratio(made):
    for kind in ("rayleigh", "modal"):
        building = made(GOOD.replace('ratio = "2 %"', f'kind = "{kind}", ratio = 0.03'))
        modes = building.modes
        got = np.diag(modes.shapes.T @ building.damping @ modes.shapes) / (2 * modes.frequencies)
        assert np.allclose(got, 0.03)


def test_matrices_come_from_files(tmp_path):
    np.savetxt(tmp_path / "M.csv", np.eye(2), delimiter=",")
    np.save(tmp_path / "K.npy", np.array([[20.0, -10.0], [-10.0, 10.0]]))
    path = tmp_path / "b.toml"
    path.write_text('[matrices]\nmass = "M.csv"\nstiffness = "K.npy"\nunits = { mass = "Mg" }\n')
    building = read_building(path)
    assert building.mass[0, 0] == pytest.approx(1000 / 175126.8, rel=1e-4)
    assert building.stiffness[0, 1] == -10.0
    np.save(tmp_path / "K.npy", np.array([[20.0, -10.0], [-30.0, 10.0]]))
    with pytest.raises(BuildingError, match=r"K\.npy must be symmetric"):
        read_building(path)
    for key, values in (("influence", "[1.0]"), ("heights", '["3 m"]')):
        path.write_text(f'[matrices]\nmass = "M.csv"\nstiffness = "M.csv"\n{key} = {values}\n')
        with pytest.raises(BuildingError, match=rf"matrices\.{key} in .* must have 2 values"):
            read_building(path)


WRONG = [
    ('weight = "100 kip"', 'weight = "0 kip"', r"storey 1\.weight in b.toml.*greater than 0"),
    ('"326.32 kip/in"', '"-3 kip/in"', r"storey 1\.stiffness in b.toml.*greater than 0"),
    ('mass = "22.7 Mg"', 'mass = "22.7 in"', r"storey 2\.mass in b.toml: expected a mass"),
    ('weight = "100 kip"', "", r"storey 1 in b.toml: give either mass or weight"),
    ("storey = 2", "storey = 7", r"damper 1\.storey in b.toml: expected floors of 0.* to 2"),
    ("storey = 2", "between = [1, 1]", r"damper 1\.between in b.toml.*two different"),
    ("storey = 2", "", r"damper 1 in b.toml: give either storey, or between"),
    ("count = 2", "count = 3", r"one for each of the 3 dampers"),
    ('"900 psi"', '"900 in"', r"damper 1\.actuation.*actuation needs a pressure"),
    ('stiffness = "57', 'stifness = "57', r"unknown key 'stifness'.*did you mean 'stiffness'"),
    ('ratio = "2 %"', 'ratio = "200 %"', r"building\.damping\.ratio in b.toml.*less than 1"),
    ("[[damper]]", "[damper]", r"a damper in b.toml begins with \[\[damper\]\]"),
    ('"12 ft"', "12", r"storey 2\.height in b.toml: give a number and a unit"),
]


def test_nonsense_is_one_sentence_with_the_key(made):
    for old, new, words in WRONG:
        with pytest.raises(BuildingError, match=words) as error:
            made(GOOD.replace(old, new))
        assert "\n" not in str(error.value)
    for limit in ("drift", "residual"):
        text = GOOD.replace('height = "12 ft"\n', "") + f'[limits]\n{limit} = "1 %"\n'
        with pytest.raises(BuildingError, match=rf"limits\.{limit} in b.toml needs the height"):
            made(text)


def test_a_matrix_that_is_none_or_declared_huge_or_complex_is_refused(tmp_path):
    path, bad = tmp_path / "b.toml", tmp_path / "M.npy"

    def refused(words, name="M.npy"):
        path.write_text(f'[matrices]\nmass = "{name}"\nstiffness = "{name}"\n')
        with pytest.raises(BuildingError, match=rf"matrices\.mass.*{words}") as error:
            read_building(path)
        assert "\n" not in str(error.value)

    bad.write_bytes(b"")
    refused(r"M\.npy as numbers")
    np.save(bad, np.array([["a", "b"], ["c", "d"]]))
    refused(r"M\.npy as numbers")
    np.savez(tmp_path / "M.npz", np.eye(2))
    (tmp_path / "M.npz").rename(bad)
    refused(r"M\.npy as numbers")
    (tmp_path / "M.csv").write_text("1+1j,0\n0,1+1j\n")
    refused(r"M\.csv as numbers", "M.csv")
    for shape in ((100_000, 100_000), (10**9, 10**9), (10**12,)):
        with bad.open("wb") as file:
            about = {"descr": "<f8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(file, about)
            file.write(bytes(64))
        refused(r"M\.npy as numbers")
    np.save(bad, np.eye(2) * (1 + 0j))
    refused("complex128, and no real numbers")
    np.save(bad, np.eye(2, dtype=np.int8))  # the control
    assert read_building(path).freedoms == 2


def test_what_is_no_level_or_path_of_a_building_is_refused(made):
    for level in (np.nan, "36 lbf", None, -1.0, np.inf, True):
        with pytest.raises(BuildingError, match="actuation must be a finite number of at least 0"):
            made(GOOD).at_level(level)
    assert {device.actuation for device in made(GOOD).at_level(0).devices} == {0.0}
    for path in (None, 5, b"b.toml", ["b.toml"], "a\0b"):
        with pytest.raises(BuildingError, match="building must be a path"):
            read_building(path)


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
def test_a_file_outside_the_folder_is_refused(folder, form):
    words = r"matrices\.stiffness in .*b\.toml: the file '.*M\.csv' lies outside the folder"
    with pytest.raises(BuildingError, match=words):
        building(folder, matrix=named(form, "M.csv", folder))
    words = r"the actuation of storey 1: the file '.*valve\.csv' lies outside the folder"
    with pytest.raises(BuildingError, match=words):
        building(folder, history=named(form, "valve.csv", folder))


def test_files_in_the_folder_are_read(folder, monkeypatch):
    for form in ("{}", "sub/{}", "./{}", "sub/../{}"):
        found = building(folder, form.format("M.csv"), form.format("valve.csv"))
        (device,) = found.devices
        assert [float(column[-1]) for column in device.history] == [10.0, 1.2]
    with pytest.raises(BuildingError, match=r"stiffness in .*cannot be found"):
        building(folder, matrix="a\\u0000b")
    building(folder)
    monkeypatch.chdir(folder)  # where the folder has no name
    assert read_building("b.toml").freedoms == 1
