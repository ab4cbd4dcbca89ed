"""A campaign file: what it may say, its defaults, and one sentence for each fault."""

import json
import pickle
import re

import numpy as np
import pytest

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.channels import Source, Subtracted

COLUMNS = """
[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }
"""
TEST = """
[[test]]
id = "p500_f0.05"
file = "a.csv"
actuation = "500 psi"
"""


@pytest.fixture
def folder(tmp_path):
    inside = tmp_path / "campaign"
    inside.mkdir()
    time = np.arange(1001) / 100
    table = np.column_stack([time, np.sin(np.pi * time), np.cos(np.pi * time), 500 + 0 * time])
    for path in (inside / "a.csv", inside / "b.csv", tmp_path / "outside.csv"):
        header = "time_s,displacement_in,force_kip,pressure_psi"
        np.savetxt(path, table, delimiter=",", header=header, comments="")
    return inside


def load(folder, text):
    path = folder / "c.toml"
    path.write_text(text)
    return load_campaign(path)


def refused(folder, text):
    with pytest.raises(CampaignError) as caught:
        load(folder, text)
    message = str(caught.value)
    assert "c.toml" in message
    assert "\n" not in message
    return message


def test_the_defaults_are_the_papers(folder):
    campaign = load(folder, TEST)
    settings, (test,) = campaign.settings, campaign.tests
    assert (campaign.title, campaign.priors, campaign.rate) == ("c", "mfd", None)
    assert (settings.model, settings.noise, settings.area) == ("three_stage", "ou", None)
    assert settings.laws["Fc_fwd"] == settings.laws["Fy_bwd"] == "proportional"
    assert settings.laws["sigma0"] == "affine"
    assert settings.actuation_unit == "ksi"
    assert (test.id, test.path, test.role) == ("p500_f0.05", folder / "a.csv", "calibrate")
    assert (test.actuation, test.window) == ("500 psi", None)
    assert load_campaign(campaign.path, "lugre", "iid").model == "lugre"


def test_everything_can_be_said(folder):
    text = """
    [campaign]
    title = "Brake"
    priors = "my/priors.toml"
    model = "lugre"
    noise = "student_t"
    rate = "64 Hz"
    start = "mask"
    area = "645.16 mm^2"
    [laws]
    Fc_fwd = "compare"
    Fs_fwd = "compare"
    [dependence]
    sigma0 = ["velocity", "amplitude"]
    d2 = []
    [tolerances]
    energy = "2 %"
    """
    entry = '\nfit = "1 s to 9 s"\nrole = "validate"\nsession = "Monday"\n'
    entry += 'columns.force = { name = "pressure_psi" }\n'
    second = TEST.replace("p500_f0.05", "other").replace("a.csv", "./b.csv") + entry
    campaign = load(folder, text + COLUMNS + TEST + second)
    settings = campaign.settings
    assert (campaign.title, campaign.priors, campaign.rate) == ("Brake", "my/priors.toml", 64)
    assert settings.area == pytest.approx(1)
    assert settings.campaign.start == "mask"
    assert settings.laws["Fc_fwd"] == "compare"
    assert settings.dependence == {"sigma0": ("velocity", "amplitude")}
    assert settings.tolerances == {"energy": 0.02}
    first, other = campaign.tests
    assert (first.session, other.session) == ("", "Monday")
    assert first.columns["force"] == Source("force_kip", "kip")
    assert other.columns["force"] == Source("pressure_psi")
    assert other.columns["time"] == Source("time_s", "s")
    assert (other.window, other.role) == ((1, 9), "validate")
    assert load(folder, "[campaign]\nrate = 50\n" + TEST).rate == 50


def test_a_test_reads_its_record_in_other_processes_too(folder):
    campaign = load(folder, COLUMNS + TEST + 'fit = "2 s to 8 s"\n')
    record = pickle.loads(pickle.dumps(campaign)).tests[0].read()
    assert record.actuation == pytest.approx(0.5)
    assert record.fit == (2, 8)
    assert load(folder, TEST).tests[0].read().columns["force"] == ("force_kip", "kip")


@pytest.mark.parametrize("unit", [', unit = "psi"', ""])
def test_a_measured_actuation_is_a_column(folder, unit):
    table = f'{{ name = "pressure_psi"{unit} }}'
    campaign = load(folder, TEST.replace('"500 psi"', table))
    (test,) = campaign.tests
    assert test.actuation is None
    assert test.read().actuation[5] == pytest.approx(0.5)
    assert campaign.settings.actuation_unit == "ksi"


def test_the_unit_of_a_history_may_stand_in_the_files_row_of_units(folder):
    rows = "".join(f"{i / 10},{i % 7},{500 + i}\n" for i in range(50))
    (folder / "a.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,psi\n{rows}")
    columns = '{ time = { name = "Time" }, displacement = { name = "Stroke" } }'
    history = TEST.replace('"500 psi"', '{ name = "Pressure" }') + f"columns = {columns}\n"
    campaign = load(folder, history)
    record = campaign.tests[0].read()
    assert record.columns["actuation"] == ("Pressure", "psi")
    assert record.actuation[0] == pytest.approx(0.5)
    assert campaign.settings.test[0].actuation_unit == "psi"
    (folder / "a.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,mm\n{rows}")
    assert "measures length; actuation needs a pressure" in refused(folder, history)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[campaign]\nprors = "mfd"\n' + TEST, "did you mean 'priors'?"),
        ('[campain]\ntitle = "x"\n' + TEST, "'campain'"),
        (TEST + 'rol = "validate"\n', "in [test 'p500_f0.05'] of"),
        ('[laws]\nFc_fw = "affine"\n' + TEST, "did you mean 'Fc_fwd'?"),
        ("[dependence]\nFcc = []\n" + TEST, "'Fcc' in [dependence]"),
        ('[columns]\ntime = { nam = "t" }\n' + TEST, "'nam' in [columns.time]"),
        ('[columns]\nforce = { name = "f", minos_mass = "3 kg" }\n' + TEST, "'minus_mass'?"),
        (TEST.replace('"500 psi"', '{ nme = "p" }'), "did you mean 'name'?"),
        ("[campaign]\nzzzz = 1\n" + TEST, "expected title, priors"),
        ("", "test is missing"),
        ("[test]\nid = 'a'", "[[test]]"),
        ("[[test]]\nid = 'a'\n", "test 'a'.file"),
        ("[[test]]\nfile = 'a.csv'\n", "test 1.id"),
        ('[campaign]\nmodel = "two"\n' + TEST, "'backlash', got 'two'"),
        ("[campaign]\ntitle = 7\n" + TEST, "got 7"),
        ('[campaign]\nrate = "64 kip"\n' + TEST, "force"),
        ("[campaign]\nrate = true\n" + TEST, "got True"),
        ("[campaign]\nrate = nan\n" + TEST, "campaign.rate"),
        ('[campaign]\narea = "3 in^2"\n' + TEST.replace("500 psi", "30 lbf"), "area"),
        ('[laws]\nFs_fwd = "power"\n' + TEST, "Fs_fwd"),
        ('[dependence]\nFc_fwd = "velocity"\n' + TEST, '["velocity"]'),
        ('[columns]\nforce = { name = "f", column = 3 }\n' + TEST, "columns.force"),
        ('[columns]\nforce = { name = "f", sign = 2 }\n' + TEST, "sign"),
        (TEST + 'fit = "60 s"\n', "0 s to 60 s"),
        (TEST.replace("500 psi", "500 mm"), "length"),
        (TEST.replace("500 psi", "500"), "no unit"),
        (TEST.replace('"500 psi"', "500"), "actuation"),
        (TEST.replace('"500 psi"', '{ name = "p" }'), "needs a unit"),
        (TEST + 'role = "validate"\n', "'calibrate'"),
        (TEST + TEST.replace("p500", "P500"), "(as 'p500_f0.05'"),
        (TEST + TEST.replace("p500", "x").replace("psi", "lbf"), "kind"),
        (TEST.replace("p500_f0.05", "Sentence"), "'Sentence'"),
        ("[campaign]\ntitle = oops\n", "line 2"),
    ],
)
def test_bad_campaigns_say_where_what_was_expected_and_what_came(folder, text, expected):
    assert expected in refused(folder, text)


def test_several_faults_come_in_one_sentence_that_can_be_read(folder):
    message = refused(folder, '[campaign]\nmodel = "x"\nnoise = "y"\n' + TEST)
    assert message.count("; ") == 1
    faults = "".join(f'[[test]]\nid = "{"!" * 999}"\n"{"k" * 3000}{i}" = 1\n' for i in range(50))
    with pytest.raises(CampaignError, match=r"; and more$") as caught:
        load(folder, faults)
    assert len(str(caught.value)) < 5000


def test_ids_that_are_no_folder_names_are_refused(folder):
    for name in ("", ".hidden", "..", "a/b", "a b", "a\\b", "ä", "a\n", "x" * 101):
        assert "names a folder" in refused(folder, TEST.replace('"p500_f0.05"', json.dumps(name)))


def test_files_that_are_not_there_or_outside_the_campaigns_folder_are_refused(folder):
    (folder / "link.csv").symlink_to(folder.parent / "outside.csv")
    (folder / "loop.csv").symlink_to(folder / "loop.csv")
    for file in ("../outside.csv", "../campaign/../outside.csv", "/etc/hostname", "link.csv"):
        assert "outside the campaign's folder" in refused(folder, TEST.replace("a.csv", file))
    for file in ("none.csv", ".", "x\\u0000y", "x" * 300, "loop.csv"):
        refused(folder, TEST.replace("a.csv", file))


def test_a_campaign_reached_by_a_link_still_owns_its_folder(folder, tmp_path):
    load(folder, TEST)
    (tmp_path / "link").symlink_to(folder, target_is_directory=True)
    assert load_campaign(tmp_path / "link" / "c.toml").tests[0].path == folder / "a.csv"


def test_files_that_are_no_campaign_are_refused(folder):
    (folder / "c.toml").write_bytes(b"\xff\xfe")
    for path, words in (
        ("c.toml", "not valid TOML"),
        ("d.toml", r"cannot read .*d\.toml.*did you mean .*c\.toml"),
        (".", "is a folder: give the campaign file in it"),
        ("no/c.toml", "cannot read"),
    ):
        with pytest.raises(CampaignError, match=words):
            load_campaign(folder / path)


def test_columns_by_number_and_what_is_taken_off_them(folder):
    text = COLUMNS.replace('{ name = "time_s", unit = "s" }', '{ column = 1, unit = "s" }').replace(
        '{ name = "force_kip", unit = "kip" }',
        '{ column = 3, unit = "kip", minus = { column = 4, unit = "psi", times = "1 in^2" }, '
        'minus_mass = "3 kg", tare = "0 s to 10 s" }',
    )
    test = load(folder, text + TEST).tests[0]
    assert test.columns["time"] == Source(1, "s")
    assert test.columns["force"] == Source(
        3, "kip", Subtracted(4, "psi", "1 in^2"), minus_mass="3 kg", tare="0 s to 10 s"
    )
    assert abs(float(np.mean(test.read().force))) < 1e-12


def test_a_test_has_a_column_of_times_or_a_rate(folder):
    both = TEST + 'rate = "10 ms"\ncolumns.time = { name = "time_s" }\n'
    assert "either by its column or by a rate" in refused(folder, both)


def in_order(**after):
    """Tests with these ids, each after another or after none."""
    entries = []
    for name, before in after.items():
        follows = f'after = "{before}"\n' if before else ""
        file = f'file = "{"b" if name == "b" else "a"}.csv"'
        entries.append(TEST.replace("p500_f0.05", name).replace('file = "a.csv"', file) + follows)
    return "".join(entries)


def test_a_test_may_follow_another_in_any_place(folder):
    campaign = load(folder, in_order(c="b", a="", b="a"))
    assert {test.id: test.after for test in campaign.tests} == {"a": "", "b": "a", "c": "b"}
    assert campaign.settings.order == {"b": "a", "c": "b"}


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ({"one": "", "two": "on"}, "after of test 'two' in .* another test, got 'on'; did you mea"),
        ({"one": "", "two": "two"}, "after of test 'two' .* a circle: two after two"),
        ({"a": "", "b": "a", "c": "a"}, "after of test 'c' in .* got 'a', which test 'b' follows"),
        ({"a": "c", "b": "a", "c": "b"}, "'a' .* a circle: a after c after b after a"),
    ],
)
def test_an_order_that_cannot_be_is_refused_in_one_sentence(folder, after, expected):
    assert re.search(expected, refused(folder, in_order(**after)))


def test_of_one_file_a_later_part_may_follow(folder):
    def text(*parts):
        tests = [TEST.replace("p500_f0.05", name) for name in "xy"]
        tests[1] += 'after = "x"\n'
        fits = [f'fit = "{part}"\n' if part else "" for part in parts]
        return "".join(f"{test}{fit}" for test, fit in zip(tests, fits, strict=True))

    campaign = load(folder, text("0 s to 5 s", "5 s to 9 s"))
    assert [campaign.since(test) for test in campaign.tests] == [-np.inf, 5.0]
    assert "all of the file after 0 s to 5 s" in refused(folder, text("0 s to 5 s", None))
    assert "4 s to 9 s after 0 s to 5 s" in refused(folder, text("0 s to 5 s", "4 s to 9 s"))
