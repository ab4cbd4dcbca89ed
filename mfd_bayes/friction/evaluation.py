"""What is checked of every model's arguments and of its force, whatever the model."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.columns import columns_in_order
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]


def checked(compute: Callable[..., Array]) -> Callable[..., Array]:
    """A model's method of theta and a trace that takes no vector too, and gives finite numbers.

    The method itself is its `__wrapped__`.
    """

    @wraps(compute)
    def found(model: Any, theta: ArrayLike, trace: Trace, *args: Any, **options: Any) -> Array:
        vectors = columns_in_order("theta", theta, model.parameters)
        check_trace("trace", trace, FitError)
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


def of_trace(compute: Callable[..., Array]) -> Callable[..., Array]:
    """A model's method of theta and a trace that refuses what is no trace."""

    @wraps(compute)
    def found(model: Any, theta: ArrayLike, trace: Trace, *args: Any, **options: Any) -> Array:
        return compute(model, theta, check_trace("trace", trace, FitError), *args, **options)

    return found


def check_start(start: ArrayLike | None, n: int) -> Array:
    """Place in the gap at the first sample, (n,), checked; its middle where none is given.

    Raises
    ------
    FitError
        When it is no fraction of the gap, or its shape does not fit.
    """
    if start is None:
        return np.full(n, 0.5)
    w0 = real_numbers("start", start, FitError)
    if w0.shape not in ((), (n,)) or not np.all((w0 >= 0) & (w0 <= 1)):
        raise FitError(f"start must be a fraction of the gap in [0, 1] with shape ({n},)")
    return np.broadcast_to(w0, (n,)).copy()  # a state must not change with the caller's array


def check_state(state: Any, kind: type, model: str, *, own: bool = True) -> None:
    """Refuse what is no state of a model; `own` is whether a state of its kind is one of it.

    Raises
    ------
    FitError
        When it is none.
    """
    if not (own and isinstance(state, kind)):
        kind_of_it = type(state).__name__
        raise FitError(f"state must come from start or step of {model}; this {kind_of_it} does not")
