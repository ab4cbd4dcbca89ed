"""A campaign file: what it may say, its defaults, and one sentence for each fault."""

import numpy as np
import pytest

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.record import Source

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
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    time = np.arange(1001) / 100
    table = np.column_stack([time, np.sin(np.pi * time), np.cos(np.pi * time), 500 + 0 * time])
    for path in (campaign / "a.csv", campaign / "b.csv", tmp_path / "outside.csv"):
        header = "time_s,displacement_in,force_kip,pressure_psi"
        np.savetxt(path, table, delimiter=",", header=header, comments="")
    return campaign


def load(folder, text):
    path = folder / "c.toml"
    path.write_text(text)
    return load_campaign(path)


def test_the_defaults_are_the_papers(folder):
    campaign = load(folder, TEST)
    settings, (test,) = campaign.settings, campaign.tests
    assert (campaign.title, campaign.priors, campaign.rate) == ("c", "mfd", None)
    assert (settings.model, settings.noise, settings.area) == ("three_stage", "ou", None)
    assert settings.laws["Fc_fwd"] == settings.laws["Fy_bwd"] == "proportional"
    assert (settings.laws["sigma0"], settings.actuation_unit) == ("affine", "ksi")
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
    initial = "discard"
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
    entry = '\nwindow = "1 s to 9 s"\nrole = "validate"\nsession = "Monday"\n'
    entry += 'columns.force = { name = "pressure_psi" }\n'
    second = TEST.replace("p500_f0.05", "other").replace("a.csv", "./b.csv") + entry
    campaign = load(folder, text + COLUMNS + TEST + second)
    settings = campaign.settings
    assert (campaign.title, campaign.priors, campaign.rate) == ("Brake", "my/priors.toml", 64)
    assert settings.area == pytest.approx(1)
    assert settings.campaign.initial == "discard"
    assert settings.laws["Fc_fwd"] == "compare"
    assert settings.dependence == {"sigma0": ("velocity", "amplitude")}
    assert settings.tolerances == {"energy": 0.02}
    test_a, test_b = campaign.tests
    assert (test_a.session, test_b.session) == ("", "Monday")
    assert test_a.columns["force"] == Source("force_kip", "kip")
    assert test_b.columns["force"] == Source("pressure_psi")
    assert test_b.columns["time"] == Source("time_s", "s")
    assert (test_b.window, test_b.role) == ((1, 9), "validate")
    assert load(folder, "[campaign]\nrate = 50\n" + TEST).rate == 50
    with pytest.raises(CampaignError, match="'Monday'"):  # it is not calibrated
        load(folder, text + COLUMNS + TEST + second + '\n[goal]\nsession = "Monday"\n')


def test_a_measured_actuation_is_a_column_whose_unit_may_stand_in_its_name_or_in_the_file(folder):
    rows = "".join(f"{i / 10},{i % 7},{500 + i}\n" for i in range(50))
    (folder / "b.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,psi\n{rows}")
    columns = '{ time = { name = "Time" }, displacement = { name = "Stroke" } }'
    in_file = TEST.replace('"a.csv"', f'"b.csv"\ncolumns = {columns}')
    for column, test in (
        ('{ name = "pressure_psi", unit = "psi" }', TEST),
        ('{ name = "pressure_psi" }', TEST),
        ('{ name = "Pressure" }', in_file),
    ):
        campaign = load(folder, test.replace('"500 psi"', column))
        assert campaign.tests[0].actuation is None
        assert campaign.tests[0].read().actuation[0] == pytest.approx(0.5)
        assert campaign.settings.test[0].actuation_unit == "psi"
    (folder / "b.csv").write_text(f"Time,Stroke,Pressure\nsec,mm,mm\n{rows}")
    with pytest.raises(CampaignError, match="measures length; actuation needs a pressure"):
        load(folder, in_file.replace('"500 psi"', '{ name = "Pressure" }'))


def order(**predecessors):
    """Tests with these ids, each after another or after none."""
    entries = []
    for name, predecessor in predecessors.items():
        follows = f'after = "{predecessor}"\n' if predecessor else ""
        file = f'file = "{"b" if name == "b" else "a"}.csv"'
        entries.append(TEST.replace("p500_f0.05", name).replace('file = "a.csv"', file) + follows)
    return "".join(entries)


def parts(*windows):
    """A test, and one after it in the same file, with their windows."""
    entry_x, entry_y = TEST.replace("p500_f0.05", "x"), TEST.replace("p500_f0.05", "y")
    fits = [f'window = "{window}"\n' if window else "" for window in windows]
    return f'{entry_x}{fits[0]}{entry_y}{fits[1]}after = "x"\n'


def given(table, key, value):
    return f"[{table}]\n{key} = {value}\n{TEST}"


STANDARD = 'standard = "asce7-22"'


def design(text, tests=TEST):
    return f"[design]\n{text}\n{tests}"


def instruments(force_a, force_b):
    """Two tests, each with what is said of the force beside its name."""
    entry = TEST + 'columns.force = { name = "force_kip", '
    return f"{entry}{force_a} }}\n{entry.replace('p500', 'q500')}{force_b} }}\n"


FORCE, TIME = 'name = "f"', 'name = "t"'

REFUSED = [
    (given("campaign", "prors", '"mfd"'), "did you mean 'priors'?"),
    (given("campain", "title", '"x"'), "'campain'"),
    (TEST + 'rol = "validate"\n', "in [test 'p500_f0.05'] of"),
    (given("laws", "Fc_fw", '"affine"'), "did you mean 'Fc_fwd'?"),
    (given("dependence", "Fcc", "[]"), "'Fcc' in [dependence]"),
    (given("columns", "force", f'{{ {FORCE}, minos_mass = "3 kg" }}'), "'minus_mass'?"),
    (TEST.replace('"500 psi"', '{ nme = "p" }'), "did you mean 'name'?"),
    ("", "test is missing"),
    ("[[test]]\nid = 'a'\n", "test 'a'.file"),
    (given("campaign", "model", '"two"'), "'backlash', got 'two'"),
    (given("campaign", "rate", "true"), "got True"),
    (given("campaign", "area", '"3 in^2"').replace("500 psi", "30 lbf"), "area"),
    (given("dependence", "Fc_fwd", '"velocity"'), '["velocity"]'),
    (given("dependence", "Fc_fwd", '["date"]'), "dependence.Fc_fwd"),
    (given("columns", "force", f"{{ {FORCE}, column = 3 }}"), "columns.force"),
    (TEST + f'rate = "10 ms"\ncolumns.time = {{ {TIME} }}\n', "'p500_f0.05'"),
    (TEST + 'window = "60 s"\n', "0 s to 60 s"),
    (TEST.replace("500 psi", "500"), "no unit"),
    (TEST.replace('"500 psi"', "500"), "actuation"),
    (TEST.replace('"500 psi"', '{ name = "p" }'), "needs a unit"),
    (TEST + 'role = "validate"\n', "'calibrate'"),
    (TEST + TEST.replace("p500", "P500"), "(as 'p500_f0.05'"),
    (TEST + TEST.replace("p500", "x").replace("psi", "lbf"), "kind"),
    ("[campaign]\ntitle = oops\n", "line 2"),
    ("a = " + "[" * 100_000, "not valid TOML"),
    ("a" + ".a" * 100_000 + " = 1", "200 dots"),
    ("#" * 2**21, "larger than 1 MB"),
    *((TEST.replace("p500_f0.05", name), "test") for name in ("Sentence", "", ".hidden", "..")),
    *((TEST.replace("p500_f0.05", name), "test") for name in ("a/b", "a b", "ä", "x" * 101)),
    *((TEST.replace("a.csv", file), "outside") for file in ("../outside.csv", "/etc/hostname")),
    *((TEST.replace("a.csv", file), "outside") for file in ("../campaign/../outside.csv", "l.csv")),
    *((TEST.replace("a.csv", file), "file") for file in ("none.csv", ".", "x\\u0000y", "loop.csv")),
    (order(one="", two="on"), "after of test 'two'"),
    (order(a="", b="a", c="a"), "test 'b' follows"),
    (order(a="c", b="a", c="b"), "a after c after b after a"),
    *(
        (given("columns", "force", f"{{ {FORCE}, uncertainty = {value} }}"), 'such as "0.5 %"')
        for value in ("0", "0.2", "true", "nan", "-0.01", '"1 kip"', '"25 %"', '"0.005"')
    ),
    (given("columns", "force", f"{{ {FORCE}, arm_uncertainty = 0.01 }}"), "needs an arm"),
    (given("columns", "velocity", f"{{ {FORCE}, uncertainty = 0.01 }}"), "'uncertainty'"),
    (
        instruments("uncertainty = 0.01", "uncertainty = 0.02"),
        "uncertainty of test 'q500_f0.05'",
    ),
    (
        instruments('arm = "4 in", arm_uncertainty = 0.01', 'arm = "4 in", arm_uncertainty = 0.02'),
        "must be 0.01, that of test 'p500_f0.05', which has the same arm, '4 in'",
    ),
    (design('standard = "asce7-23"'), "there is no standard 'asce7-23'; expected asce7-16, asce7"),
    (design('standard = "ours.toml"'), "there is no file 'ours.toml' in the folder"),
    (design('T1 = "1 s"'), "design.standard is missing"),
    *(
        (design(f"{STANDARD}\nT1 = {value}"), "'10 s'")
        for value in ("1.3", '"1.3"', '"-1 s"', '"0 s"')
    ),
    (design(f'{STANDARD}\nT1 = "1.3 in"'), "time needs a time such as"),
    (design(f'{STANDARD}\nmce = "-2 in"'), "expected a positive number with its unit"),
    (design(f"{STANDARD}\nlambda_spec = {{ max = 0.9 }}"), "design.lambda_spec.max"),
    (design(f"{STANDARD}\nlambda_ae = {{ min = 1.1 }}"), "less than or equal to 1"),
    (design(f'{STANDARD}\ntarget = {{ slip = "2 kip" }}'), "did you mean 'slip_force'?"),
    (design(f'{STANDARD}\ntarget = {{ slip_force = "2 in" }}'), "cannot be given in 'kip'"),
    (design(f"{STANDARD}\ntarget = {{ slip_force = 2 }}"), "slip_force needs a unit such as"),
    (design(f'{STANDARD}\ntarget = {{ effective_damping = "5 kip" }}'), "is a plain number"),
    (
        design(
            f'{STANDARD}\ntarget = {{ energy = "2 kip*in" }}',
            TEST + TEST.replace("p500", "p900").replace("500 psi", "900 psi"),
        ),
        "design.actuation is missing",
    ),
    (design(f'{STANDARD}\nactuation = "10 lbf"'), "must be a pressure, as in the tests"),
    (parts("0 s to 5 s", None), "all of the file after 0 s to 5 s"),
    (parts("0 s to 5 s", "4 s to 9 s"), "4 s to 9 s after 0 s to 5 s"),
]


@pytest.mark.parametrize(("text", "expected"), REFUSED, ids=range(len(REFUSED)))
def test_a_bad_campaign_is_refused_in_one_sentence_that_names_the_fault(folder, text, expected):
    (folder / "l.csv").symlink_to(folder.parent / "outside.csv")
    (folder / "loop.csv").symlink_to(folder / "loop.csv")
    with pytest.raises(CampaignError) as caught:
        load(folder, text)
    message = str(caught.value)
    assert expected in message
    assert "c.toml" in message
    assert "\n" not in message


def test_two_instruments_may_have_two_uncertainties(folder):
    second = 'uncertainty = "2 %", instrument = "load cell 2"'
    campaign = load(folder, instruments("uncertainty = 0.01", second))
    stated = [
        (test, *instrument, u) for test, instrument, u in campaign.settings.stated_uncertainties()
    ]
    assert stated == [
        ("p500_f0.05", "force", "", 0.01), ("q500_f0.05", "force", "load cell 2", 0.02)
    ]  # fmt: skip
    assert campaign.tests[1].columns["force"] == Source("force_kip")


def test_a_test_may_follow_another_in_any_place_or_in_the_same_file(folder):
    campaign = load(folder, order(c="b", a="", b="a"))
    assert campaign.settings.order == {"b": "a", "c": "b"}
    campaign = load(folder, parts("0 s to 5 s", "5 s to 9 s"))
    assert [campaign.since(test) for test in campaign.tests] == [-np.inf, 5.0]


# --- the synthetic campaign


def test_the_demo_follows_the_papers_whole_matrix(tmp_path):
    truth = write_campaign(tmp_path, 1)
    tests = load_campaign(tmp_path / "campaign.toml").tests
    calibrated = {test.id for test in tests if test.role == "calibrate"}
    levels = (0, 500, 800, 1200, 1500)
    assert calibrated == {f"p{p}_f{f}" for p in levels for f in ("0.05", "0.5")}
    assert [test.id for test in tests if test.role == "validate"] == ["p1000_f0.5"]
    assert set(truth["tests"]) == {test.id for test in tests}


def test_a_backslash_in_a_path_is_told_what_to_write(folder):
    for path, reason in (
        (r"data\runs.csv", "does not exist"),
        (r"C:\Users\a.csv", "TOML"),
        (r"x\y.csv", "TOML"),
    ):
        with pytest.raises(CampaignError, match=rf"{reason}.*write / in place of"):
            load(folder, TEST.replace("a.csv", path))


def test_an_old_key_is_refused_with_its_new_name(tmp_path):
    for table, line, new in (
        ("[campaign]", 'start = "mask"', "it is 'initial' now"),
        ("[[test]]", 'fit = "1 s to 2 s"', "it is 'window' now"),
        ("[campaign]", "noise_check = true", "use mfd-bayes compare .* --noises"),
    ):
        path = tmp_path / "campaign.toml"
        path.write_text('[campaign]\ntitle = "t"\npriors = "mfd"\n[[test]]\nid = "a"\n')
        path.write_text(path.read_text().replace(table, f"{table}\n{line}"))
        with pytest.raises(CampaignError, match=new):
            load_campaign(path)
