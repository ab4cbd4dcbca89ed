"""Checks of one test or of the population, each with its limit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.identifiability import TRADE_OFF, Identifiability
from mfd_bayes.calibration.predictive import PredictiveCheck, Replicas, check_predictive
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.campaign.schema import complete_tolerances
from mfd_bayes.evaluation.noises import noise_checks
from mfd_bayes.evaluation.read_off import reading_check
from mfd_bayes.evaluation.views import (
    CONTRACTION,
    COVERAGE,
    DIRECTIONS,
    FREE_EXPONENT,
    LIKELIHOOD_SENSITIVITY,
    PREDICTIVE,
    PRIOR_SENSITIVITY,
    TRADE_OFFS,
    Check,
    NoiseRow,
    ReadingRow,
    Row,
)
from mfd_bayes.runs.verdict import Verdict
from mfd_bayes.store.netcdf import StoredTest

INFORMED = 0.5
"""Least contraction of a parameter that the data inform."""

NOT_INFORMED = "the data do not determine this parameter: its posterior is about its prior"
"""Note of a parameter with less contraction."""

TELLING = 0.5
"""Width of an exponent's 95 % interval up to which it tells a law from others: it leaves the force
at twice the actuation uncertain by less than a fifth either way."""

EXTREME = 0.005
"""A posterior predictive p-value nearer than this to 0 or 1 is extreme."""

GROSS = 5.0
"""A feature that is missed by more than this many tolerances says that something is wrong."""

LENGTH = "autocorrelation times kept"
CALIBRATION = "calibration"
SHOWN = "report"
MODES = "modes found"

SECOND_MODE = 0.1
"""A second mode with this share of the draws makes the parameters of a test two sets."""

SAMPLING = ("R-hat", "bulk ESS", "tail ESS", LENGTH)
"""Names of the checks that say whether the sampling can be trusted."""


def convergence_checks(subject: str, rows: Iterable[Row], effort: Effort) -> list[Check]:
    """R-hat and effective sample sizes against the effort's targets.

    A quantity that is not sampled has NaN for R-hat, and no check; an infinite R-hat fails.
    """
    checks = []
    for row in (row for row in rows if not np.isnan(row.r_hat)):
        for name, value, limit, good in (
            ("R-hat", row.r_hat, f"<= {effort.r_hat:g}", row.r_hat <= effort.r_hat),
            ("bulk ESS", row.ess_bulk, f">= {effort.ess:g}", row.ess_bulk >= effort.ess),
            ("tail ESS", row.ess_tail, f">= {effort.ess:g}", row.ess_tail >= effort.ess),
        ):
            checks.append(Check(subject, name, row.name, value, limit, Verdict.of(good)))
    return checks


def length_check(subject: str, facts: Mapping[str, Any], effort: Effort) -> Check:
    """Kept steps over the longest autocorrelation time, against the effort's target."""
    times = {n: np.inf if t is None else t for n, t in facts["autocorrelation"].items()}  # of JSON
    slowest, time = max(times.items(), key=lambda item: item[1])
    lengths = (facts["steps"] - facts["discarded"]) / time
    good = Verdict.of(lengths >= effort.length)
    return Check(subject, LENGTH, slowest, lengths, f">= {effort.length:g}", good)


def predictive_check(
    subject: str, check: PredictiveCheck, tolerances: Mapping[str, float] | None = None
) -> Check:
    """A feature of the record against the model's, judged by p-value and size together.

    A p-value that is not extreme passes: artificial records differ by as much. So does a size
    within the tolerance: nobody minds it. Beyond both, the figure is to be used with care, and
    beyond `GROSS` tolerances not at all. A band is judged by its coverage (`coverage_check`).
    """
    tolerance = complete_tolerances(tolerances).get(check.kind, np.inf)
    if check.kind == "coverage":
        return coverage_check(subject, check, tolerance)
    likely = EXTREME <= check.p_value <= 1.0 - EXTREME
    verdict = Verdict.PASS if likely else _of_size(abs(check.size), tolerance)
    if verdict == Verdict.CARE and check.kind == "energy" and check.observed < 0.0:
        verdict = Verdict.FAIL  # no damper makes energy
    seen = f"observed {check.observed:.3g}, expected {check.expected:.3g}, off by {check.size:+.2g}"
    return Check(
        subject,
        PREDICTIVE,
        f"{check.name} ({seen})",
        check.p_value,
        f"in [{EXTREME:g}, {1 - EXTREME:g}], or within its tolerance",
        verdict,
        check.size,
        tolerance,
    )


def coverage_check(subject: str, check: PredictiveCheck, tolerance: float) -> Check:
    """Share of samples inside a band: too few are a fault, many only a wide band."""
    verdict = _of_size(-check.size, tolerance)
    if verdict == Verdict.PASS and check.size > tolerance:
        verdict = Verdict.NOTE
    seen = f"observed {check.observed:.3g}, {check.size:+.2g} from the band's probability"
    wide = "; the band is wider than necessary" if verdict == Verdict.NOTE else ""
    return Check(
        subject,
        COVERAGE,
        f"{check.name} ({seen}{wide})",
        check.observed,
        "not below the band's probability by more than its tolerance",
        verdict,
        check.size,
        tolerance,
    )


def _of_size(size: float, tolerance: float) -> Verdict:
    if size <= tolerance:
        return Verdict.PASS
    return Verdict.CARE if size <= GROSS * tolerance else Verdict.FAIL


def notes(subject: str, rows: Iterable[Row], facts: Mapping[str, Any]) -> list[Check]:
    """Checks that cannot fail: how well each parameter is informed, and several modes.

    A second mode with `SECOND_MODE` of the draws is to be used with care.
    """
    found = []
    for row in (row for row in rows if np.isfinite(row.contraction)):
        verdict = Verdict.noted(row.contraction >= INFORMED)
        limit = f">= {INFORMED:g}"
        found.append(Check(subject, CONTRACTION, row.name, row.contraction, limit, verdict))
    if facts["modes"] > 1:
        shares = np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0)
        ranked = sorted(shares)[::-1]
        held = ", ".join(f"{100 * share:.0f} %" for share in ranked if share >= 0.005)
        target = f"posterior ({held} of the draws)" if held else "posterior"
        two = len(ranked) > 1 and ranked[1] >= SECOND_MODE
        verdict = Verdict.CARE if two else Verdict.NOTE
        found.append(Check(subject, MODES, target, facts["modes"], "1", verdict))
    return found


def identifiability_checks(subject: str, found: Identifiability) -> list[Check]:
    """Checks that cannot fail: directions informed, trade-offs and sensitivities of a test."""
    directions = found.directions
    total = len(directions.names)
    best, least = (" and ".join(directions.carriers(at)) for at in (0, total - 1))
    target = f"of {total} (best: {best}; least: {least})"
    informed = directions.informed
    verdict = Verdict.noted(informed >= total)
    checks = [Check(subject, DIRECTIONS, target, informed, f">= {total}", verdict)]
    for pair in found.pairs:
        target = f"{pair.first} and {pair.second}"
        limit = f"within +-{TRADE_OFF:g}"
        checks.append(Check(subject, TRADE_OFFS, target, pair.correlation, limit, Verdict.NOTE))
    for s in found.sensitivities:
        target = f"{s.name} ({s.diagnosis})" if s.diagnosis else s.name
        limit, verdict = f"<= {s.prior_limit:.2g}", Verdict.noted(not s.prior > s.prior_limit)
        checks.append(Check(subject, PRIOR_SENSITIVITY, target, s.prior, limit, verdict))
        limit = f"> {s.likelihood_limit:.2g}"
        verdict = Verdict.noted(s.likelihood > s.likelihood_limit)
        name = LIKELIHOOD_SENSITIVITY
        checks.append(Check(subject, name, s.name, s.likelihood, limit, verdict))
    return checks


def exponent_checks(exponents: Mapping[str, Iterable[float]]) -> list[Check]:
    """Whether 1 is in the 95 % interval of each proportional law's exponent, set free.

    An interval that holds 1 but is wider than `TELLING` says nothing either way: it is a note.

    Parameters
    ----------
    exponents : mapping of str to iterable of float
        2.5 %, 50 % and 97.5 % quantile by quantity.
    """
    checks, limit = [], f"interval holds 1, no wider than {TELLING:g}"
    for name, (low, middle, high) in exponents.items():
        verdict = Verdict.noted(high - low <= TELLING) if low <= 1.0 <= high else Verdict.CARE
        target = f"{name} (95 % interval {low:.2f} to {high:.2f})"
        checks.append(Check("population", FREE_EXPONENT, target, middle, limit, verdict))
    return checks


@dataclass(frozen=True, eq=False)
class CheckedTest:
    """A calibrated test with everything that its checks need.

    Attributes
    ----------
    stored : StoredTest
        What the test has stored, read once.
    rows : sequence of Row
        Parameters with their convergence.
    replicas : Replicas
        Artificial records that the posterior predicts.
    effort : Effort
        Targets of the sampling.
    tolerances : mapping of str to float, optional
        Those that the campaign gives.
    readings : tuple of ReadingRow
    noises : tuple of NoiseRow
    """

    test: TestResult
    stored: StoredTest
    rows: Sequence[Row]
    replicas: Replicas
    known: Identifiability
    effort: Effort
    tolerances: Mapping[str, float] | None = None
    readings: tuple[ReadingRow, ...] = ()
    noises: tuple[NoiseRow, ...] = ()

    @property
    def id(self) -> str:
        """Id of the test."""
        return self.test.id


def _convergence(found: CheckedTest) -> list[Check]:
    return convergence_checks(found.id, found.rows, found.effort)


def _length(found: CheckedTest) -> list[Check]:
    return [length_check(found.id, found.stored.facts, found.effort)]


def _predictive(found: CheckedTest) -> list[Check]:
    posterior, values = found.test.posterior, found.stored.values()
    crossing = posterior.model.crossing(values)
    gap = None if crossing is None else float(np.median(crossing))
    checks = check_predictive(posterior, found.replicas, gap)
    return [predictive_check(found.id, check, found.tolerances) for check in checks]


def _readings(found: CheckedTest) -> list[Check]:
    return [reading_check(row) for row in found.readings]


def _noises(found: CheckedTest) -> list[Check]:
    return noise_checks(found.id, found.noises, found.stored.facts)


def _notes(found: CheckedTest) -> list[Check]:
    return notes(found.id, found.rows, found.stored.facts)


def _identifiability(found: CheckedTest) -> list[Check]:
    return identifiability_checks(found.id, found.known)


OF_TEST: tuple[Callable[[CheckedTest], Iterable[Check]], ...] = (
    _convergence,
    _length,
    _predictive,
    _readings,
    _noises,
    _notes,
    _identifiability,
)
"""The checks of a calibrated test, in the order of the table."""


def checks_of_test(found: CheckedTest) -> tuple[Check, ...]:
    """All checks of a calibrated test."""
    return tuple(check for make in OF_TEST for check in make(found))
