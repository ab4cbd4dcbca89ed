"""Sentences that say what is wrong, and input that was taken for something else."""

import numpy as np
import pytest

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import CampaignError, RecordError, StoreError, UnitError
from mfd_bayes.records.data_quality import contradictions
from mfd_bayes.records.record import read_record
from mfd_bayes.store.files import read_json
from mfd_bayes.units import parse_actuation, parse_quantity, percent
from tests.command_line import here, write_csv

TEST = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'
TIME = np.arange(201) / 50
NINES = "9" * 5000


@pytest.fixture
def home(tmp_path):
    write_csv(tmp_path / "a.csv", TIME, np.sin(np.pi * TIME), np.tanh(4 * np.cos(np.pi * TIME)))
    return tmp_path


def refused(home, text):
    """The sentence with which a campaign is refused."""
    (home / "campaign.toml").write_text(text, encoding="utf-8")
    with pytest.raises(CampaignError) as caught:
        load_campaign(home / "campaign.toml")
    return str(caught.value)


TWICE = '[dependence]\nFc_fwd = ["velocity", "velocity"]\n'


@pytest.mark.parametrize(
    ("old", "new", "words", "unsaid"),
    [
        ("[[test]]", "[test]", "begins with [[test]], in two brackets", "tuple"),
        ("500 psi", "1,000 psi", "without thousands separators", ""),
        ("500 psi", "1'000,5 psi", "without thousands separators", ""),
        ("500 psi", "-5 psi", "-5 psi", ""),
        ("500 psi", "7 miles", "7 miles", ""),
        ('id = "a"', 'id = "a b"', "a b", ""),
        ('id = "a"', 'id = "a"\nfit = "5 s to 1 s"', "5 s to 1 s", ""),
        ("[[test]]", f"[campaign]\nrate = {NINES}\n[[test]]", "thousands of digits", "sys."),
        ("[[test]]", f"{TWICE}[[test]]", "'velocity' is there twice", ""),
    ],
)
def test_what_is_wrong_in_a_campaign_is_said_once(home, old, new, words, unsaid):
    sentence = refused(home, TEST.replace(old, new))
    assert words in sentence
    assert sentence.count(", got ") <= 1
    assert not unsaid or unsaid not in sentence


def test_two_covariates_are_no_covariate_twice(home):
    (home / "campaign.toml").write_text(TWICE.replace(', "velocity"', ', "amplitude"') + TEST)
    dependence = load_campaign(home / "campaign.toml").settings.dependence
    assert dependence == {"Fc_fwd": ("velocity", "amplitude")}


def test_numbers_that_are_none_are_refused_by_what_reads_them(home):
    (home / "a.json").write_text(f'{{"time_s": [{NINES}], "displacement_in": [1]}}')
    for read, error in ((read_record, RecordError), (read_json, StoreError)):
        with pytest.raises(error, match="a number of thousands of digits"):
            read(home / "a.json")
    for text in ("600 rpm", "60 rad/s"):
        with pytest.raises(UnitError, match="has an angle"):
            parse_quantity(text, "rate")
    with pytest.raises(UnitError, match="without thousands separators"):
        parse_actuation("1,000 psi")
    lines = (home / "a.csv").read_text().splitlines()
    for cell in ("１２", "1\u00a02", "²"):  # digits of other scripts
        text = "\n".join([*lines[:8], f"0.14,{cell},1", *lines[9:]])
        (home / "a.csv").write_text(text, encoding="utf-8")
        with pytest.raises(RecordError, match=r"line 9 of .*column 'displacement_in'"):
            read_record(home / "a.csv")


def test_columns_and_units_that_contradict_their_names_are_said(home):
    columns = {"time": "time_s", "displacement": "displacement_in", "force": "displacement_in"}
    with pytest.raises(RecordError, match="given for displacement and force"):
        read_record(home / "a.csv", columns, {"force": "kip"})
    (fault,) = contradictions(read_record(home / "a.csv", units={"force": "kN"}))
    assert "'force_kip' is read in 'kN', and its name says 'kip'" in str(fault.message)
    for units in ({"force": "kip"}, {"force": "kips"}, {}):
        assert contradictions(read_record(home / "a.csv", units=units)) == ()


def test_a_probability_below_one_is_never_all_and_a_long_word_is_not_repeated_whole():
    assert [percent(0.95), percent(0.9999999999999999)] == ["95", "99.99999999999999"]
    outcome = here("check", NINES)
    assert outcome.exit_code == 2
    assert len(outcome.stderr) < 500
    assert "9" * 60 + "…" in outcome.stderr
