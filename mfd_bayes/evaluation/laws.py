"""The laws of a run: Table II, and each quantity against actuation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, measure_draws
from mfd_bayes.calibration.prior_files import units
from mfd_bayes.evaluation.bands import fan_of, spread_of
from mfd_bayes.evaluation.checks import INFORMED, NOT_INFORMED
from mfd_bayes.evaluation.design import sessions_of
from mfd_bayes.evaluation.law_choices import weighed
from mfd_bayes.evaluation.mixed_laws import mixed_rows
from mfd_bayes.evaluation.views import Fan, LawView, Row
from mfd_bayes.population.laws import COMPARE, law_unit, shapes_of
from mfd_bayes.population.population import Population
from mfd_bayes.population.settings import Setting
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

DRAWS = 4000
"""Draws of the bands of a law."""


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
    """Every quantity that follows the actuation, with its law's bands and the tests.

    The bands are those of `design_rows`: the mean property has the effect of its level, and the
    tests are of the declared sessions. Both bands have the same draws, with the same random
    numbers at every actuation.
    """
    population = run.population
    laws = population.design.laws
    levels = [test.trace.reference_actuation for test in run.tests.values()]
    grid = np.union1d(np.linspace(0.0, 1.15 * max(levels), 60), levels)
    drawn, tested = _drawn(run, grid), _tested(run, list(laws))
    views = []
    for name, law in laws.items():
        starts = np.any(population.ratio(name, grid) > 0.0, axis=(0, 1))  # not at zero
        device, again = (
            fan_of(kind, starts * drawn[kind][name]) for kind in ("device", "new_test")
        )
        views.append(
            LawView(
                name=name,
                unit=units()[name],
                law=weighed(law, population.law_weights[name]),
                actuation=grid,
                device=device,
                new_test=_around(again, device),
                tested=tuple(tested[name]),
            )
        )
    return tuple(views)


def _drawn(run: Run, grid: Array) -> dict[str, dict[str, Array]]:
    """Draws of the quantities with a law on a grid of actuations, (n, G) each, by kind.

    The tests are of the declared sessions; the numbers are the same at every actuation.
    """
    population, sessions = run.population, sessions_of(run)
    rng, parts = np.random.default_rng(0), []
    for session in sessions:
        n = DRAWS // len(sessions)
        index = population.draw_index(n, float(grid[-1]), rng)
        inside = np.where(index < population.size, index, index % population.size)
        numbers = population.draw_numbers(n, grid.size, rng)
        within, beyond = (
            population.level_effects(chosen, session, grid, numbers.level)
            for chosen in (inside, index)
        )
        found: dict[str, list[dict[str, Array]]] = {"device": [], "new_test": []}
        for at, p in enumerate(grid.tolist()):
            setting = Setting(p, session, dict(population.design.covariates))
            known = population.within_levels(p)
            chosen, effects = (inside, within) if known else (index, beyond)
            here = {name: effect[:, at] for name, effect in effects.items()}
            made = population.parts(setting, chosen, numbers, here)
            found["device"].append(population.values(made.mean))
            found["new_test"].append(population.values(made.mean + made.scatter))
        parts.append(found)
    return {
        kind: {
            name: np.concatenate(
                [np.stack([at[name] for at in part[kind]], axis=1) for part in parts]
            )
            for name in population.design.laws
        }
        for kind in ("device", "new_test")
    }


def _around(wide: Fan, narrow: Fan) -> Fan:
    """A fan that is nowhere inside another, which chance in its draws may make it."""
    pairs = zip(wide.intervals, narrow.intervals, strict=True)
    return replace(
        wide,
        intervals=tuple(
            replace(w, lower=np.minimum(w.lower, n.lower), upper=np.maximum(w.upper, n.upper))
            for w, n in pairs
        ),
    )


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
