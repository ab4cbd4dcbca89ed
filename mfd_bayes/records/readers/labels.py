"""Names of columns that have none, or share one: by their number, "column 3"."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

_OURS = re.compile(r"column \d+(: .*)?", re.DOTALL)


def label(number: int, name: str = "") -> str:
    """Name of a column by its number, from 1: ``"column 3"``, or ``"column 3: force_kip"``."""
    return f"column {number}: {name}" if name else f"column {number}"


def labels(names: Sequence[str], numbers: Sequence[int] | None = None) -> tuple[str, ...]:
    """Names of which each is there once.

    A column gets a label in place of its name where that is empty, is shared with another
    column, or could be taken for a label.

    Parameters
    ----------
    names : sequence of str
    numbers : sequence of int, optional
        Number of each column in its file, from 1; by default in the order of names.
    """
    count = Counter(names)
    places = range(1, len(names) + 1) if numbers is None else numbers
    return tuple(
        label(number, name) if not name or count[name] > 1 or _OURS.fullmatch(name) else name
        for number, name in zip(places, names, strict=True)
    )


def own_name(name: str) -> str:
    """Name that the file gives a column, without its number; empty where it gives none."""
    return re.sub(r"^column \d+(: )?", "", name) if _OURS.fullmatch(name) else name
