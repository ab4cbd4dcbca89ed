"""The noise decides parameters where the model cannot follow the record, and not where it can."""

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.posterior import OU, load_priors
from mfd_bayes.calibration.result import Task, moves, quantiles_of
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import load_test

pytestmark = pytest.mark.slow

TIME = np.arange(0, 8, 1 / 48)
MOTION = np.sin(np.pi * TIME)
THETA = np.array([[20, 0.02, 0.02, 2.2, 2.0, 1.9, 1.7, 2.5, 30, 0.2, 0.1, 1, 0.04, 1.0]])
SHORT = Effort(name="short", ess=60, limit=700, r_hat=1.1, length=1.5, ensembles=2, starts=4)


def record():
    """Three stages with correlated noise, and what they do not have.

    A slip force that falls by 30 % along a stroke, and a spike of 0.5 kip after build-up.
    """
    quiet = Trace.from_arrays(TIME, MOTION, 0.03)
    force, travel = ThreeStage().force(THETA, quiet)[0], ThreeStage().travel(THETA, quiet)[0]
    values = {"noise_sd": np.array([0.1]), "noise_time": np.array([0.1])}
    noise = OU().draw(np.random.default_rng(1), TIME, values)[0]
    noise -= 0.3 * force * np.clip(travel - 0.3, 0, 2) / 1.7
    spike = 0.5 * np.exp(-np.abs(travel - 0.35) / 0.03) * (travel > 0.2)
    return Trace.from_arrays(TIME, MOTION, 0.03, force + noise + spike * np.sign(force))


def test_noise_decides_slip_force_and_gap_where_the_model_cannot_follow(tmp_path):
    settings = ("a", "a.nc", record(), load_priors("brfd"), "three_stage", "ou", "sample", SHORT)
    task = Task(*settings, (1, 1), checks_noise=True)
    assert not task.run(tmp_path, lambda _: None).error
    stored = load_test(tmp_path / "a.nc")
    own, decided = quantiles_of(task.posterior(), stored.values()), {}
    for fit in stored.facts["other_noises"]:
        assert not fit["error"]
        moved = {name for name in own if moves(own[name], fit["quantities"][name])}
        decided[fit["noise"]] = moved
    assert {"Fc_fwd", "Fc_bwd"} <= decided["staged"]
    assert {"Fc_fwd", "Fc_bwd", "k3", "gap"} <= decided["iid"]
