"""The command next on a small synthetic campaign, tested at 500, 1000 and 1500 psi."""

import json
import shutil
import tomllib

import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import CampaignError

FEW = "1000|1900 psi, 0.5 Hz, 1 in"


@pytest.fixture(scope="module")
def out(finished_run, tmp_path_factory):
    """A copy of the run folder."""
    assert finished_run.code == 0, finished_run.stderr
    return shutil.copytree(finished_run.out, tmp_path_factory.mktemp("next") / "out")


def ask(out, *options):
    return CliRunner().invoke(app, ["next", str(out), *map(str, options), "--draws", "300"])


def refusal(out, *options):
    outcome = ask(out, *options)
    assert outcome.exit_code == 2
    (sentence,) = outcome.stderr.splitlines()
    return sentence


def test_it_advises_and_writes_table_json_picture_and_draft(out, tmp_path):
    draft = tmp_path / "next.toml"
    outcome = ask(out, "--candidates", FEW, "--write", draft, "--tests", 2)
    assert outcome.exit_code == 0, outcome.stderr
    assert "One test at " in outcome.stdout
    assert "is expected to narrow the 95 % band over the campaign's range by " in outcome.stdout
    assert "The best two together" in outcome.stdout
    table = pd.read_csv(out / "next.csv")
    assert table["expected_reduction"].is_monotonic_decreasing
    assert set(table["actuation_psi"]) == {1000.0, 1900.0}
    assert set(table.set_index("actuation_psi")["repeats_a_test"].items()) == {
        (1000.0, "yes"),
        (1900.0, "no"),
    }
    assert table["expected_reduction"].between(0.0, 1.0).all()
    found = json.loads((out / "next.json").read_text())
    assert found["unit"] == "kip"
    assert found["sentence"] in outcome.stdout.replace("\n", " ")
    assert len(found["candidates"]) == 2
    assert [point["tests"] for point in found["curve"]] == list(range(7))
    assert found["curve"][0]["expected_width"] == pytest.approx(found["width_now"])
    assert (out / "next.png").read_bytes().startswith(b"\x89PNG")
    entries = tomllib.loads(draft.read_text())["test"]
    assert len(entries) == 2
    assert {entry["actuation"] for entry in entries} <= {"1000 psi", "1900 psi"}
    advice = mb.open_run(out).next_test(candidates=FEW, draws=300)  # the same in Python
    assert list(table["expected_reduction"]) == pytest.approx(advice["reduction"], rel=1e-4)
    assert list(table["error"]) == pytest.approx(advice["error"], rel=1e-4)
    assert list(table["cost_h"]) == pytest.approx([row.cost for row in advice], rel=1e-4)


def test_candidates_of_a_file_within_limits_in_metric_units(out, tmp_path):
    path = tmp_path / "candidates.txt"
    path.write_text("# what the frame can do\n1500 psi, 0.5 Hz, 1 in\n\n700 psi, 2 h  # long\n")
    options = "--candidates", path, "--limits", "2 kip", "--units", "si"
    outcome = ask(out, *options)  # its own files are replaced
    assert outcome.exit_code == 0, outcome.stderr
    assert "One test at 4.826 MPa, 0.5 Hz, 25.4 mm" in outcome.stdout
    assert "10.34 MPa" not in outcome.stdout
    table = pd.read_csv(out / "next.csv")
    assert list(table["actuation_MPa"]) == pytest.approx([4.82633, 10.3421], rel=1e-4)
    assert list(table["amplitude_mm"]) == pytest.approx([25.4, 25.4])
    assert table["cost_h"][0] == 2.0
    assert table["cost_h"][1] < 1.0
    assert table["ruled_out_by"][1] == "force"
    assert pd.isna(table["expected_reduction"][1])


def test_mistakes_end_in_one_sentence(out, tmp_path):
    assert "unknown quantity 'bend'; did you mean 'band'?" in refusal(out, "--goal", "bend")
    assert "forbid every candidate" in refusal(out, "--limits", "0.01 in")
    assert "limit of the force, 0.01 kip" in refusal(out, "--limits", "10 lbf")
    assert "must not end in .png" in refusal(out, "-o", tmp_path / "a.png")
    other = tmp_path / "other.toml"
    other.write_text("x = 1\n")
    assert "other.toml exists: give another name, or --force" in refusal(out, "--write", other)
    assert other.read_text() == "x = 1\n"
    empty = tmp_path / "empty.txt"
    empty.write_text("# nothing\n")
    assert "has no test" in refusal(out, "--candidates", empty)
    assert "there is no file" in refusal(out, "--candidates", tmp_path / "none.txt")
    assert "give --write too" in refusal(out, "--tests", 2)
    assert "has no manifest.json" in refusal(tmp_path) or "manifest" in refusal(tmp_path)


# --- [goal] of a campaign file

GOAL = """
[goal]
quantity = "energy"
at = ["1000 psi, 0.5 Hz, 1 in"]
candidates = ["500|1000 psi, 0.5 Hz, 1 in"]
limits = "10 in/s, 6 in, 20 kip"
"""


def test_the_goal_of_the_campaign_file_is_taken(out, finished_run, tmp_path):
    changed = shutil.copytree(out, tmp_path / "out")
    path = changed / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["settings"] |= tomllib.loads(GOAL)  # as a campaign with this goal is stored
    path.write_text(json.dumps(manifest))
    advice = mb.open_run(changed).next_test(draws=300)
    assert (advice.goal.quantity, advice.unit) == ("energy", "kip*in")
    assert sorted(row.candidate.actuation for row in advice) == [0.5, 1.0]
    given = mb.open_run(changed).next_test(goal="band at 500 psi", draws=300)
    assert (given.goal.quantity, len(given)) == ("band", 2)


def test_a_bad_goal_is_found_when_the_campaign_is_read(finished_run, tmp_path):
    for old, new, said in [
        ('"energy"', '"energie"', "goal.quantity in {}: unknown quantity 'energie'"),
        ("500|1000 psi", "500|1000", "goal.candidates in {}: a test reads"),
        ("quantity", "quantty", "unknown key 'quantty' in [goal] of {}; did you mean 'quantity'"),
        (
            "limits",
            'session = "2023"\nlimits',
            "goal.session in {}: no calibrated test has the session '2023'; they have no sessions",
        ),
    ]:
        folder = tmp_path / "campaign"
        shutil.copytree(finished_run.campaign.parent, folder, dirs_exist_ok=True)
        path = folder / "campaign.toml"
        path.write_text(path.read_text() + GOAL)
        assert load_campaign(path).tests  # the control
        path.write_text(path.read_text().replace(GOAL, GOAL.replace(old, new)))
        with pytest.raises(CampaignError) as caught:
            load_campaign(path)
        assert said.format(path) in str(caught.value)
