"""The laws of a run: Table II, each quantity against actuation, and which law predicts best."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, measure_draws
from mfd_bayes.calibration.priors import units
from mfd_bayes.evaluation.checks import INFORMED, NOT_INFORMED
from mfd_bayes.evaluation.design import sessions_of
from mfd_bayes.evaluation.scores import fan_of, spread_of
from mfd_bayes.evaluation.views import Fan, LawChoice, LawScoreRow, LawView, Row
from mfd_bayes.population.law_scores import LARGEST_K, LawScore
from mfd_bayes.population.laws import COMPARE, INTERCEPTS, LAW_NAMES, LAWS, law_unit, shapes_of
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
    draws_by_name = dict(population.slopes) | _shapes(population) | spreads
    draws_by_name |= {f"dependence_{name}": b for name, b in population.dependences.items()}
    # the scatter of what may be negative is not of a logarithm
    negative = {f"scatter_{q.name}": q.unit for q in run.model.quantities if q.least < 0.0}
    rows = [*_mixed_rows(run), *_level_rows(run)]
    for name, draws in draws_by_name.items():
        converged = measure_draws(draws, population.walkers)
        shrunk = _contraction(draws, prior_sd[name]) if name in prior_sd else float("nan")
        rows.append(
            Row(
                subject="population",
                name=name,
                unit=negative.get(name) or law_unit(name, run.actuation_unit),
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


def _level_rows(run: Run) -> list[Row]:
    """What follows a law in a user's own model, at the reference actuation of the laws."""
    population, rows = run.population, []
    reference = population.design.reference
    at = run.system.words([reference], run.actuation_unit, actuation=True)
    for name, law in population.design.laws.items():
        if not run.model.own or law == COMPARE:
            continue
        draws = population.median(name, [reference])[..., 0]
        converged = measure_draws(draws, population.walkers)
        rows.append(
            Row(
                subject="population",
                name=name,
                unit=units(run.model)[name],
                **spread_of(draws),
                r_hat=converged.worst_r_hat,
                ess_bulk=float(converged.ess_bulk[0]),
                ess_tail=float(converged.ess_tail[0]),
                contraction=float("nan"),
                note=f"{law} law; at {at}",
            )
        )
    return rows


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
    drawn, tested = _law_draws(run, grid), _tested(run, list(laws))
    views = []
    for name, law in laws.items():
        starts = np.any(population.ratio(name, grid) > 0.0, axis=(0, 1))  # not at zero
        device, again = (
            fan_of(kind, starts * drawn[kind][name]) for kind in ("device", "new_test")
        )
        views.append(
            LawView(
                name=name,
                unit=units(run.model)[name],
                law=law_label(law, population.law_weights[name]),
                actuation=grid,
                device=device,
                new_test=_around(again, device),
                tested=tuple(tested[name]),
            )
        )
    return tuple(views)


def _law_draws(run: Run, grid: Array) -> dict[str, dict[str, Array]]:
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
        by_kind: dict[str, list[dict[str, Array]]] = {"device": [], "new_test": []}
        for at, p in enumerate(grid.tolist()):
            setting = Setting(p, session, dict(population.design.covariates))
            within_tested = population.within_levels(p)
            chosen, effects = (inside, within) if within_tested else (index, beyond)
            here = {name: effect[:, at] for name, effect in effects.items()}
            made = population.parts(setting, chosen, numbers, here)
            by_kind["device"].append(population.values(made.mean))
            by_kind["new_test"].append(population.values(made.mean + made.scatter))
        parts.append(by_kind)
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
    tested: dict[str, list[tuple[str, float, float, float, float]]] = {name: [] for name in names}
    for test in run.tests.values():
        for name in names:
            middle, low, high = test.intervals[name]
            tested[name].append((test.id, test.trace.reference_actuation, low, middle, high))
    return tested


# --- the constants of compared laws

FEWEST = 20
"""Fewest draws under a law of which an interval is given."""

_SLOPES = {"Fc_fwd": "K_c_fwd", "Fc_bwd": "K_c_bwd", "sigma0": "alpha_sigma0"}


def _mixed_rows(run: Run) -> list[Row]:
    """Constants of every law of each quantity whose laws are compared.

    Each draw of the population has one law. The rows of a law are of the draws that have it, so
    they hold given that law; a law of too few draws has none. R̂ and effective sample sizes of such
    a part of the chains are not known.
    """
    population, unit, kinds = run.population, run.actuation_unit, units(run.model)
    reference = population.design.reference
    at = run.system.words([reference], unit, actuation=True)
    rows = []
    for name, law, picked in _chosen(population):
        weight = population.law_weights[name].get(law, 0.0)
        about = f"{law} law, weight {weight:.2g}"
        for constant, draws in _constants(population, name, law).items():
            of_level = constant == name
            rows.append(
                Row(
                    subject="population",
                    name=constant,
                    unit=kinds[name] if of_level else law_unit(constant, unit),
                    **spread_of(draws[picked]),
                    r_hat=np.nan,
                    ess_bulk=np.nan,
                    ess_tail=np.nan,
                    contraction=np.nan,
                    note=f"{about}; at {at}" if of_level else about,
                )
            )
    return rows


def _chosen(population: Population) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Quantity, law, and which draws have it, (chain, draw), of all that have enough draws."""
    for column, (name, law) in enumerate(population.design.laws.items()):
        if law != COMPARE:
            continue
        for number, law_name in enumerate(LAW_NAMES):
            picked = population.choice[..., column] == number
            if np.count_nonzero(picked) >= FEWEST:
                yield name, law_name, picked


def _constants(population: Population, name: str, law: str) -> dict[str, Array]:
    """Constants of a quantity's law by name, (chain, draw): slope, intercept, level, exponent."""
    design, form = population.design, LAWS[law]
    level = population.median(name, np.array([design.reference]))[..., 0]
    share, exponent = population.shapes(name)
    constants: dict[str, Array] = {}
    if form.exponent == 1.0 and form.share != 0.0 and name in _SLOPES:
        constants[_SLOPES[name]] = level * share / design.reference
    else:
        constants[name] = level
    if f"{name}_0" in INTERCEPTS and "share" in form.shapes:
        constants[f"{name}_0"] = level * (1.0 - share)
    if "exponent" in form.shapes:
        constants[f"exponent_{name}"] = exponent
    return constants


# --- which law predicts best


def law_choices(scores: Sequence[LawScore], laws: Mapping[str, str]) -> tuple[LawChoice, ...]:
    """The laws of each quantity, best first, with a sentence; `laws` are the campaign's."""
    choices = []
    for name in dict.fromkeys(score.quantity for score in scores):
        own = [score for score in scores if score.quantity == name]
        rows = _rows(own, laws.get(name, ""))
        choices.append(LawChoice(name, rows, _sentence(rows, len(own[0].levels), laws.get(name))))
    return tuple(choices)


def _rows(scores: Sequence[LawScore], chosen: str) -> tuple[LawScoreRow, ...]:
    ordered = sorted(scores, key=lambda score: (not score.trusted, -score.elpd))
    best = np.array(ordered[0].levels)
    rows = []
    for score in ordered:
        apart = np.array(score.levels) - best
        rows.append(
            LawScoreRow(
                quantity=score.quantity,
                law=score.law,
                chosen=score.law == chosen,
                elpd=score.elpd,
                elpd_se=score.se,
                difference=float(apart.sum()),
                difference_se=float(np.sqrt(apart.size) * apart.std(ddof=1)),
                weight=score.weight,
                pareto_k=score.pareto_k,
            )
        )
    return tuple(rows)


def _sentence(rows: Sequence[LawScoreRow], levels: int, chosen: str | None) -> str:
    """Which law predicts best, and which others are within the standard error."""
    unreliable = [row for row in rows if row.pareto_k > LARGEST_K]
    rows = [row for row in rows if row not in unreliable]
    caveat = ""
    if unreliable:
        names = " and ".join(f"{row.law} (Pareto k {row.pareto_k:.2f})" for row in unreliable)
        caveat = f"; the score of {names} cannot be trusted, so it gets no weight"
    if not rows:
        return f"the laws have no weights{caveat}."
    best, *others = rows
    text = f"the {best.law} law predicts levels that were left out best"
    near = [row.law for row in others if -row.difference <= row.difference_se]
    if near:
        text += (
            f", but the {levels} levels cannot separate it from {' or '.join(near)}: the "
            "difference is within its standard error"
        )
    own = next((row for row in others if row.chosen and row.law not in near), None)
    if own:
        text += (
            f"; the campaign's own, {own.law}, is worse by {-own.difference:.1f} ± "
            f"{own.difference_se:.1f}"
        )
    elif chosen == COMPARE:
        held = law_label(COMPARE, {row.law: row.weight for row in rows})
        text += f"; predictions mix them ({held})"
    return f"{text}{caveat}."


def law_label(law: str, weights: Mapping[str, float]) -> str:
    """A law's name, or the weights of those that were compared."""
    if law != COMPARE:
        return law
    held = sorted(((name, w) for name, w in weights.items() if w > 0), key=lambda it: -it[1])
    return "compared: " + ", ".join(f"{name} {weight:.2g}" for name, weight in held)
