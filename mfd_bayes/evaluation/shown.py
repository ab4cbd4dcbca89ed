"""The tests that a report shows, and those that it leaves out, each with its reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.evaluation.checks import SHOWN
from mfd_bayes.evaluation.fits import calibrated_view, held_out_view, sharing_priors
from mfd_bayes.evaluation.views import CampaignView, Check, TestView
from mfd_bayes.jobs.parallel import Meanwhile, in_turn, several_processes, when_wanted
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.verdict import Verdict

Given = TypeVar("Given")


def views_of_tests(
    run: Run, jobs: int = 1, beside: Meanwhile = when_wanted
) -> tuple[list[TestView], dict[str, str]]:
    """Views of all tests, in the order of the campaign; and why others cannot be shown.

    Parameters
    ----------
    run : Run
    jobs : int
        Processes that make those of calibrated tests.
    beside : Meanwhile
        Makes those of the other tests.

    Raises
    ------
    StoreError
        When a stored file cannot be used: that is no fault of one test.
    """
    others = {
        name: beside(partial(_attempt, partial(held_out_view, run, name), trace))
        for name, trace in run.held_out.items()
    }
    found = _calibrated(run, jobs) | {name: view() for name, view in others.items()}
    names = [name for name in run.manifest.tests if name in found]
    views = [view for name in names if isinstance(view := found[name], TestView)]
    return views, {name: str(e) for name in names if isinstance(e := found[name], MfdError)}


def _calibrated(run: Run, jobs: int) -> dict[str, TestView | MfdError]:
    """View of each calibrated test, or why there is none.

    Each test is sent to a process by itself: the records of all need not be held there.
    """
    views = [partial(_attempt, partial(calibrated_view, run.manifest))] * len(run.tests)
    tests = enumerate(replace(test, extras=None) for test in run.tests.values())
    with several_processes(views, jobs) as in_processes:
        found = (in_processes or in_turn(views))(tests)
        return {
            name: sharing_priors(view) if isinstance(view, TestView) else view
            for name, view in zip(run.tests, found, strict=True)
        }


def _attempt(make: Callable[[Given], TestView], given: Given) -> TestView | MfdError:
    """A view, or why it cannot be made."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            return make(given)
    except StoreError:
        raise
    except MfdError as error:
        return error


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
