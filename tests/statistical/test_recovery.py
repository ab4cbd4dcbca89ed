"""Known parameters are inside their intervals as often as the intervals say."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, PriorFile, load_priors
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.records.trace import Trace

pytestmark = pytest.mark.slow

TESTS = 12
PROBABILITY = 0.8
WATCHED = ("Fc_fwd", "Fc_bwd", "k3", "d2", "ell", "noise_sd")
# 72 trials at 0.8: mean 57.6; three and a half standard deviations of a binomial
# leave 45.7 to 69.5, and some tests are correlated within.
FEWEST, MOST = 45, 70


def narrow_priors() -> PriorFile:
    """The shipped priors around sensible loops, from which the truths are drawn too."""
    medians = {
        "sigma0": 25.0,
        "sigma1": 0.02,
        "sigma2": 0.01,
        "Fc_fwd": 1.0,
        "Fc_bwd": 1.2,
        "k2": 0.8,
        "k3": 20.0,
        "d2": 0.10,
        "d3": 0.08,
        "ell": 0.02,
        "v_s": 0.4,
        "noise_sd": 0.04,
        "noise_time": 0.1,
    }
    shipped = load_priors("mfd")
    narrow = {n: Prior("lognormal", {"median": m, "spread": 0.25}) for n, m in medians.items()}
    return replace(shipped, parameters=dict(shipped.parameters) | narrow)


def motion() -> Trace:
    time = np.arange(0.0, 8.0, 0.04)
    return Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.25 * time) * np.minimum(1, time / 4))


def synthesize(priors: PriorFile, rng: np.random.Generator) -> tuple[Posterior, dict[str, float]]:
    """A synthetic test with a truth drawn from the priors."""
    plain = motion()
    blank = Trace.from_arrays(plain.time, plain.displacement, force=np.zeros(plain.samples))
    source = Posterior(blank, priors)
    truth = source.draw_prior(rng, 1)
    force = source.force(truth) + truth["offset"] + source.noise.draw(rng, plain.time, truth)
    trace = Trace.from_arrays(plain.time, plain.displacement, force=force[0])
    return Posterior(trace, priors), {name: float(v[0]) for name, v in truth.items()}


@pytest.fixture(scope="module")
def quantile_ranks() -> np.ndarray:
    """Share of the posterior below the truth, (tests, watched)."""
    priors, rng = narrow_priors(), np.random.default_rng(11)
    effort = Effort(ess=80, limit=400, r_hat=1.05, length=1.0, ensembles=2, starts=6)
    ranks = np.empty((TESTS, len(WATCHED)))
    for i in range(TESTS):
        posterior, truth = synthesize(priors, rng)
        draws = sample(posterior, effort, seed=(17, i))
        ranks[i] = [np.mean(draws.values[name] < truth[name]) for name in WATCHED]
    return ranks


def inside(ranks: np.ndarray, probability: float) -> int:
    return int(np.sum(np.abs(ranks - 0.5) <= 0.5 * probability))


def test_truths_are_inside_as_often_as_promised(quantile_ranks: np.ndarray) -> None:
    assert FEWEST <= inside(quantile_ranks, PROBABILITY) <= MOST


def test_posteriors_half_as_wide_would_fail(quantile_ranks: np.ndarray) -> None:
    """Negative control: the same medians, with half the spread."""
    from scipy.stats import norm

    scores = norm.ppf(np.clip(quantile_ranks, 1e-3, 1 - 1e-3))
    overconfident = norm.cdf(2.0 * scores)
    assert inside(overconfident, PROBABILITY) < FEWEST
