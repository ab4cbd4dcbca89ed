"""Checks of one test or of the population: what is observed, what is expected, and the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.identifiability import Directions
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import COVERAGES, Replicas, check_predictive
from mfd_bayes.campaign.schema import complete_tolerances
from mfd_bayes.evaluation.properties import EXTREME, TOLERANCE_OF, measured_properties
from mfd_bayes.evaluation.views import (
    CONTRACTION,
    COVERAGE,
    DIRECTIONS,
    FREE_EXPONENT,
    LENGTH,
    LOOP_ESTIMATE,
    MODES,
    PREDICTIVE,
    Check,
    Row,
    Rows,
)
from mfd_bayes.records.loops import MeasuredCycles
from mfd_bayes.runs.manifest import Verdict

Array = NDArray[np.float64]

INFORMED = 0.5
"""Least contraction of a parameter that the data inform."""

NOT_INFORMED = "the data do not determine this parameter: its posterior is about its prior"
"""Note of a parameter with less contraction."""

SCALE_ONLY = ("gamma1", "gamma2")
SCALE_NOTE = "not identifiable: only ℓ = γ2/γ1 reaches the force"

TELLING = 0.5
"""Width of an exponent's 95 % interval up to which it tells a law from others: it leaves the force
at twice the actuation uncertain by less than a fifth either way."""

GROSS = 5.0
"""A feature that is missed by more than this many tolerances says that something is wrong."""

FAR = 2.0
"""A slip force of the model more than this many times the measured one, or less than its inverse,
is none: the noise stands in for the friction."""

SECOND_MODE, SMALLEST_MODE = 0.1, 0.01
"""Share of the draws from which a second mode makes the parameters of a test two sets, and below
which a further mode is not spoken of."""

_FEATURES = {
    "energy_per_cycle": ("energy per cycle", "kip*in", PREDICTIVE),
    "energy_in_all": ("energy in all", "kip*in", PREDICTIVE),
    "peak_fwd": ("peak force forward", "kip", PREDICTIVE),
    "peak_bwd": ("peak force backward", "kip", PREDICTIVE),
    "slip_fwd": ("slip force forward", "kip", LOOP_ESTIMATE),
    "slip_bwd": ("slip force backward", "kip", LOOP_ESTIMATE),
    "build_up_slope": ("build-up slope", "kip/in", LOOP_ESTIMATE),
    "gap": ("gap", "in", LOOP_ESTIMATE),
}
"""Feature in words, unit, and check, by property."""


def convergence_checks(test: str, rows: Iterable[Row], effort: Effort) -> list[Check]:
    """R-hat and effective sample sizes against the effort's targets.

    A quantity that is not sampled has NaN for R-hat, and no check; an infinite R-hat fails.
    """
    checks = []
    for row in rows:
        if np.isnan(row["r_hat"]):
            continue
        good = Verdict.of(row["r_hat"] <= effort.r_hat)
        checks.append(Check(test, "R-hat", row["name"], row["r_hat"], effort.r_hat, good))
        for name, key in (("bulk ESS", "ess_bulk"), ("tail ESS", "ess_tail")):
            enough = Verdict.of(row[key] >= effort.ess)
            checks.append(Check(test, name, row["name"], row[key], effort.ess, enough))
    return checks


def length_check(test: str, facts: Mapping[str, Any], effort: Effort) -> Check:
    """Kept steps over the longest autocorrelation time, against the effort's target."""
    times = {n: np.inf if t is None else t for n, t in facts["autocorrelation"].items()}  # of JSON
    slowest, time = max(times.items(), key=lambda item: item[1])
    lengths = (facts["steps"] - facts["discarded"]) / time
    return Check(
        test, LENGTH, slowest, lengths, effort.length, Verdict.of(lengths >= effort.length)
    )


def predictive_checks(
    test: str,
    posterior: Posterior,
    replicas: Replicas,
    measured: MeasuredCycles,
    properties: Mapping[str, Array],
    tolerances: Mapping[str, float] | None = None,
) -> list[Check]:
    """Features of a record beside those of replicated records, by p-value and size together.

    Energy, peaks and what is read off the loop are measured on the record as recorded, and on
    replicated records by the same rules; `properties` are theirs, by name, (n,) each.
    """
    allowed = complete_tolerances(tolerances)
    width = posterior.model.gap_width(replicas.values)
    gap = None if width is None else float(np.median(width))
    checks = []
    for check in check_predictive(posterior, replicas, gap):
        if check.kind in ("residual", "correlation", "mid_gap"):
            feature, _, unit = check.name.partition(", ")
            sizes = check.observed, check.expected, check.size, check.p_value
            checks.append(feature_check(test, feature, unit or "1", *sizes, allowed[check.kind]))
    seen = measured_properties(measured)
    axes = posterior.model.axes
    for name, (feature, unit, check_name) in _FEATURES.items():
        if not axes.has(name):
            continue
        values, own = properties[name][np.isfinite(properties[name])], seen[name]
        if not values.size or not np.isfinite(own):
            continue
        if name == "energy_in_all" and measured.full_stroke.all() and measured.full_stroke.size:
            continue  # it says the same as the energy of a cycle
        expected = float(values.mean())
        difference = (expected - own) / max(abs(own), 1e-12)
        p_value = float(np.mean(values > own) + 0.5 * np.mean(values == own))
        tolerance = allowed[TOLERANCE_OF.get(name, "energy")]
        figures = unit, own, expected, difference, p_value, tolerance, check_name
        checks.append(feature_check(test, feature, *figures))
    return checks


def feature_check(
    test: str,
    feature: str,
    unit: str,
    observed: float,
    expected: float,
    difference: float,
    p_value: float,
    tolerance: float,
    check: str = PREDICTIVE,
) -> Check:
    """A feature of the record against the model's.

    A p-value that is not extreme passes: artificial records differ by as much. So does a size
    within the tolerance: nobody minds it. Beyond both, the figure is to be used with care, and
    beyond `GROSS` tolerances not at all; an estimate from the loop is noted.
    """
    likely = EXTREME <= p_value <= 1.0 - EXTREME
    status = Verdict.PASS if likely else _of_size(abs(difference), tolerance)
    if status == Verdict.WARNING and feature.startswith("energy") and observed < 0.0:
        status = Verdict.FAIL  # no damper makes energy
    if check == LOOP_ESTIMATE and status != Verdict.PASS:
        status = Verdict.NOTE
    figures = unit, difference, tolerance, p_value
    return Check(test, check, feature, observed, expected, status, *figures)


def coverage_checks(score: Row, tolerances: Mapping[str, float] | None = None) -> list[Check]:
    """Share of samples inside each band: too few are a fault, many only a wide band."""
    tolerance = complete_tolerances(tolerances)["coverage"]
    checks = []
    for probability in COVERAGES:
        share = score[f"coverage_{100 * probability:.0f}"]
        away = share - probability
        status, note = _of_size(-away, tolerance), ""
        if status == Verdict.PASS and away > tolerance:
            status, note = Verdict.NOTE, "the band is wider than necessary"
        feature = f"coverage of the {100 * probability:.0f} % band"
        figures = score["test"], COVERAGE, feature, share, probability, status
        checks.append(Check(*figures, difference=away, tolerance=tolerance, note=note))
    return checks


def _of_size(size: float, tolerance: float) -> Verdict:
    if size <= tolerance:
        return Verdict.PASS
    return Verdict.WARNING if size <= GROSS * tolerance else Verdict.FAIL


def slip_checks(
    test: str, posterior: Posterior, values: Mapping[str, Array], measured: MeasuredCycles
) -> list[Check]:
    """Fails where a slip force of the model is far from the measured one.

    Replicated records do not show it, for the noise stands in for the friction there.
    """
    own, offset = measured.of_test(), float(np.median(values["offset"]))
    sides = (own["slip_fwd"] - offset, own["slip_bwd"] + offset)
    checks = []
    for name, slip in zip(posterior.model.slip_forces, sides, strict=False):
        middle = float(np.median(values[name]))
        if slip > 0.0 and not slip / FAR <= middle <= FAR * slip:
            sizes = "kip", middle / slip - 1.0, FAR - 1.0
            checks.append(Check(test, LOOP_ESTIMATE, name, slip, middle, Verdict.FAIL, *sizes))
    return checks


def loop_estimates(checks: Iterable[Check], properties: Mapping[str, Array]) -> Rows:
    """What is read off the loop of a test, beside the figures of replicated records."""
    names = {feature: name for name, (feature, *_) in _FEATURES.items()}
    estimates = []
    for check in checks:
        if check.check == LOOP_ESTIMATE and check.feature in names:
            values = properties[names[check.feature]]
            low, middle, high = np.nanquantile(values, [0.025, 0.5, 0.975]).tolist()
            estimates.append(
                {"test": check.test, "name": check.feature, "unit": check.unit}
                | {"value": check.observed, "lower": low, "median": middle, "upper": high}
                | {"tolerance": check.tolerance, "missed": check.status != Verdict.PASS}
            )
    return tuple(estimates)


def notes(test: str, rows: Iterable[Row], facts: Mapping[str, Any]) -> list[Check]:
    """Checks that cannot fail: how well each parameter is informed, and several modes."""
    checks = [
        Check(
            *(test, CONTRACTION, row["name"], row["contraction"], INFORMED),
            Verdict.pass_or_note(row["contraction"] >= INFORMED),
        )
        for row in rows
        if np.isfinite(row["contraction"])
    ]
    shares = np.sort(np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0))[::-1]
    if facts["modes"] > 1 and (shares.size < 2 or shares[1] >= SMALLEST_MODE):
        second = float(shares[1]) if shares.size > 1 else 0.0
        status = Verdict.WARNING if second >= SECOND_MODE else Verdict.NOTE
        held = ", ".join(f"{100 * share:.0f} %" for share in shares if share >= SMALLEST_MODE)
        feature = f"posterior ({held} of the draws)" if held else "posterior"
        checks.append(Check(test, MODES, feature, facts["modes"], 1.0, status))
    return checks


def directions_check(test: str, directions: Directions) -> Check:
    """A check that cannot fail: the directions that the data of a test inform."""
    total, informed = len(directions.names), directions.informed
    best, least = (" and ".join(directions.carriers(at)) for at in (0, total - 1))
    feature = f"of {total} (best: {best}; least: {least})"
    status = Verdict.pass_or_note(informed >= total)
    return Check(test, DIRECTIONS, feature, informed, total, status)


def exponent_checks(exponents: Mapping[str, Iterable[float]]) -> list[Check]:
    """Whether 1 is in the 95 % interval of each proportional law's exponent, set free.

    `exponents` are its 2.5 %, 50 % and 97.5 % quantile by quantity. An interval that holds 1 but is
    wider than `TELLING` says nothing either way: it is a note.
    """
    checks = []
    for name, (low, middle, high) in exponents.items():
        holds = low <= 1.0 <= high
        status = Verdict.pass_or_note(high - low <= TELLING) if holds else Verdict.WARNING
        note = f"95 % interval {low:.2f} to {high:.2f}"
        checks.append(Check("population", FREE_EXPONENT, name, middle, 1.0, status, note=note))
    return checks
