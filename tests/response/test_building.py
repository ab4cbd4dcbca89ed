"""Building files: what is read, and one sentence for each mistake."""

from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from mfd_bayes.applications.buildings.building import read_building
from mfd_bayes.errors import BuildingError

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
    monkeypatch.chdir(tmp_path)  # where the folder has no name

    def read(text):
        Path("b.toml").write_text(text)
        return read_building("b.toml")

    return read


def refused(words, function, *arguments):
    with pytest.raises(BuildingError, match=words) as error:
        function(*arguments)
    assert "\n" not in str(error.value)


def test_units_are_turned_into_kip_in_and_s(made):
    building = made(GOOD)
    assert building.mass[0, 0] == pytest.approx(100 / 386.0886, rel=1e-6)
    assert building.mass[1, 1] == pytest.approx(22700 / 175126.8, rel=1e-4)  # kg in a kip s²/in
    assert building.storeys[1] == pytest.approx(326.3, rel=1e-3)
    assert building.heights[1] == pytest.approx(144)
    assert [d.actuation for d in building.devices] == [0.9, 1.1]
    assert [d.brace for d in building.devices] == [500, 500]


def test_modes_are_those_of_eigh_and_each_has_the_damping_ratio(made):
    building = made(GOOD)
    squares, _ = linalg.eigh(building.stiffness, building.mass)
    assert np.allclose(building.modes.periods, 2 * np.pi / np.sqrt(squares), rtol=1e-12)
    shapes = building.modes.shapes
    assert np.allclose(shapes.T @ building.mass @ shapes, np.eye(2), atol=1e-12)
    for kind in ("rayleigh", "modal"):
        damping = made(GOOD.replace('ratio = "2 %"', f'kind = "{kind}", ratio = 0.03')).damping
        got = np.diag(shapes.T @ damping @ shapes) / (2 * building.modes.frequencies)
        assert np.allclose(got, 0.03)


MATRICES = '[matrices]\nmass = "M.csv"\nstiffness = "{}"\n'


def test_matrices_come_from_files(made):
    np.savetxt("M.csv", np.eye(2), delimiter=",")
    np.save("K.npy", np.array([[20.0, -10.0], [-10.0, 10.0]]))
    building = made(MATRICES.format("K.npy") + 'units = { mass = "Mg" }\n')
    assert building.mass[0, 0] == pytest.approx(1000 / 175126.8, rel=1e-4)
    assert building.stiffness[0, 1] == -10.0
    for entry in ("influence = [1.0]", 'heights = ["3 m"]'):
        words = rf"matrices\.{entry.split()[0]} in .* must have 2 values"
        refused(words, made, MATRICES.format("M.csv") + entry)


def test_a_matrix_that_is_none_or_declared_huge_or_complex_is_refused(made):
    def none(words, write, name="K.npy"):
        np.savetxt("M.csv", np.eye(2), delimiter=",")
        with Path(name).open("wb") as file:
            write(file)
        refused(rf"stiffness.*{words}", made, MATRICES.format(name))

    none("must be symmetric", lambda file: np.save(file, np.array([[20.0, -10.0], [-30.0, 10.0]])))
    none(r"K\.npy as numbers", lambda file: None)
    none(r"K\.npy as numbers", lambda file: np.save(file, np.array([["a", "b"], ["c", "d"]])))
    none(r"K\.npy as numbers", lambda file: np.savez(file, np.eye(2)))
    none(r"K\.csv as numbers", lambda file: file.write(b"1+1j,0\n0,1+1j\n"), "K.csv")
    none("complex128, and no real numbers", lambda file: np.save(file, np.eye(2) * (1 + 0j)))

    def declared(shape):
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        return lambda file: (
            np.lib.format.write_array_header_1_0(file, header),
            file.write(bytes(64)),
        )

    for shape in ((100_000, 100_000), (10**9, 10**9), (10**12,)):
        none(r"K\.npy as numbers", declared(shape))
    np.save("K.npy", np.eye(2, dtype=np.int8))  # the control
    assert made(MATRICES.format("K.npy")).freedoms == 2


WRONG = [
    ('weight = "100 kip"', 'weight = "0 kip"', r"storey 1\.weight in b.toml.*greater than 0"),
    ('weight = "100 kip"', "", r"storey 1 in b.toml: give either mass or weight"),
    ("storey = 2", "storey = 7", r"damper 1\.storey in b.toml: expected floors of 0.* to 2"),
    ("storey = 2", "", r"damper 1 in b.toml: give either storey, or between"),
    ("count = 2", "count = 3", r"one for each of the 3 dampers"),
    ('"900 psi"', '"900 in"', r"damper 1\.actuation.*actuation needs a pressure"),
    ('stiffness = "57', 'stifness = "57', r"unknown key 'stifness'.*did you mean 'stiffness'"),
    ('ratio = "2 %"', 'ratio = "200 %"', r"building\.damping\.ratio in b.toml.*less than 1"),
    ("[[damper]]", "[damper]", r"a damper in b.toml begins with \[\[damper\]\]"),
    ('"12 ft"', "12", r"storey 2\.height in b.toml: give a number and a unit"),
]


def test_nonsense_is_one_sentence_with_the_key(made):
    for target, replacement, words in WRONG:
        refused(words, made, GOOD.replace(target, replacement))
    for limit in ("drift", "residual"):
        text = GOOD.replace('height = "12 ft"\n', "") + f'[limits]\n{limit} = "1 %"\n'
        refused(rf"limits\.{limit} in b.toml", made, text)
    for level in (np.nan, "36 lbf", None, -1.0, np.inf, True):
        refused("actuation must be", made(GOOD).at_level, level)
    assert {device.actuation for device in made(GOOD).at_level(0).devices} == {0.0}
    for path in (None, 5, b"b.toml", ["b.toml"], "a\0b"):
        refused("building must be a path", read_building, path)


DAMPER = """[[damper]]
storey = 1
actuation = {{ file = "{}", column = "pressure_ksi", unit = "ksi" }}
"""


def test_files_in_the_folder_are_read_and_others_refused(made, tmp_path, monkeypatch):
    inner = tmp_path / "building"
    (inner / "sub").mkdir(parents=True)
    monkeypatch.chdir(inner)
    for directory in (tmp_path, inner, inner / "sub"):
        np.savetxt(directory / "M.csv", np.eye(1), delimiter=",")
        (directory / "valve.csv").write_text("time_s,pressure_ksi\n0,1.0\n10,1.2\n")
    for name in ("M.csv", "valve.csv"):
        (inner / f"link_{name}").symlink_to(tmp_path / name)

    def read(matrix="M.csv", history="valve.csv"):
        return made(MATRICES.format(matrix) + DAMPER.format(history))

    for form in ("{}", "sub/{}", "./{}", "sub/../{}"):
        (device,) = read(form.format("M.csv"), form.format("valve.csv")).devices
        assert [float(column[-1]) for column in device.history] == [10.0, 1.2]
    for form in ("../{}", "sub/../../{}", "link_{}", f"{tmp_path}/{{}}"):
        matrix, history = form.format("M.csv"), form.format("valve.csv")
        refused(r"matrices\.stiffness .*'.*M\.csv' lies outside", read, matrix)
        refused(r"the actuation of storey 1.*'.*valve\.csv' lies outside", read, "M.csv", history)
    refused(r"stiffness in .*cannot be found", read, "a\\u0000b")
