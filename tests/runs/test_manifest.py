"""Run folders from others: hashes, links, ids that lead out of the folder, invalid manifests."""

import json
from dataclasses import replace

import pytest

from mfd_bayes.applications.comparison.crossvalidation import Fold, read_predictions
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.errors import StoreError
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.runs.run import open_run
from tests.run_folders import RECORD

FINDING = {"subject": "a", "name": "gap", "stage": "records"}
STORED = ("tests/a/posterior.nc", "tests/c/record.nc", "population.nc")


def read_all(folder):
    run = open_run(folder)
    return [*run.tests.values()], [*run.held_out.values()], run.population


@pytest.mark.parametrize("name", STORED)
def test_a_file_that_was_changed_or_is_missing_or_a_link_is_refused(out, tmp_path, name):
    read_all(out)  # the control
    content = (out / name).read_bytes()
    (out / name).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))  # it may still be read
    with pytest.raises(StoreError, match=rf"{name} is not what this run wrote"):
        read_all(out)
    (out / name).rename(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match=name):
        read_all(out)
    (out / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="outside of the run folder"):
        read_all(out)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        *((("settings", "test", 0, "id"), i, "names a folder") for i in ("../x", "/x", "a\u202e")),
        (("tests", "a", "conditions"), {"stroke": "long"}, "conditions"),
        (("tests", "a", "measured", "energy"), [1.0] * 99, "measured"),
        (("settings", "test", 0, "actuation"), "5 m", "5 m"),
        (("settings", "test", 0, "after"), "x", "x"),
        (("settings", "laws", "Fc_fwd"), "cubic", "cubic"),
        (("effort", "r_hat"), "small", "r_hat"),
        (("truth",), {"population": {}, "tests": {"elsewhere": {}}}, "elsewhere"),
        (("crossvalidation", "predictions", 0, "score", "coverage"), [0.5, 0.9], "coverage"),
        (("comparison", "rows", 0, "cycles"), 1.5, "cycles"),
        *(
            (("warnings",), [FINDING | {"message": message}], "warnings")
            for message in (
                {"template": "{x", "values": {}},
                {"template": "{x}", "values": {}},
                {"template": "{x:>999999999}", "values": {"x": "a"}},
                {"template": "{x.a}", "values": {"x": "a"}},
                {"template": "{x}", "values": {"x": {"values": [1.0], "unit": "in", "digits": -3}}},
                {"template": "{x}", "values": {"x": {"values": [], "unit": "in", "digits": 3}}},
            )
        ),
        (("format",), 1, "format 1.*reads format 4 only"),
        (("status",), "running", "not finished; finish it with: mfd-bayes calibrate"),
    ],
)
def test_a_manifest_that_says_something_else_is_refused(out, change, keys, value, words):
    def replace_value(node):
        for key in keys[:-1]:
            node = node[key]
        node[keys[-1]] = value

    change(out, replace_value)
    with pytest.raises(StoreError, match=words) as caught:
        open_run(out)
    assert str(out) in str(caught.value)


def test_a_quantity_that_a_stored_run_lacks_is_a_gap(out, change):
    def remove(manifest):
        for test in manifest["tests"].values():
            del test["measured"]["gap"], test["measured"]["energy"]

    complete = datasheet(open_run(out)).rows.set_index("quantity")
    change(out, remove)
    rows = datasheet(open_run(out)).rows.set_index("quantity")
    assert rows.loc[["gap", "energy"], "measured"].isna().all()
    assert not complete.loc["energy", "measured"].isna().any()
    kept = rows.index.difference(["gap", "energy"])
    assert rows.loc[kept, "measured"].equals(complete.loc[kept, "measured"])


def test_a_campaign_that_bears_the_name_of_its_priors_does_not_hide_behind_them(tmp_path):
    (tmp_path / "mfd.toml").write_text(
        '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n', encoding="utf-8"
    )
    (tmp_path / "a.csv").write_text(RECORD)
    inputs = plan_campaign(tmp_path / "mfd.toml", RunOptions(effort="quick")).manifest.inputs
    assert {"mfd.toml", "priors/mfd.toml"} <= set(inputs)


def test_stored_predictions_that_say_something_else_are_refused(out):
    fold = Fold("a", "test_1.json", ("a",), ("b",), "quick", 1)
    (prediction,) = read_predictions(out, [fold])
    assert (prediction.part, prediction.test, prediction.score.width) == ("a", "a", 1.0)
    with pytest.raises(StoreError, match="not of its part"):
        list(read_predictions(out, [replace(fold, left_out=("A",))]))
    for predictions, words in (
        ([], "predictions"),
        ([{"part": "a", "test": "a", "score": {}}], "score"),
    ):
        content = {"key": {}, "predictions": predictions}
        (out / "crossvalidation" / "test_1.json").write_text(json.dumps(content))
        with pytest.raises(StoreError, match=rf"test_1\.json.*{words}"):
            list(read_predictions(out, [fold]))
