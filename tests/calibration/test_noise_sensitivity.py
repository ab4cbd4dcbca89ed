"""Which quantities of a test its noise model decides."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.noise_sensitivity import moves, other_noises, quantiles_of
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.calibration.result import Task
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import load_test

QUICK = Effort(name="tiny", ess=30, limit=500, r_hat=1.2, length=1.0, ensembles=2, starts=3)
TIME = np.arange(0, 5, 1 / 32)


def task_of(**more):
    """A short test of LuGre's model with white noise."""
    motion = np.sin(2 * np.pi * 0.5 * TIME)
    quiet = Trace.from_arrays(TIME, motion, 0.03)
    theta = np.array([[60.0, 0.02, 0.02, 2.2, 2.0, 1.9, 1.7, 0.5]])
    force = LuGre().force(theta, quiet)[0] + np.random.default_rng(2).normal(0, 0.05, TIME.size)
    trace = Trace.from_arrays(TIME, motion, 0.03, force)
    settings = {
        "id": "a",
        "file": "a.nc",
        "trace": trace,
        "priors": load_priors("brfd"),
        "model": "lugre",
        "noise": "ou",
        "start": "sample",
        "effort": QUICK,
        "seed": (1, 2),
        "checks_noise": True,
    }
    return Task(**(settings | more))


@pytest.mark.parametrize(
    ("own", "other", "expected"),
    [
        ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), False),
        ((1.0, 2.0, 3.0), (1.4, 3.1, 5.0), True),
        ((1.0, 2.9, 3.0), (3.01, 3.1, 3.2), True),  # the intervals do not overlap
    ],
)
def test_a_quantity_moves_by_more_than_half_its_interval_or_leaves_it(own, other, expected):
    assert moves(own, other) is expected


def test_a_test_is_fitted_under_every_other_noise_ou_first():
    assert other_noises("ou") == ("staged", "iid", "student_t")
    assert all(set(other_noises(noise)) == set(NOISES) - {noise} for noise in NOISES)
    for noise in set(NOISES) - {"ou"}:
        assert other_noises(noise)[0] == "ou"
        assert noise not in other_noises(noise)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checked")
    assert not task_of().run(folder, lambda _: None).error
    return load_test(folder / "a.nc")


def test_white_noise_decides_nothing(stored):
    """Of a record with white noise, the fits with and without correlation agree."""
    task, test = task_of(), stored
    own = quantiles_of(task.posterior(), test.values())
    (iid,) = [fit for fit in test.facts["other_noises"] if fit["noise"] == "iid"]
    assert not iid["error"]
    assert {"Fc_fwd", "Fc_bwd", "sigma0"} <= set(iid["quantities"])
    assert not {"noise_sd", "start", "gamma1"} & set(iid["quantities"])
    for name in ("Fc_fwd", "Fc_bwd", "sigma0"):
        assert not moves(own[name], iid["quantities"][name]), name
        assert iid["quantities"][name][1] == pytest.approx(own[name][1], rel=0.05)


def test_a_noise_without_priors_is_an_error_of_its_fit_alone(tmp_path):
    file = load_priors("brfd")
    parameters = {k: v for k, v in file.parameters.items() if k != "noise_build"}
    task = task_of(priors=replace(file, parameters=parameters))
    assert task.run(tmp_path, lambda _: None).error == ""
    staged, iid, _ = load_test(tmp_path / "a.nc").facts["other_noises"]
    assert "no prior for noise_build" in staged["error"]
    assert staged["quantities"] == {}
    assert iid["quantities"]
