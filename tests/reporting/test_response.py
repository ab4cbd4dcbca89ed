"""Page and tables of a response of a building, and its best actuation in words."""

import numpy as np

from mfd_bayes.applications.buildings.command import ResponseView, render_response, sweep_sentence
from mfd_bayes.applications.buildings.response import Sweep
from mfd_bayes.reporting import figures
from mfd_bayes.reporting.figures import to_png
from mfd_bayes.runs.tested_range import Range
from mfd_bayes.runs.unit_system import SI, US


def test_a_page_of_a_response_has_both_systems_of_units():
    row = {"quantity": "of in", "ground": "g.csv", "place": "storey 1", "unit": "in"}
    row |= {"median": 2.0, "mean": 3.0} | dict.fromkeys(("plain", "lower", "upper"), np.nan)
    row |= {"bare": 5.0, "bands": dict.fromkeys(("50", "90", "95"), (0.9, 1.1))}
    grounds = ["quake.csv", "other.csv"]
    view = ResponseView("", "", "fail", "", [], [], [row], [], [], "", grounds, 1, True, {})
    dot = to_png(figures.new_figure(1, 1))
    names = ("profile", "building", "history_1", "history_2", "loops_1", "loops_2")
    images = {f"{name}_{system}": dot for name in names for system in ("us", "si")}
    text = render_response(view, images)
    assert text.count('data-system="us" hidden') == len(names)
    assert '<span data-value="0.9" data-unit="in" data-digits="3">22.9</span> to' in text
    assert "nan" not in text


TESTED = (Range("stroke", "in", 1.0, 2.0), Range("actuation", "ksi", 0.5, 1.5))


def sentence(levels, best, scores=(), goal="mean", interval=None, tested=TESTED, system=US):
    scores = np.array(scores or range(len(levels)), dtype=float)
    interval = interval or (0.9 * best, best)
    sweep = Sweep(np.array(levels), "ksi", {}, "drift", goal, scores, best, interval)
    return sweep_sentence(sweep, tested, system)


def test_what_to_do_where_the_best_level_is_at_an_end():
    upper, lower = "This is the upper end of the sweep", "This is the lower end of the sweep"
    for best, low, high, advice in (
        (1.0, 0.5, 1.5, ""),
        (1.2, 0.8, 1.2, f" {upper}: sweep further."),
        (1.5, 0.8, 1.5, f" {upper} and of the tests: make a test above it before you"),
        (0.5, 0.5, 1.2, f" {lower} and of the tests: make a test below it before you"),
    ):
        ends = f"{900 * best:.4g} to {1000 * best:.4g} psi"
        text = sentence(np.linspace(low, high, 5), best)
        start = f"The mean of the largest drift is smallest at {1000 * best:.4g} psi (90 % interval"
        assert text.startswith(f"{start}: {ends}).{advice}"), best
        assert bool(advice) == (not text.endswith(f"{ends})."))
    text = sentence(np.linspace(0.5, 1.5, 5), 1.0, goal="passing", system=SI)
    assert text.startswith("The probability that the largest drift exceeds its limit is smallest")
    assert "6.89" in text


def test_levels_that_are_best_alike_are_no_optimum():
    wide = (Range("actuation", "ksi", 0.1, 2.0),)
    for scores, words in (
        ((0, 0, 0), "the same at all 3 levels, 500 to 1500 psi: none of them is better."),
        ((0.1, 0, 0), "smallest at 2 levels alike, 1000 to 1500 psi: none of them is better (90 %"),
        ((0, np.inf, np.inf), "smallest at 500 psi (90 % interval: 500 to 1500 psi)."),
    ):
        text = sentence([0.5, 1.0, 1.5], 0.5, scores, "passing", (0.5, 1.5), wide)
        start = "The probability that the largest drift exceeds its limit is"
        assert text.startswith(f"{start} {words}")
