"""The commands as functions of Python, and what their results print."""

import pytest

import mfd_bayes as mb
from mfd_bayes.campaign.synthetic import write_campaign


@pytest.fixture
def campaign(tmp_path):
    write_campaign(tmp_path / "campaign", 1)
    return tmp_path / "campaign" / "campaign.toml"


def test_inspect_reads_a_record_or_a_campaign(campaign):
    inspections = mb.inspect(campaign)
    assert len(inspections) == 11
    (inspection,) = mb.inspect(campaign.with_name("p500_f0.5.csv"))
    assert "slip force" in repr(inspection)
    assert repr(inspection).startswith("p500_f0.5.csv\n")
    with pytest.raises(mb.MfdError, match="nowhere"):
        mb.inspect("nowhere.csv")


def test_calibrate_and_demo_refuse_what_the_commands_refuse(campaign, tmp_path):
    with pytest.raises(mb.MfdError, match="lavish"):
        mb.calibrate(campaign, tmp_path / "out", effort="lavish")
    with pytest.raises(mb.MfdError, match="exists"):
        mb.demo(campaign.parent)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_calibrate_gives_the_run_that_it_writes(campaign, tmp_path):
    text = campaign.read_text("utf-8").split("[[test]]")
    campaign.write_text("[[test]]".join(text[:3]), "utf-8")
    run = mb.calibrate(campaign, tmp_path / "out", effort="quick", jobs=1)
    assert (tmp_path / "out" / "report.html").is_file()
    assert len(run.tests) == 2
    assert run.use


def test_results_say_what_they_are_in_a_few_lines(run):
    test = next(iter(run.tests.values()))
    band = run.predict(test.trace, draws=20)
    for result in (run, band, run.population, test, test.trace, test.posterior):
        assert type(result).__name__ in repr(result)
        assert len(repr(result)) < 400
