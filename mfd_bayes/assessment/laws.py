"""The laws in the report: Table II, and each quantity against actuation."""

from __future__ import annotations

import numpy as np

from mfd_bayes.assessment.bands import fan_of
from mfd_bayes.calibration.diagnostics import measure_draws
from mfd_bayes.quantities import UNITS, law_unit
from mfd_bayes.reporting.views import LawView, Row
from mfd_bayes.run import Run


def law_rows(run: Run) -> tuple[Row, ...]:
    """Table II: slopes and intercepts, the laws' shapes, and the scatter of each group."""
    population = run.population
    unit = run.actuation_unit
    found = dict(population.slopes)
    for name, shape in population.shapes.items():
        power = population.pooling.laws[name] == "power"
        found[f"exponent_{name}" if power else f"share_{name}"] = (
            shape if power else 1.0 / (1.0 + np.exp(-shape))
        )
    found |= {f"scatter_{group}": tau for group, tau in population.scatters.items()}
    rows = []
    for name, draws in found.items():
        converged = measure_draws(draws, population.walkers)
        lower, median, upper = np.quantile(draws, [0.025, 0.5, 0.975])
        rows.append(
            Row(
                subject="population",
                name=name,
                unit=law_unit(name, unit),
                mean=float(draws.mean()),
                sd=float(draws.std()),
                lower=float(lower),
                median=float(median),
                upper=float(upper),
                r_hat=converged.worst_r_hat,
                ess_bulk=float(converged.ess_bulk[0]),
                ess_tail=float(converged.ess_tail[0]),
                contraction=float("nan"),
            )
        )
    return tuple(rows)


def law_views(run: Run) -> tuple[LawView, ...]:
    """Every quantity that follows the actuation, with its law's bands and the tests."""
    population = run.population
    pooling = population.pooling
    levels = [test.trace.reference_actuation for test in run.tests.values()]
    grid = np.linspace(0.0, 1.15 * max(levels), 60)
    rng = np.random.default_rng(0)
    views = []
    for name, law in pooling.laws.items():
        medians = population.median(name, grid).reshape(-1, grid.size)
        pick = np.linspace(0, len(medians) - 1, 4000).astype(np.intp)
        group = pooling.member[pooling.names.index(name)]
        scatter = population.scatter[..., group].reshape(-1)[pick]
        swing = np.exp(scatter * rng.standard_normal(pick.size))[:, None]
        tested = []
        for test in run.tests.values():
            low, mid, high = np.quantile(test.draws[name].to_numpy(), [0.025, 0.5, 0.975])
            level = test.trace.reference_actuation
            tested.append((test.id, level, float(low), float(mid), float(high)))
        views.append(
            LawView(
                name=name,
                unit=UNITS[name],
                law=law,
                actuation=grid,
                median=fan_of("device", medians[pick]),
                new_test=fan_of("new_test", medians[pick] * swing),
                tested=tuple(tested),
            )
        )
    return tuple(views)
