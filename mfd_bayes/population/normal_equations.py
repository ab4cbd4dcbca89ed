"""Normal equations of tests that have some coordinates in common, and damped steps that solve them.

All coordinates are in prior units: each has a normal prior of mean 0 and sd 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class System(NamedTuple):
    """Normal equations of a test: of c common coordinates, and of f that are free.

    Attributes
    ----------
    common, free, cross : (c, c), (f, f), (c, f)
        Products of the weighted slopes.
    pull, gradient : (c,), (f,)
        Their products with what is left over; the prior of what is free is in its gradient.
    """

    common: Array
    free: Array
    cross: Array
    pull: Array
    gradient: Array


def damped_steps(
    systems: Sequence[System], common: Array, damping: float
) -> tuple[Array, list[Array]]:
    """Levenberg–Marquardt step of what is common, (c,), and of what is free in each test, (f,).

    What is free is eliminated first: the cost is linear in the number of tests.

    Parameters
    ----------
    systems : sequence of System
        Of the tests.
    common : (c,)
        Where the common coordinates are.
    damping : float
        Share by which diagonals are raised.
    """
    matrix, pull, kept = np.eye(common.size), -common, []
    for of_common, of_free, cross, of_pull, gradient in systems:
        own = of_free + np.diag(1.0 + damping * np.diag(of_free))
        gain = np.linalg.solve(own, cross.T).T
        matrix += of_common + damping * np.diag(np.diag(of_common)) - gain @ cross.T
        pull += of_pull - gain @ gradient
        kept.append(own)
    together = np.asarray(np.linalg.solve(matrix, pull))
    alone = [
        np.asarray(np.linalg.solve(own, system.gradient - system.cross.T @ together))
        for own, system in zip(kept, systems, strict=True)
    ]
    return together, alone
