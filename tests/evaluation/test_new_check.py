"""A check of a test is added by one function and one line: see docs/pages/architecture.md."""

from types import SimpleNamespace

from mfd_bayes.evaluation import checks
from mfd_bayes.evaluation.checks import CheckedTest, checks_of_test
from mfd_bayes.evaluation.views import Check
from mfd_bayes.runs.verdict import Verdict


def enough_samples(found):
    """Toy: a record must have 100 samples."""
    samples = found.test.trace.samples
    return [Check(found.id, "samples", "record", samples, ">= 100", Verdict.of(samples >= 100))]


def test_a_check_that_is_registered_is_in_the_table(monkeypatch):
    monkeypatch.setattr(checks, "OF_TEST", (enough_samples,))
    test = SimpleNamespace(id="a", trace=SimpleNamespace(samples=99))
    (check,) = checks_of_test(CheckedTest(test, None, (), None, None, {}))
    assert (check.subject, check.name, check.verdict) == ("a", "samples", Verdict.FAIL)
