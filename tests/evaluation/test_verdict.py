"""What a test may be used for: the worst first, by test, with the likely cause."""

from types import SimpleNamespace

import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.evaluation.assessment import LOOP_ESTIMATE, MODES, Check
from mfd_bayes.evaluation.checks import GROSS, coverage_checks, feature_check
from mfd_bayes.evaluation.summary import judge, use_of, verdict_sentences
from mfd_bayes.messages import Message, join
from mfd_bayes.runs.findings import CheckStatus, Finding, Fitness
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.units import DAMPER

MANIFEST = SimpleNamespace(
    effort=Effort(r_hat=1.01, ess=400.0, length=5.0, limit=8000), axes=DAMPER
)


def missed(test, feature, observed, expected, p_value=0.0, tolerance=0.05, unit="kip"):
    difference = (expected - observed) / abs(observed)
    return feature_check(test, feature, unit, observed, expected, difference, p_value, tolerance)


def energy(test, observed, expected, p_value=0.0):
    return missed(test, "energy per cycle", observed, expected, p_value, unit="kip*in")


def band(test, half=0.5, ninety=0.9, nearly=0.95):
    shares = {"coverage_50": half, "coverage_90": ninety, "coverage_95": nearly}
    return coverage_checks({"test": test} | shares)


def sentence(checks, judged):
    return str(join(verdict_sentences(MANIFEST, checks, judged), " "))


NEGATIVE = Message("the force does negative work in the loops: its sign is swapped")
SWAPPED = Finding("t70lb", "force sign", NEGATIVE)
CHECKS = [
    energy("t70lb", -5.31, 0.299, 1.0),
    missed("t70lb", "peak force forward", 3.26, 2.6),
    missed("t25lb", "peak force forward", 3.68, 2.9, tolerance=0.15),
]
TESTS = ("t25lb", "t35lb", "t70lb", "t80lb")


def test_the_verdict_of_a_run_with_a_swapped_sign_names_the_test_and_the_sign():
    judged = judge(TESTS, CHECKS, [SWAPPED])
    assert [j.subject for j in judged][:2] == ["t70lb", "t25lb"]
    assert use_of(judged, CHECKS) == Fitness.NOT_USABLE
    text = sentence(CHECKS, judged)
    assert text.startswith(
        "Something is wrong with 1 of 4 tests. t70lb: energy per cycle -5.31 kip·in where 0.299 "
        "kip·in is expected: the force does negative work"
    )
    assert "To be used with care: 1 of 4 tests. t25lb: peak force forward 3.68 kip where" in text
    assert "The test to believe least is t70lb." in text
    metric = join(verdict_sentences(MANIFEST, CHECKS, judged), " ").to_text(SI)
    assert "peak force forward 16.4 kN where 12.9 kN is expected" in metric


def test_a_figure_is_judged_by_its_size_and_its_p_value():
    for expected, p_value, status in (
        (5.1, 0.0, CheckStatus.PASS),  # 2 % off: nobody minds, however many samples say so
        (5.5, 0.0, CheckStatus.WARNING),
        (5.0 * (1 + 0.05 * GROSS) + 0.1, 0.0, CheckStatus.FAIL),
    ):
        assert energy("a", 5.0, expected, p_value).status == status


def test_a_band_is_judged_by_too_few_inside():
    for shares, status in (
        ({"nearly": 0.53}, CheckStatus.WARNING),
        ({"half": 0.7}, CheckStatus.NOTE),
        ({"nearly": 0.3}, CheckStatus.FAIL),
        ({"nearly": 1.0}, CheckStatus.PASS),
    ):
        checks = band("a", **shares)
        assert status in {check.status for check in checks}
        (judged,) = judge(["a"], checks, [])
        assert (judged.use == Fitness.USABLE) == (status in (CheckStatus.PASS, CheckStatus.NOTE))


def check(name, feature, status, observed=1.2, expected=1.01, unit=""):
    return Check("a", name, feature, observed, expected, status, unit)


SLIP = check(LOOP_ESTIMATE, "Fc_fwd", CheckStatus.FAIL, 0.931, 0.083, "kip")
TWO = (MODES, "posterior (60 %, 40 % of the draws)")


@pytest.mark.parametrize(
    ("checks", "findings", "use", "words"),
    [
        ([energy("a", -5.31, 0.3)], [], Fitness.NOT_USABLE, "displacement is probably swapped"),
        ([], [Finding("a", "lag", Message("the force is late"))], Fitness.WITH_CARE, "is late"),
        (
            [check(*TWO, CheckStatus.WARNING, 2.0, 1.0)],
            [],
            Fitness.WITH_CARE,
            "2 different sets of",
        ),
        ([check(*TWO, CheckStatus.NOTE, 2.0, 1.0)], [], Fitness.USABLE, "explain it (60 %, 40 %"),
        ([SLIP, *band("a", nearly=0.98)], [], Fitness.NOT_USABLE, "band is usable, its parameters"),
        ([SLIP], [], Fitness.NOT_USABLE, "Fc_fwd 0.369 kN, measured 4.14 kN"),
    ],
)
def test_what_a_test_may_be_used_for_has_its_reason(checks, findings, use, words):
    (judged,) = judge(["a"], checks, findings)
    assert judged.use == use
    assert words in judged.to_text(SI)


def test_sampling_that_fell_short_is_no_fault_of_the_record_and_a_wrong_record_comes_first():
    short = check("R-hat", "k3", CheckStatus.FAIL)
    judged = judge(["a"], [short], [])
    assert not judged[0].wrong
    assert sentence([short], judged).startswith("The sampling did not reach its targets")
    short = Check("population", "R-hat", "K_c_fwd", 1.2, 1.01, CheckStatus.FAIL)
    text = sentence([*CHECKS, short], judge(TESTS, CHECKS, [SWAPPED]))
    assert "but correct what is wrong first" in text
    assert "--effort" not in text
    assert "but give a larger --effort" in sentence([short], judge(TESTS, [], []))


def test_a_test_that_was_not_calibrated_has_not_converged_and_one_not_shown_says_why():
    lost = Check("b", "calibration", "finished", 0.0, 1.0, CheckStatus.FAIL)
    assert "All 2 calibrated tests" in sentence([lost], judge(["a", "b", "c"], [lost], []))
    hidden = Check("b", "report", "shown", 0.0, 1.0, CheckStatus.FAIL)
    worst = judge(["a", "b"], [hidden], [])[0]
    assert (worst.subject, str(worst.reasons[0])) == ("b", "it could not be shown in the report")
