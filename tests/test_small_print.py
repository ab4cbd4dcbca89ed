"""Sentences that say what is wrong, and input that was taken for something else."""

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import CampaignError, RecordError, StoreError, UnitError
from mfd_bayes.records.data_quality import contradictions, inspect_record
from mfd_bayes.records.record import read_record
from mfd_bayes.store.files import read_json
from mfd_bayes.units import parse_actuation, parse_quantity, percent

TEST = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'
TIME = np.arange(201) / 50
ROWS = np.column_stack([TIME, np.sin(np.pi * TIME), np.tanh(4 * np.cos(np.pi * TIME))])


@pytest.fixture
def home(tmp_path):
    write_record(tmp_path / "a.csv")
    return tmp_path


def write_record(path, cell=None, head="time_s,displacement_in,force_kip"):
    rows = [[f"{x:.5f}" for x in row] for row in ROWS]
    if cell is not None:
        rows[7][1] = cell
    text = head + "\n" + "\n".join(map(",".join, rows)) + "\n"
    path.write_text(text, encoding="utf-8")


def refusal(home, text, name="campaign.toml"):
    (home / name).write_text(text, encoding="utf-8")
    with pytest.raises(CampaignError) as caught:
        load_campaign(home / name)
    return str(caught.value)


def test_one_bracket_for_two_is_said(home):
    sentence = refusal(home, TEST.replace("[[test]]", "[test]"))
    assert "begins with [[test]], in two brackets" in sentence
    assert "tuple" not in sentence


def test_thousands_separators_are_said(home):
    for text in ["1,000 psi", "1'000,5 psi"]:
        with pytest.raises(UnitError, match="without thousands separators"):
            parse_actuation(text)
        sentence = refusal(home, TEST.replace("500 psi", text))
        assert "without thousands separators" in sentence
        assert sentence.count(f"got {text!r}") == 1


def test_what_came_is_said_once(home):
    for line in [
        'actuation = "-5 psi"',
        'fit = "5 s to 1 s"',
        'id = "a b"',
        'actuation = "7 miles"',
    ]:
        key = line.split(" ")[0]
        text = "\n".join(old for old in TEST.splitlines() if not old.startswith(f"{key} ="))
        sentence = refusal(home, f"{text}\n{line}\n")
        assert sentence.count(", got ") <= 1


def test_a_number_of_thousands_of_digits_names_no_function(home):
    digits = "9" * 5000
    (home / "a.json").write_text(f'{{"time_s": [{digits}], "displacement_in": [1]}}')
    messages = [refusal(home, f"[campaign]\nrate = {digits}\n{TEST}")]
    for read, error in ((read_record, RecordError), (read_json, StoreError)):
        with pytest.raises(error) as caught:
            read(home / "a.json")
        messages.append(str(caught.value))
    for message in messages:
        assert "a number of thousands of digits" in message
        assert "sys." not in message


def test_digits_of_other_scripts_are_named_by_line_and_column(home):
    for cell in ["１２", "1\u00a02", "²"]:
        write_record(home / "a.csv", cell)
        with pytest.raises(RecordError, match=r"line 9 of .*column 'displacement_in'"):
            read_record(home / "a.csv")


def test_an_angle_is_no_rate():
    for text in ["600 rpm", "60 rad/s"]:
        with pytest.raises(UnitError, match="has an angle"):
            parse_quantity(text, "rate")


def test_one_column_for_two_roles_is_refused(home):
    columns = {"time": "time_s", "displacement": "displacement_in", "force": "displacement_in"}
    with pytest.raises(RecordError, match="given for displacement and force"):
        read_record(home / "a.csv", columns, {"force": "kip"})


def test_a_unit_that_contradicts_a_columns_name_is_a_warning(home):
    record = read_record(home / "a.csv", units={"force": "kN"})
    (fault,) = contradictions(record)
    assert "'force_kip' is read in 'kN', and its name says 'kip'" in str(fault.message)
    assert str(fault.message) in {str(f.message) for f in inspect_record("a", record).faults}
    for unit in ("kip", "kips", None):
        units = {} if unit is None else {"force": unit}
        assert contradictions(read_record(home / "a.csv", units=units)) == ()


def test_a_covariate_is_there_once(home):
    head = '[dependence]\nFc_fwd = ["velocity", "velocity"]\n'
    assert "'velocity' is there twice" in refusal(home, head + TEST)
    (home / "campaign.toml").write_text(head.replace(', "velocity"', ', "amplitude"') + TEST)
    assert load_campaign(home / "campaign.toml").settings.dependence == {
        "Fc_fwd": ("velocity", "amplitude")
    }


def test_a_probability_below_one_is_never_all():
    for probability, text in [(0.95, "95"), (0.9999999999999999, "99.99999999999999")]:
        assert percent(probability) == text


def test_a_word_of_thousands_of_letters_is_not_repeated_whole(home):
    words = ["check", "9" * 5000]
    outcome = CliRunner().invoke(app, words)
    assert outcome.exit_code == 2
    assert len(outcome.stderr) < 500
    assert "9" * 60 + "…" in outcome.stderr
