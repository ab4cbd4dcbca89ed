"""The laws of a run: Table II, bands against actuation, which predicts best, and drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, measure_draws
from mfd_bayes.calibration.priors import units
from mfd_bayes.evaluation.bounds import sessions_of
from mfd_bayes.evaluation.scores import Row, Rows, fan_of, spread_of
from mfd_bayes.evaluation.views import DEFAULT_LIMITS, INFORMED, NOT_INFORMED, DriftRow, LawView
from mfd_bayes.population.design import (
    COMPARE,
    CONDITIONS,
    INTERCEPTS,
    LAW_NAMES,
    LAWS,
    TestConditions,
    law_unit,
    shapes_of,
)
from mfd_bayes.population.law_scores import LARGEST_K, LawScore
from mfd_bayes.population.population import Population
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import FAR

Array = NDArray[np.float64]

DRAWS = 4000  # draws of the bands of a law
FEWEST = 20  # fewest draws under a law of which an interval is given
_SLOPES = {"Fc_fwd": "K_c_fwd", "Fc_bwd": "K_c_bwd", "sigma0": "alpha_sigma0"}


def law_rows(run: Run) -> Rows:
    """Table II: slopes and intercepts, the laws' shapes, and the scatter of each quantity.

    Where laws are compared, those of each law with its weight.
    """
    population, design, unit = run.population, run.population.design, run.actuation_unit
    kinds, level = units(run.model), run.system.words([design.reference], unit, actuation=True)
    rows = mixed_rows(run, level)
    constants = dict(population.slopes) if run.model.standard_names else {}
    for name, law in design.laws.items():
        if law == COMPARE:  # a mixture has no constants of its own
            continue
        if (
            name not in run.model.standard_names
        ):  # what follows a law, at the reference actuation of the laws
            draws = population.median(name, [design.reference])[..., 0]
            converged = measure_draws(draws, population.walkers).figures()
            rows.append(_row(name, kinds[name], draws, f"{law} law; at {level}", **converged))
        shapes = dict(zip(("share", "exponent"), population.shapes(name), strict=True))
        constants |= {
            f"{shape}_{name}": shapes[shape] for shape in shapes if shape in shapes_of(law)
        }
    if not run.model.standard_names:
        for name in (n for n in design.names if n in run.model.parameters and n not in design.laws):
            draws = population.median(name, [design.reference])[..., 0]
            converged = measure_draws(draws, population.walkers).figures()
            rows.append(_row(name, kinds[name], draws, "median over the tests", **converged))
    spreads = {f"scatter_{name}": tau for name, tau in population.scatters.items()}
    spreads |= {f"deviation_{name}": omega for name, omega in population.effect_sds.items()}
    constants |= spreads | {f"dependence_{name}": b for name, b in population.dependences.items()}
    # the prior's standard deviation, of a half-normal
    prior_sds = np.sqrt(1.0 - 2.0 / np.pi) * population.scatter_scales
    prior_sd = dict(zip(spreads, prior_sds.tolist(), strict=True))
    # the scatter of what may be negative is not of a logarithm
    negative = {f"scatter_{q.name}": q.unit for q in run.model.quantities if q.lower < 0.0}
    for name, draws in constants.items():
        shrunk = float("nan")
        if name in prior_sd:
            shrunk = float(contraction(np.array([prior_sd[name]]), draws.reshape(-1, 1))[0])
        note = NOT_INFORMED if shrunk < INFORMED else ""
        figures = measure_draws(draws, population.walkers).figures() | {"contraction": shrunk}
        rows.append(_row(name, negative.get(name) or law_unit(name, unit), draws, note, **figures))
    return tuple(rows)


def convergence_rows(population: Population, table: Rows) -> Rows:
    """Convergence of the sampled levels, but for those whose own the table of the laws has."""
    design, sampled = population.design, population.convergence
    first = len(sampled.r_hat) - design.tabled.size
    tail_share = np.broadcast_to(sampled.tail_share, sampled.r_hat.shape)
    has_own = {row["name"] for row in table if not np.isnan(row["r_hat"])}
    return tuple(
        {"name": name, "tail_share": float(tail_share[first + k])} | sampled.figures(first + k)
        for k, name in enumerate(design.names)
        if name not in has_own
    )


def _row(name: str, unit: str, draws: Array, note: str, **figures: float) -> Row:
    blank = dict.fromkeys(("ess_bulk", "ess_tail", "r_hat", "contraction"), float("nan"))
    head: Row = {"test": "population", "name": name, "unit": unit}
    return head | spread_of(draws) | blank | figures | {"note": note}


def mixed_rows(run: Run, level: str) -> list[Row]:
    """Constants of every law of each quantity whose laws are compared; `level` is the reference.

    Each draw of the population has one law. The rows of a law are of the draws that have it, so
    they hold given that law; a law of too few draws has none. R-hat and effective sample sizes of
    such a part of the chains are not known.
    """
    population, unit, kinds, rows = run.population, run.actuation_unit, units(run.model), []
    for column, (name, choice) in enumerate(population.design.laws.items()):
        for number, law in enumerate(LAW_NAMES if choice == COMPARE else ()):
            mask = population.choice[..., column] == number
            if np.count_nonzero(mask) < FEWEST:
                continue
            description = f"{law} law, weight {population.law_weights[name].get(law, 0.0):.2g}"
            for constant, draws in _constants(population, name, law).items():
                of_level = constant == name
                of_unit = kinds[name] if of_level else law_unit(constant, unit)
                note = f"{description}; at {level}" if of_level else description
                rows.append(_row(constant, of_unit, draws[mask], note))
    return rows


def _constants(population: Population, name: str, law: str) -> dict[str, Array]:
    """Constants of a quantity's law by name, (chain, draw): slope, intercept, level, exponent."""
    reference, form = population.design.reference, LAWS[law]
    level = population.median(name, np.array([reference]))[..., 0]
    share, exponent = population.shapes(name)
    constants: dict[str, Array] = {}
    if form.exponent == 1.0 and form.share != 0.0 and name in _SLOPES:
        constants[_SLOPES[name]] = level * share / reference
    else:
        constants[name] = level
    if f"{name}_0" in INTERCEPTS and "share" in form.shapes:
        constants[f"{name}_0"] = level * (1.0 - share)
    if "exponent" in form.shapes:
        constants[f"exponent_{name}"] = exponent
    return constants


# --- each quantity against the actuation


def law_views(run: Run) -> tuple[LawView, ...]:
    """Every quantity that follows the actuation, with its law's bands and the tests.

    The bands are those of `design_rows`: the mean property has the effect of its level, and the
    tests are of the declared sessions. Both bands have the same draws, with the same random
    numbers at every actuation.
    """
    population, tests = run.population, run.tests.values()
    levels = [test.trace.reference_actuation for test in tests]
    # farther below the tests a prediction is refused, but where it is asked for expressly
    lowest = min((level for level in levels if level > 0.0), default=0.0) / FAR
    grid = np.union1d(np.linspace(lowest, 1.15 * max(levels), 60), levels)
    draws, views = _law_draws(run, grid), []
    scores = law_score_rows(run.manifest.law_scores, run.manifest.settings.laws)
    for name, law in population.design.laws.items():
        starts = np.any(population.ratio(name, grid) > 0.0, axis=(0, 1))  # not at zero
        bounds = [test.intervals[name] for test in tests]
        views.append(
            LawView(
                name=name,
                unit=units(run.model)[name],
                law=law_label(
                    law,
                    population.law_weights[name],
                    tuple(row for row in scores if row["quantity"] == name),
                ),
                actuation=grid,
                device=fan_of("mean", starts * draws["mean"][name]),
                new_test=fan_of("new_test", starts * draws["new_test"][name]),
                tested=tuple(
                    (test.id, actuation, low, middle, high)
                    for test, actuation, (middle, low, high) in zip(
                        tests, levels, bounds, strict=True
                    )
                ),
            )
        )
    return tuple(views)


def _law_draws(run: Run, grid: Array) -> dict[str, dict[str, Array]]:
    """Draws of the quantities with a law on a grid of actuations, (n, G) each, by kind.

    The tests are of the declared sessions; the numbers are the same at every actuation.
    """
    population, sessions, rng = run.population, sessions_of(run), np.random.default_rng(0)
    names, kinds = population.design.laws, ("mean", "new_test")
    session_draws: dict[str, dict[str, list[Array]]] = {
        kind: {n: [] for n in names} for kind in kinds
    }
    for session in sessions:
        n = DRAWS // len(sessions)
        index = population.draw_index(n, float(grid[-1]), rng)
        inner_index = np.where(index < population.size, index, index % population.size)
        numbers = population.draw_numbers(n, grid.size, rng)
        inner_effects, outer_effects = (
            population.level_effects(rows, session, grid, numbers.level)
            for rows in (inner_index, index)
        )
        values: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
        for p in grid.tolist():
            setting = TestConditions(p, session, dict(population.design.covariates))
            tested = population.within_levels(p)
            rows, effects = (inner_index, inner_effects) if tested else (index, outer_effects)
            mean, scatter = population.parts(setting, rows, numbers, effects)
            values["mean"].append(population.values(mean))
            values["new_test"].append(population.values(mean + scatter))
        for kind, at_levels in values.items():
            for name in names:
                session_draws[kind][name].append(np.stack([of[name] for of in at_levels], axis=1))
    return {
        kind: {name: np.concatenate(several) for name, several in of.items()}
        for kind, of in session_draws.items()
    }


# --- which law predicts best


def law_score_rows(scores: Sequence[LawScore], laws: Mapping[str, str]) -> Rows:
    """How well each law predicts each quantity at levels that were left out, the best first.

    `laws` are the campaign's. Differences are to the best law, paired over levels. A score whose
    Pareto k is above `LARGEST_K` cannot be trusted.
    """
    rows = []
    for name in dict.fromkeys(score.quantity for score in scores):
        quantity_scores = [score for score in scores if score.quantity == name]
        quantity_scores.sort(key=lambda score: (not score.trusted, -score.elpd))
        for score in quantity_scores:
            differences = np.array(score.levels) - np.array(quantity_scores[0].levels)
            rows.append(
                {
                    "quantity": name,
                    "law": score.law,
                    "chosen": score.law == laws.get(name, ""),
                    "elpd": score.elpd,
                    "elpd_se": score.se,
                    "difference": float(differences.sum()),
                    "difference_se": float(np.sqrt(differences.size) * differences.std(ddof=1)),
                    "weight": score.weight,
                    "pareto_k": score.pareto_k,
                    "levels": len(score.levels),
                }
            )
    return tuple(rows)


def law_choices(rows: Rows, laws: Mapping[str, str]) -> dict[str, str]:
    """Which law predicts each quantity best, and which others are within the standard error."""
    names = dict.fromkeys(row["quantity"] for row in rows)
    groups = {name: [row for row in rows if row["quantity"] == name] for name in names}
    return {name: _sentence(group, laws.get(name)) for name, group in groups.items()}


def _sentence(rows: Sequence[Row], campaign_law: str | None) -> str:
    unreliable = [row for row in rows if row["pareto_k"] > LARGEST_K]
    trusted = [row for row in rows if row not in unreliable]
    caveat = ""
    if unreliable:
        names = (f"{row['law']} (Pareto k {row['pareto_k']:.2f})" for row in unreliable)
        caveat = f"; the score of {' and '.join(names)} cannot be trusted, so it gets no weight"
    if not trusted:
        mixed = "; predictions mix all laws with equal weights" if campaign_law == COMPARE else ""
        return f"no law is known to predict best{mixed}{caveat}."
    best, *alternatives = trusted
    text = f"the {best['law']} law predicts levels that were left out best"
    ties = [row["law"] for row in alternatives if -row["difference"] <= row["difference_se"]]
    if ties:
        text += (
            f", but the {best['levels']} levels cannot separate it from {' or '.join(ties)}: the "
            "difference is within its standard error"
        )
    entry = next((row for row in alternatives if row["chosen"] and row["law"] not in ties), None)
    if entry:
        text += (
            f"; the campaign's own, {entry['law']}, is worse by {-entry['difference']:.1f} ± "
            f"{entry['difference_se']:.1f}"
        )
    elif campaign_law == COMPARE:
        weights = {row["law"]: row["weight"] for row in trusted}
        text += f"; predictions mix them ({law_label(COMPARE, weights)})"
    return f"{text}{caveat}."


def law_label(law: str, weights: Mapping[str, float], scores: Rows = ()) -> str:
    """A law's name, or the weights of those that were compared.

    `scores` are the rows of `law_score_rows` of its quantity: where they speak against the
    campaign's law, the label says so, as the sentence of `law_choices` does.
    """
    if law != COMPARE:
        trusted = [row for row in scores if not row["pareto_k"] > LARGEST_K]
        ties = [r["law"] for r in trusted if -r["difference"] <= r["difference_se"]]
        best = next((row["law"] for row in trusted), law)
        return law if law in (best, *ties) else f"{law}, the campaign's; {best} predicts best"
    ranking = sorted(((name, w) for name, w in weights.items() if w > 0), key=lambda it: -it[1])
    mixed = ", ".join(f"{name} {weight:.2g}" for name, weight in ranking)
    return f"compared: {mixed}"


# --- change with age, cycles or temperature, and when it is too much

UNITS = {"date": (1.0, "year"), "cycles": (1000.0, "1000 cycles"), "temperature": (10.0, "10 °C")}
"""For how much of a condition a change is said, and its words."""

AHEAD = 10.0  # years, or spans of cycles or temperatures, after the last test that are looked at


def drift_rows(run: Run) -> tuple[DriftRow, ...]:
    """Change of each quantity that follows a date, a count of cycles or a temperature."""
    limits, design = run.manifest.settings.limits, run.population.design
    rows = []
    for name, conditions in design.dependence.items():
        kind = "gap" if name in ("d2", "gap") else "slip"
        limit = limits.get(kind) or limits.get("all") or DEFAULT_LIMITS["all"]
        for condition in conditions:
            if condition in CONDITIONS:
                draws = run.population.dependences[f"{name}_{condition}"].reshape(-1)
                values = np.array([s.covariates[condition] for s in design.settings])
                rows.append(drift_row(name, condition, draws, values, limit))
    return tuple(rows)


def drift_row(quantity: str, condition: str, draws: Array, values: Array, limit: float) -> DriftRow:
    """Row of draws (n,) of the change of a logarithm over the span of the tests' values (J,)."""
    step, per = UNITS[condition]
    span, lowest = float(np.ptp(values)) or 1.0, float(values.min())
    slope = draws / span
    change = 100.0 * np.expm1(slope * step)
    lower, middle, upper = np.quantile(change, [0.025, 0.5, 0.975]).tolist()
    room = np.where(slope > 0.0, np.log1p(limit), -np.log1p(-limit))
    with np.errstate(divide="ignore"):
        leaving = lowest + room / np.abs(slope)
    highest = float(values.max())
    end = highest + AHEAD * (1.0 if condition == "date" else span)
    whens = [
        _shown(condition, quantile, end) for quantile in np.quantile(leaving, [0.5, 0.05, 0.95])
    ]
    return DriftRow(
        *(quantity, condition, per, middle, lower, upper),
        float(np.mean(np.sign(slope) == np.sign(middle))),
        100.0 * limit,
        float(np.mean(leaving <= highest)),
        float(np.mean(leaving <= end)),
        *whens,
    )


def _shown(condition: str, value: float, end: float) -> str:
    """A value of a condition as it is given; "" beyond what is looked at."""
    if not value <= end:
        return ""
    if condition == "date":
        year = int(value)
        return str(date(year, 1, 1) + timedelta(days=round(365.25 * (value - year))))
    return f"{value:.3g}"
