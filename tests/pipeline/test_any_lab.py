"""A device of any size, in any unit: from a logger's files to priors, with nothing edited."""

import tomllib

import numpy as np
import pytest

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.pipeline.inspect import inspect_campaign, system_of_records
from tests.command_line import refusal, said
from tests.pipeline import devices

SEAL, DAMPER, _, ISOLATOR = devices.DEVICES


@pytest.mark.parametrize("device", devices.DEVICES, ids=lambda device: device.name)
def test_init_and_inspect_read_a_device_of_any_size(tmp_path, device):
    devices.write_device(tmp_path, device)
    words = said("init", tmp_path)
    campaign = tmp_path / "campaign.toml"
    if device.named:
        assert "FIXME" not in words
    else:
        assert "guessed from the numbers" in words
        devices.complete(campaign, device)
        said("init", campaign)
    loaded = load_campaign(campaign)
    assert len(loaded.tests) == 4
    stroke = np.ptp(loaded.tests[-1].read().displacement) * 25.4
    in_mm = {"mm": 1.0, "in": 25.4}[device.length_unit]
    assert stroke == pytest.approx(device.length * in_mm, rel=1e-3)
    inspections, records = inspect_campaign(campaign)
    system = system_of_records(records)
    force, unit = inspections[0].facts["slip force"].to_text(system).split()[:2]
    assert unit == system.force
    assert 0.1 < float(force) < 3000.0  # to be read, whatever the device's size


def test_a_folder_of_a_logger_says_at_each_step_what_is_next(tmp_path):
    devices.write_device(tmp_path, SEAL)
    for path in sorted(tmp_path.glob("*.txt"))[1:]:
        path.unlink()
    campaign = tmp_path / "campaign.toml"
    words = said("init", tmp_path)
    assert 'the unit of force is unknown; add unit = "N", "kN", "lbf" or "kip"' in words
    assert f"then: mfd-bayes init {campaign}, which writes priors.toml" in words
    assert "#     mfd-bayes init campaign.toml, once the units are complete" in campaign.read_text()
    assert "give the unit of displacement" in refusal("inspect", campaign, "--force")
    devices.complete(campaign, SEAL)
    assert "mfd-bayes init CAMPAIGN.TOML writes it" in refusal("inspect", campaign, "--force")
    assert f"look next: mfd-bayes prior-check {campaign}" in said("init", campaign)
    campaign.write_text(campaign.read_text().replace('"3 bar"', '"7 bar"'))
    assert " 7 bar " in said("inspect", campaign, "-o", tmp_path)


def test_priors_of_a_device_hold_its_truth_and_its_force_and_are_kept(tmp_path):
    truth = devices.write_device(tmp_path, ISOLATOR)
    said("init", tmp_path)
    priors = load_priors("priors.toml", tmp_path)
    for values in truth.values():
        for name in ("Fc_fwd", "Fc_bwd", "sigma0", "k3", "d2", "d3", "noise_sd"):
            figures = priors.parameters[name].figures
            assert abs(np.log(values[name] / figures["median"])) < 2.5 * figures["sigma"], name
    text = (tmp_path / "priors.toml").read_text(encoding="utf-8")
    assert "the slip force of 3bar_0.5Hz.txt" in text
    assert "sigma is a factor of 3" in text
    assert all(len(table["reason"]) > 5 for table in tomllib.loads(text)["parameters"].values())
    (tmp_path / "campaign.toml").unlink()
    assert "give --force to replace it" in refusal("init", tmp_path)
    assert (tmp_path / "priors.toml").read_text(encoding="utf-8") == text
    assert not (tmp_path / "campaign.toml").exists()


def test_priors_of_another_device_are_found_wrong_with_what_would_mend_them(tmp_path):
    devices.write_device(tmp_path, ISOLATOR)
    for path in sorted(tmp_path.glob("*.txt"))[1:]:
        path.unlink()
    said("init", tmp_path)
    campaign = tmp_path / "campaign.toml"
    words = said("prior-check", campaign, "-o", tmp_path)  # the negative control: its own priors
    assert words.count("100%") == 1
    text = campaign.read_text(encoding="utf-8").replace('"priors.toml"', '"mfd"')
    campaign.write_text(text, encoding="utf-8")
    words = said("prior-check", campaign, "-o", tmp_path, "--force", code=1)
    assert "the prior most wrong is that of Fc_" in words
    assert "kN, and the slip force of the loop is" in words
    assert "give it a median of about" in words
