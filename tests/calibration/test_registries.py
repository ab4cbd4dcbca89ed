"""A new model, noise or prior family needs one class and one entry in its registry."""

from types import MappingProxyType

import numpy as np
import pytest

from mfd_bayes.calibration import noise as noises
from mfd_bayes.calibration import priors as families
from mfd_bayes.calibration.noise import SD, Noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import WIDTH, Family, load_priors, units
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.compare import check_models
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.population.laws import complete_laws, default_laws
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import symbols

TIME = np.arange(0, 4, 1 / 32)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
PRIORS = """
[parameters.mu]
family = "lognormal"
median = "2 kip"
spread = 0.5

[parameters.offset]
family = "normal"
mean = "0 kip"
sd = "0.1 kip"

[parameters.noise_sd]
family = "half_normal"
sd = "0.2 kip"
"""
CAMPAIGN = """
[campaign]
model = "three_stage"
noise = "iid"
[columns]
time = { name = "t_s" }
[[test]]
id = "a"
file = "a.csv"
actuation = "500 psi"
"""


class Coulomb(Model):
    """Dry friction: a constant force against the motion."""

    name = "coulomb"
    quantities = (Quantity("mu", "force", r"\mu", "μ", "friction force"),)
    laws = MappingProxyType({"mu": "power"})

    def force(self, theta, trace, start=None, *, scales=None):
        return np.asarray(theta) * np.sign(trace.velocity)


class Laplace(Noise):
    """Independent noise with the tails of a Laplace distribution, whose mean size is noise_sd."""

    name = "laplace"
    quantities = (SD, Quantity("noise_tilt", "dimensionless", "b", "b", "no more than a name"))

    def _density(self, standard, values):
        return -np.abs(standard).sum(axis=1) - standard.shape[1] * np.log(2.0)

    def _innovations(self, rng, shape, values):
        return rng.laplace(size=shape)


EXPONENTIAL = Family(
    {"scale": WIDTH},
    lambda x, f: -x / f["scale"] - np.log(f["scale"]),
    lambda rng, n, f: rng.exponential(f["scale"], n),
    lambda f: f["scale"] * np.log(2.0),
)
FORCE = 2.0 * np.sign(np.cos(2 * np.pi * 0.5 * TIME))
TRACE = Trace.from_arrays(TIME, MOTION, actuation=0.5, force=FORCE)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,x_in,f_kip\n0,0,0\n")
    (tmp_path / "own.toml").write_text(PRIORS)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path


def name_in(path, old, new):
    path.write_text(path.read_text().replace(old, new))
    return path


def test_a_new_friction_model_is_one_class_and_one_entry(folder, monkeypatch):
    path = name_in(folder / "campaign.toml", "three_stage", "coulomb")
    with pytest.raises(CampaignError, match="'bouc_wen' or 'backlash', got 'coulomb'"):
        load_campaign(path)
    monkeypatch.setattr(models, "MODELS", {**models.MODELS, "coulomb": Coulomb()})
    posterior = Posterior(TRACE, load_priors("own.toml", folder), "iid", "coulomb")
    assert posterior.names == ("mu", "offset", "noise_sd")
    values = {"mu": np.array([2.0, 1.0]), "offset": np.zeros(2), "noise_sd": np.full(2, 0.1)}
    density = posterior.log_prob(posterior.coordinates(values))
    assert density[0] > density[1] + 100
    assert load_campaign(path).model == "coulomb"
    assert symbols.label("mu", units()["mu"]) == r"$\mu$, kip"
    assert symbols.meaning("mu") == "friction force"
    assert default_laws()["mu"] == "power"
    assert complete_laws({"mu": "affine"})["mu"] == "affine"
    assert check_models(["coulomb", "lugre"]) == ("lugre", "coulomb")


def test_a_law_of_a_new_model_can_be_chosen_in_a_campaign(folder, monkeypatch):
    path = name_in(folder / "campaign.toml", "[columns]", '[laws]\nmu = "affine"\n[columns]')
    with pytest.raises(CampaignError, match=r"unknown key 'mu' in \[laws\]"):
        load_campaign(path)
    monkeypatch.setattr(models, "MODELS", {**models.MODELS, "coulomb": Coulomb()})
    assert load_campaign(path).settings.laws["mu"] == "affine"


def test_a_new_noise_is_one_class_and_one_entry(folder, monkeypatch):
    path = name_in(folder / "campaign.toml", '"iid"', '"laplace"')
    with pytest.raises(CampaignError, match="'student_t' or 'staged', got 'laplace'"):
        load_campaign(path)
    monkeypatch.setattr(noises, "NOISES", {**noises.NOISES, "laplace": Laplace()})
    assert load_campaign(path).noise == "laplace"
    tilt = '[parameters.noise_tilt]\nfamily = "beta"\na = 1\nb = 1\n'
    file = name_in(folder / "own.toml", "[parameters.mu]", tilt + "[parameters.mu]")
    monkeypatch.setattr(models, "MODELS", {"coulomb": Coulomb()})
    posterior = Posterior(TRACE, load_priors(str(file)), "laplace", "coulomb")
    assert posterior.names == ("mu", "offset", "noise_sd", "noise_tilt")
    drawn = posterior.draw_prior(np.random.default_rng(0), 5)
    assert np.all(np.isfinite(posterior.log_prob(posterior.coordinates(drawn))))
    assert posterior.noise.draw(np.random.default_rng(0), TIME, drawn).shape == (5, TIME.size)
    assert (symbols.maths("noise_tilt"), units()["noise_tilt"]) == ("b", "1")


def test_a_new_prior_family_is_one_entry(folder, monkeypatch):
    monkeypatch.setattr(families, "FAMILIES", {**families.FAMILIES, "exponential": EXPONENTIAL})
    monkeypatch.setattr(models, "MODELS", {"coulomb": Coulomb()})
    file = name_in(
        folder / "own.toml", 'family = "half_normal"\nsd = ', 'family = "exponential"\nscale = '
    )
    posterior = Posterior(TRACE, load_priors(str(file)), "iid", "coulomb")
    prior = posterior.priors["noise_sd"]
    assert (prior.lower, prior.upper) == (0.0, np.inf)
    assert prior.typical == pytest.approx(0.2 * np.log(2.0))
    x = np.array([0.1, 0.5])
    expected = -x / 0.2 - np.log(0.2) + np.log(x)
    np.testing.assert_allclose(prior.log_density(prior.coordinate(x)), expected)
    drawn = posterior.draw_prior(np.random.default_rng(0), 5)
    assert np.all(np.isfinite(posterior.log_prob(posterior.coordinates(drawn))))


def test_every_registered_object_has_the_name_that_it_is_registered_by():
    for registry in (models.MODELS, noises.NOISES):
        assert all(name == entry.name for name, entry in registry.items())
        assert all(entry.parameters for entry in registry.values())
