"""Tests that stand apart from the others of their campaign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.quantities import units
from mfd_bayes.messages import Message
from mfd_bayes.population.design import Design
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.folder import pooled_of
from mfd_bayes.runs.run import Run
from mfd_bayes.store.netcdf import load_arrays

Array = NDArray[np.float64]

FEWEST = 5
"""Fewest tests among which one can stand apart."""

RARE = 0.01
"""Probability with which any test of a campaign stands apart by chance, about."""

DRAWS = 400
"""Draws of the population by which its median is known well enough."""


def odd_tests(run: Run) -> list[Finding]:
    """A warning for every test and quantity that stand apart.

    A test's deviation from the law is compared with the deviations of the others: a Student-t
    statistic that leaves the test out, with Bonferroni's correction for tests and quantities.
    """
    if len(run.tests) < FEWEST:
        return []
    design = run.population.design
    columns = [k for k, name in enumerate(design.names) if _compared(design, k, name)]
    places, medians = _places(run)
    found = []
    names, deviations = list(run.tests), places - medians
    for j, k, away in _apart(deviations, columns, design.informs):
        others = np.median(np.delete(deviations[:, k], j)) + medians[j, k]
        subject, unit = _subject(design, k)
        sentence = (
            f"{names[j]} stands apart from the other tests: {subject} "
            f"{np.exp(places[j, k]):.3g}{unit}, where the others suggest "
            f"{np.exp(others):.3g}{unit}, "
            f"{away:.1f} of their standard deviations away; check its displacement, units and "
            "actuation before you use the campaign"
        )
        found.append(
            Finding(
                names[j], "stands apart", Message("{text}", {"text": sentence}), stage="results"
            )
        )
    return found


def _apart(
    deviations: Array, columns: list[int], informs: NDArray[np.bool_]
) -> Iterator[tuple[int, int, float]]:
    """As `stand_apart`, in each quantity of the tests that tell of it."""
    groups: dict[bytes, list[int]] = {}
    for k in columns:
        groups.setdefault(informs[:, k].tobytes(), []).append(k)
    for same in groups.values():
        rows = np.flatnonzero(informs[:, same[0]])
        if rows.size >= FEWEST:
            for j, i, away in stand_apart(deviations[rows][:, same]):
                yield int(rows[j]), same[i], away


def stand_apart(deviations: Array) -> Iterator[tuple[int, int, float]]:
    """Test, quantity and distance in sds of the others, of deviations (J, K) that stand apart."""
    count, size = deviations.shape
    limit = -float(special.stdtrit(count - 2, 0.5 * RARE / max(count * size, 1)))
    for j in range(count):
        others = np.delete(deviations, j, axis=0)
        sd = np.maximum(others.std(axis=0, ddof=1), 1e-12)
        away = np.abs(deviations[j] - others.mean(axis=0)) / sd
        for i in np.flatnonzero(away / np.sqrt(1.0 + 1.0 / (count - 1)) > limit).tolist():
            yield j, i, float(away[i])


def _compared(design: Design, k: int, name: str) -> bool:
    """Whether a quantity may differ between tests, and is the damper's."""
    return not design.common[k] and name != "offset" and not name.startswith("noise_")


def _places(run: Run) -> tuple[Array, Array]:
    """Each test's shared coordinates, and those that laws and effects give it, (J, d) each."""
    population, design = run.population, run.population.design
    d, rng = len(design.names), np.random.default_rng(0)
    index = rng.choice(population.size, size=min(DRAWS, population.size))
    places, medians = [], []
    for name, setting in zip(run.tests, design.settings, strict=True):
        values, _ = load_arrays(run.folder / pooled_of(name))
        known = design.coordinates.names
        flat = {n: values[n].reshape(-1).astype(np.float64) for n in known}
        places.append(design.coordinates.of(flat).mean(axis=0)[:d])
        numbers = population.draw_numbers(index.size, 1, rng)
        at = [setting.actuation]
        effects = population.level_effects(index, setting.session, at, numbers.level)
        here = {n: effect[:, 0] for n, effect in effects.items()}
        parts = population.parts(setting, index, numbers, here, scatter=False)
        medians.append(parts.mean.mean(axis=0))
    centre, spread = design.coordinates.centre[:d], design.spread
    return centre + spread * np.array(places), centre + spread * np.array(medians)


def _subject(design: Design, k: int) -> tuple[str, str]:
    """What a shared coordinate is, in words, and its unit behind a blank."""
    name = design.names[k]
    words = {"d2": "gap", "Fc_fwd": "forward slip force", "Fc_bwd": "backward slip force"}
    if name == "d3":
        return "d3/d2", ""
    unit = units()[name]
    return words.get(name, name), "" if unit == "1" else f" {unit}"
