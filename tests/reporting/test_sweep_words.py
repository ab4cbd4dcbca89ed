"""What is told of the best actuation of a sweep."""

from __future__ import annotations

import numpy as np
import pytest

from mfd_bayes.reporting.sweep_words import sweep_sentence
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.runs.systems import SI, US
from mfd_bayes.runs.tested import Span

TESTED = (Span("stroke", "in", 1.0, 2.0), Span("actuation", "ksi", 0.5, 1.5))


def swept(best, low, high, goal="mean"):
    """A sweep of five levels between these, with the best one of them."""
    levels = np.linspace(low, high, 5)
    return Sweep(levels, "ksi", {}, "drift", goal, levels, best, (0.9 * best, best))


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
