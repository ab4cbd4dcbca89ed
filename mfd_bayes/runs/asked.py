"""What a prediction asks of a run: checked, and found."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from mfd_bayes.calibration.result import TestResult
from mfd_bayes.errors import FitError
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.settings import THIS_TEST, same_level
from mfd_bayes.population.starts import Ending
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.systems import System
from mfd_bayes.runs.tested import Departure
from mfd_bayes.runs.verdict import Use


def this_test(
    tests: Collection[str], held_out: Collection[str], forecast: Forecast, name: str
) -> str:
    """Id of the calibrated test that is asked for.

    Raises
    ------
    FitError
        When the kind is another, or there is no calibrated test of this name.
    """
    if not isinstance(name, str):
        raise FitError(f"test must be text, got {name!r}")
    if forecast.kind != THIS_TEST:
        raise FitError(f"a test ({name!r}) is for the kind this_test, not for {forecast.kind}")
    known = f"one of {', '.join(tests)}"
    if not name:
        raise FitError(f"the kind this_test needs the id of a calibrated test: {known}")
    if name in held_out:
        raise FitError(f"test {name!r} was held out, so nothing is known of it alone: {known}")
    if name not in tests:
        raise FitError(f"the run has no calibrated test {name!r}: {known}")
    return name


def own_session(own: str, asked: str) -> str:
    """Session of a calibrated test, where none or the same is asked for.

    Raises
    ------
    FitError
        When another is asked for.
    """
    if asked and asked != own:
        made = f"session {own!r}" if own else "no session"
        raise FitError(
            f"session {asked!r} is for a new test: the kind this_test takes that of its test, "
            f"which was made in {made}"
        )
    return own


def check_level(test: TestResult, asked: Trace, unit: str, system: System) -> None:
    """Refuse an actuation (`unit` is ksi or kip) that is not that of the test."""
    made, wanted = test.trace.reference_actuation, asked.reference_actuation
    if np.isfinite(wanted) and not same_level(made, wanted):
        own, other = (system.words((one,), unit, 4, actuation=True) for one in (made, wanted))
        raise FitError(
            f"test {test.id!r} was made at {own}, and the kind this_test knows nothing of {other}: "
            "take the kind new_test"
        )


def check_given(test: str, after: str | Ending) -> None:
    """Refuse what a given part cannot be combined with."""
    if after:
        name = after.test if isinstance(after, Ending) else after
        raise FitError(
            f"after ({name!r}) cannot be combined with given: the given part itself shows where "
            "in its gap the device stands"
        )
    if test:
        raise FitError(
            f"given cannot be combined with a calibrated test ({test!r}): it shows one new test"
        )


def sentence_of(manifest: Manifest, system: System) -> str:
    """Sentence of the verdict in the run's own units; stored are internal ones."""
    return system.reworded(manifest.verdicts.get("sentence", ""))


def use_word(manifest: Manifest) -> str:
    """What a run may be used for, in the words of `Use`; "" where it was not judged."""
    use = manifest.verdicts.get("campaign", "")
    return Use.NOT_USABLE if use == "fail" else use  # as earlier versions wrote


def use_of_run(manifest: Manifest, system: System) -> str:
    """What a run may be used for, with the reason; "" where it is usable, or was not judged."""
    use = use_word(manifest)
    if use not in (Use.NOT_USABLE, Use.WITH_CARE):
        return ""
    return f"the run of this device is {use}: {sentence_of(manifest, system)}"


def new_session(manifest: Manifest, session: str) -> tuple[str, ...]:
    """A remark where a session is asked for that no test of the run has."""
    known = dict.fromkeys(test.session for test in manifest.settings.tests.values())
    if not session or session in known:
        return ()
    named = ", ".join(repr(name) for name in known if name)
    has = f"the run has {named}" if named else "the campaign declares no sessions"
    return (f"session {session!r} is taken for a new one, whose tests may differ: {has}",)


def remarks_of(
    left: Iterable[Departure], manifest: Manifest, system: System, *, widened: bool
) -> tuple[str, ...]:
    """Reasons to trust a prediction less: where it leaves the tested range, an unusable run.

    Bands of a new test are `widened` outside the tested range.
    """
    remarks = [departure.sentence(system, widened=widened) for departure in left]
    if use_word(manifest) == Use.NOT_USABLE:
        remarks.append(f"the run is not usable as it is: {sentence_of(manifest, system)}")
    return tuple(remarks)
