"""The tests that a report shows, and those that it leaves out, each with its reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from mfd_bayes.assessment.fits import calibrated_view, held_out_view
from mfd_bayes.assessment.views import CampaignView, Check, TestView
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.verdict import Verdict

SHOWN = "report"
"""Name of the check that fails where a test is left out of the report."""


def views_of_tests(run: Run) -> tuple[list[TestView], dict[str, str]]:
    """Views of all tests, in the order of the campaign; and why others cannot be shown.

    Raises
    ------
    StoreError
        When a stored file cannot be used: that is no fault of one test.
    """
    makers: dict[str, Callable[[], TestView]] = {
        **{name: partial(calibrated_view, run, test) for name, test in run.tests.items()},
        **{name: partial(held_out_view, run, name, t) for name, t in run.held_out.items()},
    }
    views, lost = [], {}
    for name in (name for name in run.manifest.tests if name in makers):
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused by name
                views.append(makers[name]())
        except StoreError:
            raise
        except MfdError as error:
            lost[name] = str(error)
    return views, lost


def unshown(lost: Mapping[str, str]) -> list[Check]:
    """A failed check for every test that is left out of the report."""
    return [Check(name, SHOWN, "shown", 0.0, "shown", Verdict.FAIL) for name in lost]


def with_lost(sentence: str, lost: Mapping[str, str]) -> str:
    """The verdict's sentence, with the tests that are left out and their reasons before it."""
    told = "".join(f"Test {name} is left out of the report: {lost[name]}. " for name in lost)
    return told + sentence


def is_whole(view: CampaignView) -> bool:
    """Whether a report shows every test that it could."""
    return all(check.name != SHOWN for check in view.checks)
