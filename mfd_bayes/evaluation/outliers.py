"""Tests that differ from the others of their campaign, and device values that few tests have."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.priors import units
from mfd_bayes.messages import Message, Quantity
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.settings import Setting
from mfd_bayes.runs.manifest import Finding
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

FEWEST = 5
"""Fewest tests among which one can stand out."""

RARE = 0.01
"""Probability with which any test of a campaign stands out by chance, about."""

DRAWS = 400
"""Draws of the population by which its median is known well enough."""

START_DRAWS = 1000

LEAST = 0.2
"""Least distance of two starts, as a share of the gap. Intervals are narrower than the model is
right in the gap: on real tests a start moved by 0.1 when the test was pooled with the others."""

MOST_OUTSIDE = 0.5
"""A device value that more than this share of its tests do not have is named."""

_WORDS = {
    "d2": "gap",
    "d3": "d3/d2",
    "Fc_fwd": "forward slip force",
    "Fc_bwd": "backward slip force",
}
"""What a shared coordinate is, where that is not the quantity of its name."""


def outlying_tests(run: Run) -> list[Finding]:
    """A warning for every test and quantity that stand out.

    A test's deviation from the law is compared with the deviations of the others that inform the
    quantity: a Student-t statistic that leaves the test out, with Bonferroni's correction for tests
    and quantities.
    """
    if len(run.tests) < FEWEST:
        return []
    design = run.population.design
    places, medians = _places(run)
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
        for row, column, away in standing_out(deviations[tests][:, columns]):
            j, k = int(tests[row]), columns[column]
            others = np.median(np.delete(deviations[:, k], j)) + medians[j, k]
            name = design.names[k]
            standard = name in run.model.standard_names
            unit = "1" if standard and name == "d3" else units(run.model)[name]
            shown = _WORDS.get(name, name) if standard else name
            values = {
                key: Quantity.of(value, unit=unit) if unit != "1" else f"{value:.3g}"
                for key, value in (("own", np.exp(places[j, k])), ("others", np.exp(others)))
            }
            message = Message(
                f"{{test}} stands apart from the other tests: {shown} {{own}}, "
                f"where the others suggest {{others}}, {away:.1f} of their standard deviations "
                "away; check its displacement, units and actuation before you use the campaign",
                {"test": names[j], **values},
            )
            findings.append(Finding(names[j], "stands apart", message, stage="results"))
    return findings


def standing_out(deviations: Array) -> Iterator[tuple[int, int, float]]:
    """Test, quantity and distance in sds of the others, of deviations (J, K) that stand out."""
    count, size = deviations.shape
    limit = -float(special.stdtrit(count - 2, 0.5 * RARE / max(count * size, 1)))
    for j in range(count):
        others = np.delete(deviations, j, axis=0)
        sd = np.maximum(others.std(axis=0, ddof=1), 1e-12)
        away = np.abs(deviations[j] - others.mean(axis=0)) / sd
        for i in np.flatnonzero(away / np.sqrt(1.0 + 1.0 / (count - 1)) > limit).tolist():
            yield j, i, float(away[i])


def _places(run: Run) -> tuple[Array, Array]:
    """Each test's shared coordinates, and those that laws and effects give it, (J, d) each."""
    population, design = run.population, run.population.design
    d, rng = len(design.names), np.random.default_rng(0)
    index = rng.choice(population.size, size=min(DRAWS, population.size))
    places, medians = [], []
    for name, setting in zip(run.tests, design.settings, strict=True):
        places.append(design.coordinates.of(run.sequence.pooled(name)).mean(axis=0)[:d])
        medians.append(_coordinates(run, setting, index, rng).mean(axis=0))
    centre, spread = design.coordinates.centre[:d], design.spread
    return centre + spread * np.array(places), centre + spread * np.array(medians)


def _coordinates(
    run: Run,
    setting: Setting,
    index: NDArray[np.intp],
    rng: np.random.Generator,
    *,
    scatter: bool = False,
) -> Array:
    """Coordinates of the device at a setting, or of a test with its scatter, (n, d)."""
    population = run.population
    numbers = population.draw_numbers(index.size, 1, rng)
    effects = population.level_effects(index, setting.session, [setting.actuation], numbers.level)
    here = {n: effect[:, 0] for n, effect in effects.items()}
    parts = population.parts(setting, index, numbers, here, scatter=scatter)
    return np.asarray(parts.mean + parts.scatter if scatter else parts.mean)


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
        drawn = run.population.values(_coordinates(run, setting, index, rng, scatter=True))
        own = dict(test.intervals)
        if {"d2", "d3"} <= drawn.keys() & model.standard_names:
            drawn["gap"] = drawn["d2"] + drawn["d3"]
            middle, lower, upper = (own["d2"][k] + own["d3"][k] for k in range(3))
            own["gap"] = middle, lower, upper
        for name in of_device:
            if name in drawn:
                low, high = np.quantile(drawn[name], [0.025, 0.975]).tolist()
                middle, lower, upper = own[name]
                outside = lower > high or upper < low
                rows.setdefault(name, []).append((low, high, middle, outside))
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
                "device": Quantity.of(min(lows), max(highs), unit=unit),
                "tests": Quantity.of(min(middles), max(middles), unit=unit),
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
    for name, after in run.manifest.settings.order.items():
        test = run.tests.get(name)
        if test is None or after not in run.tests or "start" not in test.posterior.names:
            continue
        model, trace = test.posterior.model, test.trace
        before = run.sequence.before(name, trace, Forecast(draws=START_DRAWS))
        values = run.sequence.values(name)
        own, theta = values["start"], model.theta(values)
        expected = own if before is None else before.starts(model, theta, trace, 0)
        # the place of a start is the start of a place: both count along the first direction
        (low, middle, high), (lowest, ended, highest) = (
            np.quantile(model.start_at(start, trace), [0.025, 0.5, 0.975]).tolist()
            for start in (own, expected)
        )
        if (low > highest or high < lowest) and abs(middle - ended) >= LEAST:
            message = Message(
                f"the test begins at {middle:.2f} [{low:.2f}, {high:.2f}] of its gap (0: slip "
                f"backward, 1: slip forward), but test {{after}} ended at {ended:.2f} "
                f"[{lowest:.2f}, {highest:.2f}]: check whether the device was reset or moved in "
                "between",
                {"after": after},
            )
            findings.append(Finding(name, "start in the gap", message, stage="results"))
    return findings
