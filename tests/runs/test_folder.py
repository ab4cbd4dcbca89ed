"""What a resumed run keeps where its campaign or its prior file has changed; links."""

import json
import shutil
from dataclasses import replace
from typing import get_args

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.pipeline.report import report
from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.runs.folder import PartKind, discard
from mfd_bayes.runs.resume import prepare_folder, with_keys
from mfd_bayes.runs.run import open_run


def resume(plan, folder, priors=None, **settings):
    """Resume with changed settings, or another prior file, as a campaign file with them has it."""
    manifest = plan.manifest
    requested = manifest.changed(
        settings=manifest.settings.model_copy(update=settings),
        inputs={**manifest.inputs, "campaign.toml": "0" * 64},
    )
    requested = with_keys(requested, priors or plan.priors)
    return prepare_folder(requested, plan.campaign.folder, folder, resume=True)


def stored(folder):
    """Tests whose posteriors are stored, and whether what was left out is."""
    tests = "".join(name for name in "ab" if (folder / f"tests/{name}/posterior.nc").is_file())
    return tests, (folder / "crossvalidation").is_dir()


def wider_scatter(priors):
    scatter = dict(priors.scatter)
    name = next(iter(scatter))
    return replace(priors, scatter={**scatter, name: replace(scatter[name], sd=9.0)})


def other_k3(priors):
    k3 = replace(priors.parameters["k3"], figures={"median": 1.0, "sigma": 0.1})
    return replace(priors, parameters={**priors.parameters, "k3": k3})


def updated(**values):
    return lambda settings: settings.model_copy(update=values)


def stated_gain(priors):
    return replace(priors, measurement={"force": 0.005})


CHANGES = {
    # settings, priors, tests whose posteriors are kept, population kept, predictions kept
    "nothing": (updated(), None, "ab", True, True),
    "tolerance": (updated(tolerances={"energy": 0.2}), None, "ab", True, True),
    "order": (lambda s: s.with_test("b", after="a"), None, "ab", True, False),
    "session": (lambda s: s.with_test("a", session="Monday"), None, "ab", False, False),
    "laws": (lambda s: updated(laws={**s.laws, "sigma0": "constant"})(s), None, "ab", False, False),
    "scatter": (updated(), wider_scatter, "ab", False, False),
    "gain": (updated(), stated_gain, "ab", True, True),
    "window": (lambda s: s.with_test("a", window="0 s to 1 s"), None, "b", False, False),
    "actuation": (lambda s: s.with_test("b", actuation="999 psi"), None, "a", False, False),
    "prior": (updated(), other_k3, "", False, False),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_does_not_rest_on_a_change_is_kept(plan, out, name):
    settings, priors, tests, population, left_out = CHANGES[name]
    requested = settings(plan.manifest.settings)
    fields = {name: getattr(requested, name) for name in type(requested).model_fields}
    resumed = resume(plan, out, priors and priors(plan.priors), **fields)
    assert stored(out) == (tests, left_out)
    status = {name: entry.status for name, entry in resumed.manifest.tests.items()}
    assert "".join(name for name in "ab" if status[name] == "done") == tests
    assert all(f"tests/{name}/posterior.nc" in resumed.manifest.files for name in tests)
    assert (resumed.before is not None) == population
    if population:
        assert (resumed.before.crossvalidation is not None) == left_out
    else:
        assert json.loads((out / "manifest.json").read_text())["status"] == "running"
    again = ", ".join(name for name in "ab" if name not in tests)
    assert (f"sampled again: {again}" in "".join(resumed.notes)) == bool(again)
    assert (resumed.manifest.comparison is not None) == (tests == "ab")


def other_tests(manifest):
    manifest["tests"] = {f"x{name}": entry for name, entry in manifest["tests"].items()}
    for test in manifest["settings"]["test"]:
        test["id"] = f"x{test['id']}"
    del manifest["truth"]


def test_a_run_that_cannot_be_resumed_is_refused_and_stays(plan, out, change):
    intact = (out / "manifest.json").read_text()
    for how, words in [
        (lambda m: m.update(seed=2), "seed changed.*--force"),
        (lambda m: m.update(versions={f"v{i}": "1" for i in range(100)}), "versions .*99 more"),
        (other_tests, r"a run of other tests \(xa, .*another folder"),
    ]:
        change(out, how)
        with pytest.raises(StoreError, match=words):
            resume(plan, out)
        assert stored(out) == ("ab", True)
        (out / "manifest.json").write_text(intact)
    for content in ("", '{"status": "run', "[]", "{}"):
        (out / "manifest.json").write_text(content)
        with pytest.raises(StoreError, match=r"cannot be resumed.*--force"):
            resume(plan, out)
        assert stored(out) == ("ab", True)


def test_another_machine_is_said(plan, out, change):
    assert resume(plan, out).notes == ()
    change(out, lambda manifest: manifest["machines"][0].update(processor="Z80"))
    resumed = resume(plan, out)
    (note,) = resumed.notes
    assert [m["processor"] == "Z80" for m in resumed.manifest.machines] == [True, False]
    assert "another machine" in note
    assert "processor was Z80, is " in note


# --- links


def test_nothing_is_written_through_a_link(plan, out, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    (out / "tests/a").rename(elsewhere)
    (out / "tests/a").symlink_to(elsewhere)
    snapshot = {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()}
    source = plan.campaign.folder
    for act in (
        lambda: open_run(out),
        lambda: report(ReportOptions(out)),
        lambda: discard(out),
        lambda: resume(plan, out),
        lambda: prepare_folder(plan.manifest, source, out, force=True),
    ):
        with pytest.raises(StoreError, match="outside of the run folder"):
            act()
    assert {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()} == snapshot
    assert (out / "manifest.json").is_file()


def test_a_link_in_place_of_a_folder_is_removed_and_not_what_it_leads_to(out):
    (out / "kept").mkdir()
    (out / "kept" / "notes.txt").write_text("mine")
    shutil.rmtree(out / "crossvalidation")
    (out / "crossvalidation").symlink_to("kept")
    discard(out)
    assert [path.name for path in out.iterdir()] == ["kept"]
    assert (out / "kept" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("kind", get_args(PartKind))
def test_predictions_of_parts_that_were_left_out_are_removed_with_the_run(out, kind):
    stored, mine = (out / "crossvalidation" / f"{name}_7.json" for name in (kind, "mine"))
    for path in (stored, mine):
        path.write_text("{}")
    discard(out)
    assert not stored.exists()
    assert mine.exists()


# --- damaged files, and files that are not the run's

FOREIGN = ("tests/a/notes.txt", "tests/a/raw/record.csv", "figures/mine.png", "tests/mine/a.png")
FOREIGN += ("crossvalidation/mine.json", "tests/a/.mine.part")


def forget(manifest):
    del manifest["files"]["tests/b/posterior.nc"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-2000]),
        lambda path: path.write_bytes(b""),
        lambda path: shutil.copy(path.parents[1] / "a/posterior.nc", path),
    ],
    ids=["truncated", "empty", "another test's"],
)
@pytest.mark.parametrize("hashed", [True, False], ids=["hash hashed", "hash not hashed"])
def test_a_test_whose_file_is_damaged_is_sampled_again(plan, out, change, damage, hashed):
    if not hashed:
        change(out, forget)
        assert resume(plan, out).notes == ()  # the control: it is whole
        assert stored(out)[0] == "ab"
    (out / "tests/b/mine.txt").write_text("mine")
    damage(out / "tests/b/posterior.nc")
    (note,) = resume(plan, out).notes
    assert note.startswith(f"{out / 'tests/b/posterior.nc'} is ")
    assert note.endswith("b is sampled again")
    assert stored(out)[0] == "a"
    assert (out / "tests/b/mine.txt").read_text() == "mine"
    assert json.loads((out / "manifest.json").read_text())["status"] == "running"


@pytest.mark.parametrize("content", [b"", b"x" * 5000])
def test_a_damaged_population_is_inferred_again(plan, out, content):
    (out / "population.nc").write_bytes(content)
    resumed = resume(plan, out)
    assert resumed.before is None
    assert "population.nc is not what this run wrote" in resumed.notes[0]
    assert stored(out)[0] == "ab"


@pytest.mark.parametrize("how", ["force", "resume"])
def test_what_a_run_did_not_write_is_kept(plan, out, how):
    for name in FOREIGN:
        (out / name).parent.mkdir(exist_ok=True, parents=True)
        (out / name).write_text("mine")
    (out / "figures/overview.png").write_text("ours")
    if how == "force":
        prepare_folder(plan.manifest, plan.campaign.folder, out, force=True)
        assert sorted(p for p in out.rglob("*") if p.is_file()) == sorted(
            out / name for name in FOREIGN
        )
    else:
        resume(plan, out, other_k3(plan.priors))
        assert stored(out)[0] == ""
    assert [(out / name).read_text() for name in FOREIGN] == ["mine"] * len(FOREIGN)
