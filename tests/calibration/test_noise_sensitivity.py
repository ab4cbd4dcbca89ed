"""Which quantities of a test its noise model decides."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.posterior import load_priors
from mfd_bayes.calibration.result import Task, moves, quantiles_of
from mfd_bayes.friction.three_stage import LuGre
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import load_test

QUICK = Effort(name="tiny", ess=30, limit=500, r_hat=1.2, length=1.0, ensembles=2, starts=3)
TIME = np.arange(0, 5, 1 / 32)


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


def test_white_noise_decides_nothing_and_a_noise_without_priors_is_an_error_of_its_own(tmp_path):
    motion, file = np.sin(2 * np.pi * 0.5 * TIME), load_priors("brfd")
    theta = np.array([[60.0, 0.02, 0.02, 2.2, 2.0, 1.9, 1.7, 0.5]])
    force = LuGre().force(theta, Trace.from_arrays(TIME, motion, 0.03))[0]
    force += np.random.default_rng(2).normal(0, 0.05, TIME.size)
    task = Task(
        id="a",
        file="a.nc",
        trace=Trace.from_arrays(TIME, motion, 0.03, force),
        priors=replace(
            file, parameters={k: v for k, v in file.parameters.items() if k != "noise_build"}
        ),
        model="lugre",
        noise="ou",
        start="sample",
        effort=QUICK,
        seed=(1, 2),
        checks_noise=True,
    )
    assert not task.run(tmp_path, lambda _: None).error
    stored = load_test(tmp_path / "a.nc")
    staged, iid, student_t = stored.facts["other_noises"]
    assert [fit["noise"] for fit in (staged, iid, student_t)] == ["staged", "iid", "student_t"]
    assert "noise_build" in staged["error"]
    assert staged["quantities"] == {}
    own = quantiles_of(task.posterior(), stored.values())
    for fit in (iid, student_t):
        assert not fit["error"]
        assert fit["size"] >= 50.0
        assert not {"noise_sd", "start", "gamma1"} & set(fit["quantities"])
        for name in ("Fc_fwd", "Fc_bwd", "sigma0"):
            assert not moves(own[name], fit["quantities"][name]), name
            assert fit["quantities"][name][1] == pytest.approx(own[name][1], rel=0.05)
