"""Cycles, energies and replicated records."""

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import derive_from_parameters, replicate
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import RecordError
from mfd_bayes.friction.three_stage import LuGre, ThreeStage
from mfd_bayes.records.loops import cycle_values
from mfd_bayes.records.trace import Trace

X = 1.3  # in
OMEGA = 2.0 * np.pi * 0.25  # 1/s
TIME = np.arange(0.0, 14.0, 0.005)  # three and a half periods


def harmonic(time=TIME, omega=OMEGA):
    return Trace.from_arrays(
        time, X * np.sin(omega * time), velocity=X * omega * np.cos(omega * time)
    )


def decaying():
    x = X * np.exp(-0.1 * TIME) * np.sin(OMEGA * TIME)
    return Trace.from_arrays(TIME, x)


def test_a_coulomb_loop_dissipates_four_times_force_times_amplitude():
    trace, friction = harmonic(), np.array([0.5, 2.0])
    force = friction[:, None] * np.sign(trace.velocity)
    values = cycle_values(trace, force)
    energies = values["energy"]
    assert energies.shape == (2, 3)
    np.testing.assert_allclose(energies, np.tile(4.0 * friction[:, None] * X, 3), rtol=1e-3)
    equivalent = 4.0 * friction / (np.pi * OMEGA * X)  # Chopra, Coulomb damping
    np.testing.assert_allclose(values["c_eq"], np.tile(equivalent[:, None], 3), rtol=1e-3)
    for name in ("peak_fwd", "peak_bwd"):
        np.testing.assert_array_equal(values[name], np.tile(friction[:, None], 3))
    for motion in (trace, decaying()):  # a dashpot is equivalent to itself
        np.testing.assert_allclose(
            cycle_values(motion, 0.7 * motion.velocity[None])["c_eq"], 0.7, rtol=1e-3
        )


def test_gap_and_self_energizing_factors_follow_from_the_parameters():
    columns = {"d2": [0.1, 0.2], "d3": [0.05, 0.1], "Fc_fwd": [2.0, 4.0], "Fc_bwd": [6.0, 8.0]}
    values = {name: np.array(column) for name, column in columns.items()}
    derived = derive_from_parameters(ThreeStage(), values, pressure=0.5, area=4.0)
    for name, expected in (("gap_width", [0.15, 0.3]), ("C_fwd", [1, 2]), ("C_bwd", [3, 4])):
        np.testing.assert_allclose(derived[name], expected)
    assert set(derive_from_parameters(ThreeStage(), values)) == {"gap_width"}
    without = derive_from_parameters(ThreeStage(), values, pressure=0.0, area=2.0)
    assert set(without) == {"gap_width"}
    assert derive_from_parameters(LuGre(), values) == {}


def test_a_replicated_force_beyond_all_range_ends_in_a_sentence():
    time = np.arange(60) * 0.05
    trace = Trace.from_arrays(time, np.sin(time), 0.5, np.cos(time))
    posterior = Posterior(trace, "mfd", "iid", "lugre")
    drawn = posterior.draw_prior(np.random.default_rng(0), 20)
    assert np.all(np.isfinite(replicate(posterior, drawn, np.random.default_rng(0)).observed))
    drawn["sigma2"] = np.full(20, 1e14)
    with pytest.raises(RecordError, match="replicated force"):
        replicate(posterior, drawn, np.random.default_rng(0))
