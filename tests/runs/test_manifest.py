"""Run folders from others: hashes, links, ids that lead out of the folder, invalid manifests."""

import json
from dataclasses import replace

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation.crossvalidate import Fold, read_predictions
from mfd_bayes.pipeline.plan import Options, effort_of, plan_campaign
from mfd_bayes.runs.run import open_run
from tests.run_folders import RECORD

STORED = ("tests/a/posterior.nc", "tests/c/record.nc", "population.nc")


def read_all(folder):
    """Everything that a run folder holds."""
    run = open_run(folder)
    return [*run.tests.values()], [*run.held_out.values()], run.population


def test_a_run_with_its_hashes_opens(out):
    run = open_run(out)
    assert (list(run.tests), list(run.held_out)) == (["a", "b"], ["c"])
    assert run.population.actuation_unit == run.actuation_unit == "ksi"
    assert read_all(out)


def test_a_file_that_was_changed_is_refused(out):
    for name in STORED:
        content = bytearray((out / name).read_bytes())
        content[-1] ^= 1  # a file that may still be read
        (out / name).write_bytes(content)
        with pytest.raises(StoreError, match=rf"{name} is not what this run wrote"):
            read_all(out)
        content[-1] ^= 1
        (out / name).write_bytes(content)


@pytest.mark.parametrize("name", STORED)
def test_a_file_that_is_missing_or_a_link_is_refused(out, tmp_path, name):
    (out / name).rename(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match=name):
        read_all(out)
    (out / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="outside of the run folder"):
        read_all(out)


def test_ids_lead_nowhere_else(out):
    for test_id in ["..", "../../x", "/etc", "a\u202e"]:
        before = (out / "manifest.json").read_bytes()
        manifest = json.loads(before)
        manifest["tests"] = {test_id: manifest["tests"].pop("a"), **manifest["tests"]}
        manifest["settings"]["test"][0]["id"] = test_id
        (out / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(StoreError, match=r"manifest\.json.*id names a folder"):
            open_run(out)
        (out / "manifest.json").write_bytes(before)


def test_a_manifest_that_says_something_else_is_refused(out):
    for keys, value in [
        (("tests",), {}),
        (("tests", "a", "role"), "both"),
        (("tests", "a", "conditions"), {"stroke": "long"}),
        (("tests", "a", "measured", "energy"), [1.0] * 99),
        (("settings", "test", 0, "actuation"), "5 m"),
        (("settings", "test", 0, "after"), "x"),
        (("settings", "laws", "Fc_fwd"), "cubic"),
        (("settings", "campaign", "area"), 1e300),
        (("effort", "r_hat"), "small"),
        (("files",), {"population.nc": 3}),
        (("seed",), -1),
        (("truth",), {"population": {}, "tests": {"elsewhere": {}}}),
        (("crossvalidation", "by"), "../x"),
        (("crossvalidation", "predictions", 0, "score", "coverage"), [0.5, 0.9]),
        (("comparison", "rows", 0, "cycles"), 1.5),
    ]:
        whole = (out / "manifest.json").read_bytes()
        manifest = part = json.loads(whole)
        for key in keys[:-1]:
            part = part[key]
        part[keys[-1]] = value
        (out / "manifest.json").write_text(json.dumps(manifest))
        with pytest.raises(StoreError, match=r"manifest\.json"):
            open_run(out)
        (out / "manifest.json").write_bytes(whole)


def test_a_folder_of_another_version_is_refused_in_one_sentence(out, change):
    for number, writer in [(1, "0.1.0"), ("two", None)]:
        about = {"format": number, "versions": {"mfd_bayes": writer}}
        change(out, lambda manifest, about=about: manifest.update(about))
        with pytest.raises(StoreError, match=rf"format {number!r}.*reads format 2 only.*{writer}"):
            open_run(out)


def test_a_run_that_is_not_finished_says_how_to_finish_it(out, change):
    change(out, lambda manifest: manifest.update(status="running"))
    with pytest.raises(StoreError, match="not finished; finish it with: mfd-bayes calibrate"):
        open_run(out)
    change(out, lambda manifest: manifest.update(effort=["quick"]))
    with pytest.raises(StoreError, match="effort"):
        effort_of(out, None, resume=True)


def test_a_campaign_that_bears_the_name_of_its_priors_does_not_hide_behind_them(tmp_path):
    (tmp_path / "mfd.toml").write_text(
        '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n', encoding="utf-8"
    )
    (tmp_path / "a.csv").write_text(RECORD)
    inputs = plan_campaign(tmp_path / "mfd.toml", Options(effort="quick")).manifest.inputs
    assert {"mfd.toml", "priors/mfd.toml"} <= set(inputs)


# --- stored predictions of a part that was left out

FOLD = Fold("a", "test_1.json", ("a",), ("b",), "quick", 1)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"key": {}, "predictions": []}, "predictions"),
        ({"key": {}, "predictions": [{"part": "a", "test": "a", "score": {}}]}, "score"),
    ],
)
def test_predictions_that_say_something_else_are_refused(out, content, words):
    (prediction,) = read_predictions(out, [FOLD])
    assert (prediction.part, prediction.test, prediction.score.width) == ("a", "a", 1.0)
    with pytest.raises(StoreError, match="not of its part"):
        list(read_predictions(out, [replace(FOLD, left_out=("b",))]))
    (out / "crossvalidation" / "test_1.json").write_text(json.dumps(content))
    with pytest.raises(StoreError, match=rf"test_1\.json.*{words}"):
        list(read_predictions(out, [FOLD]))
