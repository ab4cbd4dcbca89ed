"""A stored population is refused unless it is consistent and within its priors."""

import json
import shutil

import h5py
import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.errors import StoreError
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.storage import load_population, save_population

NAMES = ("sigma0", "Fc_fwd", "Fc_bwd", "static_excess_fwd", "static_excess_bwd", "v_s", "offset")


@pytest.fixture(scope="module")
def made(tmp_path_factory, priors):
    """File of a population with effects of session and level, a law and a dependence."""
    laws = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}
    settings = [
        Setting(p, s, {"velocity": 1.0, "amplitude": 1.0})
        for p, s in ((0.5, "a"), (0.5, "a"), (0.8, "b"), (1.5, "b"))
    ]
    layout = lay_out(priors, NAMES, settings, laws, {"Fc_fwd": ("velocity",)})
    assert {effect.name for effect in layout.effects} == {"level", "session"}
    rng = np.random.default_rng(1)
    d, cells = len(NAMES), sum(len(e.cells) for e in layout.effects)
    population = Population(
        layout=layout,
        h=rng.normal(-2.0, 0.2, size=(2, 12, layout.dim)),
        latent=0.1 * rng.normal(size=(2, 12, 1 + cells, d)),
        choice=layout.draw_choice(24).reshape(2, 12, -1),
        together=np.broadcast_to(np.eye(d), (2, 12, d, d)),
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(np.ones(2), np.ones(2), np.ones(2)),
    )
    path = tmp_path_factory.mktemp("made") / "population.nc"
    save_population(path, population)
    return path


@pytest.fixture
def path(made, tmp_path):
    return shutil.copy(made, tmp_path / "population.nc")


def change_facts(path, how):
    with h5py.File(path, "r+") as file:
        facts = json.loads(file["posterior"].attrs["facts"])
        how(facts)
        file["posterior"].attrs["facts"] = json.dumps(facts)


def test_the_file_is_read(path, priors):
    assert load_population(path, priors).size == 24


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("names", ["sigma0"]),
        ("names", ["../x", *NAMES[1:]]),
        ("names", [NAMES[0], *NAMES[:-1]]),
        ("laws", {"Fc_fwd": "cubic"}),
        ("laws", {"k2": "power"}),
        ("weights", {}),
        ("weights", {n: {"power": 0.0} for n in ("Fc_fwd", "Fc_bwd", "sigma0")}),
        ("centre", [0.0]),
        ("spread", [0.0] * len(NAMES)),
        ("spread", [1e-310] * len(NAMES)),
        ("scatter_sd", [1.0] * len(NAMES)),
        ("member", [99] * len(NAMES)),
        ("member", [-1] * len(NAMES)),
        ("groups", ["nothing"]),
        ("reference", 0.0),
        ("reference", 1e-310),
        ("reference", None),
        ("settings", []),
        ("settings", [{"actuation": -1.0, "session": "", "covariates": {}}] * 4),
        ("settings", [{"actuation": 1.0, "session": "", "covariates": {}}] * 4),
        ("dependence", {"k2": ["velocity"]}),
        ("dependence", {"Fc_fwd": ["weight"]}),
        ("covariate_reference", {}),
        ("actuation_unit", "psi"),
        ("walkers", 5),
        ("walkers", 0),
        ("r_hat", "good"),
    ],
)
def test_facts_that_do_not_fit_together_are_refused(path, priors, key, value):
    change_facts(path, lambda facts: facts.update({key: value}))
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_population(path, priors)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("group", 99),
        ("members", [99]),
        ("members", []),
        ("home", [0]),
        ("home", [99] * 4),
        ("name", "weather"),
        ("cells", [["a", 0.5]] * 3),
        ("cells", [["a"]] * 3),
        ("cells", [["a", -1.0], ["b", 0.8], ["b", 1.5]]),
    ],
)
def test_effects_that_do_not_fit_are_refused(path, priors, key, value):
    def spoil(facts):
        effect = next(e for e in facts["effects"] if e["name"] == "level")
        effect[key] = value

    change_facts(path, spoil)
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_population(path, priors)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("hyperparameters", np.nan, "finite"),
        ("hyperparameters", 1e300, "finite"),
        ("hyperparameters", 50.0, "that its prior excludes"),
        ("latent", np.inf, "finite"),
        ("latent", 1e5, "level that its prior excludes"),
        ("law", 99.0, "law has a number"),
        ("law", np.nan, "law has a number"),
        ("together", 2.0, "correlation"),
    ],
)
def test_draws_out_of_range_are_refused(path, priors, name, value, words):
    with h5py.File(path, "r+") as file:
        data = file["posterior"][name]
        data[(1, 3, *(0 for _ in data.shape[2:]))] = value
    with pytest.raises(StoreError, match=words):
        load_population(path, priors)


@pytest.mark.parametrize("name", ["hyperparameters", "latent", "law", "together"])
def test_draws_of_another_size_are_refused(path, priors, name):
    def spoil(facts):
        facts["effects"] = facts["effects"][:1]
        facts["laws"] = {"Fc_fwd": "power"}
        facts["weights"] = {"Fc_fwd": {"power": 1.0}}

    change_facts(path, spoil)
    with pytest.raises(StoreError, match="of shape"):
        load_population(path, priors)
    with h5py.File(path, "r+") as file:
        del file["posterior"][name]
    with pytest.raises(StoreError, match=name):
        load_population(path, priors)
