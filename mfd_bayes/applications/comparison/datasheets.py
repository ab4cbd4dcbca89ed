"""The data sheet under several models of one campaign, and under their mixture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.applications.properties import sheet_conditions
from mfd_bayes.errors import MfdError
from mfd_bayes.evaluation.bounds import bounds, drawn_properties, with_gains
from mfd_bayes.population.mixed_model import stack
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.reporting.tables import to_units
from mfd_bayes.runs.manifest import ComparedSheet, ComparedValue
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.unit_system import UnitSystem

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

MIXTURE = "mixture"
PROBABILITY = 0.95  # of the interval between lower and upper bound, as on the data sheet
MARK = (
    "A value depends on the model where the models' nominal values are further apart than half of "
    "the width between the mixture's bounds."
)

_COLUMNS = [
    *("condition", "quantity", "direction", "unit", "model", "weight"),
    *("nominal", "lower", "upper", "difference", "depends_on_model"),
]


def sheet_over_models(average: ModelAverage) -> pd.DataFrame:
    """Values of the data sheet under each of several models, and under their mixture.

    The models are weighted by how well they predict kinds of motion that were left out, where
    `crossvalidate --by motion` or `compare --by motion` has scored every run (stacking, Yao et
    al., 2018); else all have the same weight, as in `ModelAverage.predict`.

    Parameters
    ----------
    average : ModelAverage
        Of two or more runs.

    Returns
    -------
    DataFrame
        Columns condition, quantity, direction, unit, model (the last is "mixture"), weight,
        nominal, lower and upper (the 95 % bounds of a measurement), all in the units of the
        campaign; difference, that of the models' nominal values, over half of the width between
        the mixture's bounds; depends_on_model, whether it is larger than 1. Models of weight 0
        do not count in these two.
    """
    return sheet_frame(compare_sheets(average), average.runs[0].system)


def compare_sheets(average: ModelAverage) -> ComparedSheet:
    """Values of the data sheet of each run, as `datasheet.csv` has them, and of the mixture."""
    weights, reason = sheet_weights(average)
    first_run, *_ = average.runs
    rows = []
    for label, trace, places in sheet_conditions(first_run):
        try:
            draws = [with_gains(r, drawn_properties(r, trace, places)) for r in average.runs]
        except MfdError:  # the data sheet of the run has no such condition, and says so
            continue
        for item in PROPERTIES.values():
            if not (item.sheet and item.applies(first_run.system.axes)):
                continue
            mean, observed = (
                [of_run[basis][item.name] for of_run in draws] for basis in ("mean", "observation")
            )
            if not any(np.isfinite(v).any() for v, w in zip(observed, weights, strict=True) if w):
                continue
            values, difference = values_of(average.models, weights, mean, observed)
            head = label, item.sheet, item.direction, item.unit
            rows.append(ComparedValue(*head, values, difference))
    marked = sum(row.depends_on_model for row in rows)
    count = f"{marked or 'None'} of {len(rows)} values {'does' if marked < 2 else 'do'}."
    sentence = f"{reason} {MARK} {count}"
    return ComparedSheet(
        tuple(rows), dict(zip(average.models, weights.tolist(), strict=True)), sentence
    )


def sheet_weights(average: ModelAverage) -> tuple[Array, str]:
    """Weights of the models in their mixture, (models,), and a sentence on them."""
    scores = []
    for run in average.runs:
        stored = run.manifest.crossvalidation
        predictions = stored.predictions if stored and stored.by == "motion" else ()
        of_tests = {prediction.test: prediction.log_score for prediction in predictions}
        scores.append([of_tests.get(name) for name in average.runs[0].tests])
    terms = np.array(scores, dtype=float).T  # (tests, models), NaN where there is none
    if not np.isfinite(terms).all():
        return np.full(len(scores), 1.0 / len(scores)), (
            "Every model has the same weight in the mixture: not every run has predicted kinds of "
            "motion that were left out (compare --by motion)."
        )
    weights = stack(terms, prior=1.0)  # worth one test, so that a few do not rule a model out
    shares = ", ".join(f"{n} {w:.2f}" for n, w in zip(average.models, weights, strict=True))
    return weights, (
        f"Weights in the mixture: {shares}, by how well each model predicts kinds of motion that "
        "were left out (stacking)."
    )


def values_of(
    models: Sequence[str], weights: Array, mean: Sequence[Array], observed: Sequence[Array]
) -> tuple[dict[str, tuple[float, float, float]], float]:
    """Nominal value and bounds by model, the mixture last, and the difference of the models.

    From draws of the mean property and of a measurement under each model, (n,) each. The
    difference is that of the nominal values over half of the width between the mixture's bounds,
    of the models that have a weight.
    """
    values = {}
    for model, of_mean, of_test in zip(models, mean, observed, strict=True):
        row = bounds(of_mean, of_test, PROBABILITY)
        values[model] = row["nominal"], row["lower"], row["upper"]
    nominals = np.array([values[model][0] for model in models])
    usable = np.isfinite(nominals) & (weights > 0)
    nominals, shares = nominals[usable], weights[usable] / weights[usable].sum()
    finite = [draws[np.isfinite(draws)] for draws, use in zip(observed, usable, strict=True) if use]
    tail = 0.5 * (1.0 - PROBABILITY)
    lower, upper = np.quantile(
        np.concatenate(finite),
        [tail, 1.0 - tail],
        weights=np.repeat(shares / [v.size for v in finite], [v.size for v in finite]),
        method="inverted_cdf",
    ).tolist()
    values[MIXTURE] = float(shares @ nominals), lower, upper
    half = 0.5 * (upper - lower)
    return values, float(np.ptp(nominals) / half) if half > 0 else float("nan")


def sheet_frame(sheet: ComparedSheet, system: UnitSystem) -> pd.DataFrame:
    """A row for each value and model, in the units of a system."""
    import pandas as pd  # which takes long to import

    rows = [
        (
            *(row.condition, row.quantity, row.direction, row.unit),
            *(model, sheet.weights.get(model, 1.0), *value, row.difference, row.depends_on_model),
        )
        for row in sheet.rows
        for model, value in row.values.items()
    ]
    return to_units(pd.DataFrame(rows, columns=_COLUMNS), system)
