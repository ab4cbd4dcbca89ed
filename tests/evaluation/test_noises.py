"""Where the noise decides a parameter: beside it, in the checks, the warnings and the verdict."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noise_sensitivity import quantiles_of
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.evaluation.verdict import judge
from mfd_bayes.evaluation.test_summary import (
    noise_checks,
    noise_findings,
    noise_rows,
    noise_sentence,
    unchecked,
    with_others,
)
from mfd_bayes.evaluation.views import NOISE, Row
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.runs.verdict import Use, Verdict

TIME = np.arange(0.0, 6.0, 1 / 32)
TRACE = Trace.from_arrays(TIME, np.sin(np.pi * TIME), 0.08, np.cos(np.pi * TIME))
POSTERIOR = Posterior(TRACE, "brfd", "ou")
WORDS = "k3 is 26 [23, 29] kip/in with ou, 42.2 [39, 45.6] kip/in with staged"


def draws():
    """Draws of every quantity; k3 has 26 [23, 29] kip/in."""
    middle = POSTERIOR.draw_prior(np.random.default_rng(0), 1)
    middle |= {"k3": 26.0, "d2": 0.2, "d3": 0.1, "Fc_fwd": 2.8, "Fc_bwd": 2.9}
    spread = np.quantile(np.linspace(-1, 1, 4001), np.linspace(0, 1, 2001)) / 0.95
    found = {name: float(np.ravel(at)[0]) * (1 + 0.01 * spread) for name, at in middle.items()}
    return found | {"k3": 26.0 + 3.0 * spread}


def facts(k3, noise="staged", error=""):
    """Stored facts of a fit in which all is as under the test's own noise but k3."""
    own = {row.name: (row.lower, row.median, row.upper) for row in rows({"k3": None})}
    quantities = {} if error else {n: list(b) for n, b in own.items()} | {"k3": list(k3)}
    return {"other_noises": [{"noise": noise, "quantities": quantities, "error": error}]}


def rows(more):
    own = quantiles_of(POSTERIOR, draws())
    fit = {"noise": "staged", "quantities": {n: list(b) for n, b in own.items()}, "error": ""}
    fit["quantities"] |= {k: v for k, v in more.items() if v is not None}
    return noise_rows("80lb", POSTERIOR, draws(), {"other_noises": [fit]})


MOVED = (39.0, 42.2, 45.6)


def test_what_moves_is_told_with_both_values():
    found = rows({"k3": MOVED})
    (decided,) = [row for row in found if row.decides]
    assert decided.name == "k3"
    assert noise_sentence(found) == f"{WORDS}: the noise model decides"
    metric = SI.reworded(noise_sentence(found))
    assert metric.startswith("k3 is 4.55 [4.03, 5.08] kN/mm with ou, 7.39 [6.83, 7.99] kN/mm with")
    (check,) = noise_checks("80lb", found, facts(MOVED))
    assert (check.name, check.verdict) == (NOISE, Verdict.NOTE)
    assert check.target == f"{WORDS}: the noise model decides"
    assert check.value == pytest.approx((42.2 - 26.0) / 6.0, rel=0.01)


def test_what_stays_passes_without_a_word():
    found = rows({"k3": (24.0, 27.0, 30.0)})
    assert not any(row.decides for row in found)
    assert noise_sentence(found) == ""
    (check,) = noise_checks("80lb", found, facts((24.0, 27.0, 30.0)))
    assert check.verdict == Verdict.PASS
    assert check.target == f"all {len(found)} quantities with staged"


def test_the_quantities_of_design_come_first_and_the_others_by_name():
    more = dict.fromkeys(("sigma0", "k3", "gap", "Fc_bwd", "ell"), (900.0, 950.0, 999.0))
    sentence = noise_sentence(rows(more))
    told = [part.split(" is ")[0] for part in sentence.split("; ")[:3]]
    assert told == ["Fc_bwd", "gap", "k3"]
    assert sentence.endswith("the noise model decides; also sigma0, ell")


def test_a_fit_that_failed_is_a_note_and_earlier_versions_have_none():
    (check,) = noise_checks("80lb", (), facts(MOVED, error="no prior for noise_build"))
    assert check.verdict == Verdict.NOTE
    assert check.target == "no fit with staged: no prior for noise_build"
    assert noise_rows("80lb", POSTERIOR, draws(), {}) == ()
    assert noise_checks("80lb", (), {}) == []


class View:
    """What is needed of a test's view."""

    def __init__(self, noises, rows=(1,)):
        self.id, self.noises, self.rows = "80lb", noises, rows


def test_the_verdict_notes_it_and_the_test_stays_usable():
    findings = noise_findings([View(rows({"k3": MOVED})), View(rows({}))])
    (finding,) = findings
    assert (finding.subject, finding.name, finding.stage) == ("80lb", NOISE, "results")
    (judged,) = judge(["80lb"], [], findings)
    assert judged.use == Use.USABLE
    assert judged.sentence == ""
    assert judged.notes == f"note: {WORDS}: the noise model decides"


def test_tests_that_were_not_checked_are_named():
    assert "80lb" in unchecked([View(())])
    assert unchecked([View(rows({}))]) == ""
    assert unchecked([View((), rows=())]) == ""  # predicted, not calibrated


def test_rows_of_table_one_hold_what_decides_them_alone():
    row = Row("80lb", "k3", "kip/in", *(26.0, 1.5, 23.0, 26.0, 29.0), 1.0, 900.0, 900.0, 0.9)
    (moved,) = with_others([row], rows({"k3": MOVED}))
    assert [(o.other, o.other_median) for o in moved.others] == [("staged", 42.2)]
    assert with_others([row], rows({})) == [row]
    assert with_others([replace(row, name="k2")], rows({"k3": MOVED}))[0].others == ()
