"""The command next on a small synthetic campaign, tested at 500, 1000 and 1500 psi."""

import json
import shutil
import tomllib

import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import CampaignError
from tests.command_line import here, refusal

FEW = "1000|1900 psi, 0.5 Hz, 1 in"
GOAL = """
[goal]
quantity = "energy"
at = ["1000 psi, 0.5 Hz, 1 in"]
candidates = ["500|1000 psi, 0.5 Hz, 1 in"]
limits = "10 in/s, 6 in, 20 kip"
"""


@pytest.fixture(scope="module")
def copied(out, tmp_path_factory):
    return shutil.copytree(out, tmp_path_factory.mktemp("next") / "out")


@pytest.fixture(scope="module")
def words(copied):
    return lambda *options: ("next", copied, *options, "--draws", 300)


def test_it_advises_and_writes_table_json_picture_and_draft(words, copied, tmp_path):
    draft = tmp_path / "next.toml"
    outcome = here(*words("--candidates", FEW, "--write", draft, "--tests", 2))
    assert outcome.exit_code == 0, outcome.stderr
    assert "The best two together" in outcome.stdout
    table = pd.read_csv(copied / "next.csv")
    assert table["expected_reduction"].is_monotonic_decreasing
    repeats = table.set_index("actuation_psi")["repeats_a_test"].to_dict()
    assert repeats == {1000.0: "yes", 1900.0: "no"}
    summary = json.loads((copied / "next.json").read_text())
    assert summary["sentence"] in outcome.stdout.replace("\n", " ")
    assert [point["tests"] for point in summary["curve"]] == list(range(7))
    assert summary["curve"][0]["expected_width"] == pytest.approx(summary["width_now"])
    assert (copied / "next.png").read_bytes().startswith(b"\x89PNG")
    entries = tomllib.loads(draft.read_text())["test"]
    assert len(entries) == 2
    assert {entry["actuation"] for entry in entries} <= {"1000 psi", "1900 psi"}
    advice = mb.next_test(mb.open_run(copied), candidates=FEW, draws=300)  # the same in Python
    assert list(table["expected_reduction"]) == pytest.approx(advice["reduction"], rel=1e-4)


def test_candidates_of_a_file_within_limits_in_metric_units(words, copied, tmp_path):
    path = tmp_path / "candidates.txt"
    path.write_text("# what the frame can do\n1500 psi, 0.5 Hz, 1 in\n\n700 psi, 2 h  # long\n")
    options = ("--candidates", path, "--limits", "2 kip", "--units", "si")
    outcome = here(*words(*options))  # its own files are replaced
    assert outcome.exit_code == 0, outcome.stderr
    assert "One test at 4.826 MPa, 0.5 Hz, 25.4 mm" in outcome.stdout
    assert "10.34 MPa" not in outcome.stdout
    table = pd.read_csv(copied / "next.csv")
    assert list(table["actuation_MPa"]) == pytest.approx([4.82633, 10.3421], rel=1e-4)
    assert list(table["amplitude_mm"]) == pytest.approx([25.4, 25.4])
    assert table["cost_h"][0] == 2.0
    assert table["cost_h"][1] < 1.0
    assert table["ruled_out_by"][1] == "force"
    assert pd.isna(table["expected_reduction"][1])


def test_mistakes_end_in_one_sentence(words, tmp_path):
    existing, empty = tmp_path / "other.toml", tmp_path / "empty.txt"
    existing.write_text("x = 1\n")
    empty.write_text("# nothing\n")
    for options, offender in (
        (("--goal", "bend"), "unknown quantity 'bend'; did you mean 'band'?"),
        (("--limits", "0.01 in"), "forbid every candidate"),
        (("-o", tmp_path / "a.png"), "must not end in .png"),
        (("--write", existing), "other.toml exists: give another name, or --force"),
        (("--candidates", empty), "has no test"),
        (("--tests", 2), "give --write too"),
    ):
        assert offender in refusal(*words(*options))
    assert existing.read_text() == "x = 1\n"
    assert "manifest" in refusal("next", tmp_path)


def test_the_goal_of_the_campaign_file_is_taken(copied, tmp_path):
    folder = shutil.copytree(copied, tmp_path / "out")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["settings"] |= tomllib.loads(GOAL)  # as a campaign with this goal is stored
    (folder / "manifest.json").write_text(json.dumps(manifest))
    advice = mb.next_test(mb.open_run(folder), draws=300)
    assert (advice.goal.quantity, advice.unit) == ("energy", "kip*in")
    assert sorted(row.candidate.actuation for row in advice) == [0.5, 1.0]
    explicit = mb.next_test(mb.open_run(folder), goal="band at 500 psi", draws=300)
    assert (explicit.goal.quantity, len(explicit)) == ("band", 2)


def test_a_bad_goal_is_found_when_the_campaign_is_read(finished_run, tmp_path):
    shutil.copytree(finished_run.campaign.parent, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "campaign.toml"
    text = path.read_text()
    path.write_text(text + GOAL)
    assert load_campaign(path).tests  # the control
    for target, replacement, words in (
        ('"energy"', '"energie"', "goal.quantity in {}: unknown quantity 'energie'"),
        ("limits", 'session = "2023"\nlimits', "goal.session in {}: no calibrated test has"),
    ):
        path.write_text(text + GOAL.replace(target, replacement))
        with pytest.raises(CampaignError) as caught:
            load_campaign(path)
        assert words.format(path) in str(caught.value)
