"""The signals of a matrix, by MATLAB's names: ``data(:,3)``."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

SIGNALS, SAMPLES = 32, 20
"""Most signals of a matrix and fewest samples of each; another matrix is left out."""


def names_of(name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Names of the signals along the longer side of a matrix; its own name for a vector.

    Empty where it has another number of dimensions, more signals than `SIGNALS`, or fewer samples
    than `SAMPLES`.
    """
    size, longest = math.prod(shape), max(shape, default=0)
    if size == longest:
        return (name,)
    if len(shape) != 2 or longest < SAMPLES or min(shape) > SIGNALS:
        return ()
    along = "(:,{})" if shape[0] >= shape[1] else "({},:)"
    return tuple(name + along.format(k + 1) for k in range(min(shape)))


def signals_of(
    name: str, numbers: NDArray[np.generic]
) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Name and numbers of each signal of an array, all of them if it is a vector."""
    names = names_of(name, numbers.shape)
    if names == (name,):
        yield name, numbers.reshape(-1)
        return
    for k, signal in enumerate(names):
        yield signal, numbers[:, k] if numbers.shape[0] >= numbers.shape[1] else numbers[k]
