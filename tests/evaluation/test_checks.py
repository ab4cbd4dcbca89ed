import numpy as np
import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.identifiability import (
    CONFLICT,
    Directions,
    Identifiability,
    Pair,
    Sensitivity,
)
from mfd_bayes.evaluation.checks import (
    convergence_checks,
    identifiability_checks,
    length_check,
    notes,
)
from mfd_bayes.evaluation.views import (
    CONTRACTION,
    DIRECTIONS,
    IDENTIFIABILITY,
    LIKELIHOOD_SENSITIVITY,
    PRIOR_SENSITIVITY,
    TRADE_OFFS,
    Row,
)

FOUND = Identifiability(
    directions=Directions(("k2", "d2"), np.array([80.0, 0.2]), np.array([[0.8, 0.6], [0.6, -0.8]])),
    pairs=(Pair("k2", "d2", -0.84),),
    sensitivities=(
        Sensitivity("k2", 0.01, 0.2),
        Sensitivity("d2", 0.09, 0.08, prior_limit=0.07),
    ),
)


def find(checks, name):
    return [c for c in checks if c.name == name]


def test_nothing_about_identifiability_is_a_failure():
    checks = identifiability_checks("p500", FOUND)
    assert {c.verdict for c in checks} == {"pass", "note"}
    assert {c.name for c in checks} < set(IDENTIFIABILITY)
    assert {c.subject for c in checks} == {"p500"}


def test_directions_are_counted_and_the_ends_named():
    (check,) = find(identifiability_checks("p500", FOUND), DIRECTIONS)
    assert (check.value, check.limit, check.verdict) == (1, ">= 2", "note")
    assert check.target == "of 2 (best: k2 and d2; least: d2 and k2)"


def test_pairs_that_trade_off_are_noted():
    (check,) = find(identifiability_checks("p500", FOUND), TRADE_OFFS)
    assert (check.target, check.value, check.verdict) == ("k2 and d2", -0.84, "note")
    assert check.limit == "within +-0.7"


def test_every_parameter_has_both_sensitivities():
    checks = identifiability_checks("p500", FOUND)
    prior = find(checks, PRIOR_SENSITIVITY)
    assert [c.target for c in prior] == ["k2", f"d2 ({CONFLICT})"]
    assert [(c.value, c.limit, c.verdict) for c in prior] == [
        (0.01, "<= 0.05", "pass"),
        (0.09, "<= 0.07", "note"),
    ]
    told = find(checks, LIKELIHOOD_SENSITIVITY)
    assert [(c.target, c.limit, c.verdict) for c in told] == [
        ("k2", "> 0.05", "pass"),
        ("d2", "> 0.05", "pass"),
    ]


@pytest.mark.parametrize(("contraction", "verdict"), [(0.9, "pass"), (0.2, "note")])
def test_every_contraction_is_checked(contraction, verdict):
    spread = (1.0, 0.1, 0.8, 1.0, 1.2, 1.0, 900.0, 900.0)
    rows = [
        Row("p500", "k2", "kip/in", *spread, contraction),
        Row("p500", "gamma1", "1", *spread, float("nan")),
    ]
    (check,) = notes("p500", rows, {"modes": 1})
    assert (check.name, check.target, check.verdict) == (CONTRACTION, "k2", verdict)
    (*_, modes) = notes("p500", rows, {"modes": 2})
    assert (modes.name, modes.value, modes.verdict) == ("modes found", 2, "note")


def test_an_ensemble_that_is_stuck_fails_the_verdict():
    effort = Effort(r_hat=1.01, ess=400.0, length=5.0, limit=8000)
    spread = (1.0, 0.1, 0.8, 1.0, 1.2)
    rows = [
        Row("p500", "k2", "kip/in", *spread, 1.004, 900.0, 800.0, 0.9),
        Row("p500", "k3", "kip/in", *spread, 1.31, 40.0, 30.0, 0.9),
        Row("p500", "d2", "in", *spread, np.inf, 0.0, 0.0, 0.9),
        Row("p500", "sigma1", "kip*s/in", *spread, np.nan, np.nan, np.nan, 0.0),
    ]
    verdicts = {(c.name, c.target): c.verdict for c in convergence_checks("p500", rows, effort)}
    assert [verdicts["R-hat", name] for name in ("k2", "k3", "d2")] == ["pass", "fail", "fail"]
    assert verdicts["bulk ESS", "d2"] == "fail"
    assert not any(target == "sigma1" for _, target in verdicts)
    facts = {"autocorrelation": {"k2": 10.0, "d2": None}, "steps": 500, "discarded": 100}
    check = length_check("p500", facts, effort)
    assert (check.target, check.value, check.verdict) == ("d2", 0.0, "fail")


def test_modes_are_noted_with_their_shares_of_the_draws():
    facts = {"modes": 2, "mode_shares": [[0.9, 0.1], [0.94, 0.06]]}
    (check,) = notes("p500", [], facts)
    assert check.target == "posterior (92 %, 8 % of the draws)"
    assert (check.value, check.verdict) == (2, "note")
    assert notes("p500", [], {"modes": 1, "mode_shares": [[1.0]]}) == []
