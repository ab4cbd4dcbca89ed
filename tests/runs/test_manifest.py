"""Run folders from others: hashes, links, ids that lead out of the folder, invalid manifests."""

import json
import math
import os
import shutil
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation.folds import Fold, read_predictions
from mfd_bayes.pipeline.plan import Options, effort_of, plan_campaign
from mfd_bayes.pipeline.report import report
from mfd_bayes.runs.folder import check_links, check_stored, discard, hash_stored
from mfd_bayes.runs.manifest import read_begun, read_manifest
from mfd_bayes.runs.opening import open_run
from mfd_bayes.runs.resumption import Existing, prepare_folder
from mfd_bayes.store.files import write_text


@pytest.fixture(scope="module")
def runs(benchmark_module) -> ModuleType:
    """The benchmark's maker of run folders."""
    return benchmark_module("fuzz.runs")


@pytest.fixture(scope="module")
def made(runs, tmp_path_factory):
    """A run folder with hashes of everything."""
    folder = tmp_path_factory.mktemp("made") / "out"
    runs.write_run(folder)
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
        (("seed",), -1),
        (("seconds",), "long"),
        (("finished",), 3),
        (("verdicts",), {"campaign": ["fail"]}),
        (("settings", "area"), 1e300),
        (("settings", "laws", "Fc_fwd"), "cubic"),
        (("truth",), {"population": {}, "tests": {"a": {"Fc_fwd": "1"}}}),
        (("truth",), {"population": {}, "tests": {"elsewhere": {}}}),
        (("crossvalidation",), {"by": "test"}),
        (("crossvalidation", "predictions"), []),
        (("crossvalidation", "by"), "../x"),
        (("crossvalidation", "predictions", 0, "score", "coverage"), [0.5, 0.9]),
        (("crossvalidation", "predictions", 0, "fitted"), None),
        (("comparison", "rows", 0, "cycles"), 1.5),
        (("comparison", "sentence"), 0),
        (("law_scores", 0, "levels"), [1.0]),
        (("law_scores", 0, "levels"), [1.0, 2.0, 3.0]),
        (("law_scores", 0, "elpd"), 1e300),
        (("dependence_scores", 0), "none"),
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
    assert next(key for key in reversed(keys) if isinstance(key, str)) in str(caught.value)


def test_checking_costs_little(out):
    """Hashes take milliseconds, opening a run takes most of a second."""
    names = [p.relative_to(out).as_posix() for p in out.rglob("*.nc")]
    began = time.process_time()
    hash_stored(out, names)
    hashing = time.process_time() - began
    began = time.process_time()
    open_run(out)
    assert hashing < 0.5 * (time.process_time() - began)


NEWER = (
    *("files", "verdicts", "truth", "law_scores", "free_exponents", "dependence_scores"),
    *("crossvalidation", "comparison", "seconds"),
)


def test_an_older_manifest_without_newer_keys_opens(out):
    change(out, lambda manifest: [manifest.pop(key) for key in NEWER])
    assert open_run(out).tests


def test_figures_that_were_not_finite_are_read_as_such(out):
    """They are null in JSON."""

    def spoil(manifest):
        manifest["law_scores"][0]["elpd"] = None
        manifest["crossvalidation"]["predictions"][0]["score"]["crps"] = None

    change(out, spoil)
    found = read_manifest(out)
    assert math.isnan(found.law_scores[0].elpd)
    assert math.isnan(found.crossvalidation.predictions[0].score.crps)


def test_what_is_not_read_is_kept(out):
    change(out, lambda manifest: manifest.update(mine={"a": [1, None]}))
    change(out, lambda manifest: manifest["tests"]["a"].update(mine=2))
    before = json.loads((out / "manifest.json").read_text())
    read_manifest(out).changed(verdicts={"campaign": "pass"}).write(out)
    after = json.loads((out / "manifest.json").read_text())
    assert list(after.items()) == list((before | {"verdicts": {"campaign": "pass"}}).items())


def test_a_sentence_does_not_repeat_what_a_stranger_wrote(out):
    change(out, lambda manifest: manifest.update(title=["x" * 9000]))
    with pytest.raises(StoreError) as caught:
        open_run(out)
    assert len(str(caught.value)) < 500


# --- a run that is resumed


@pytest.fixture
def resumed(runs, made, tmp_path):
    """The plan of the run, and the folder."""
    return runs.plan_of(small=False), Path(shutil.copytree(made, tmp_path / "out"))


def resume(plan, out):
    resumed = prepare_folder(plan.manifest, plan.campaign.folder, out, Existing.RESUMED)
    return resumed.manifest, resumed.before


def test_a_finished_run_is_resumed(resumed):
    plan, out = resumed
    manifest, before = resume(plan, out)
    assert before.status == "finished"
    assert manifest.tests["a"].status == "done"
    assert manifest.seconds == 1.0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("tests", []),
        ("tests", {"a": None}),
        ("seconds", "long"),
        ("files", ["population.nc"]),
        ("truth", 3),
        ("started", {}),
        ("effort", ["quick"]),
        ("law_scores", {"a": 1}),
    ],
)
def test_a_run_that_says_something_else_is_not_resumed(resumed, key, value):
    plan, out = resumed
    change(out, lambda manifest: manifest.update({key: value, "status": "running"}))
    with pytest.raises(StoreError, match=f"cannot be resumed: .*{key}.*--force"):
        resume(plan, out)
    with pytest.raises(StoreError, match=key):
        effort_of(out, None, resume=True)


def test_of_an_earlier_session_only_its_end_is_taken_over(resumed):
    plan, out = resumed
    change(out, lambda manifest: manifest["tests"]["a"].update(role="validate", rate=1.0))
    manifest, _ = resume(plan, out)
    assert manifest.tests["a"].role == "calibrate"
    assert manifest.tests["a"].rate != 1.0


def test_versions_with_endless_names_are_told_in_a_sentence(resumed):
    plan, out = resumed
    names = {f"{i}{'x' * 3000}": str(i) for i in range(100)}
    change(out, lambda manifest: manifest["versions"].update(names))
    with pytest.raises(StoreError, match=r"versions .*and 90 more") as caught:
        resume(plan, out)
    assert len(str(caught.value)) < 1500


def test_a_folder_whose_name_is_no_text_holds_a_campaign_as_any_other(benchmark_module, tmp_path):
    seeds = benchmark_module("fuzz.seeds")
    home = tmp_path / os.fsdecode(b"cam\xe9p")
    home.mkdir()
    (home / "campaign.toml").write_text(
        '[campaign]\npriors = "own.toml"\nmodel = "lugre"\nnoise = "iid"\n'
        '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'
    )
    (home / "own.toml").write_bytes(seeds.priors())
    (home / "a.csv").write_bytes(seeds.texts()[0])
    command = f"mfd-bayes calibrate {home}/campaign.toml"
    found = plan_campaign(home / "campaign.toml", Options(effort="quick", command=command))
    assert found.manifest.command.endswith("cam\\udce9p/campaign.toml")
    named = (home / "campaign.toml").rename(home / os.fsdecode(b"\xe9.toml"))
    with pytest.raises(CampaignError, match=r"name of the file '\\udce9.toml' is not UTF-8"):
        plan_campaign(named, Options(effort="quick"))


def test_a_manifest_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(StoreError, match="No such file"):
        read_begun(tmp_path)


# --- stored predictions of a part that was left out


FOLD = Fold("a", "test_1.json", ("a",), ("b",), "quick", 1)


def test_stored_predictions_are_read(out):
    (found,) = read_predictions(out, [FOLD])
    assert (found.part, found.test, found.score.width) == ("a", "a", 1.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"key": {}}, "predictions"),
        ({"key": {}, "predictions": []}, "predictions"),
        ({"key": {}, "predictions": [{"part": "a", "test": "a", "score": {}}]}, "score"),
        ({"key": [], "predictions": {}}, "key"),
    ],
)
def test_predictions_that_say_something_else_are_refused(out, content, words):
    (out / "crossvalidation" / "test_1.json").write_text(json.dumps(content))
    with pytest.raises(StoreError, match=rf"test_1\.json.*{words}"):
        list(read_predictions(out, [FOLD]))


def test_predictions_of_another_part_are_refused(out):
    with pytest.raises(StoreError, match="not of its part"):
        list(read_predictions(out, [replace(FOLD, left_out=("b",))]))


# --- links


def outside(out, name, elsewhere):
    """Put a part of the folder elsewhere, and a link in its place."""
    elsewhere.mkdir(exist_ok=True)
    if (out / name).exists():
        (out / name).rename(elsewhere / "it")
    else:
        (elsewhere / "it").mkdir()
    (out / name).symlink_to(elsewhere / "it")
    return {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()}


LINKED = ("tests", "tests/a", "figures", "crossvalidation", "tests/a/posterior.nc")


@pytest.mark.parametrize("name", LINKED)
def test_nothing_is_written_through_a_link(resumed, tmp_path, name):
    plan, out = resumed
    elsewhere = tmp_path / "elsewhere"
    before = outside(out, name, elsewhere)
    for act in (
        lambda: open_run(out),
        lambda: report(out),
        lambda: discard(out),
        lambda: resume(plan, out),
        lambda: prepare_folder(plan.manifest, plan.campaign.folder, out, Existing.REPLACED),
    ):
        with pytest.raises(StoreError, match="outside of the run folder"):
            act()
    assert {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()} == before
    assert (out / "manifest.json").is_file()


def test_a_link_out_of_the_folder_is_not_written_through_nor_replaced(out, tmp_path):
    (tmp_path / "mine.html").write_text("mine")
    (out / "report.html").symlink_to(tmp_path / "mine.html")
    with pytest.raises(StoreError, match="link out of its folder"):
        write_text(out / "report.html", "ours")
    assert (tmp_path / "mine.html").read_text() == "mine"
    assert (out / "report.html").is_symlink()


def test_links_in_a_circle_end_in_nothing_but_a_sentence(out):
    (out / "figures").symlink_to(out / "figures")
    with suppress(StoreError):  # Python before 3.13 detects the circle
        check_links(out)


def test_links_within_the_folder_and_an_empty_folder_pass(out, tmp_path):
    (out / "figures").symlink_to(out / "tests")
    check_links(out)
    check_links(tmp_path / "nothing")
