import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.noise import NOISES, find_noise
from mfd_bayes.errors import FitError

UNIFORM = np.arange(40) / 64.0
IRREGULAR = np.sort(np.random.default_rng(0).uniform(0, 1.0, 40))
TIMES = pytest.mark.parametrize("time", [UNIFORM, IRREGULAR], ids=["uniform", "irregular"])
VALUES = {
    "noise_sd": np.array([0.1, 0.3, 2.0]),
    "noise_time": np.array([0.005, 0.05, 3.0]),
    "noise_dof": np.array([1.5, 4.0, 60.0]),
}


def values_of(name):
    return {key: VALUES[key] for key in NOISES[name].parameters}


def residuals(time, n=3):
    return np.random.default_rng(1).normal(size=(n, time.size))


def long_record(name, *, noise_time, samples=4000, copies=25, seed=2, dof=6.0):
    time = np.arange(samples) / 64.0
    values = {
        "noise_sd": np.full(copies, 0.2),
        "noise_time": np.full(copies, noise_time),
        "noise_dof": np.full(copies, dof),
    }
    values = {key: values[key] for key in NOISES[name].parameters}
    return NOISES[name].draw(np.random.default_rng(seed), time, values)


def z_scores(noise, sd, phi, kurtosis=0.0):
    """Variance and lag-one correlation of a record against AR(1)'s, in standard errors."""
    n = noise.size
    variance_error = sd**2 * np.sqrt((2 * (1 + phi**2) / (1 - phi**2) + kurtosis) / n)
    lag_one = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
    lag_error = np.sqrt((1 - phi**2) / n)
    return (np.mean(noise**2) - sd**2) / variance_error, (lag_one - phi) / lag_error


@TIMES
def test_ou_is_the_gaussian_process_with_exponential_covariance(time):
    residual, values = residuals(time), values_of("ou")
    got = NOISES["ou"].log_density(residual, time, values)
    apart = np.abs(time[:, None] - time)
    for i in range(3):
        covariance = values["noise_sd"][i] ** 2 * np.exp(-apart / values["noise_time"][i])
        expected = stats.multivariate_normal(np.zeros(time.size), covariance).logpdf(residual[i])
        assert got[i] == pytest.approx(expected, rel=1e-9)


@TIMES
def test_iid_is_independent_normal(time):
    residual, values = residuals(time), values_of("iid")
    got = NOISES["iid"].log_density(residual, time, values)
    expected = stats.norm(scale=values["noise_sd"][:, None]).logpdf(residual).sum(axis=1)
    np.testing.assert_allclose(got, expected, rtol=1e-9)


@TIMES
def test_student_t_is_autoregressive_with_t_innovations(time):
    residual, values = residuals(time), values_of("student_t")
    got = NOISES["student_t"].log_density(residual, time, values)
    for i in range(3):
        sd, tau, dof = (values[key][i] for key in ("noise_sd", "noise_time", "noise_dof"))
        phi = np.exp(-np.diff(time) / tau)
        scale = np.concatenate([[sd], sd * np.sqrt(1 - phi**2)])
        centre = np.concatenate([[0.0], phi * residual[i, :-1]])
        expected = stats.t(dof, loc=centre, scale=scale).logpdf(residual[i]).sum()
        assert got[i] == pytest.approx(expected, rel=1e-9)


def test_ou_with_a_very_short_memory_is_iid():
    residual = residuals(UNIFORM)
    sd = {"noise_sd": VALUES["noise_sd"]}
    short = sd | {"noise_time": np.full(3, 1e-5)}
    np.testing.assert_allclose(
        NOISES["ou"].log_density(residual, UNIFORM, short),
        NOISES["iid"].log_density(residual, UNIFORM, sd),
        rtol=1e-12,
    )


def test_ou_keeps_its_digits_when_memory_is_far_longer_than_the_record():
    # on two samples the density is known in closed form; 1 − φ² = 2e-9 there
    time, residual = np.array([0.0, 0.01]), np.array([[0.1, 0.100001]])
    values = {"noise_sd": np.array([1.0]), "noise_time": np.array([1e7])}
    shrink = -np.expm1(-2 * 0.01 / 1e7)
    innovation = residual[0, 1] + np.expm1(-0.01 / 1e7) * residual[0, 0] - residual[0, 0]
    expected = stats.norm.logpdf(0.1) + stats.norm.logpdf(innovation, scale=np.sqrt(shrink))
    assert NOISES["ou"].log_density(residual, time, values)[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["ou", "student_t"])
def test_the_longest_memory_that_a_prior_allows_warns_of_nothing_and_is_no_nan(name):
    values = values_of(name) | {"noise_time": np.full(3, 9e14)}
    density = NOISES[name].log_density(residuals(UNIFORM), UNIFORM, values)
    assert not np.any(np.isnan(density))


@pytest.mark.parametrize(
    ("name", "noise_time", "kurtosis"), [("ou", 0.05, 0.0), ("iid", 0.05, 0.0)]
)
def test_draws_have_the_stated_spread_and_memory(name, noise_time, kurtosis):
    noise = long_record(name, noise_time=noise_time)
    phi = np.exp(-1 / 64 / noise_time) if name == "ou" else 0.0
    scores = z_scores(noise, 0.2, phi, kurtosis)
    assert np.max(np.abs(scores)) < 4
    # the control: a scale or a correlation time that is a few percent off is detected
    assert abs(z_scores(noise, 0.2 * 1.04, phi, kurtosis)[0]) > 4
    assert abs(z_scores(noise, 0.2, phi + 0.03, kurtosis)[1]) > 4


def test_student_t_draws_have_the_spread_of_their_scale_and_heavy_tails():
    dof = 6.0
    noise = long_record("student_t", noise_time=0.05, dof=dof)
    phi = np.exp(-1 / 64 / 0.05)
    sd = 0.2 * np.sqrt(dof / (dof - 2))
    variance, lag_one = z_scores(noise, sd, phi, kurtosis=6 / (dof - 4))
    assert max(abs(variance), abs(lag_one)) < 4
    innovation = (noise[:, 1:] - phi * noise[:, :-1]) / (0.2 * np.sqrt(1 - phi**2))
    assert stats.kstest(innovation[:, ::5].ravel(), stats.t(dof).cdf).pvalue > 0.001
    assert stats.kstest(innovation[:, ::5].ravel(), stats.norm(0, sd / 0.2).cdf).pvalue < 0.001


def test_draws_at_irregular_times_are_white_once_their_memory_is_removed():
    time = np.sort(np.random.default_rng(3).uniform(0, 60, 4000))
    values = {"noise_sd": np.full(5, 0.2), "noise_time": np.full(5, 0.05)}
    noise = NOISES["ou"].draw(np.random.default_rng(4), time, values)
    phi = np.exp(-np.diff(time) / 0.05)
    white = (noise[:, 1:] - phi * noise[:, :-1]) / (0.2 * np.sqrt(1 - phi**2))
    assert stats.kstest(white.ravel(), stats.norm.cdf).pvalue > 0.001
    wrong = (noise[:, 1:] - phi.mean() * noise[:, :-1]) / (0.2 * np.sqrt(1 - phi.mean() ** 2))
    assert stats.kstest(wrong.ravel(), stats.norm.cdf).pvalue < 0.001


def test_draws_follow_their_own_values_and_the_seed():
    values = {"noise_sd": np.array([0.01, 10.0]), "noise_time": np.array([0.05, 0.05])}
    first, again = (NOISES["ou"].draw(np.random.default_rng(5), UNIFORM, values) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert first.shape == (2, UNIFORM.size)
    assert first[1].std() > 100 * first[0].std()


def test_unknown_noise_lists_the_known():
    with pytest.raises(FitError, match="ou, iid, student_t"):
        find_noise("pink")
