"""What is told of the best actuation of a sweep."""

from __future__ import annotations

import numpy as np
import pytest

from mfd_bayes.reporting.sweep_words import sweep_sentence
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SI, US

TESTED = (Span("stroke", "in", 1.0, 2.0), Span("actuation", "ksi", 0.5, 1.5))


def swept(best, low, high, goal="mean"):
    """A sweep of five levels between these, with the best one of them."""
    levels = np.linspace(low, high, 5)
    scores = np.arange(5.0)
    return Sweep(levels, "ksi", {}, "drift", goal, scores, best, (0.9 * best, best))


@pytest.mark.parametrize(
    ("best", "low", "high", "more"),
    [
        (1.0, 0.5, 1.5, ""),
        (1.2, 0.8, 1.2, " This is the upper end of the sweep: sweep further."),
        (0.8, 0.8, 1.2, " This is the lower end of the sweep: sweep further."),
        (
            1.5,
            0.8,
            1.5,
            " This is the upper end of the sweep and of the tests: make a test above it before you "
            "sweep further.",
        ),
        (
            0.5,
            0.5,
            1.2,
            " This is the lower end of the sweep and of the tests: make a test below it before you "
            "sweep further.",
        ),
        (
            1.8,
            0.8,
            2.0,
            " No test was made there (tests: 500 to 1500 psi): make one before you use this "
            "actuation.",
        ),
    ],
)
def test_what_to_do_where_the_best_level_is_at_an_end(best, low, high, more):
    told = sweep_sentence(swept(best, low, high), TESTED, US)
    ends = f"{900 * best:.4g} to {1000 * best:.4g} psi"
    assert told == (
        f"The mean of the largest drift is smallest at {1000 * best:.4g} psi (90 % interval: "
        f"{ends}).{more}"
    )


def test_the_goal_and_the_system_of_units_are_told():
    told = sweep_sentence(swept(1.0, 0.5, 1.5, "passing"), TESTED, SI)
    assert told.startswith(
        "The probability that the largest drift exceeds its limit is smallest at"
    )
    assert "6890 kPa" in told or "6.89 MPa" in told


@pytest.mark.parametrize(
    ("scores", "words"),
    [
        ((0, 0, 0), "is the same at all 3 levels, 500 to 1500 psi: none of them is better."),
        (
            (0.1, 0, 0),
            "is smallest at 2 levels alike, 1000 to 1500 psi: none of them is better (90 % "
            "interval: 500 to 1500 psi).",
        ),
        ((0, 0, np.inf), "is the same at all 2 levels, 500 to 1000 psi: none of them is better."),
        ((0, np.inf, np.inf), "is smallest at 500 psi (90 % interval: 500 to 1500 psi)."),
    ],
)
def test_levels_that_are_best_alike_are_no_optimum(scores, words):
    levels, scores = np.array([0.5, 1.0, 1.5]), np.array(scores, dtype=float)
    sweep = Sweep(levels, "ksi", {}, "drift", "passing", scores, 0.5, (0.5, 1.5))
    told = sweep_sentence(sweep, (Span("actuation", "ksi", 0.1, 2.0),), US)
    assert told.startswith(f"The probability that the largest drift exceeds its limit {words}")


def test_levels_that_are_best_alike_and_were_not_tested_are_told():
    levels, scores = np.array([0.5, 1.0, 1.5]), np.array([0.1, 0.0, 0.0])
    sweep = Sweep(levels, "ksi", {}, "drift", "passing", scores, np.nan, (1.0, 1.5))
    told = sweep_sentence(sweep, (Span("actuation", "ksi", 0.5, 1.2),), US)
    assert told.endswith(
        "No test was made there (tests: 500 to 1200 psi): make one before you use this actuation."
    )
