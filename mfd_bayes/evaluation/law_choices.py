"""Scores of the laws, and which law predicts best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mfd_bayes.evaluation.views import LawChoice, LawScoreRow
from mfd_bayes.population.law_scores import LARGEST_K, LawScore
from mfd_bayes.population.laws import COMPARE


def law_choices(scores: Sequence[LawScore], laws: Mapping[str, str]) -> tuple[LawChoice, ...]:
    """The laws of each quantity, best first, with a sentence; `laws` are the campaign's."""
    found = []
    for name in dict.fromkeys(score.quantity for score in scores):
        own = [score for score in scores if score.quantity == name]
        rows = _rows(own, laws.get(name, ""))
        found.append(LawChoice(name, rows, _sentence(rows, len(own[0].levels), laws.get(name))))
    return tuple(found)


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
    doubtful = [row for row in rows if row.pareto_k > LARGEST_K]
    rows = [row for row in rows if row not in doubtful]
    doubt = ""
    if doubtful:
        named = " and ".join(f"{row.law} (Pareto k {row.pareto_k:.2f})" for row in doubtful)
        doubt = f"; the score of {named} cannot be trusted, so it gets no weight"
    if not rows:
        return f"the laws have no weights{doubt}."
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
        held = weighed(COMPARE, {row.law: row.weight for row in rows})
        text += f"; predictions mix them ({held})"
    return f"{text}{doubt}."


def weighed(law: str, weights: Mapping[str, float]) -> str:
    """A law's name, or the weights of those that were compared."""
    if law != COMPARE:
        return law
    held = sorted(((name, w) for name, w in weights.items() if w > 0), key=lambda it: -it[1])
    return "compared: " + ", ".join(f"{name} {weight:.2g}" for name, weight in held)
