"""Predictions of a part of a run that was left out, as a fold stores them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.results import Prediction
from mfd_bayes.store.files import read_json
from mfd_bayes.store.schema import AtLeastOne, Part, check


class _Predictions(Part):
    """Stored predictions of a part that was left out."""

    key: dict[str, Any]
    predictions: AtLeastOne[Prediction]


def read_predictions_of(path: Path, tests: Iterable[str]) -> tuple[Prediction, ...]:
    """Stored predictions of the tests of a part that was left out.

    Raises
    ------
    StoreError
        When the file is missing, or does not hold these tests' predictions.
    """
    predictions = check(_Predictions, read_json(path), path).predictions
    found = [prediction.test for prediction in predictions]
    if found != list(tests):
        raise StoreError(f"{path} holds predictions of {', '.join(found)[:200]}, not of its part")
    return predictions
