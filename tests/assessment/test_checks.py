import numpy as np
import pytest

from mfd_bayes.assessment.checks import identifiability_checks, notes
from mfd_bayes.calibration.identifiability import (
    CONFLICT,
    Directions,
    Identifiability,
    Pair,
    Sensitivity,
)
from mfd_bayes.reporting.views import (
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
def test_every_contraction_is_told(contraction, verdict):
    spread = (1.0, 0.1, 0.8, 1.0, 1.2, 1.0, 900.0, 900.0)
    rows = [
        Row("p500", "k2", "kip/in", *spread, contraction),
        Row("p500", "gamma1", "1", *spread, float("nan")),
    ]
    (check,) = notes("p500", rows, {"modes": 1})
    assert (check.name, check.target, check.verdict) == (CONTRACTION, "k2", verdict)
    (*_, modes) = notes("p500", rows, {"modes": 2})
    assert (modes.name, modes.value, modes.verdict) == ("modes found", 2, "note")
