"""A first campaign for a folder: correct where names are clear, with doubts where they are not."""

import json
import os
import shutil
import tomllib

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft import campaign_text, doubts, draft_campaign, gaps, own_priors
from mfd_bayes.campaign.draft.actuation import levels_in
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import CampaignError, MfdError
from mfd_bayes.records.channels import Source

HEADER = "time_s,displacement_in,force_kip"


def signals(rate=50.0, cycles=4):
    """Time, displacement and force, s, in, kip: (T, 3)."""
    time = np.arange(int(rate * cycles * 2) + 1) / rate
    motion = np.sin(np.pi * time)
    force = np.tanh(4 * np.gradient(motion, time)) + 0.01 * np.cos(37 * time)
    return np.column_stack([time, motion, force])


def write(path, header=HEADER, table=None, above=""):
    rows = signals() if table is None else table
    lines = "".join(",".join(f"{cell:.6f}" for cell in row) + "\n" for row in rows)
    path.write_text(f"{above}{header}\n{lines}", encoding="utf-8")


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


def plain(columns):
    return {role: (c["name"], c.get("unit")) for role, c in columns.items()}


# --- from names


def test_files_that_name_everything_leave_no_doubt(tmp_path):
    for name in ("1000psi.csv", "500psi.csv"):
        write(tmp_path / name)
    draft, content = draft_of(tmp_path)
    assert doubts(draft) == gaps(draft) == []
    assert content["campaign"]["priors"] == "mfd"
    assert plain(content["columns"]) == {
        "time": ("time_s", "s"),
        "displacement": ("displacement_in", "in"),
        "force": ("force_kip", "kip"),
    }
    assert [(t["id"], t["actuation"]) for t in content["test"]] == [
        ("500psi", "500 psi"),
        ("1000psi", "1000 psi"),
    ]
    accepted(tmp_path)


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("Time (sec),Axial Displacement (mm),Axial Force (kN)", ("sec", "mm", "kN")),
        ("Time [s],LVDT [in],Load Cell [lbf]", ("s", "in", "lbf")),
        ("elapsed_ms,stroke_mm,load_N", ("ms", "mm", "N")),
        ("t_s,disp_cm,Force kN", ("s", "cm", "kN")),
        ("TestTime_s,ActuatorStroke_in,LoadCell_kip", ("s", "in", "kip")),
        ("Running Time (s),Position (in),Force (kips)", ("s", "in", "kips")),
    ],
)
def test_laboratories_call_their_columns_as_they_like(tmp_path, header, units):
    write(tmp_path / "a_500psi.csv", header)
    draft, content = draft_of(tmp_path)
    names = header.split(",")
    expected = zip(("time", "displacement", "force"), names, units, strict=True)
    assert plain(content["columns"]) == {role: (n, u) for role, n, u in expected}
    assert doubts(draft) == gaps(draft) == []


def test_commands_and_other_channels_are_not_taken_for_what_was_measured(tmp_path):
    table = np.column_stack([signals(), signals()[:, 1:2] * 1.01, signals()[:, 1:2] * 0.3])
    header = f"{HEADER},displacement_command_in,actuator_1_position_in"
    write(tmp_path / "a_500psi.csv", header, table)
    draft, content = draft_of(tmp_path)
    assert content["columns"]["displacement"]["name"] == "displacement_in"
    assert doubts(draft) == []


def test_two_that_are_as_likely_are_a_doubt_with_the_alternative(tmp_path):
    table = np.column_stack([signals(), signals()[:, 1:2] * 0.98])
    write(tmp_path / "a_500psi.csv", "time_s,LVDT1_in,force_kip,LVDT2_in", table)
    draft, content = draft_of(tmp_path)
    assert content["columns"]["displacement"]["name"] == "LVDT1_in"
    (doubt,) = doubts(draft)
    assert "LVDT2_in" in doubt
    assert f"# unsure: {doubt.removeprefix('columns: ')}" in campaign_text(draft)


def test_a_velocity_is_taken_where_it_is_the_slope_of_the_displacement(tmp_path):
    time, motion, _ = signals().T
    slope = np.gradient(motion, time)[:, None]
    header = f"{HEADER},velocity_in_per_s"
    write(tmp_path / "500psi.csv", header, np.hstack([signals(), slope]))
    assert plain(draft_of(tmp_path)[1]["columns"])["velocity"] == ("velocity_in_per_s", "in/s")
    write(tmp_path / "500psi.csv", header, np.hstack([signals(), -slope]))
    assert "velocity" not in draft_of(tmp_path)[1]["columns"]


def test_a_matlab_file_is_looked_at_too(tmp_path):
    time, motion, force = signals().T
    savemat(tmp_path / "p500.mat", {"time_s": time, "disp_mm": 25.4 * motion, "force_kN": force})
    assert accepted(tmp_path).tests[0].columns["displacement"] == Source("disp_mm", "mm")


# --- from numbers


def test_time_in_milliseconds_is_seen_from_its_steps(tmp_path):
    table = signals() * [1000.0, 1.0, 1.0]
    write(tmp_path / "500psi.csv", "Time,disp_in,force_kip", table)
    draft, content = draft_of(tmp_path)
    assert content["columns"]["time"]["unit"] == "ms"
    assert "look like ms" in doubts(draft)[0]
    write(tmp_path / "500psi.csv", "Time,disp_in,force_kip")
    draft, content = draft_of(tmp_path)
    assert content["columns"]["time"]["unit"] == "s"
    assert "look like s" in doubts(draft)[0]


def test_time_that_says_seconds_is_seconds_however_slow_it_is(tmp_path):
    write(tmp_path / "500psi.csv", HEADER, signals() * [1000.0, 1.0, 1.0])
    draft, content = draft_of(tmp_path)
    assert content["columns"]["time"]["unit"] == "s"
    assert not doubts(draft)


def test_a_unit_that_goes_with_the_others_is_a_doubt(tmp_path):
    write(tmp_path / "500psi.csv", "time_s,disp,force_kN")
    draft, content = draft_of(tmp_path)
    assert content["columns"]["displacement"]["unit"] == "mm"
    assert "mm matches the other columns, in does not" in doubts(draft)[0]


def test_columns_without_names_are_guessed_from_their_numbers(tmp_path):
    table = signals()[:, [2, 0, 1]]
    write(tmp_path / "500psi.csv", "Ch 1,Ch 2,Ch 3", table)
    draft, content = draft_of(tmp_path)
    found = {role: c["name"] for role, c in content["columns"].items()}
    assert found == {"time": "Ch 2", "displacement": "Ch 3", "force": "Ch 1"}
    assert any("guessed from the numbers" in doubt for doubt in doubts(draft))


def test_units_that_nothing_tells_are_to_be_filled_in(tmp_path):
    write(tmp_path / "500psi.csv", "t,disp,load")
    draft, content = draft_of(tmp_path)
    assert "unit" not in content["columns"]["displacement"]
    assert "FIXME: the unit of displacement is unknown" in campaign_text(draft)
    assert len(gaps(draft)) == 2
    (tmp_path / "campaign.toml").write_text(campaign_text(draft))
    with pytest.raises(MfdError, match=r"column 'disp' of .* give the unit of displacement"):
        load_campaign(tmp_path / "campaign.toml").tests[0].read()


# --- the actuation


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("1000psi", "1000 psi"),
        ("p500", "500 psi"),
        ("P1500-2", "1500 psi"),
        ("p500_f0.05", "500 psi"),
        ("30lb", "30 lbf"),
        ("2022_35lb_0.50Hz_1.0in", "35 lbf"),
        ("0.5kN run 2", "0.5 kN"),
        ("0p5kN", "0.5 kN"),
        ("120 kPa", "120 kPa"),
        ("_35lb_", "35 lbf"),
        ("tension30", "30 lbf"),
        ("seal_0,5MPa", "0.5 MPa"),
        ("3,5bar run 2", "3.5 bar"),
        ("36lb,0.25Hz", "36 lbf"),
        ("2022,36lb,0.25Hz", "36 lbf"),
        ("brfd,2023,35lb", "35 lbf"),
        ("p500,1in", "500 psi"),
        ("p500,0.5Hz", "500 psi"),
    ],
)
def test_a_level_is_read_off_a_name(name, level):
    assert [found.text for found in levels_in(name)] == [level]


@pytest.mark.parametrize(
    "name",
    [
        *("pump1", "step0.015backward", "3in_2Hz", "p0.5Hz", "test12", "harmonic0.03ea1forward"),
        *("1,200psi", "1.5e3psi", "p1,200", "p2,5", "test3,35lb"),
    ],
)
def test_what_is_no_level_is_not_taken_for_one(name):
    assert levels_in(name) == ()


def test_a_number_after_p_is_psi_with_a_doubt(tmp_path):
    write(tmp_path / "p500.csv")
    draft, content = draft_of(tmp_path)
    assert content["test"][0]["actuation"] == "500 psi"
    assert doubts(draft) == ["p500: psi is assumed; it may be kPa"]


def test_of_two_levels_in_a_name_the_one_that_differs_counts(tmp_path):
    for name in ("20kN damper 500psi.csv", "20kN damper 800psi.csv"):
        write(tmp_path / name)
    found = accepted(tmp_path)
    assert [test.actuation for test in found.tests] == ["500 psi", "800 psi"]


def test_a_column_that_stays_is_a_level_and_one_that_moves_a_history(tmp_path):
    size = len(signals())
    still = 500 + np.random.default_rng(0).standard_normal((size, 1))
    write(tmp_path / "a.csv", f"{HEADER},pressure_psi", np.hstack([signals(), still]))
    moving = 500 + 200 * np.sin(signals()[:, :1])
    write(tmp_path / "b.csv", f"{HEADER},pressure_psi", np.hstack([signals(), moving]))
    first, second = draft_of(tmp_path)[1]["test"]
    assert first["actuation"] == "500 psi"
    assert second["actuation"] == {"name": "pressure_psi", "unit": "psi"}
    accepted(tmp_path)


def test_a_name_that_contradicts_the_column_is_a_doubt(tmp_path):
    still = np.full((len(signals()), 1), 800.0)
    write(tmp_path / "500psi.csv", f"{HEADER},pressure_psi", np.hstack([signals(), still]))
    draft, content = draft_of(tmp_path)
    assert content["test"][0]["actuation"] == "800 psi"
    assert "500 psi" in doubts(draft)[0]


def test_a_level_is_read_off_the_lines_above_the_numbers(tmp_path):
    write(tmp_path / "a.csv", above="# Brake pressure: 120 kPa\n")
    assert draft_of(tmp_path)[1]["test"][0]["actuation"] == "120 kPa"


def test_a_pressure_above_the_numbers_that_is_not_called_one_is_a_doubt(tmp_path):
    write(tmp_path / "a.csv", above="# Brake held at 500 psi\n")
    draft, content = draft_of(tmp_path)
    assert content["test"][0]["actuation"] == "500 psi"
    assert doubts(draft) == ["a: it is a pressure in the header lines"]
    write(tmp_path / "a.csv", above="# Supply of 3000 psi\n")
    (tmp_path / "a.csv").rename(tmp_path / "800psi.csv")
    draft, content = draft_of(tmp_path)
    assert content["test"][0]["actuation"] == "800 psi"
    assert doubts(draft) == ["800psi: it could also be 3000 psi"]


def test_an_actuation_of_zero_is_a_test_with_a_doubt(tmp_path):
    for name in ("0psi.csv", "500psi.csv"):
        write(tmp_path / name)
    draft, content = draft_of(tmp_path)
    assert [test["actuation"] for test in content["test"]] == ["0 psi", "500 psi"]
    (doubt,) = doubts(draft)
    assert "only laws with an intercept learn from it" in str(doubt)
    assert len(accepted(tmp_path).tests) == 2


def test_a_link_to_a_file_elsewhere_is_left_out(tmp_path):
    folder = tmp_path / "tests"
    folder.mkdir()
    write(folder / "500psi.csv")
    write(tmp_path / "800psi.csv")
    (folder / "800psi.csv").symlink_to(tmp_path / "800psi.csv")
    assert [test.id for test in accepted(folder).tests] == ["500psi"]


def test_columns_that_only_their_units_tell_are_a_doubt(tmp_path):
    write(tmp_path / "500psi.csv", "Tijd [s],Weggrootheid [mm],Last [kN]")
    draft, content = draft_of(tmp_path)
    assert content["columns"]["force"] == {"name": "Last [kN]", "unit": "kN"}
    assert doubts(draft) == [
        f"columns: column for {role} chosen by its unit alone"
        for role in ("time", "displacement", "force")
    ]


def test_a_row_of_units_is_read(tmp_path):
    rows = "".join(f"{t:.4f}\t{25.4 * x:.5f}\t{f:.5f}\n" for t, x, f in signals())
    names = "Running Time\tAxial Displacement\tAxial Force\nSec\tmm\tkN\n"
    (tmp_path / "500psi.txt").write_text(f"Station Name: Frame 4\n\n{names}{rows}")
    content = draft_of(tmp_path)[1]
    assert [column["unit"] for column in content["columns"].values()] == ["Sec", "mm", "kN"]
    assert accepted(tmp_path).tests[0].read().displacement.max() == pytest.approx(1.0, abs=1e-4)


def test_tensions_bring_the_priors_of_the_band_brake(tmp_path):
    write(tmp_path / "30lb.csv")
    draft, content = draft_of(tmp_path)
    assert content["campaign"]["priors"] == "brfd"
    assert "actuations here are tensions" in campaign_text(draft)
    accepted(tmp_path)


def test_a_test_of_the_other_kind_of_actuation_is_left_out(tmp_path):
    for name in ("500psi.csv", "800psi.csv", "30lb.csv"):
        write(tmp_path / name)
    assert len(accepted(tmp_path).tests) == 2
    ((name, reason),) = draft_campaign(tmp_path).left_out
    assert name == "30lb.csv"
    assert "is a force" in reason


def test_an_actuation_that_nothing_tells_is_to_be_filled_in(tmp_path):
    write(tmp_path / "500psi.csv")
    write(tmp_path / "first.csv", f"{HEADER},cell_lbf", np.hstack([signals(), signals()[:, 2:]]))
    draft = draft_campaign(tmp_path)
    assert '# FIXME: add actuation = "500 psi" or similar' in campaign_text(draft)
    assert "'cell_lbf'" in gaps(draft)[0]
    (tmp_path / "campaign.toml").write_text(campaign_text(draft))
    with pytest.raises(CampaignError, match=r"^test 'first'\.actuation is missing in"):
        load_campaign(tmp_path / "campaign.toml")
    (tmp_path / "500psi.csv").unlink()
    (tmp_path / "campaign.toml").write_text(campaign_text(draft_campaign(tmp_path)))
    with pytest.raises(CampaignError, match=r"^test 'first'\.actuation is missing in [^;]*$"):
        load_campaign(tmp_path / "campaign.toml")


# --- files


def test_columns_that_most_files_have_are_shared_and_others_override(tmp_path):
    for name in ("500psi.csv", "800psi.csv"):
        write(tmp_path / name)
    write(tmp_path / "900psi_SI.csv", "time_s,displacement_m,force_N")
    content = draft_of(tmp_path)[1]
    assert content["columns"]["force"]["name"] == "force_kip"
    assert [test.get("columns", {}) for test in content["test"][:2]] == [{}, {}]
    assert plain(content["test"][2]["columns"]) == {
        "displacement": ("displacement_m", "m"),
        "force": ("force_N", "N"),
    }
    accepted(tmp_path)


def test_files_that_are_no_tests_are_left_out_with_the_reason(tmp_path):
    write(tmp_path / "500psi.csv")
    write(tmp_path / "still_500psi.csv", table=signals() * [1, 0, 1])
    write(
        tmp_path / "bands.csv", "time_s,displacement_in,lower_kip,median_kip,upper_kip", np.eye(5)
    )
    write(tmp_path / "parameters.csv", "test,parameter", np.eye(2))
    (tmp_path / "notes.txt").write_text("We tested on Monday\nand it rained\n")
    (tmp_path / "broken.csv").write_text(f"{HEADER}\n1,fast,3\n")
    (tmp_path / "empty.csv").touch()
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8")
    (tmp_path / "sub").mkdir()
    write(tmp_path / "sub" / "700psi.csv")
    draft = draft_campaign(tmp_path)
    assert [test.file for test in draft.tests] == ["500psi.csv"]
    reasons = dict(draft.left_out)
    assert reasons.keys() == {
        *("still_500psi.csv", "bands.csv", "parameters.csv", "notes.txt"),
        *("broken.csv", "empty.csv"),
    }
    assert "constant" in reasons["still_500psi.csv"]
    assert reasons["bands.csv"] == reasons["parameters.csv"] == "written by mfd-bayes"
    assert "line 2" in reasons["broken.csv"]
    assert all(f"# {name}: " in campaign_text(draft) for name in reasons)
    accepted(tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        'a "quoted" 500psi.csv',
        "a'b 500psi.csv",
        "back\\slash 500psi.csv",
        "new\nline] = 500psi.csv",
        'x"\n[[test]]\nid = "500psi.csv',
        "Prüfung ñ 500psi.csv",
        "试验 500psi.CSV",
        "\x7f\x01 500psi.csv",
        ".hidden 500psi.csv",
        "# comment 500psi.csv",
        "line\u2028separator 500psi.csv",
    ],
)
def test_any_name_comes_out_as_valid_toml(tmp_path, name):
    write(tmp_path / name)
    write(tmp_path / f"no test {name}", "a,b", np.eye(2))
    draft, content = draft_of(tmp_path)
    assert [test["file"] for test in content["test"]] == [name]
    assert len(draft.left_out) == 1
    (tmp_path / "campaign.toml").write_text(campaign_text(draft), encoding="utf-8")
    (test,) = load_campaign(tmp_path / "campaign.toml").tests
    assert test.read().force is not None


def test_names_of_columns_are_text_too(tmp_path):
    header = 'time_s,"disp ""x"" (in)","force\' # = \t (kip)"'
    write(tmp_path / "500psi.csv", header)
    (test,) = accepted(tmp_path).tests
    assert test.columns["displacement"] == Source('disp "x" (in)', "in")


def test_a_name_that_is_not_utf8_is_left_out(tmp_path):
    write(tmp_path / "500psi.csv")
    try:
        write(tmp_path / os.fsdecode(b"caf\xe9 800psi.csv"))
    except OSError:
        pytest.skip("this file system takes UTF-8 names alone")
    draft = draft_campaign(tmp_path)
    campaign_text(draft).encode("utf-8")
    ((_, reason),) = draft.left_out
    assert "not UTF-8" in reason
    assert len(accepted(tmp_path).tests) == 1


def test_a_column_whose_name_is_not_utf8_is_left_out(tmp_path):
    write(tmp_path / "500psi.csv")
    time, motion, force = signals().T.tolist()
    columns = {"time_s": time, "displacement_in": motion, "force \ud800 (kip)": force}
    (tmp_path / "800psi.json").write_text(json.dumps(columns))
    assert [test.id for test in accepted(tmp_path).tests] == ["500psi"]
    ((_, reason),) = draft_campaign(tmp_path).left_out
    assert "not UTF-8" in reason


def test_ids_differ_whatever_the_case_of_letters(tmp_path):
    for name in ("500psi.csv", "500PSI.csv", "500psi.txt", "500 psi!.csv"):
        write(tmp_path / name)
    ids = [test.id for test in accepted(tmp_path).tests]
    assert len({name.lower() for name in ids}) == 4


def test_a_file_named_as_a_run_names_its_own_gets_another_id(tmp_path):
    write(tmp_path / "population.csv", table=signals(), above="# pressure: 500 psi\n")
    write(tmp_path / "500psi.csv")
    assert {test.id for test in accepted(tmp_path).tests} == {"500psi", "population_2"}


def test_earthquakes_are_suggested_for_validation_and_not_made_it(tmp_path):
    for name in ("500psi.csv", "500psi_ElCentro.csv", "500psi_required.csv"):
        write(tmp_path / name)
    text = campaign_text(draft_campaign(tmp_path))
    assert text.count('# role = "validate"') == 1
    assert {test.role for test in accepted(tmp_path).tests} == {"calibrate"}


def test_a_folder_without_a_test_is_refused_with_reasons(tmp_path):
    with pytest.raises(CampaignError, match=r"holds no test.*\.csv"):
        draft_campaign(tmp_path)
    (tmp_path / "a.csv").touch()
    with pytest.raises(CampaignError, match=r"a\.csv: a\.csv is empty"):
        draft_campaign(tmp_path)
    with pytest.raises(CampaignError, match="cannot read the folder"):
        draft_campaign(tmp_path / "no")


def test_the_real_records_are_laid_out_but_for_the_semi_active_ones(tmp_path, data_folder):
    for name in ("2022_25lb_1.00Hz_1.0in", "2023_36lb_0.10Hz_1.0in_SI", "2023_36lb_KocaeliDBE"):
        shutil.copy(data_folder / f"{name}.csv", tmp_path)
    shutil.copy(data_folder / "manifest.csv", tmp_path)
    campaign = accepted(tmp_path)
    assert [test.actuation for test in campaign.tests] == ["25 lbf", "36 lbf", "36 lbf"]
    assert campaign.priors == "brfd"
    assert [name for name, _ in draft_campaign(tmp_path).left_out] == ["manifest.csv"]
    shutil.copy(data_folder / "2023-08_semiactive_step0.015backward.csv", tmp_path)
    assert "FIXME" in campaign_text(draft_campaign(tmp_path))


@pytest.mark.parametrize("unit", ["kip", "kN", "N", "lbf"])
def test_a_prediction_of_this_program_is_no_test(tmp_path, unit):
    write(tmp_path / "p500.csv")
    names = ["time_s", "displacement_mm", *(f"{n}_{unit}" for n in ("lower", "median", "upper"))]
    time = np.arange(400) / 50.0
    columns = [time, 25 * np.sin(np.pi * time), *(np.cos(np.pi * time) * k for k in (1, 2, 3))]
    np.savetxt(
        tmp_path / "b.csv", np.transpose(columns), "%.6g", ",", header=",".join(names), comments=""
    )
    draft, _ = draft_of(tmp_path)
    assert [test.file for test in draft.tests] == ["p500.csv"]
