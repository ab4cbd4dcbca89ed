"""What every model's force is checked for, whatever the model."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


def checked(compute: Callable[..., Array]) -> Callable[..., Array]:
    """A model's method of theta and a trace that takes no vector too, and gives finite numbers.

    The method itself is its `__wrapped__`.
    """

    @wraps(compute)
    def found(model: Any, theta: ArrayLike, trace: Trace, *args: Any, **options: Any) -> Array:
        vectors = real_numbers("theta", theta, FitError)
        if vectors.ndim == 2 and len(vectors) == 0:
            few = np.ones((1, vectors.shape[1]))
            compute(model, few, trace)  # refuses a wrong shape
            return np.empty((0, trace.samples))
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                values = compute(model, vectors, trace, *args, **options)
        except (ArithmeticError, IndexError) as error:  # of a place that is not a number
            what = f"the {compute.__name__} is no finite number for these parameters"
            raise FitError(what) from error
        if not np.all(np.isfinite(values)):
            at = int(np.argmax(~np.all(np.isfinite(values), axis=1)))
            raise FitError(f"the {compute.__name__} of parameter vector {at} is no finite number")
        return values

    return found
