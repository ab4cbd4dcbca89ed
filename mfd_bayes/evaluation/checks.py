"""Checks of one test or of the population, and tests that differ from the others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import COVERAGES, Directions, Replicas, check_predictive
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import units
from mfd_bayes.campaign.schema import complete_tolerances
from mfd_bayes.evaluation.assessment import (
    CONTRACTION,
    COVERAGE,
    DIRECTIONS,
    FREE_EXPONENT,
    LENGTH,
    LOOP_ESTIMATE,
    MODES,
    PREDICTIVE,
    SCATTER,
    Check,
)
from mfd_bayes.evaluation.properties import EXTREME, share_above
from mfd_bayes.evaluation.scores import Row, Rows
from mfd_bayes.evaluation.views import INFORMED
from mfd_bayes.messages import Measure, Message
from mfd_bayes.population.bands import PredictionOptions
from mfd_bayes.population.design import TestConditions
from mfd_bayes.records.cycles import PROPERTIES, TOLERANCES, MeasuredCycles
from mfd_bayes.runs.findings import CheckStatus, Finding
from mfd_bayes.runs.run import Run, sequence_of

Array = NDArray[np.float64]


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
    quantity.feature: quantity
    for kind in TOLERANCES
    for quantity in PROPERTIES.values()
    if quantity.tolerance == kind
}
"""Property by its words as a feature."""


def convergence_checks(test: str, rows: Iterable[Row], effort: Effort) -> list[Check]:
    """R-hat and effective sample sizes against the effort's targets.

    A quantity that is not sampled has NaN for R-hat, and no check; an infinite R-hat fails. A row
    may say which share of the target is enough for its tail.
    """
    checks = []
    for row in rows:
        if np.isnan(row["r_hat"]):
            continue
        verdict = CheckStatus.of(row["r_hat"] <= effort.r_hat)
        checks.append(Check(test, "R-hat", row["name"], row["r_hat"], effort.r_hat, verdict))
        tail = effort.ess * row.get("tail_share", 1.0)
        for name, key, ess in (
            ("bulk ESS", "ess_bulk", effort.ess),
            ("tail ESS", "ess_tail", tail),
        ):
            enough = CheckStatus.of(row[key] >= ess)
            checks.append(Check(test, name, row["name"], row[key], ess, enough))
    return checks


def length_check(test: str, facts: Mapping[str, Any], effort: Effort) -> Check:
    """Kept steps over the longest autocorrelation time, against the effort's target."""
    times = {n: np.inf if t is None else t for n, t in facts["autocorrelation"].items()}  # of JSON
    slowest, time = max(times.items(), key=lambda item: item[1])
    lengths = (facts["steps"] - facts["discarded"]) / time
    return Check(
        test, LENGTH, slowest, lengths, effort.length, CheckStatus.of(lengths >= effort.length)
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
    width = posterior.model.slip_to_slip(replicas.values)
    gap = None if width is None else float(np.median(width))
    checks = []
    for check in check_predictive(posterior, replicas, gap):
        feature, _, unit = check.name.partition(", ")
        sizes = check.observed, check.expected, check.size, check.p_value
        checks.append(feature_check(test, feature, unit or "1", *sizes, allowed[check.kind]))
    observed = measured.of_test()
    for feature, quantity in _FEATURES.items():
        name = quantity.name
        if not quantity.applies(posterior.model.axes):
            continue
        values, value = properties[name][np.isfinite(properties[name])], observed[name]
        if not values.size or not np.isfinite(value):
            continue
        if name == "total_energy" and measured.full_stroke.all() and measured.full_stroke.size:
            continue  # it says the same as the energy of a cycle
        expected = float(values.mean())
        difference = (expected - value) / max(abs(value), 1e-12)
        tolerance, p_value = allowed[quantity.tolerance], share_above(values, value)
        figures = quantity.unit, value, expected, difference, p_value, tolerance
        check_name = LOOP_ESTIMATE if quantity.estimate else PREDICTIVE
        checks.append(feature_check(test, feature, *figures, check_name))
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
    status = CheckStatus.PASS if likely else _of_size(abs(difference), tolerance)
    if status == CheckStatus.WARNING and feature.startswith("energy") and observed < 0.0:
        status = CheckStatus.FAIL  # no damper makes energy
    if check == LOOP_ESTIMATE and status != CheckStatus.PASS:
        status = CheckStatus.NOTE
    figures = unit, difference, tolerance, p_value
    return Check(test, check, feature, observed, expected, status, *figures)


def coverage_checks(score: Row, tolerances: Mapping[str, float] | None = None) -> list[Check]:
    """Share of samples inside each band: too few are a fault, many only a wide band."""
    tolerance = complete_tolerances(tolerances)["coverage"]
    checks = []
    for probability in COVERAGES:
        share = score[f"coverage_{100 * probability:.0f}"]
        difference = share - probability
        status, note = _of_size(-difference, tolerance), ""
        if status == CheckStatus.PASS and difference > tolerance:
            status, note = CheckStatus.NOTE, "the band is wider than necessary"
        feature = f"coverage of the {100 * probability:.0f} % band"
        figures = score["test"], COVERAGE, feature, share, probability, status
        checks.append(Check(*figures, difference=difference, tolerance=tolerance, note=note))
    return checks


def _of_size(size: float, tolerance: float) -> CheckStatus:
    if size <= tolerance:
        return CheckStatus.PASS
    return CheckStatus.WARNING if size <= GROSS * tolerance else CheckStatus.FAIL


def slip_checks(
    test: str, posterior: Posterior, values: Mapping[str, Array], measured: MeasuredCycles
) -> list[Check]:
    """Fails where a slip force of the model is far from the measured one.

    Replicated records do not show it, for the noise stands in for the friction there.
    """
    estimates, offset = measured.of_test(), float(np.median(values["offset"]))
    sides = (estimates["slip_fwd"] - offset, estimates["slip_bwd"] + offset)
    checks = []
    for name, slip in zip(posterior.model.slip_forces, sides, strict=False):
        middle = float(np.median(values[name]))
        if slip > 0.0 and not slip / FAR <= middle <= FAR * slip:
            sizes = "kip", middle / slip - 1.0, FAR - 1.0
            checks.append(Check(test, LOOP_ESTIMATE, name, slip, middle, CheckStatus.FAIL, *sizes))
    return checks


def loop_estimates(checks: Iterable[Check], properties: Mapping[str, Array]) -> Rows:
    """What is read off the loop of a test, beside the figures of replicated records."""
    estimates = []
    for check in checks:
        if check.check == LOOP_ESTIMATE and check.feature in _FEATURES:
            values = properties[_FEATURES[check.feature].name]
            low, middle, high = np.nanquantile(values, [0.025, 0.5, 0.975]).tolist()
            estimates.append(
                {"test": check.test, "name": check.feature, "unit": check.unit}
                | {"value": check.observed, "lower": low, "median": middle, "upper": high}
                | {"tolerance": check.tolerance, "missed": check.status != CheckStatus.PASS}
            )
    return tuple(estimates)


def notes(test: str, rows: Iterable[Row], facts: Mapping[str, Any]) -> list[Check]:
    """Checks that cannot fail: how well each parameter is informed, and several modes."""
    checks = [
        Check(
            *(test, CONTRACTION, row["name"], row["contraction"], INFORMED),
            CheckStatus.pass_or_note(row["contraction"] >= INFORMED),
        )
        for row in rows
        if np.isfinite(row["contraction"])
    ]
    shares = np.sort(np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0))[::-1]
    if facts["modes"] > 1 and (shares.size < 2 or shares[1] >= SMALLEST_MODE):
        second = float(shares[1]) if shares.size > 1 else 0.0
        status = CheckStatus.WARNING if second >= SECOND_MODE else CheckStatus.NOTE
        shares_text = ", ".join(
            f"{100 * share:.0f} %" for share in shares if share >= SMALLEST_MODE
        )
        feature = f"posterior ({shares_text} of the draws)" if shares_text else "posterior"
        checks.append(Check(test, MODES, feature, facts["modes"], 1.0, status))
    return checks


def directions_check(test: str, directions: Directions) -> Check:
    """A check that cannot fail: the directions that the data of a test inform."""
    total, informed = len(directions.names), directions.informed
    best, worst = (" and ".join(directions.carriers(index)) for index in (0, total - 1))
    feature = f"of {total} (best: {best}; least: {worst})"
    status = CheckStatus.pass_or_note(informed >= total)
    return Check(test, DIRECTIONS, feature, informed, total, status)


def exponent_checks(exponents: Mapping[str, Iterable[float]]) -> list[Check]:
    """Whether 1 is in the 95 % interval of each proportional law's exponent, set free.

    `exponents` are its 2.5 %, 50 % and 97.5 % quantile by quantity. An interval that holds 1 but is
    wider than `TELLING` says nothing either way: it is a note.
    """
    checks = []
    for name, (low, middle, high) in exponents.items():
        holds = low <= 1.0 <= high
        status = CheckStatus.pass_or_note(high - low <= TELLING) if holds else CheckStatus.WARNING
        note = f"95 % interval {low:.2f} to {high:.2f}"
        checks.append(Check("population", FREE_EXPONENT, name, middle, 1.0, status, note=note))
    return checks


# --- tests that differ from the others, and device values that few tests have

FEWEST = 5  # fewest tests among which one can stand out
RARE = 0.01  # probability with which any test of a campaign stands out by chance, about
DRAWS = 400  # draws of the population by which its median is known well enough
START_DRAWS = 1000

LEAST = 0.2
"""Least distance of two starts, as a share of the gap. Intervals are narrower than the model is
right in the gap: on real tests a start moved by 0.1 when the test was pooled with the others."""

MOST_OUTSIDE = 0.5  # a device value that more than this share of its tests do not have is named
_WORDS = {
    "d2": "gap",
    "d3": "d3/d2",
    "Fc_fwd": "forward slip force",
    "Fc_bwd": "backward slip force",
}
"""What a shared coordinate is, where that is not the quantity of its name."""


def outlying_tests(run: Run) -> list[Finding]:
    """A warning for every test and quantity that stand out.

    The deviation of a test's own posterior from the law is compared with those of the others that
    inform the quantity: a Student-t statistic that leaves the test out, with Bonferroni's
    correction for tests and quantities. Pooled values would not do: they are shrunken to the law.
    """
    if len(run.tests) < FEWEST:
        return []
    design = run.population.design
    places, medians, sds = _places(run)
    deviations, names = places - medians, list(run.tests)
    groups: dict[bytes, list[int]] = {}  # quantities by the tests that inform them
    for k, name in enumerate(design.names):
        if not (design.common[k] or name == "offset" or name.startswith("noise_")):
            groups.setdefault(design.informs[:, k].tobytes(), []).append(k)
    findings = []
    for columns in groups.values():
        tests = np.flatnonzero(design.informs[:, columns[0]])
        if tests.size < FEWEST:
            continue
        for row, column, distance in standing_out(
            deviations[tests][:, columns], sds[tests][:, columns]
        ):
            j, k = int(tests[row]), columns[column]
            expected = np.median(np.delete(deviations[:, k], j)) + medians[j, k]
            name = design.names[k]
            standard = name in run.model.standard_names
            unit = "1" if standard and name == "d3" else units(run.model)[name]
            label = _WORDS.get(name, name) if standard else name
            values = {
                key: Measure.of(value, unit=unit) if unit != "1" else f"{value:.3g}"
                for key, value in (("own", np.exp(places[j, k])), ("others", np.exp(expected)))
            }
            message = Message(
                f"{{test}} stands apart from the other tests: {label} {{own}}, "
                f"where the others suggest {{others}}, {distance:.1f} standard deviations of tests "
                "away; check its displacement, units and actuation before you use the campaign",
                {"test": names[j], **values},
            )
            findings.append(Finding(names[j], "stands apart", message, stage="results"))
    return findings


def standing_out(deviations: Array, sds: Array) -> Iterator[tuple[int, int, float]]:
    """Test, quantity and distance in sds, of deviations (J, K) that stand out from the others.

    `sds` (J, K) are those of each deviation by its own posterior. The sd of a distance is that of
    the others, which is at least their own, and the test's own.
    """
    count, size = deviations.shape
    limit = -float(special.stdtrit(count - 2, 0.5 * RARE / max(count * size, 1)))
    for j in range(count):
        peers = np.delete(deviations, j, axis=0)
        mean_variance = np.mean(np.delete(sds, j, axis=0) ** 2, axis=0)
        spread = np.maximum(peers.var(axis=0, ddof=1), np.maximum(mean_variance, 1e-24))
        sd = np.sqrt(
            spread * (1.0 + 1.0 / (count - 1)) + np.maximum(sds[j] ** 2 - mean_variance, 0.0)
        )
        distances = np.abs(deviations[j] - peers.mean(axis=0)) / sd
        for i in np.flatnonzero(distances > limit).tolist():
            yield j, i, float(distances[i])


def _places(run: Run) -> tuple[Array, Array, Array]:
    """Each test's own coordinates, those of laws and effects, and its own sds, (J, d) each."""
    population, design = run.population, run.population.design
    d, rng = len(design.names), np.random.default_rng(0)
    index = rng.choice(population.size, size=min(DRAWS, population.size))
    places, medians, sds = [], [], []
    for name, setting in zip(run.tests, design.settings, strict=True):
        draws = design.coordinates.of(run.tests[name].stored.values())[:, :d]
        places.append(draws.mean(axis=0))
        sds.append(draws.std(axis=0))
        medians.append(_coordinates(run, setting, index, rng).mean(axis=0))
    centre, spread = design.coordinates.centre[:d], design.spread
    scaled = (centre + spread * np.array(x) for x in (places, medians))
    return *scaled, spread * np.array(sds)


MUCH = 2.0
"""Median of a scatter, in sds of its half-normal prior, that is a sign: its probability is 5 %."""


def scatter_checks(run: Run) -> list[Check]:
    """A warning where slip force or gap scatters between tests more than the priors expect.

    A mistake in a test that no other check saw, such as an exchanged actuation, makes a scatter of
    what is much the same in all tests.
    """
    if len(run.tests) < FEWEST:
        return []
    named = {*run.model.slip_forces, *(("d2", "gap") if run.model.standard_names else ())}
    checks, scatters = [], run.population.scatters
    for (name, draws), sd in zip(scatters.items(), run.population.scatter_scales, strict=False):
        scatter = float(np.median(draws))
        if name in named and scatter > MUCH * sd:
            label = _WORDS.get(name, name) if run.model.standard_names else name
            figures = "population", SCATTER, label, scatter, float(sd)
            checks.append(Check(*figures, CheckStatus.WARNING))
    return checks


def _coordinates(
    run: Run,
    setting: TestConditions,
    index: NDArray[np.intp],
    rng: np.random.Generator,
    *,
    scatter: bool = False,
) -> Array:
    """Coordinates of the device at a setting, or of a test with its scatter, (n, d)."""
    population = run.population
    numbers = population.draw_numbers(index.size, 1, rng)
    effects = population.level_effects(index, setting.session, [setting.actuation], numbers.level)
    mean, scattered = population.parts(setting, index, numbers, effects, scatter=scatter)
    return mean + scattered


def uncommon_device_values(run: Run) -> list[Finding]:
    """A warning for each quantity whose device value is outside of most of its tests.

    That is the interval of one more test at the setting of each, 95 %, scatter included; a test is
    outside where the 95 % interval of its own posterior does not overlap it.
    """
    if len(run.tests) < FEWEST:
        return []
    model = run.model
    of_device = (*model.slip_forces, *(("sigma0", "gap") if model.standard_names else ()))
    rows: dict[str, list[tuple[float, float, float, bool]]] = {}
    rng = np.random.default_rng(0)
    for test, setting in zip(run.tests.values(), run.population.design.settings, strict=True):
        index = run.population.draw_index(DRAWS, setting.actuation, rng) % run.population.size
        draws = run.population.values(_coordinates(run, setting, index, rng, scatter=True))
        intervals = dict(test.intervals)
        if {"d2", "d3"} <= draws.keys() & model.standard_names:
            draws["gap"] = draws["d2"] + draws["d3"]
            middle, lower, upper = (intervals["d2"][k] + intervals["d3"][k] for k in range(3))
            intervals["gap"] = middle, lower, upper
        for name in of_device:
            if name in draws:
                low, high = np.quantile(draws[name], [0.025, 0.975]).tolist()
                middle, lower, upper = intervals[name]
                is_outside = lower > high or upper < low
                rows.setdefault(name, []).append((low, high, middle, is_outside))
    findings = []
    for name, of_tests in rows.items():
        lows, highs, middles, outside_of = zip(*of_tests, strict=True)
        count = sum(outside_of)
        if count <= MOST_OUTSIDE * len(of_tests):
            continue
        unit = "in" if name == "gap" else units(model)[name]
        message = Message(
            f"{name} of the device, {{device}}, is outside of {count} of its {len(of_tests)} "
            "tests, which have {tests} each by itself",
            {
                "device": Measure.of(min(lows), max(highs), unit=unit),
                "tests": Measure.of(min(middles), max(middles), unit=unit),
            },
        )
        findings.append(Finding("laws", "device value", message, stage="results"))
    return findings


def contradicted_order(run: Run) -> list[Finding]:
    """A warning for every calibrated test whose start contradicts the end of the one before.

    The start of each test is inferred from its own force. Where its 95 % interval and that of the
    end of the test before do not overlap, one of the two is wrong, or the device was moved.
    """
    findings = []
    for name, predecessor in run.manifest.settings.order.items():
        test = run.tests.get(name)
        if test is None or predecessor not in run.tests or "start" not in test.posterior.names:
            continue
        model, trace = test.posterior.model, test.trace
        ending = sequence_of(run).before(name, trace, PredictionOptions(draws=START_DRAWS))
        values = sequence_of(run).values(name)
        starts, theta = values["start"], model.theta(values)
        expected = starts if ending is None else ending.starts(model, theta, trace, 0)
        # the place of a start is the start of a place: both count along the first direction
        (low, middle, high), (lowest, ended, highest) = (
            np.quantile(model.start_at(start, trace), [0.025, 0.5, 0.975]).tolist()
            for start in (starts, expected)
        )
        if (low > highest or high < lowest) and abs(middle - ended) >= LEAST:
            message = Message(
                f"the test begins at {middle:.2f} [{low:.2f}, {high:.2f}] of its gap (0: slip "
                f"backward, 1: slip forward), but test {{after}} ended at {ended:.2f} "
                f"[{lowest:.2f}, {highest:.2f}]: check whether the device was reset or moved in "
                "between",
                {"after": predecessor},
            )
            findings.append(Finding(name, "start in the gap", message, stage="results"))
    return findings
