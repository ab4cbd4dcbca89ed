import json
import pickle
import re

import numpy as np
import pytest

from mfd_bayes.campaign.file import load_campaign
from mfd_bayes.campaign.order import check_order
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


def test_the_model_may_be_given_instead_of_the_files_own(folder):
    campaign = load(folder, '[campaign]\nmodel = "bouc_wen"\n' + TEST)
    assert campaign.model == "bouc_wen"
    assert load_campaign(campaign.path, "lugre").model == "lugre"


def test_the_defaults_are_the_papers(folder):
    campaign = load(folder, TEST)
    assert campaign.title == "c"
    assert (campaign.priors, campaign.model, campaign.noise) == ("mfd", "three_stage", "ou")
    assert (campaign.rate, campaign.start, campaign.area) == (None, "sample", None)
    assert campaign.laws["Fc_fwd"] == campaign.laws["Fs_bwd"] == "proportional"
    assert campaign.laws["sigma0"] == "affine"
    assert campaign.actuation_unit == "ksi"
    (test,) = campaign.tests
    assert (test.id, test.path, test.role) == ("p500_f0.05", folder / "a.csv", "calibrate")
    assert (test.actuation, test.actuation_unit) == ("500 psi", "ksi")
    assert test.window is None


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
    [dependence]
    sigma0 = ["velocity", "amplitude"]
    """
    entry = '\nfit = "1 s to 9 s"\nrole = "validate"\nsession = "Monday"\n'
    entry += 'columns.force = { name = "pressure_psi" }\n'
    second = TEST.replace("p500_f0.05", "other").replace("a.csv", "./b.csv") + entry
    campaign = load(folder, text + COLUMNS + TEST + second)
    assert (campaign.title, campaign.rate, campaign.start) == ("Brake", 64, "mask")
    assert campaign.area == pytest.approx(1)
    assert campaign.priors == "my/priors.toml"
    assert campaign.laws["Fc_fwd"] == "compare"
    assert campaign.dependence == {"sigma0": ("velocity", "amplitude")}
    first, other = campaign.tests
    assert (first.session, other.session) == ("", "Monday")
    assert first.columns["force"] == Source("force_kip", "kip")
    assert other.columns["force"] == Source("pressure_psi")
    assert other.columns["time"] == Source("time_s", "s")
    assert (other.window, other.role) == ((1, 9), "validate")
    assert load(folder, "[campaign]\nrate = 50\n" + TEST).rate == 50


@pytest.mark.parametrize("name", ["Fc_fwd", "Fc_bwd", "d2"])
def test_nothing_depends_on_travel(folder, name):
    with pytest.raises(CampaignError, match=rf"dependence\.{name}.*'velocity' or 'amplitude'"):
        load(folder, f'[dependence]\n{name} = ["travel"]\n' + COLUMNS + TEST)


def test_a_test_reads_its_record(folder):
    test = load(folder, COLUMNS + TEST + 'fit = "2 s to 8 s"\n').tests[0]
    record = test.read()
    assert record.actuation == pytest.approx(0.5)
    assert record.fit == (2, 8)
    assert record.force[0] == pytest.approx(1)
    assert load(folder, TEST).tests[0].read().columns["force"] == ("force_kip", "kip")


@pytest.mark.parametrize("unit", [', unit = "psi"', ""])
def test_a_measured_actuation_is_a_column(folder, unit):
    table = f'{{ name = "pressure_psi"{unit} }}'
    for columns in (COLUMNS, ""):
        (test,) = load(folder, columns + TEST.replace('"500 psi"', table)).tests
        assert (test.actuation, test.actuation_unit) == (None, "ksi")
        assert test.read().actuation[5] == pytest.approx(0.5)


def test_a_campaign_survives_pickling_for_other_processes(folder):
    campaign = pickle.loads(pickle.dumps(load(folder, COLUMNS + TEST)))
    assert campaign.tests[0].read().turning_points == 10


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[campaign]\nprors = "mfd"\n' + TEST, "unknown key 'prors' in [campaign] of"),
        ('[campaign]\nprors = "mfd"\n' + TEST, "did you mean 'priors'?"),
        ('[campain]\ntitle = "x"\n' + TEST, "unknown key 'campain' of"),
        (TEST + 'rol = "validate"\n', "in [test 'p500_f0.05'] of"),
        (TEST + 'rol = "validate"\n', "did you mean 'role'?"),
        ('[laws]\nFc_fw = "affine"\n' + TEST, "did you mean 'Fc_fwd'?"),
        ('[columns]\ntimes = { name = "t" }\n' + TEST, "did you mean 'time'?"),
        ('[columns]\ntime = { nam = "t" }\n' + TEST, "unknown key 'nam' in [columns.time]"),
        ("[campaign]\nzzzz = 1\n" + TEST, "expected title, priors"),
    ],
)
def test_unknown_keys_name_the_nearest(folder, text, expected):
    assert expected in refused(folder, text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "test is missing"),
        ("test = []", "test in"),
        ("[test]\nid = 'a'", "test in"),
        ("[[test]]\nid = 'a'\n", "test 'a'.file is missing"),
        ("[[test]]\nfile = 'a.csv'\n", "test 1.id is missing"),
        ('[campaign]\nmodel = "two"\n' + TEST, "campaign.model in"),
        ('[campaign]\nmodel = "two"\n' + TEST, "'bouc_wen' or 'backlash', got 'two'"),
        ("[campaign]\ntitle = 7\n" + TEST, "got 7"),
        ('[campaign]\nrate = "64 kip"\n' + TEST, "measures force"),
        ("[campaign]\nrate = 0\n" + TEST, "greater than 0"),
        ("[campaign]\nrate = true\n" + TEST, "got True"),
        ("[campaign]\nrate = nan\n" + TEST, "campaign.rate"),
        ('[campaign]\narea = "3 in"\n' + TEST, "measures length"),
        ('[campaign]\narea = "3 in^2"\n' + TEST.replace("500 psi", "30 lbf"), "leave area out"),
        ('[laws]\nsigma0 = "cubic"\n' + TEST, "laws.sigma0"),
        (
            '[dependence]\nFc_fwd = "velocity"\n' + TEST,
            'should be a list such as ["velocity"], got',
        ),
        ("[dependence]\nFc_fwd = 3\n" + TEST, "dependence.Fc_fwd in"),
        (TEST + 'fit = "60 s"\n', "0 s to 60 s"),
        (TEST + "fit = [0, 60]\n", "test 'p500_f0.05'.fit"),
        (TEST.replace("500 psi", "500 mm"), "measures length"),
        (TEST.replace("500 psi", "500"), "no unit"),
        (TEST.replace('"500 psi"', "500"), "valid string, got 500"),
        (TEST.replace('"500 psi"', '{ unit = "psi" }'), "either by its name or, as column = 1"),
        (TEST.replace('"500 psi"', '{ name = "p" }'), "needs a unit"),
        (TEST.replace('"500 psi"', '{ name = "p", unit = "s" }'), "measures time"),
        (TEST + 'role = "validate"\n', "no test with role 'calibrate'"),
        (TEST + TEST, "two tests"),
        (TEST + TEST.replace("p500", "P500"), "two tests"),
        (TEST + TEST.replace("p500", "x").replace("psi", "lbf"), "all pressures or all forces"),
    ],
)
def test_bad_campaigns_say_where_what_was_expected_and_what_came(folder, text, expected):
    assert expected in refused(folder, text)


def test_several_faults_come_in_one_sentence(folder):
    message = refused(folder, '[campaign]\nmodel = "x"\nnoise = "y"\n' + TEST)
    assert message.count("; ") == 1


@pytest.mark.parametrize("name", ["", ".hidden", "..", "a/b", "a b", "a\\b", "ä", "a\n", "x" * 101])
def test_ids_that_are_no_folder_names_are_refused(folder, name):
    assert "names a folder" in refused(folder, TEST.replace('"p500_f0.05"', json.dumps(name)))


@pytest.mark.parametrize(
    "file", ["../outside.csv", "../campaign/../outside.csv", "/etc/hostname", "link.csv"]
)
def test_files_outside_the_campaigns_folder_are_refused(folder, file):
    (folder / "link.csv").symlink_to(folder.parent / "outside.csv")
    assert "lies outside the campaign's folder" in refused(folder, TEST.replace("a.csv", file))


def test_a_campaign_reached_by_a_link_still_owns_its_folder(folder, tmp_path):
    load(folder, TEST)
    (tmp_path / "link").symlink_to(folder, target_is_directory=True)
    assert load_campaign(tmp_path / "link" / "c.toml").tests[0].path == folder / "a.csv"


@pytest.mark.parametrize("file", ["none.csv", ".", "x\\u0000y", "x" * 300, "loop.csv"])
def test_files_that_are_not_there_are_refused(folder, file):
    (folder / "loop.csv").symlink_to(folder / "loop.csv")
    refused(folder, TEST.replace("a.csv", file))


def test_toml_that_does_not_parse_is_refused_with_its_line(folder):
    assert "line 2" in refused(folder, "[campaign]\ntitle = oops\n")
    (folder / "c.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(CampaignError, match="not valid TOML"):
        load_campaign(folder / "c.toml")


def test_a_campaign_that_is_not_there_is_refused(folder):
    with pytest.raises(CampaignError, match=r"cannot read .*none\.toml"):
        load_campaign(folder / "none.toml")


def test_the_unit_of_a_history_may_stand_in_the_files_row_of_units(folder):
    rows = "".join(f"{i / 10},{i % 7},{500 + i}\n" for i in range(50))
    (folder / "a.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,psi\n{rows}")
    columns = '{ time = { name = "Time" }, displacement = { name = "Stroke" } }'
    history = TEST.replace('"500 psi"', '{ name = "Pressure" }') + f"columns = {columns}\n"
    (test,) = load(folder, history).tests
    assert test.actuation_unit == "ksi"
    record = test.read()
    assert record.columns["actuation"] == ("Pressure", "psi")
    assert record.actuation[0] == pytest.approx(0.5)
    (folder / "a.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,mm\n{rows}")
    assert "measures length; actuation needs a pressure" in refused(folder, history)


def test_what_is_said_of_a_strange_file_can_be_read(tmp_path):
    path = tmp_path / "campaign.toml"
    faults = "".join(f'[[test]]\nid = "{"!" * 999}"\n"{"k" * 3000}{i}" = 1\n' for i in range(50))
    path.write_text(faults)
    with pytest.raises(CampaignError, match=r"; and more$") as caught:
        load_campaign(path)
    assert len(str(caught.value)) < 5000


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


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ('{ name = "f", column = 3 }', "either by its name or"),
        ("{ column = 0 }", "greater than or equal to 1"),
        ('{ name = "f", minos_mass = "3 kg" }', "did you mean 'minus_mass'?"),
        ('{ name = "f", minus = { name = "p", time = "3 mm^2" } }', "did you mean 'times'?"),
    ],
)
def test_columns_that_cannot_be_are_refused(folder, column, expected):
    text = COLUMNS.replace('{ name = "force_kip", unit = "kip" }', column)
    assert expected in refused(folder, text + TEST)


def in_order(**after):
    """Tests with these ids, each after another or after none."""
    entries = []
    for name, before in after.items():
        told = f'after = "{before}"\n' if before else ""
        file = f'file = "{"b" if name == "b" else "a"}.csv"'
        entries.append(TEST.replace("p500_f0.05", name).replace('file = "a.csv"', file) + told)
    return "".join(entries)


def test_a_test_may_follow_another_at_another_level_and_in_any_place(folder):
    text = in_order(c="b", a="", b="a") + 'actuation = "900 psi"\n'
    text = text.replace('actuation = "500 psi"\nafter = "a"\nactuation', 'after = "a"\nactuation')
    campaign = load(folder, text)
    assert {test.id: test.after for test in campaign.tests} == {"a": "", "b": "a", "c": "b"}


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ({"one": "", "two": "on"}, "after of test 'two' in .* another test, got 'on'; did you mea"),
        ({"one": "", "two": "zzz"}, "after of test 'two' in .* another test, got 'zzz'$"),
        ({"one": "", "two": "two"}, "after of test 'two' in .* another test, got its own"),
        ({"a": "", "b": "a", "c": "a"}, "after of test 'c' in .* got 'a', which test 'b' follows"),
        (
            {"a": "c", "b": "a", "c": "b"},
            "after of test 'a' .* a circle: a after c after b after a",
        ),
        ({"x": "", "y": "x", "a": "b", "b": "a"}, "after of test 'a' .* circle: a after b after a"),
    ],
)
def test_an_order_that_cannot_be_is_refused_in_one_sentence(folder, after, expected):
    assert re.search(expected, refused(folder, in_order(**after)))


WINDOWS = "0 s to 5 s", "5 s to 9 s"


@pytest.mark.parametrize(
    ("windows", "got"),
    [
        ((None, None), "all of the file after all of the file"),
        (("0 s to 5 s", None), "all of the file after 0 s to 5 s"),
        (("0 s to 5 s", "4 s to 9 s"), "4 s to 9 s after 0 s to 5 s"),
    ],
)
def test_of_one_file_a_later_part_may_follow(folder, windows, got):
    def text(*parts):
        tests = [TEST.replace("p500_f0.05", name) for name in "xy"]
        tests[1] += 'after = "x"\n'
        told = [f'fit = "{part}"\n' if part else "" for part in parts]
        return "".join(f"{test}{fit}" for test, fit in zip(tests, told, strict=True))

    campaign = load(folder, text(*WINDOWS))
    assert [campaign.since(test) for test in campaign.tests] == [-np.inf, 5.0]
    assert f"after of test 'y' in {folder / 'c.toml'}" in refused(folder, text(*windows))
    assert got in refused(folder, text(*windows))


def test_a_long_order_is_checked_quickly(folder):
    names = [f"t{i}" for i in range(3000)]
    check_order(folder, dict(zip(names, ["", *names[:-1]], strict=True)))
    with pytest.raises(CampaignError, match="a circle"):
        check_order(folder, dict(zip(names, [names[-1], *names[:-1]], strict=True)))


@pytest.mark.parametrize(("value", "said"), [("3", "valid string, got 3"), ('["a"]', "string")])
def test_what_a_test_follows_is_one_id(folder, value, said):
    assert f"test 'p500_f0.05'.after in {folder / 'c.toml'}" in refused(
        folder, TEST + f"after = {value}\n"
    )
    assert said in refused(folder, TEST + f"after = {value}\n")


def test_two_tests_with_the_same_short_id_are_refused(folder):
    one = re.sub('id = "[^"]*"', 'id = "1"', TEST)
    assert "have the id '1'" in refused(folder, one + one)


@pytest.mark.parametrize("name", ["campaign", "Sentence", "population"])
def test_a_name_that_a_run_uses_for_itself_is_no_id(folder, name):
    """The verdicts of a run are by id, beside that of the campaign and its sentence."""
    said = refused(folder, re.sub('id = "[^"]*"', f'id = "{name}"', TEST))
    assert f"a test's id cannot be '{name}'" in said
