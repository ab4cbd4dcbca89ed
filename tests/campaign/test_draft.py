"""A first campaign for a folder: correct where names are clear, with doubts where they are not."""

import json
import os
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft import campaign_text, doubts, draft_campaign, gaps, own_priors
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.record import Source

HEADER = "time_s,displacement_in,force_kip"
TIME = np.arange(401) / 50.0
MOTION = np.sin(np.pi * TIME)
FORCE = np.tanh(4 * np.gradient(MOTION, TIME)) + 0.01 * np.cos(37 * TIME)
SIGNALS = np.column_stack([TIME, MOTION, FORCE])  # s, in, kip


def write(path, header=HEADER, table=SIGNALS, preamble=""):
    lines = "".join(",".join(f"{cell:.6f}" for cell in row) + "\n" for row in table)
    path.write_text(f"{preamble}{header}\n{lines}", encoding="utf-8")


def with_column(values):
    return np.column_stack([SIGNALS, values])


def draft_of(folder):
    draft = draft_campaign(folder)
    return draft, tomllib.loads(campaign_text(draft))


def accepted(folder):
    """Campaign that is written for a folder, once a dry run has accepted it."""
    draft = draft_campaign(folder)
    (folder / "campaign.toml").write_text(campaign_text(draft), encoding="utf-8")
    if (priors := own_priors(draft)) is not None:
        (folder / "priors.toml").write_text(priors, encoding="utf-8")
    words = ["calibrate", str(folder / "campaign.toml"), "-o", str(folder / "out"), "--dry-run"]
    outcome = CliRunner().invoke(app, words)
    assert outcome.exit_code == 0, outcome.output
    return load_campaign(folder / "campaign.toml")


def test_laboratories_call_their_columns_as_they_like(tmp_path):
    for header, *units in (
        ("Time (sec),Axial Displacement (mm),Axial Force (kN)", "sec", "mm", "kN"),
        ("Time [s],LVDT [in],Load Cell [lbf]", "s", "in", "lbf"),
        ("elapsed_ms,stroke_mm,load_N", "ms", "mm", "N"),
        ("t_s,disp_cm,Force kN", "s", "cm", "kN"),
        ("TestTime_s,ActuatorStroke_in,LoadCell_kip", "s", "in", "kip"),
        (f"{HEADER},displacement_command_in,actuator_1_position_in", "s", "in", "kip"),
    ):
        names = header.split(",")
        table = np.column_stack([SIGNALS, *[MOTION * 1.01] * (len(names) - 3)])
        write(tmp_path / "a_500psi.csv", header, table)
        draft, content = draft_of(tmp_path)
        columns = {role: (c["name"], c.get("unit")) for role, c in content["columns"].items()}
        expected = zip(names[:3], units, strict=True)
        assert columns == dict(zip(("time", "displacement", "force"), expected, strict=True))
        assert doubts(draft) == gaps(draft) == []


def test_what_is_guessed_is_a_doubt(tmp_path):
    two = ("time_s,LVDT1_in,force_kip,LVDT2_in", with_column(MOTION * 0.98))
    for header, table, role, column, doubt in (
        ("Time,disp_in,force_kip", SIGNALS, "time", ("Time", "s"), "look like s"),
        ("Time,disp_in,force_kip", SIGNALS * [1e3, 1, 1], "time", ("Time", "ms"), "look like ms"),
        (HEADER, SIGNALS * [1e3, 1, 1], "time", ("time_s", "s"), ""),  # as slow as it says
        ("time_s,disp,force_kN", SIGNALS, "displacement", ("disp", "mm"), "mm matches the other"),
        ("Ch 1,Ch 2,Ch 3", SIGNALS[:, [2, 0, 1]], "force", ("Ch 1", None), "guessed from the num"),
        ("Tijd [s],Weg [mm],Last [kN]", SIGNALS, "force", ("Last [kN]", "kN"), "its unit alone"),
        (*two, "displacement", ("LVDT1_in", "in"), "LVDT2_in"),
    ):
        write(tmp_path / "500psi.csv", header, table)
        draft, content = draft_of(tmp_path)
        entry = content["columns"].get(role)
        assert (entry and (entry["name"], entry.get("unit"))) == column
        sentences = doubts(draft)
        assert any(doubt in sentence for sentence in sentences) if doubt else not sentences
        for sentence in sentences:
            assert sentence.split(": ", 1)[1] in campaign_text(draft)


# --- the actuation


LEVELS = {
    "1000psi": "1000 psi",
    "P1500-2": "1500 psi",
    "2022_35lb_0.50Hz_1.0in": "35 lbf",
    "0p5kN": "0.5 kN",
    "0x5kN": "0.5 kN",
    "25mm0x25Hz0x75A": "0.75 A",
    "120 kPa": "120 kPa",
    "tension30": "30 lbf",
    "seal_0,5MPa": "0.5 MPa",
    "2022,36lb,0.25Hz": "36 lbf",
    "p500,1in": "500 psi",
    **dict.fromkeys(("pump1", "step0.015backward", "3in_2Hz", "p0.5Hz", "test12")),
    **dict.fromkeys(("1,200psi", "1.5e3psi", "p1,200", "p2,5", "test3,35lb")),
}


def test_a_level_is_read_off_a_name(tmp_path):
    for name in LEVELS:
        write(tmp_path / f"{name}.csv")
    write(tmp_path / "other.csv")
    draft = draft_campaign(tmp_path)
    levels = {Path(test.file).stem: test.actuation for test in draft.tests}
    for name, reason in draft.left_out:  # of the other kind, with the level
        levels[Path(name).stem] = re.search(r"actuation of (\S+ \S+) is", reason)[1]
    assert levels == {**LEVELS, "other": None}


READINGS = {
    ("damper_0_5bar", "damper_1_0bar", "damper_1_5bar"): ("0.5 bar", "1 bar", "1.5 bar"),
    ("a_0-5kN", "a_1-25kN"): ("0.5 kN", "1.25 kN"),
    ("1 500psi", "2 000psi"): ("1500 psi", "2000 psi"),
    ("P1_25MPa", "P1_50MPa"): ("25 MPa", "50 MPa"),
    ("1 500psi",): ("500 psi",),
    ("run_1_5bar", "run_2_5bar"): ("5 bar", "5 bar"),
    ("1x5bar",): ("1.5 bar",),
}


@pytest.mark.parametrize("names", READINGS)
def test_a_number_in_a_name_that_may_be_another_is_a_doubt(tmp_path, names):
    for name in names:
        write(tmp_path / f"{name}.csv")
    draft = draft_campaign(tmp_path)
    assert tuple(test.actuation for test in draft.tests) == READINGS[names]
    for test in draft.tests:
        assert any(" may be " in doubt and " or " in doubt for doubt in test.doubts)


@pytest.mark.parametrize(
    ("line", "level"),
    [
        ("Pressure: 1 500 psi", "1500 psi"),
        ("Pressure: 2.000,0 kPa", "2000 kPa"),
        ("Pressure: 1234,5 kPa", "1234.5 kPa"),
        ("Pressure: 1'500 psi", "1500 psi"),
        ("Brake pressure = 0,5 bar", "0.5 bar"),
    ],
)
def test_a_level_in_a_header_is_read_whole(tmp_path, line, level):
    write(tmp_path / "a.csv", preamble=f"# {line}\n")
    assert [test.actuation for test in draft_campaign(tmp_path).tests] == [level]


def test_an_x_and_an_underscore_are_decimal_points_of_frequency_and_length(tmp_path):
    for name in ("500psi_0x5Hz_1x0in", "500psi_0_5Hz_1_0in"):
        write(tmp_path / f"{name}.csv")
        assert draft_campaign(tmp_path).tests[0].doubts == ()
        (tmp_path / f"{name}.csv").unlink()
    write(tmp_path / "a_0x25A.csv")
    assert draft_campaign(tmp_path).tests[0].actuation == "0.25 A"


def test_a_device_that_turns_is_sent_to_a_model_of_its_own(tmp_path):
    for header in (
        "time_s,q [rad],tau [Nm]",
        "Time (s),Angle (deg),Torque (NM)",
        "t_s,w_rpm,M_kNm",
    ):
        write(tmp_path / "5bar.csv", header)
        with pytest.raises(CampaignError, match=r"is a torque and .* an angle"):
            draft_campaign(tmp_path)
    write(tmp_path / "5bar.csv", "time_s,disp_nm,force_N", SIGNALS * [1, 1e6, 1e3])
    assert draft_campaign(tmp_path).tests[0].columns["displacement"].unit == "nm"


def test_the_actuation_is_that_of_the_column_the_header_or_the_name(tmp_path):
    steady, changing = 500 + np.cos(7 * TIME), 500 + 200 * np.sin(TIME)
    psi = {"name": "pressure_psi", "unit": "psi"}
    for name, preamble, column, actuation, doubt in (
        ("p500", "", None, "500 psi", "p500: psi is assumed; it may be kPa"),
        ("500psi", "", 800 + 0 * TIME, "800 psi", "500 psi in the name or header, 800 psi in"),
        ("a", "# Brake pressure: 120 kPa\n", None, "120 kPa", ""),
        ("a", "# Brake held at 500 psi\n", None, "500 psi", "a: it is a pressure in the header"),
        ("800psi", "# Supply of 3000 psi\n", None, "800 psi", "it could also be 3000 psi"),
        ("0psi", "", None, "0 psi", "only laws with an intercept learn from it"),
        ("a", "", steady, "500 psi", ""),
        ("a", "", changing, psi, ""),
    ):
        header = HEADER if column is None else f"{HEADER},pressure_psi"
        table = SIGNALS if column is None else with_column(column)
        write(tmp_path / f"{name}.csv", header, table, preamble)
        draft, content = draft_of(tmp_path)
        assert content["test"][0]["actuation"] == actuation
        assert (doubt in " ".join(doubts(draft))) if doubt else doubts(draft) == []
        (tmp_path / f"{name}.csv").unlink()


def test_of_several_levels_the_one_that_differs_counts_and_that_of_the_other_kind_is_left_out(
    tmp_path,
):
    write(tmp_path / "30lb.csv")
    assert draft_of(tmp_path)[1]["campaign"]["priors"] == "brfd"  # of tensions
    for name in ("20kN damper 500psi.csv", "20kN damper 800psi.csv", "20kN damper 900psi.csv"):
        write(tmp_path / name)
    (tmp_path / "30lb.csv").rename(tmp_path / "20kN damper.csv")
    actuations = [test.actuation for test in accepted(tmp_path).tests]
    assert actuations == ["500 psi", "800 psi", "900 psi"]
    ((name, reason),) = draft_campaign(tmp_path).left_out
    assert name == "20kN damper.csv"
    assert "is a force" in reason


# --- files


def test_columns_that_most_files_have_are_shared_and_others_override(tmp_path):
    for name in ("1000psi.csv", "500psi.csv"):
        write(tmp_path / name)
    draft, content = draft_of(tmp_path)
    assert doubts(draft) == gaps(draft) == []
    assert content["campaign"]["priors"] == "mfd"
    tests = [(test["id"], test["actuation"]) for test in content["test"]]
    assert tests == [("500psi", "500 psi"), ("1000psi", "1000 psi")]
    write(tmp_path / "1100psi_SI.csv", "time_s,displacement_m,force_N")
    content = draft_of(tmp_path)[1]
    assert content["columns"]["force"]["name"] == "force_kip"
    roles = [set(test.get("columns", {})) for test in content["test"]]
    assert roles == [set(), set(), {"displacement", "force"}]
    accepted(tmp_path)


def test_files_that_are_no_tests_are_left_out_with_the_reason(tmp_path):
    folder, linked = tmp_path / "folder", tmp_path / "others"
    for directory in (folder, linked, folder / "sub"):
        directory.mkdir()
        write(directory / "900psi.csv")
    (folder / "link.csv").symlink_to(linked / "900psi.csv")
    write(folder / "still_500psi.csv", table=SIGNALS * [1, 0, 1])
    bands = "time_s,displacement_in,lower_kip,median_kip,upper_kip"
    write(folder / "bands.csv", bands, np.column_stack([SIGNALS, FORCE, FORCE]))
    (folder / "notes.txt").write_text("We tested on Monday\nand it rained\n")
    (folder / "broken.csv").write_text(f"{HEADER}\n1,fast,3\n")
    (folder / "empty.csv").touch()
    (folder / "._900psi.csv").write_bytes(b"\0\5\26\7")
    (folder / "photo.jpg").write_bytes(b"\xff\xd8")
    columns = {"time_s": TIME, "displacement_in": MOTION, "force \ud800 (kip)": FORCE}
    (folder / "800psi.json").write_text(json.dumps({k: v.tolist() for k, v in columns.items()}))
    expected = {
        "sub": "this one has 1",
        "link.csv": "link",
        "still_500psi.csv": "constant",
        "bands.csv": "written by mfd-bayes",
        "notes.txt": "",
        "broken.csv": "line 2",
        "empty.csv": "empty",
        "800psi.json": "not UTF-8",
    }
    try:
        write(folder / os.fsdecode(b"caf\xe9 800psi.csv"))
        expected["caf\\udce9 800psi.csv"] = "not UTF-8"
    except OSError:
        pass  # this file system takes UTF-8 names alone
    draft = draft_campaign(folder)
    reasons = dict(draft.left_out)
    assert reasons.keys() == expected.keys()
    for name, words in expected.items():
        assert words in reasons[name]
        assert f"# {name}: " in campaign_text(draft)
    assert [test.id for test in accepted(folder).tests] == ["900psi"]


def test_any_name_comes_out_as_valid_toml(tmp_path):
    names = [
        'a "quoted" 500psi.csv',
        "back\\slash 500psi.csv",
        'x"\n[[test]]\nid = "500psi.csv',
        "试验 500psi.CSV",
        "\x7f\x01 500psi.csv",
        "# comment\u2028 500psi.csv",
    ]
    for name in names:
        write(tmp_path / name, 'time_s,"disp ""x"" (in)","force\' # = \t (kip)"')
        write(tmp_path / f"no test {name}", "a,b", np.eye(2))
    draft, content = draft_of(tmp_path)
    assert {test["file"] for test in content["test"]} == set(names)
    assert len(draft.left_out) == len(names)
    (tmp_path / "campaign.toml").write_text(campaign_text(draft), encoding="utf-8")
    for test in load_campaign(tmp_path / "campaign.toml").tests:
        assert test.columns["displacement"] == Source('disp "x" (in)', "in")
        assert test.read().force is not None


def test_ids_differ_whatever_the_case_of_letters_and_from_a_runs_own_names(tmp_path):
    for name in ("500psi.csv", "500PSI.csv", "500psi.txt", "500 psi!.csv"):
        write(tmp_path / name)
    write(tmp_path / "population.csv", preamble="# pressure: 500 psi\n")
    ids = {test.id.lower() for test in accepted(tmp_path).tests}
    assert len(ids) == 5
    assert "population_2" in ids


def test_the_real_records_are_laid_out_but_for_the_semi_active_ones(tmp_path, data_folder):
    for name in ("2022_25lb_1.00Hz_1.0in", "2023_36lb_0.10Hz_1.0in_SI", "2023_36lb_KocaeliDBE"):
        shutil.copy(data_folder / f"{name}.csv", tmp_path)
    shutil.copy(data_folder / "manifest.csv", tmp_path)
    campaign = accepted(tmp_path)
    assert [test.actuation for test in campaign.tests] == ["25 lbf", "36 lbf", "36 lbf"]
    assert {test.role for test in campaign.tests} == {"calibrate"}
    assert campaign.priors == "brfd"
    text = campaign.path.read_text()
    assert text.count('# role = "validate"') == 1  # of an earthquake
    assert "# manifest.csv: " in text.split("# Left out:")[1]
    (tmp_path / "other").mkdir()
    shutil.copy(data_folder / "2023-08_semiactive_step0.015backward.csv", tmp_path / "other")
    assert "FIXME" in campaign_text(draft_campaign(tmp_path / "other"))


def test_numbers_judge_the_columns_that_names_leave_open(tmp_path):
    t = np.arange(0.0, 10.0, 0.01)
    x, f = 20.0 * np.sin(np.pi * t), np.tanh(8.0 * np.cos(np.pi * t))
    for head, columns, name, words in (
        ("t [s],P [kN],Q [kN],d [mm]", (500.0 + 0.1 * t, f, x), "Q [kN]", "does not follow"),
        (
            "Time (s),Stroke (mm),Extens. (mm),Load (kN)",
            (x + 3.0 * f, x, f),
            "Load (kN)",
            "could also be 'Extens. (mm)'",
        ),
    ):
        folder = tmp_path / name[0]
        folder.mkdir()
        table = np.column_stack([t, *columns])
        np.savetxt(folder / "a_5bar.csv", table, "%.5f", ",", header=head, comments="")
        draft = draft_campaign(folder)
        assert draft.tests[0].columns["force"].name == name
        assert any(words in doubt for doubt in doubts(draft))
