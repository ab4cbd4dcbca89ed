"""Whole posteriors: two modes, predictive checks, and a real record."""

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import check_predictive, measure_draws, replicate
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import find_modes, maximize, nearest_modes
from mfd_bayes.calibration.sampling import sample, sample_density
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace

pytestmark = pytest.mark.slow

# --- two modes

DIM, APART, MINOR = 5, 9.0, 0.2
MANY = Effort(ess=400, limit=3000)


def density(q):
    """0.8 of a unit normal at 0 and 0.2 of one half as wide, 9 sd away in every dimension."""
    main = -0.5 * np.sum(q**2, axis=1) + np.log(1 - MINOR)
    far = (q - APART) / 0.5
    minor = -0.5 * np.sum(far**2, axis=1) - DIM * np.log(0.5) + np.log(MINOR)
    return np.logaddexp(main, minor)


def modes_at(*places):
    return tuple(maximize(density, np.full(DIM, position), np.ones(DIM)) for position in places)


@pytest.fixture(scope="module")
def chains():
    return sample_density(density, modes_at(0.3, APART + 0.1), MANY, np.random.default_rng(1))


def test_both_modes_get_their_shares(chains):
    assert chains.convergence.reached(MANY.r_hat, MANY.ess)
    shares = np.mean(chains.q[..., 0] > APART / 2, axis=1)
    assert np.mean(shares) == pytest.approx(MINOR, abs=0.04)
    np.testing.assert_allclose(shares, MINOR, atol=0.1)
    nearest = nearest_modes(modes_at(0.0, APART), chains.q)
    np.testing.assert_allclose(nearest.mean(axis=1), shares, atol=1e-3)


def test_each_mode_has_its_own_width(chains):
    minor = chains.q[..., 0] > APART / 2
    assert np.std(chains.q[minor]) == pytest.approx(0.5, rel=0.1)
    assert np.std(chains.q[~minor]) == pytest.approx(1.0, rel=0.1)


def test_an_ensemble_that_is_stuck_is_seen(chains):
    stuck = chains.q[..., 0].copy()
    mode = stuck[0][stuck[0] < APART / 2]
    stuck[0] = np.resize(mode, stuck.shape[1])  # one never left the main mode, three mix
    assert measure_draws(chains.q[..., 0], chains.walkers).worst_r_hat < MANY.r_hat
    assert measure_draws(stuck, chains.walkers).worst_r_hat > MANY.r_hat


# --- predictive checks pass the model that made the data, and fail one that did not

SHORT = Effort(ess=100, limit=600, r_hat=1.05, length=1.0)
EXTREME = 0.005


def gap_record():
    """A synthetic test with a gap, and noise that is correlated."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 12.0, 0.04)
    motion = Trace.from_arrays(time, np.sin(2 * np.pi * 0.25 * time))
    blank = Trace.from_arrays(time, motion.displacement, force=np.zeros(time.size))
    source = Posterior(blank, "mfd")
    truth = {
        "sigma0": 30.0, "sigma1": 0.02, "sigma2": 0.01, "Fc_fwd": 1.1, "Fc_bwd": 1.4,
        "static_excess_fwd": 0.15, "static_excess_bwd": 0.15, "k2": 0.6, "k3": 20.0, "d2": 0.09,
        "d3": 0.07, "ell": 0.02, "gamma1": 1.0, "v_s": 0.5, "start": 0.4, "offset": 0.02,
        "noise_sd": 0.04, "noise_time": 0.1,
    }  # fmt: skip
    values = {name: np.array([value]) for name, value in truth.items()}
    force = source.force(values) + values["offset"] + source.noise.draw(rng, time, values)
    return Trace.from_arrays(time, motion.displacement, force=force[0])


def checks(model, noise):
    posterior = Posterior(gap_record(), "mfd", noise, model)
    draws = sample(posterior, SHORT, seed=2)
    values = {name: value.reshape(-1) for name, value in draws.values.items()}
    replicas = replicate(posterior, values, np.random.default_rng(0))
    results = check_predictive(posterior, replicas, 0.16)
    return {check.name: check for check in results}


def extremes(results):
    return {n for n, c in results.items() if not EXTREME <= c.p_value <= 1.0 - EXTREME}


def test_the_model_that_made_the_record_passes():
    results = checks("three_stage", "ou")
    assert extremes(results) == set()
    names = " ".join(results)
    for statistic in ("residual rms", "lag-one", "mid-gap"):
        assert statistic in names


def test_a_model_without_the_gap_fails():
    assert "force at mid-gap, kip" in extremes(checks("lugre", "iid"))


# --- real records


def misfit(path, model):
    """Residual rms of the best mode over the force's standard deviation."""
    record = read_record(path, actuation="30 lbf")
    posterior = Posterior(record.trace(64.0), "brfd", "ou", model)
    best = find_modes(posterior, np.random.default_rng(1))[0]
    residual = posterior.residual(best.q[None])[0]
    return float(np.std(residual) / np.std(np.asarray(posterior.trace.force)))


def test_three_stages_fit_where_lugre_alone_does_not(data_folder):
    path = data_folder / "2023_30lb_0.25Hz_1.0in.csv"
    assert misfit(path, "three_stage") <= 0.09
    assert misfit(path, "lugre") >= 0.14
