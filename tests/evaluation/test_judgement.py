"""What a test may be used for: the worst first, by test, with the likely cause."""

import numpy as np
import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.predictive import PredictiveCheck
from mfd_bayes.evaluation.checks import GROSS, predictive_check
from mfd_bayes.evaluation.verdict import judge, least_believed, use_of
from mfd_bayes.evaluation.verdict import verdict_sentence
from mfd_bayes.evaluation.views import COVERAGE, READING, Check
from mfd_bayes.messages import Message
from mfd_bayes.runs.verdict import Finding
from mfd_bayes.runs.verdict import Use, Verdict
from mfd_bayes.evaluation.judgement import least_believed
from mfd_bayes.evaluation.verdict import judge, use_of
from mfd_bayes.evaluation.sentences import verdict_sentence
from mfd_bayes.evaluation.views import COVERAGE, READING, Check
from mfd_bayes.runs.verdict import Finding, Use, Verdict

NAN = float("nan")


class Manifest:
    """What the sentence needs of a manifest."""

    effort = Effort(r_hat=1.01, ess=400.0, length=5.0, limit=8000)


def missed(test, name, kind, observed, expected, p_value=0.0, tolerances=None):
    size = (expected - observed) / abs(observed)
    found = PredictiveCheck(name, observed, expected, p_value, kind, size)
    return predictive_check(test, found, tolerances)


def band(test, probability, inside):
    name = f"coverage of the {probability:.0%} band".replace("%", " %")
    found = PredictiveCheck(name, inside, probability, 0.3, "coverage", inside - probability)
    return predictive_check(test, found)


SWAPPED = Finding(
    "t70lb",
    "force sign",
    Message(
        "the force does negative work in the loops (-5.3 kip·in a loop): the sign of the force or "
        "of the displacement is swapped"
    ),
)


def swapped_run():
    """Checks of four tests as a run gave them in which the sign of one was swapped."""
    return [
        missed("t70lb", "energy per cycle, kip·in", "energy", -5.31, 0.299, 1.0),
        missed("t70lb", "peak force forward, kip", "peak", 3.26, 2.6),
        missed("t25lb", "peak force forward, kip", "peak", 3.68, 2.9),
        missed("t35lb", "peak force forward, kip", "peak", 3.7, 3.5),
        band("t70lb", 0.5, 0.3),
        band("t80lb", 0.5, 0.7),
    ]


TESTS = ("t25lb", "t35lb", "t70lb", "t80lb")


def test_the_verdict_of_a_run_with_a_swapped_sign_names_the_test_and_the_sign():
    checks = swapped_run()
    judged = judge(TESTS, checks, [SWAPPED])
    assert [j.subject for j in judged][:2] == ["t70lb", "t25lb"]
    assert use_of(judged, checks) == Use.NOT_USABLE
    sentence = verdict_sentence(Manifest, checks, judged)
    assert sentence.startswith(
        "Something is wrong with 1 of 4 tests. t70lb: energy per cycle -5.31 kip·in where 0.299 "
        "kip·in is expected: the force does negative work"
    )
    assert "swapped" in sentence
    assert (
        "To be used with care: 1 of 4 tests. t25lb: peak force forward 3.68 kip where" in sentence
    )
    assert "The test to believe least is t70lb." in sentence


def test_negative_energy_alone_tells_of_a_swapped_sign():
    (judged,) = judge(["a"], [missed("a", "energy per cycle, kip·in", "energy", -5.31, 0.3)], [])
    assert judged.use == Use.NOT_USABLE
    assert "the sign of the force or of the displacement is probably swapped" in judged.sentence


def test_the_worst_miss_stands_first_whatever_its_p_value():
    checks = [
        missed("a", "peak force forward, kip", "peak", 3.0, 2.4, 0.0),
        missed("a", "energy per cycle, kip·in", "energy", 5.0, 5.9, 0.004),
        missed("b", "peak force forward, kip", "peak", 3.0, 2.5, 0.0),
    ]
    first, second = judge(["b", "a"], checks, [])
    assert first.subject == "a"
    assert first.sentence.startswith(
        "energy per cycle 5 kip·in where 5.9 kip·in is expected (18% off"
    )
    assert "also peak force forward" in first.sentence
    assert first.doubt > second.doubt > 1.0


@pytest.mark.parametrize(
    ("expected", "p_value", "verdict"),
    [
        (5.1, 0.0, Verdict.PASS),  # 2 % off: nobody minds, however many samples say so
        (5.5, 0.3, Verdict.PASS),  # records differ by as much
        (5.5, 0.0, Verdict.CARE),
        (5.0 * (1 + 0.05 * GROSS) + 0.1, 0.0, Verdict.FAIL),
    ],
)
def test_a_figure_is_judged_by_its_size_and_its_p_value(expected, p_value, verdict):
    check = missed("a", "energy per cycle, kip·in", "energy", 5.0, expected, p_value)
    assert check.verdict == verdict
    assert check.size == pytest.approx((expected - 5.0) / 5.0)
    assert check.tolerance == 0.05


def test_the_campaign_sets_the_tolerance():
    wide = {"energy": 0.2}
    figure = ("a", "energy per cycle, kip·in", "energy", 5.0, 5.5, 0.0)
    assert missed(*figure).verdict == Verdict.CARE
    assert missed(*figure, wide).verdict == Verdict.PASS
    assert missed(*figure, wide).tolerance == 0.2


@pytest.mark.parametrize(
    ("probability", "inside", "verdict"),
    [
        (0.95, 0.53, Verdict.CARE),  # passed before
        (0.5, 0.7, Verdict.NOTE),  # failed before
        (0.95, 0.3, Verdict.FAIL),
        (0.95, 0.9, Verdict.PASS),
        (0.95, 1.0, Verdict.PASS),
        (0.5, 0.35, Verdict.CARE),
        (0.5, 0.55, Verdict.PASS),
    ],
)
def test_a_band_is_judged_by_too_few_inside(probability, inside, verdict):
    check = band("a", probability, inside)
    assert (check.name, check.verdict) == (COVERAGE, verdict)
    assert ("wider than necessary" in check.target) == (verdict == Verdict.NOTE)
    (judged,) = judge(["a"], [check], [])
    assert (judged.use == Use.USABLE) == (verdict in (Verdict.PASS, Verdict.NOTE))


def test_a_test_without_fault_is_usable_and_the_least_believed_is_named_all_the_same():
    checks = [
        missed("a", "energy per cycle, kip·in", "energy", 5.0, 5.1),
        missed("b", "energy per cycle, kip·in", "energy", 5.0, 5.01),
    ]
    judged = judge(["b", "a"], checks, [])
    assert use_of(judged, checks) == Use.USABLE
    assert least_believed(judged) == "no test stands out; the model fits a least well"
    assert least_believed(judged[:1]) == ""
    sentence = verdict_sentence(Manifest, checks, judged)
    assert sentence.startswith("In both tests the model misses nothing by more than its tolerance.")


def test_a_mild_fault_of_a_record_asks_for_care():
    (judged,) = judge(["a"], [], [Finding("a", "lag", Message("the force is late"))])
    assert (judged.use, judged.sentence) == (Use.WITH_CARE, "the force is late")


def test_sampling_that_fell_short_is_no_fault_of_the_record():
    short = Check("a", "R-hat", "k3", 1.2, "<= 1.01", Verdict.FAIL)
    (judged,) = judge(["a"], [short], [])
    assert judged.use == Use.NOT_USABLE
    assert not judged.wrong
    sentence = verdict_sentence(Manifest, [short], [judged])
    assert "Something is wrong" not in sentence
    assert sentence.startswith("The sampling did not reach its targets")


def test_sampling_that_a_wrong_record_spoiled_asks_to_correct_the_record_first():
    short = Check("population", "R-hat", "K_c_fwd", 1.2, "<= 1.01", Verdict.FAIL)
    judged = judge(TESTS, swapped_run(), [SWAPPED])
    sentence = verdict_sentence(Manifest, [*swapped_run(), short], judged)
    assert "but correct what is wrong first" in sentence
    assert "--effort" not in sentence
    alone = verdict_sentence(Manifest, [short], judge(TESTS, [], []))
    assert "but give a larger --effort" in alone


def test_two_modes_ask_for_care_and_a_small_one_is_a_note():
    target = "posterior (60 %, 40 % of the draws)"
    (both,) = judge(["a"], [Check("a", "modes found", target, 2, "1", Verdict.CARE)], [])
    assert both.use == Use.WITH_CARE
    assert "2 different sets of parameters" in both.sentence
    (one,) = judge(["a"], [Check("a", "modes found", target, 2, "1", Verdict.NOTE)], [])
    assert one.use == Use.USABLE
    assert "60 %, 40 %" in one.notes


def test_a_parameter_off_its_reading_is_a_note():
    reading = Check("a", READING, "k3 (43 [33, 55] kip/in), read off 14", 14, "", Verdict.NOTE)
    (judged,) = judge(["a"], [reading], [])
    assert judged.use == Use.USABLE
    assert (
        judged.told
        == "note: differs from what is read off the loop: k3 (43 [33, 55] kip/in), read off 14"
    )
    assert np.isfinite(judged.doubt)


@pytest.mark.parametrize(
    ("inside", "use"),
    [(0.98, "its band is usable, its parameters are not"), (0.4, "do not use its parameters")],
)
def test_a_test_whose_slip_force_is_far_from_its_reading_has_no_usable_parameters(inside, use):
    target = "Fc_fwd (0.083 [0.06, 0.11] kip), read off 0.931 kip"
    reading = Check("a", READING, target, 0.931, "", Verdict.FAIL)
    (judged,) = judge(["a"], [reading, band("a", 0.95, inside)], [])
    assert judged.use == Use.NOT_USABLE
    assert (
        f"{use}: a slip force is far from what is read off the loop, so that the noise stands in "
        f"for friction: {target}"
    ) in judged.told


def test_the_doubt_is_by_how_many_tolerances_the_worst_figure_is_missed():
    one = missed("a", "energy per cycle, kip·in", "energy", 1.0, 1.15, 0.0)
    (judged,) = judge(["a"], [one], [])
    assert judged.doubt == pytest.approx(abs(one.size) / one.tolerance)


def test_a_test_that_was_not_calibrated_has_not_converged_and_one_not_shown_says_why():
    lost = Check("b", "calibration", "finished", 0.0, "finished", Verdict.FAIL)
    checks = [missed("a", "peak force forward, kip", "peak", 3.0, 3.0, 0.5), lost]
    sentence = verdict_sentence(Manifest(), checks, judge(["a", "b", "c"], checks, []))
    assert "ll 2 calibrated tests" in sentence or "Both calibrated tests" in sentence
    hidden = Check("b", "report", "shown", 0.0, "shown", Verdict.FAIL)
    worst = judge(["a", "b"], [hidden], [])[0]
    assert worst.subject == "b"
    assert worst.sentence == "it could not be shown in the report"
