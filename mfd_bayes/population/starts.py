"""Where in the gap tests begin, learned from the calibrated ones.

Tests are often made one after the other with the same or a like motion, and the device is not reset
in between. It then stands where such a motion leaves it. So the place at which a test begins is
near the middle of the gap, or near the place at which its own motion ends; which of the two, and
how near, is learned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln, softmax

Array = NDArray[np.float64]

SHAPES = np.geomspace(1.0, 100.0, 41)
"""Equally probable shapes a of the starts' density: from anywhere (1) to one place."""


def start_density(a: Array, mode: Array) -> tuple[Array, Array]:
    """Exponents of the Beta densities of shapes a with these modes, and sum 2a, (n,) each."""
    return 1.0 + 2.0 * (a - 1.0) * mode, 1.0 + 2.0 * (a - 1.0) * (1.0 - mode)


def learned_density(
    begun: Array, left: tuple[Array, float] | None, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Exponents of the Beta densities of the place where n new tests begin, (n,) each.

    Parameters
    ----------
    begun : (n, J)
        Draws of the places where the tests began.
    left : ((J,), float) or None
        Places where their own motions leave the device, and the one where the new motion does;
        None where they are not known: tests then begin about the middle.
    rng : numpy.random.Generator
    """
    sides = np.clip(begun, 1e-6, 1.0 - 1e-6)
    half = np.full(begun.shape[1], 0.5)
    modes = [(half, 0.5)] if left is None else [(half, 0.5), left]
    log = np.concatenate([_log_likelihood(sides, places) for places, _ in modes], axis=1)
    edges = np.cumsum(softmax(log, axis=1), axis=1)
    chosen = np.argmax(rng.random((len(begun), 1)) * edges[:, -1:] < edges, axis=1)
    which, shape = np.divmod(chosen, SHAPES.size)
    return start_density(SHAPES[shape], np.array([mode for _, mode in modes])[which])


def _log_likelihood(begun: Array, places: Array) -> Array:
    """Log likelihood of every shape a for starts (n, J) about these places (J,), (n, A)."""
    alpha, beta = start_density(SHAPES[:, None], places)
    log = np.log(begun) @ (alpha - 1.0).T + np.log1p(-begun) @ (beta - 1.0).T
    return np.asarray(log - betaln(alpha, beta).sum(axis=1))
