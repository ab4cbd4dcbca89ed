"""Stored draws are refused unless they fit their model and priors."""

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.result import check_draws, check_facts
from mfd_bayes.errors import StoreError
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import Group, StoredTest

TIME = np.arange(60) * 0.05
TRACE = Trace.from_arrays(TIME, np.sin(TIME), 0.5, np.cos(TIME))
FACTS = {
    "model": "lugre",
    "noise": "iid",
    "start": "sample",
    "walkers": 6,
    "steps": 300,
    "discarded": 100,
    "seed": [1, 2],
    "modes": 2,
    "mode_shares": [[0.4, 0.6], [0.5, 0.5]],
    "autocorrelation": {"Fc_fwd": 10.0, "Fc_bwd": None},
    "convergence": {"Fc_fwd": [1.0, 500.0, 500.0], "Fc_bwd": [None, 0.0, None]},
}


@pytest.fixture(scope="module")
def posterior():
    return Posterior(TRACE, "mfd", "iid", "lugre")


def make(posterior, **changed):
    """Prior draws, some changed by functions; a function of a new name is given None."""
    flat = posterior.draw_prior(np.random.default_rng(0), 24)
    flat |= dict(zip(posterior.model.parameters, posterior.theta(flat).T, strict=True))
    values = {name: draws.reshape(2, 12) for name, draws in flat.items()}
    values |= {name: how(values.get(name)) for name, how in changed.items()}
    draws = {n: ([f"{n}_{i}" for i in range(v.ndim)], v, {}) for n, v in values.items()}
    zeros = ["chain", "draw"], np.zeros((2, 12)), {}
    stats = dict.fromkeys(("log_prior", "log_likelihood"), zeros)
    return StoredTest(Group(draws, {}), Group(stats, {}), posterior.trace, FACTS)


def put(value):
    def change(draws):
        draws = draws.copy()
        draws[1, 3] = value
        return draws

    return change


def test_draws_of_the_posterior_pass(posterior):
    check_draws(make(posterior), posterior, "a.nc")
    check_facts(FACTS, "a.nc")
    check_facts({k: v for k, v in FACTS.items() if k != "mode_shares"}, "a.nc")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1.0, 0.0, 1e16])
def test_a_draw_that_no_sampling_gives_is_refused(posterior, value):
    with pytest.raises(StoreError, match=r"a\.nc .* draw.* of Fc_fwd"):
        check_draws(make(posterior, Fc_fwd=put(value)), posterior, "a.nc")


@pytest.mark.parametrize(
    "how",
    [
        lambda draws: draws[:, :5],
        lambda draws: draws[:1],
        lambda draws: draws[..., None],
        lambda draws: draws.astype(np.float32),
        lambda draws: np.ones((2, 12), dtype=int),
    ],
)
def test_draws_of_another_size_or_kind_are_refused(posterior, how):
    with pytest.raises(StoreError, match=r"Fc_fwd as \(chain, draw\)"):
        check_draws(make(posterior, Fc_fwd=how), posterior, "a.nc")


def test_names_must_be_the_models(posterior):
    with pytest.raises(StoreError, match="'evil', which the model does not have"):
        check_draws(make(posterior, evil=lambda _: np.ones((2, 12))), posterior, "a.nc")
    stored = make(posterior)
    fewer = {n: v for n, v in stored.posterior.variables.items() if n != "offset"}
    short = StoredTest(Group(fewer, {}), stored.sample_stats, TRACE, FACTS)
    with pytest.raises(StoreError, match="no draws of offset"):
        check_draws(short, posterior, "a.nc")
    bare = StoredTest(stored.posterior, Group({}, {}), TRACE, FACTS)
    with pytest.raises(StoreError, match="no log_prior and log_likelihood"):
        check_draws(bare, posterior, "a.nc")


def test_draws_must_be_of_the_walkers(posterior):
    stored = make(posterior)
    other = StoredTest(stored.posterior, stored.sample_stats, TRACE, FACTS | {"walkers": 5})
    with pytest.raises(StoreError, match="5 walkers"):
        check_draws(other, posterior, "a.nc")


def test_a_test_needs_its_actuation():
    trace = Trace.from_arrays(TIME, np.sin(TIME), None, np.cos(TIME))
    posterior = Posterior(trace, "mfd", "iid", "lugre")
    with pytest.raises(StoreError, match="must be of a test with an actuation, got nan"):
        check_draws(make(posterior), posterior, "a.nc")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("walkers", 0), ("walkers", 6.0), ("modes", "2"), ("start", "guess"), ("model", [])),
        *(("autocorrelation", {}), ("autocorrelation", {"a": 0.0}), ("seed", [-1])),
        *(("convergence", {"Fc_fwd": [1.0]}), ("convergence", None), ("mode_shares", [[None]])),
    ],
)
def test_facts_of_another_kind_are_refused(key, value):
    with pytest.raises(StoreError, match=rf"a\.nc .*{key}"):
        check_facts(FACTS | {key: value}, "a.nc")


def test_shares_of_modes_must_be_as_many_for_each_chain():
    with pytest.raises(StoreError, match="mode_shares"):
        check_facts(FACTS | {"mode_shares": [[1.0], [0.5, 0.5]]}, "a.nc")


@pytest.mark.parametrize("facts", [None, [], "a", 3])
def test_facts_that_are_none_are_refused(facts):
    with pytest.raises(StoreError, match=r"a\.nc"):
        check_facts(facts, "a.nc")
