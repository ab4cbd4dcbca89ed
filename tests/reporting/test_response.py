"""Page and tables of a response of a building, and its best actuation in words."""

import csv
import io
import json

import numpy as np
import pytest

from mfd_bayes.pipeline.respond import (
    ResponseView,
    peaks_frame,
    render_response,
    response_json,
    sweep_sentence,
)
from mfd_bayes.reporting import figures
from mfd_bayes.reporting.figures import to_png
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.response.analysis import Sweep
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SI, US
from mfd_bayes.units import GRAVITY

UNITS = ("1", "in", "in/s^2", "kip", "kip*in")
NONE = dict.fromkeys(("bare", "plain", "lower", "upper"), np.nan)
ROWS = [
    {"quantity": f"of {unit}", "ground": "g.csv", "place": "storey 1", "unit": unit}
    | {"median": 2.0, "mean": 3.0}
    | {"bands": {"50": (1.5, 2.5), "90": (1.0, 3.0), "95": (0.5, 4.0)}, **NONE, "bare": 5.0}
    for unit in UNITS
]
LIMITS = [
    {"quantity": quantity, "ground": "g.csv", "limit": limit, "unit": unit}
    | {"probability": p, "error": 0.1}
    for quantity, limit, unit, p in (("travel", 2.0, "in", 0.3), ("drift ratio", 0.01, "1", 0.2))
]


@pytest.mark.parametrize("system", [US, SI])
def test_json_and_csv_of_peaks_say_the_same_in_the_units_of_their_system(system):
    content = json.loads(response_json(ROWS, LIMITS, {"title": "t"}, system))
    table = list(csv.DictReader(io.StringIO(to_csv(peaks_frame(ROWS, system)))))
    for row, peak in zip(table, content["peaks"], strict=True):
        assert row["unit"] == peak["unit"]
        assert float(row["median"]) == pytest.approx(peak["median"], rel=1e-5)
        assert float(row["without_dampers"]) == pytest.approx(peak["bare"], rel=1e-5)
        assert peak["plain"] is None
        for share, (low, high) in peak["bands"].items():
            assert float(row[f"lower_{share}"]) == pytest.approx(low, rel=1e-5)
            assert float(row[f"upper_{share}"]) == pytest.approx(high, rel=1e-5)
    if system is SI:
        assert [row["unit"] for row in table] == ["%", "mm", "g", "kN", "kN*mm"]
        expected = [200.0, 50.8, 2.0 / GRAVITY, 8.89644, 225.97]
        assert [float(row["median"]) for row in table] == pytest.approx(expected, rel=1e-5)
        limits = [(one["limit"], one["unit"], one["probability"]) for one in content["limits"]]
        assert limits == [(50.8, "mm", 0.3), (1.0, "%", 0.2)]


ROW = ROWS[1] | {"bands": dict.fromkeys(("50", "90", "95"), (0.9, 1.1))}


def view():
    grounds = ["quake.csv", "other.csv"]
    return ResponseView("", "", "fail", "", [], [], [ROW], [], [], "", grounds, 1, True, {})


def test_a_page_of_a_response_has_both_systems_of_units():
    dot = to_png(figures.new_figure(1, 1))
    names = ("profile", "building", "history_1", "history_2", "loops_1", "loops_2")
    images = {f"{name}_{system}": dot for name in names for system in ("us", "si")}
    text = render_response(view(), images)
    assert text.count('data-system="us" hidden') == len(names)
    assert '<span data-value="0.9" data-unit="in" data-digits="3">22.9</span> to' in text
    assert "nan" not in text


TESTED = (Span("stroke", "in", 1.0, 2.0), Span("actuation", "ksi", 0.5, 1.5))


def sentence(levels, best, scores=(), goal="mean", interval=None, tested=TESTED, system=US):
    scores = np.array(scores or range(len(levels)), dtype=float)
    interval = interval or (0.9 * best, best)
    sweep = Sweep(np.array(levels), "ksi", {}, "drift", goal, scores, best, interval)
    return sweep_sentence(sweep, tested, system)


def test_what_to_do_where_the_best_level_is_at_an_end():
    upper, lower = "This is the upper end of the sweep", "This is the lower end of the sweep"
    for best, low, high, more in (
        (1.0, 0.5, 1.5, ""),
        (1.2, 0.8, 1.2, f" {upper}: sweep further."),
        (1.5, 0.8, 1.5, f" {upper} and of the tests: make a test above it before you"),
        (0.5, 0.5, 1.2, f" {lower} and of the tests: make a test below it before you"),
    ):
        ends = f"{900 * best:.4g} to {1000 * best:.4g} psi"
        told = sentence(np.linspace(low, high, 5), best)
        start = f"The mean of the largest drift is smallest at {1000 * best:.4g} psi (90 % interval"
        assert told.startswith(f"{start}: {ends}).{more}"), best
        assert bool(more) == (not told.endswith(f"{ends})."))
    told = sentence(np.linspace(0.5, 1.5, 5), 1.0, goal="passing", system=SI)
    assert told.startswith("The probability that the largest drift exceeds its limit is smallest")
    assert "6.89" in told


def test_levels_that_are_best_alike_are_no_optimum():
    wide = (Span("actuation", "ksi", 0.1, 2.0),)
    for scores, words in (
        ((0, 0, 0), "the same at all 3 levels, 500 to 1500 psi: none of them is better."),
        ((0.1, 0, 0), "smallest at 2 levels alike, 1000 to 1500 psi: none of them is better (90 %"),
        ((0, np.inf, np.inf), "smallest at 500 psi (90 % interval: 500 to 1500 psi)."),
    ):
        told = sentence([0.5, 1.0, 1.5], 0.5, scores, "passing", (0.5, 1.5), wide)
        start = "The probability that the largest drift exceeds its limit is"
        assert told.startswith(f"{start} {words}")
