"""The verdict of a run with its reason, and the remarks, in sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.prior_files import SCALED
from mfd_bayes.evaluation.checks import CALIBRATION, INFORMED, SAMPLING
from mfd_bayes.evaluation.fits import SCALE_NOTE
from mfd_bayes.evaluation.judgement import least_believed
from mfd_bayes.evaluation.noises import unchecked
from mfd_bayes.evaluation.views import FREE_EXPONENT, Check, Judgement, TestView
from mfd_bayes.evaluation.zeros import zero_sentences
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.verdict import Use, Verdict

NAMED = 4
"""Most tests that the verdict names with their reasons."""


def verdict_sentence(
    manifest: Manifest, checks: Sequence[Check], judged: Sequence[Judgement]
) -> str:
    """What a run may be used for, and why: by test, the worst first."""
    failed = [check for check in checks if check.verdict == Verdict.FAIL]
    wrong = [j for j in judged if j.wrong]
    careful = [j for j in judged if j.use == Use.WITH_CARE]
    parts = []
    if wrong:
        parts.append(_named(f"something is wrong with {_of(wrong, judged)}", wrong))
    if careful:
        parts.append(_named(f"to be used with care: {_of(careful, judged)}", careful))
    if all(j.use == Use.USABLE for j in judged):
        parts.append(_nothing_missed(len(judged)))
    advice = "correct what is wrong first" if wrong else "give a larger --effort"
    lost = {check.subject for check in failed if check.name == CALIBRATION}
    parts.append(_of_sampling(failed, manifest.effort, len(judged) - len(lost), advice))
    if least := least_believed(judged):
        parts.append(least)
    bent = [c for c in checks if c.name == FREE_EXPONENT and c.verdict == Verdict.CARE]
    if bent:
        what = ", ".join(f"{_subject_of(c)}: exponent {c.value:.2f}" for c in bent)
        parts.append(
            f"the proportional law is not supported ({what}, not 1): do not extrapolate with it"
        )
    sentences = (text[0].upper() + text[1:] for text in parts)
    return ". ".join(text.rstrip(".") for text in sentences) + "."


def _of(some: Sequence[Judgement], judged: Sequence[Judgement]) -> str:
    return f"{len(some)} of {_tests(len(judged))}"


def _nothing_missed(count: int) -> str:
    where = {1: "the one test", 2: "both tests"}.get(count, f"all {count} tests")
    return f"in {where} the model misses nothing by more than its tolerance"


def _tests(count: int) -> str:
    return f"{count} test{'' if count == 1 else 's'}"


def _named(lead: str, judged: Sequence[Judgement]) -> str:
    """Tests with their reasons, and how many more there are."""
    told = [f"{j.subject}: {j.sentence.rstrip('.')}" for j in judged[:NAMED]]
    more = [f"And {len(judged) - NAMED} more"] if judged[NAMED:] else []
    return ". ".join([lead, *told, *more])


def _subject_of(check: Check) -> str:
    """Target of a check without the figures in brackets."""
    return check.target.split(" (")[0]


def _of_sampling(failed: Sequence[Check], effort: Effort, calibrated: int, advice: str) -> str:
    """Whether the sampling reached its targets, and what to do where it did not."""
    limits = f"R-hat <= {effort.r_hat:g}, bulk and tail ESS >= {effort.ess:g}"
    where: dict[str, list[str]] = {}
    for c in failed:
        if c.name in SAMPLING:
            where.setdefault(c.subject, []).append(f"{c.name} of {c.target}")
    if not where:
        tests = "the calibrated test" if calibrated == 1 else f"all {calibrated} calibrated tests"
        return f"{tests} and the laws converged ({limits})"
    told = (
        f"{subject} ({names[0]}{f' and {len(names) - 1} more' if names[1:] else ''})"
        for subject, names in sorted(where.items())
    )
    return (
        f"the sampling did not reach its targets ({limits}, and chains that are long enough) in "
        f"{', '.join(told)}: do not use these figures, but {advice}"
    )


def _counted(names: Iterable[str], most: int | None = None) -> str:
    """Names with how often each is there, the most frequent first."""
    return ", ".join(f"{name} ({times})" for name, times in Counter(names).most_common(most))


def remarks(run: Run, tests: Sequence[TestView]) -> tuple[str, ...]:
    """Sentences that a reader must know besides the verdict."""
    found = []
    if run.manifest.truth:
        found.append(
            "The tests are synthetic: they were computed from known parameters with known noise. "
            "Where a record was low-passed for the fit, the true noise of that record is not known."
        )
    if SCALED in run.priors.title:
        found.append(
            "The scales of the priors were read off the records of this campaign: the data are "
            "used there for orders of magnitude, and once more in the calibration."
        )
    found += [
        f"{name}: the {role} is made of {text}."
        for name, entry in run.manifest.tests.items()
        for role, text in entry.derived.items()
    ]
    weak = _counted(r.name for view in tests for r in view.rows if r.contraction < INFORMED)
    if weak:
        found.append(f"Parameters that the data do not determine (number of tests): {weak}.")
    found += _of_identifiability(tests)
    if any(r.name == "gamma1" for view in tests for r in view.rows):
        found.append(f"gamma1 and gamma2 are {SCALE_NOTE}; gamma1 keeps its prior.")
    if words := unchecked(tests):
        found.append(words)
    found += _of_dependence(run)
    found += zero_sentences(run.population.design, run.tests)
    if len({round(t.trace.reference_actuation, 9) for t in run.tests.values()}) < 2:
        found.append(
            "All calibrated tests are at one actuation: at any other actuation, predictions rest "
            "only on the form of the laws."
        )
    return tuple(found)


def _of_dependence(run: Run) -> list[str]:
    """Quantities that predict tests left out better if they followed speed or stroke."""
    asked = run.population.design.dependence
    found = []
    for score in run.manifest.dependence_scores:
        name, covariate, gain = score.quantity, score.covariate, score.difference
        if covariate and covariate not in asked.get(name, ()) and gain > max(score.se, 1.0):
            found.append(
                f"Tests that were left out are predicted better if {name} depends on {covariate} "
                f"(elpd {gain:+.1f} ± {score.se:.1f} over tests): try it under [dependence]."
            )
    return found


def _of_identifiability(tests: Sequence[TestView]) -> list[str]:
    """How many directions the data inform, and which parameters trade off most often."""
    known = [view.identifiability for view in tests if view.identifiability is not None]
    if not known:
        return []
    informed = sorted({f.directions.informed for f in known})
    span = f"{informed[0]} to {informed[-1]}" if len(informed) > 1 else f"{informed[0]}"
    total = len(known[0].directions.names)
    found = [
        f"The model has {total} parameters for each test, but a test determines only {span} "
        "combinations of them better than the prior does."
    ]
    pairs = [f"{pair.first} and {pair.second}" for f in known for pair in f.pairs]
    if pairs:
        found.append(
            "Parameters that trade off, so that their combination is known better than each of "
            f"them (number of tests): {_counted(pairs, 4)}"
            f"{', and others' if len(set(pairs)) > 4 else ''}."
        )
    return found
