"""The laws of a run: Table II, and each quantity against actuation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.assessment.bands import fan_of, spread_of
from mfd_bayes.assessment.checks import INFORMED, NOT_INFORMED
from mfd_bayes.assessment.law_choices import weighed
from mfd_bayes.assessment.mixed_laws import mixed_rows
from mfd_bayes.assessment.views import LawView, Row
from mfd_bayes.calibration.diagnostics import contraction, measure_draws
from mfd_bayes.calibration.quantities import units
from mfd_bayes.population.laws import COMPARE, law_unit, shapes_of
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]


def law_rows(run: Run) -> tuple[Row, ...]:
    """Table II: slopes and intercepts, the laws' shapes, and the scatter of each quantity.

    Where laws are compared, those of each law with its weight.
    """
    population = run.population
    spreads = {f"scatter_{name}": tau for name, tau in population.scatters.items()}
    spreads |= {f"deviation_{name}": omega for name, omega in population.effect_sds.items()}
    # the prior's standard deviation, of a half-normal
    prior_sds = np.sqrt(1.0 - 2.0 / np.pi) * population.scatter_scales
    prior_sd = dict(zip(spreads, prior_sds.tolist(), strict=True))
    found = dict(population.slopes) | _shapes(population) | spreads
    found |= {f"dependence_{name}": b for name, b in population.dependences.items()}
    rows = mixed_rows(population, run.actuation_unit, run.system)
    for name, draws in found.items():
        converged = measure_draws(draws, population.walkers)
        shrunk = _contraction(draws, prior_sd[name]) if name in prior_sd else float("nan")
        rows.append(
            Row(
                subject="population",
                name=name,
                unit=law_unit(name, run.actuation_unit),
                **spread_of(draws),
                r_hat=converged.worst_r_hat,
                ess_bulk=float(converged.ess_bulk[0]),
                ess_tail=float(converged.ess_tail[0]),
                contraction=shrunk,
                note=NOT_INFORMED if shrunk < INFORMED else "",
            )
        )
    return tuple(rows)


def _shapes(population: Population) -> dict[str, Array]:
    """Draws of the shapes of each law by name; a mixture of laws has none of its own."""
    return {
        f"{shape}_{name}": draws
        for name, law in population.design.laws.items()
        if law != COMPARE
        for shape, draws in zip(("share", "exponent"), population.shapes(name), strict=True)
        if shape in shapes_of(law)
    }


def _contraction(draws: Array, prior_sd: float) -> float:
    """Share of a prior's variance that the tests removed."""
    return float(contraction(np.array([prior_sd]), draws.reshape(-1, 1))[0])


def law_views(run: Run) -> tuple[LawView, ...]:
    """Every quantity that follows the actuation, with its law's bands and the tests."""
    population = run.population
    layout = population.layout
    highest = max(test.trace.reference_actuation for test in run.tests.values())
    grid = np.linspace(0.0, 1.15 * highest, 60)
    rng = np.random.default_rng(0)
    typical = dict(layout.covariate_reference)
    tested = _tested(run, list(layout.laws))
    views = []
    for name, law in layout.laws.items():
        medians = population.median(name, grid).reshape(-1, grid.size)
        pick = np.linspace(0, len(medians) - 1, 2000).astype(np.intp)
        scattered = [
            population.draw_test(Setting(float(p), covariates=typical), pick, rng)[name]
            for p in grid
        ]
        views.append(
            LawView(
                name=name,
                unit=units()[name],
                law=weighed(law, population.law_weights[name]),
                actuation=grid,
                median=fan_of("device", medians[pick]),
                new_test=fan_of("new_test", np.stack(scattered, axis=1)),
                tested=tuple(tested[name]),
            )
        )
    return tuple(views)


def _tested(
    run: Run, names: Sequence[str]
) -> dict[str, list[tuple[str, float, float, float, float]]]:
    """Id, actuation, and three quantiles of each test's posterior, by quantity."""
    found: dict[str, list[tuple[str, float, float, float, float]]] = {name: [] for name in names}
    for test in run.tests.values():
        for name in names:
            middle, low, high = test.intervals[name]
            found[name].append((test.id, test.trace.reference_actuation, low, middle, high))
    return found
