"""What each test and the whole run may be used for, and why: the worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.priors import SCALED
from mfd_bayes.evaluation.checks import INFORMED, SCALE_NOTE
from mfd_bayes.evaluation.views import (
    CALIBRATION,
    COVERAGE,
    FREE_EXPONENT,
    LOOP_ESTIMATE,
    MODES,
    PREDICTIVE,
    REPORT,
    SAMPLING,
    Check,
    Judgement,
    TestView,
)
from mfd_bayes.messages import Message, join
from mfd_bayes.population.design import Design
from mfd_bayes.runs.manifest import Finding, Manifest, Use, Verdict
from mfd_bayes.runs.run import Run

MILD = 3.0
"""Misfit, in tolerances, of a fault of a record that does not spoil it."""

_SPOILS, _LOST, _UNREACHED, _UNLIKE = 1000.0, 2000.0, 500.0, 100.0

_HINTS = {
    "residual rms": "the noise model is not that of the record, or the model lacks something",
    "lag-one residual correlation": "the noise model is not that of the record",
    "energy": (
        "the area of the loop is not the model's: the device changes during the test, or parts of "
        "the record differ"
    ),
    "peak force": "spikes at build-up that the model does not have, or a force that drifts",
    "force at mid-gap": "the gap is not as in the model",
    "coverage": "the bands are too narrow for this record",
}

MOST_NAMED = 4
"""Most tests that the verdict names with their reasons."""


def judge(
    tests: Iterable[str], checks: Sequence[Check], findings: Sequence[Finding]
) -> tuple[Judgement, ...]:
    """Judgement of each test from its checks and warnings, the one to believe least first.

    Misfit is counted in tolerances: 1 where the model misses a figure by as much as its tolerance.
    What is wrong with the record itself counts more than any misfit.
    """
    judged = [
        _judge(
            name, [c for c in checks if c.test == name], [f for f in findings if f.subject == name]
        )
        for name in tests
    ]
    return tuple(sorted(judged, key=lambda j: -j.misfit))


def _judge(test: str, checks: Sequence[Check], findings: Sequence[Finding]) -> Judgement:
    of_fit = [c for c in checks if c.check in (PREDICTIVE, COVERAGE)]
    missed = [c for c in of_fit if c.status in (Verdict.WARNING, Verdict.FAIL)]
    missed.sort(key=lambda check: -misfit_of(check))
    reasons: list[tuple[float, Message]] = []
    for number, finding in enumerate(sorted(findings, key=lambda f: not f.spoils)):
        message = finding.message
        if missed and number == 0 and finding.spoils and finding.name != "time unit":
            message = join([missed[0].message, message], ": ")  # no clock changes an energy
        reasons.append((_SPOILS if finding.spoils else MILD, message))
    reasons += [*_of_sampler(checks), *_of_slip(checks)]
    spoiled = any(f.spoils for f in findings)
    counted = bool(missed) and not spoiled
    if counted:
        reasons.append((misfit_of(missed[0]), _miss(missed)))
    failed = {c.check for c in checks if c.status == Verdict.FAIL}
    wrong = spoiled or bool(failed - set(SAMPLING))
    use = Use.NOT_USABLE if wrong or failed else Use.WITH_CARE if reasons else Use.USABLE
    reasons.sort(key=lambda reason: -reason[0])
    least = max(map(misfit_of, of_fit), default=0.0)
    misfit = sum(size for size, _ in reasons) if reasons else min(least, 1.0)
    if reasons and not counted:  # else the worst misfit is one of the reasons
        misfit += least
    notes = tuple(_modes(c) for c in checks if c.check == MODES and c.status == Verdict.NOTE)
    return Judgement(test, use, tuple(message for _, message in reasons), misfit, wrong, notes)


def misfit_of(check: Check) -> float:
    """Size of a miss over its tolerance; of a band, only what is missing inside."""
    size = -check.difference if check.check == COVERAGE else abs(check.difference)
    return max(float(size / check.tolerance), 0.0) if np.isfinite(check.tolerance) else 0.0


def _of_sampler(checks: Sequence[Check]) -> Iterator[tuple[float, Message]]:
    """Sampling that did not reach its targets, a test that was lost, and several modes."""
    names = {check.check for check in checks}
    if CALIBRATION in names:
        yield _LOST, Message("it could not be calibrated")
    if REPORT in names:
        yield _LOST, Message("it could not be shown in the report")
    short = [c for c in checks if c.check in SAMPLING and c.status == Verdict.FAIL]
    if short:
        more = f" and {len(short) - 1} more" if short[1:] else ""
        first = f"{short[0].check} of {short[0].feature}{more}"
        text = "the sampling did not reach its targets ({first})"
        yield _UNREACHED, Message(text, {"first": first})
    for check in checks:
        if check.check == MODES and check.status == Verdict.WARNING:
            yield MILD, _modes(check)


def _modes(check: Check) -> Message:
    held = check.feature.removeprefix("posterior")
    text = f"{check.observed:.0f} different sets of parameters explain it{{held}}"
    return Message(text, {"held": held})


def _of_slip(checks: Sequence[Check]) -> Iterator[tuple[float, Message]]:
    """Slip forces that are far from the measured ones, and whether the band is usable."""
    far = [c for c in checks if c.check == LOOP_ESTIMATE and c.status == Verdict.FAIL]
    if not far:
        return
    bands = [c for c in checks if c.check == COVERAGE]
    holds = bands and all(c.status in (Verdict.PASS, Verdict.NOTE) for c in bands)
    use = "its band is usable, its parameters are not" if holds else "do not use its parameters"
    why = Message(f"{use}: a slip force is not the measured one, the noise stands in for it")
    parts = (Message("{feature} {expected}, measured {observed}", c.message.values) for c in far)
    yield _UNLIKE, join([why, join(parts, ", ")], ": ")


def _miss(missed: Sequence[Check]) -> Message:
    """The worst miss with its likely cause, and how many others there are."""
    worst = missed[0]
    cause = next((text for name, text in _HINTS.items() if worst.feature.startswith(name)), "")
    if worst.feature.startswith("energy") and worst.observed < 0.0:
        cause = "the sign of the force or of the displacement is probably swapped"
    more = f"; {len(missed) - 1} more" if missed[1:] else ""
    sizes = f" ({abs(worst.difference):.0%} off, tolerance {worst.tolerance:.0%}): {cause}{more}"
    return join([worst.message, Message(sizes)], "")


def use_of(judged: Iterable[Judgement], checks: Iterable[Check]) -> Use:
    """What the whole run may be used for: as its worst test, check or law."""
    statuses, uses = {check.status for check in checks}, {j.use for j in judged}
    if Verdict.FAIL in statuses or Use.NOT_USABLE in uses:
        return Use.NOT_USABLE
    return Use.WITH_CARE if Verdict.WARNING in statuses or Use.WITH_CARE in uses else Use.USABLE


def verdict_sentences(
    manifest: Manifest, checks: Sequence[Check], judged: Sequence[Judgement]
) -> tuple[Message, ...]:
    """What a run may be used for, and why: a sentence each, the worst first."""
    failed = [check for check in checks if check.status == Verdict.FAIL]
    wrong = [j for j in judged if j.wrong]
    careful = [j for j in judged if j.use == Use.WITH_CARE]
    sentences = []
    for lead, some in (("Something is wrong with", wrong), ("To be used with care:", careful)):
        if some:
            tests = f"{len(judged)} test{'' if len(judged) == 1 else 's'}"
            sentences.append(Message(f"{lead} {len(some)} of {tests}."))
            for j in some[:MOST_NAMED]:
                head = Message("{test}: ", {"test": j.subject})
                sentences.append(join([head, join(j.reasons, "; "), Message(".")], ""))
            if some[MOST_NAMED:]:
                sentences.append(Message(f"And {len(some) - MOST_NAMED} more."))
    if all(j.use == Use.USABLE for j in judged):
        count = len(judged)
        which = {1: "The test is", 2: "Both tests are"}.get(count, f"All {count} tests are")
        sentences.append(Message(f"{which} reproduced within tolerance."))
    lost = {check.test for check in failed if check.check == CALIBRATION}
    advice = "correct what is wrong first" if wrong else "give a larger --effort"
    sentences.append(_of_sampling(failed, manifest.effort, len(judged) - len(lost), advice))
    if len(judged) > 1 and judged[0].use != Use.USABLE:
        worst, second = judged[:2]
        alone = "" if second.misfit < worst.misfit else " (as little as {second})"
        names = {"worst": worst.subject, "second": second.subject}
        sentences.append(Message(f"The test to believe least is {{worst}}{alone}.", names))
    bent = [c for c in checks if c.check == FREE_EXPONENT and c.status == Verdict.WARNING]
    if bent:
        what = ", ".join(f"{c.feature}: exponent {c.observed:.2f}" for c in bent)
        text = f"The proportional law is not supported ({what}, not 1): do not extrapolate with it."
        sentences.append(Message(text))
    return tuple(sentences)


def _of_sampling(failed: Sequence[Check], effort: Effort, calibrated: int, advice: str) -> Message:
    """Whether the sampling reached its targets, and what to do where it did not."""
    limits = f"R-hat <= {effort.r_hat:g}, bulk and tail ESS >= {effort.ess:g}"
    where: dict[str, list[str]] = {}
    for c in failed:
        if c.check in SAMPLING:
            where.setdefault(c.test, []).append(f"{c.check} of {c.feature}")
    if not where:
        tests = "The calibrated test" if calibrated == 1 else f"All {calibrated} calibrated tests"
        return Message(f"{tests} and the laws converged ({limits}).")
    names = ", ".join(
        f"{test} ({first}{f' and {len(more)} more' if more else ''})"
        for test, (first, *more) in sorted(where.items())
    )
    return Message(
        f"The sampling did not reach its targets ({limits}, and chains that are long enough) in "
        f"{{names}}: do not use these figures, but {advice}.",
        {"names": names},
    )


# --- remarks


def remarks(run: Run, tests: Sequence[TestView]) -> tuple[Message, ...]:
    """Sentences that a reader must know besides the verdict."""
    rows, texts = [row for view in tests for row in view.rows], []
    if run.manifest.truth:
        texts.append(
            "The tests are synthetic: they were computed from known parameters with known noise. "
            "Where a record was low-passed for the fit, the true noise of that record is not known."
        )
    if SCALED in run.priors.title:
        texts.append(
            "The scales of the priors were read off the records of this campaign: the data are "
            "used there for orders of magnitude, and once more in the calibration."
        )
    texts += [
        f"{name}: the {role} is made of {text}."
        for name, entry in run.manifest.tests.items()
        for role, text in entry.derived.items()
    ]
    if weak := _counted(row["name"] for row in rows if row["contraction"] < INFORMED):
        texts.append(f"Parameters that the data do not determine (number of tests): {weak}.")
    texts += _of_identifiability(tests)
    if apart := _counted(row["name"] for row in rows if row["disagrees"]):
        texts.append(
            "Parameters whose interval in a test alone does not overlap that in the joint "
            f"posterior of all tests, which predictions use (number of tests): {apart}."
        )
    if "gamma1" in run.model.standard_names & {row["name"] for row in rows}:
        texts.append(f"gamma1 and gamma2 are {SCALE_NOTE}; gamma1 keeps its prior.")
    left = [test.id for test in tests if test.rows and not test.noises]
    if left:
        more = f" and {len(left) - 3} more" if left[3:] else ""
        texts.append(
            f"Not fitted under another noise model: {', '.join(left[:3])}{more}. How far their "
            "parameters depend on that choice is not known. The effort standard does it; at quick, "
            "noise_check = true in [campaign] asks for it."
        )
    followed = run.population.design.dependence
    texts += [
        f"Tests that were held out are predicted better if {s.quantity} depends on {s.covariate} "
        f"(elpd {s.difference:+.1f} ± {s.se:.1f} over tests): try it under [dependence]."
        for s in run.manifest.dependence_scores
        if s.covariate
        and s.covariate not in followed.get(s.quantity, ())
        and s.difference > max(s.se, 1.0)
    ]
    texts += zero_pressure_sentences(run.population.design, run.tests)
    levels = {round(t.trace.reference_actuation, 9) for t in run.tests.values()}
    if len(levels) < 2 and run.manifest.axes.actuated:
        texts.append(
            "All calibrated tests are at one actuation: at any other actuation, predictions rest "
            "only on the form of the laws."
        )
    return tuple(Message("{text}", {"text": text}) for text in texts)


def _counted(names: Iterable[str], most: int | None = None) -> str:
    """Names with how often each is there, the most frequent first."""
    return ", ".join(f"{name} ({times})" for name, times in Counter(names).most_common(most))


def _of_identifiability(tests: Sequence[TestView]) -> list[str]:
    """How many directions the data inform, and which parameters trade off most often."""
    identified = [view.identifiability for view in tests if view.identifiability is not None]
    if not identified:
        return []
    informed = sorted({f.directions.informed for f in identified})
    span = f"{informed[0]} to {informed[-1]}" if len(informed) > 1 else f"{informed[0]}"
    texts = [
        f"The model has {len(identified[0].directions.names)} parameters for each test, but a test "
        f"determines only {span} combinations of them better than the prior does."
    ]
    pairs = [f"{pair.first} and {pair.second}" for f in identified for pair in f.pairs]
    if pairs:
        texts.append(
            "Parameters that trade off, so that their combination is known better than each of "
            f"them (number of tests): {_counted(pairs, 4)}"
            f"{', and others' if len(set(pairs)) > 4 else ''}."
        )
    return texts


def zero_pressure_sentences(design: Design, tests: Iterable[str]) -> list[str]:
    """Which laws learn nothing from the tests at zero actuation; `tests` in the design's order."""
    settings = zip(tests, design.settings, strict=False)
    zeros = ", ".join(name for name, setting in settings if setting.actuation == 0)
    columns = zip(design.names, design.informs.T, strict=True)
    left = [name for name, informs in columns if not informs.all()]
    if not zeros or not left:
        return []
    laws = ", ".join(f"{name} ({design.laws[name]})" for name in left)
    return [
        f"A law without an intercept has no value at zero actuation: from {zeros} nothing is "
        f"learned about {laws}. The laws affine and residual_power would learn from it."
    ]
