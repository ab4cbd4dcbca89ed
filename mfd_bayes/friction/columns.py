"""Columns by their names: of quantities by name, and of a table whose columns have names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.inputs import real_numbers

Array = NDArray[np.float64]


def named_columns(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """Some of the quantities that are given by name, as numbers.

    Raises
    ------
    FitError
        When they are not given by name, one is missing, or one is no numbers.
    """
    by_name: Any = values
    if isinstance(values, type) or not (hasattr(values, "keys") and hasattr(values, "__getitem__")):
        kind = type(values).__name__
        raise FitError(f"values must be a mapping from names of quantities to numbers, got {kind}")
    wanted = tuple(names)
    if missing := [name for name in wanted if name not in by_name]:
        raise FitError(f"values by name lack {', '.join(missing)}")
    return {name: real_numbers(name, by_name[name], FitError) for name in wanted}


def named_vectors(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """As `named_columns`, each (n,), of the same n.

    Raises
    ------
    FitError
        When a shape does not fit either.
    """
    columns = named_columns(values, names)
    first = next(iter(columns.values())).shape if columns else (0,)
    for name, column in columns.items():
        if column.ndim != 1 or column.shape != first:
            expected = first if len(first) == 1 else "(n,)"
            raise FitError(f"values of {name} must have shape {expected}, got {column.shape}")
    return columns


def columns_in_order(name: str, table: ArrayLike, names: tuple[str, ...]) -> Array:
    """Numbers of an array as they are; of a table with named columns those of `names`, (n, p).

    Raises
    ------
    FitError
        When a column is missing, or one is no numbers.
    """
    by_name: Any = table
    if type(table) is np.ndarray or not hasattr(table, "columns"):
        return real_numbers(name, table, FitError)
    known = {column for column in by_name.columns if isinstance(column, str)}
    if missing := [column for column in names if column not in known]:
        raise FitError(
            f"{name} is a table, whose columns are taken by their names: it lacks "
            f"{', '.join(missing)}"
        )
    found = [real_numbers(f"column {c} of {name}", by_name[c], FitError) for c in names]
    return np.column_stack(found)
