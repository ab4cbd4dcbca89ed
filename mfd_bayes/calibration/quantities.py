"""Every quantity of a test that has a prior or a posterior, by name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration import noise as noises
from mfd_bayes.calibration.noise import Noise
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity

OF_RECORDS = (
    Quantity(
        *("start", "dimensionless", "w_0", "w<sub>0</sub>"),
        "place in the gap at the first sample",
        pooled=False,
    ),
    Quantity("offset", "force", "F_0", "F<sub>0</sub>", "offset of the load cell", least=-np.inf),
)
"""What a record has, whatever the model and the noise."""


def known_quantities(model: Model | None = None) -> dict[str, Quantity]:
    """Quantities of all models, or of one, of records and of all noises, by name."""
    parts = [m.quantities for m in ([model] if model else models.MODELS.values())]
    parts += [OF_RECORDS, *(noise.quantities for noise in noises.NOISES.values())]
    return {quantity.name: quantity for part in parts for quantity in part}


def quantities_of_fit(model: Model, noise: Noise, *, sampled_start: bool) -> list[Quantity]:
    """Quantities of a fit that have priors, in the order in which they are sampled."""
    has_start = model.has_gap and sampled_start
    record = [quantity for quantity in OF_RECORDS if quantity.name != "start" or has_start]
    return [q for q in (*model.quantities, *record, *noise.quantities) if q.sampled]


def sampled_quantities(model: Model | None = None) -> dict[str, Quantity]:
    """Those that may have a prior, by name; of a user's own model, its own come first."""
    own = known_quantities(model) if model and model.own else {}
    return {name: q for name, q in (known_quantities() | own).items() if q.sampled}


def units() -> dict[str, str]:
    """Internal unit of every quantity, by name."""
    return {name: quantity.unit for name, quantity in known_quantities().items()}


Array = NDArray[np.float64]
Interval = tuple[float, float, float]
"""50, 2.5 and 97.5 % quantiles of the draws of a quantity."""


def intervals_of(values: Mapping[str, Array]) -> dict[str, Interval]:
    """Median and equal-tailed 95 % interval of quantities, from draws of any shape."""
    found = {name: np.quantile(drawn, [0.5, 0.025, 0.975]) for name, drawn in values.items()}
    return {name: (float(a), float(b), float(c)) for name, (a, b, c) in found.items()}


def interval_rows(
    intervals: Mapping[str, Interval],
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table: name, unit, median and 95 % interval of quantities, as text."""
    known = units()
    rows = [(n, known.get(n, ""), *(f"{x:.4g}" for x in three)) for n, three in intervals.items()]
    return ("quantity", "unit", "median", "2.5 %", "97.5 %"), rows
