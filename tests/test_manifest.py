"""Run folders of strangers: hashes, links, ids that lead out, manifests that say anything."""

import importlib
import json
import shutil
import sys
import time
from pathlib import Path

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.manifest import check_stored, hash_stored
from mfd_bayes.run import open_run


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run folder with hashes of everything."""
    benchmarks = Path(__file__).parents[1] / "benchmarks"
    if not benchmarks.is_dir():
        pytest.skip("benchmarks/ is not part of this distribution")
    sys.path.insert(0, str(benchmarks))
    try:
        targets = importlib.import_module("fuzz_targets")
    finally:
        sys.path.remove(str(benchmarks))
    folder = tmp_path_factory.mktemp("made") / "out"
    folder.mkdir()
    targets.write_run(folder)
    names = [p.relative_to(folder).as_posix() for p in folder.rglob("*.*") if p.suffix != ".json"]
    change(folder, lambda manifest: manifest.update(files=hash_stored(folder, names)))
    return folder


@pytest.fixture
def out(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "out"))


def change(folder, how):
    manifest = json.loads((folder / "manifest.json").read_text())
    how(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_a_run_with_its_hashes_opens(out):
    run = open_run(out)
    assert set(run.tests) == {"a", "b"}
    assert set(run.held_out) == {"c"}
    assert run.hashed
    assert run.population.actuation_unit == "ksi"


STORED = ("tests/a/posterior.nc", "tests/c/record.nc", "priors.toml", "population.nc")


@pytest.mark.parametrize("name", STORED)
def test_a_file_that_was_changed_is_refused(out, name):
    content = bytearray((out / name).read_bytes())
    content[-1] ^= 1  # a file that may still be read
    (out / name).write_bytes(content)
    with pytest.raises(StoreError, match=name) as caught:
        _ = open_run(out).population
    assert "not what this run wrote" in str(caught.value)


def test_an_older_run_without_hashes_opens_and_is_known_for_it(out):
    change(out, lambda manifest: manifest.pop("files"))
    assert not open_run(out).hashed


@pytest.mark.parametrize(
    "test_id", ["..", "../../x", "/etc", "a/b", ".hidden", "", "a\u202e", "x" * 200]
)
def test_ids_lead_nowhere_else(out, test_id):
    def rename(manifest):
        manifest["tests"][test_id] = manifest["tests"].pop("a")
        manifest["settings"]["tests"][test_id] = manifest["settings"]["tests"].pop("a")

    change(out, rename)
    with pytest.raises(StoreError, match=r"manifest\.json.*id names a folder"):
        open_run(out)


@pytest.mark.parametrize("name", STORED)
def test_links_to_elsewhere_are_refused(out, tmp_path, name):
    (out / name).rename(tmp_path / "elsewhere")
    (out / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="outside of the run folder"):
        _ = open_run(out).population


def test_a_listed_file_outside_the_folder_is_not_looked_at(out):
    change(out, lambda manifest: manifest["files"].update({"../../etc/passwd": "00"}))
    assert open_run(out).tests
    with pytest.raises(StoreError, match="outside of the run folder"):
        check_stored(out, "../manifest.json", {})


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("tests",), []),
        (("tests",), {}),
        (("tests", "a"), None),
        (("tests", "a", "role"), "both"),
        (("tests", "a", "status"), 3),
        (("settings",), {}),
        (("settings", "actuation_unit"), "psi"),
        (("settings", "tests", "a"), []),
        (("settings", "laws"), ["power"]),
        (("effort", "r_hat"), "small"),
        (("free_exponents",), {"Fc_fwd": [1.0]}),
        (("files",), {"population.nc": 3}),
        (("title",), None),
    ],
)
def test_a_manifest_that_says_something_else_is_refused(out, keys, value):
    def spoil(manifest):
        for key in keys[:-1]:
            manifest = manifest[key]
        manifest[keys[-1]] = value

    change(out, spoil)
    with pytest.raises(StoreError, match=r"manifest\.json") as caught:
        open_run(out)
    assert keys[-1] in str(caught.value)


def test_checking_costs_little(out):
    """Hashes take milliseconds where opening takes the better part of a second."""
    names = [p.relative_to(out).as_posix() for p in out.rglob("*.nc")]
    began = time.perf_counter()
    hash_stored(out, names)
    hashing = time.perf_counter() - began
    began = time.perf_counter()
    open_run(out)
    assert hashing < 0.5 * (time.perf_counter() - began)
