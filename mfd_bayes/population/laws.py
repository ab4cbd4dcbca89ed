"""Laws: how a parameter's median follows the actuation (paper Eq. 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """A law v(p) = v(p0) r(p/p0), with at most one shape besides the level v(p0).

    Attributes
    ----------
    name : str
    ratio : callable
        r of p/p0 and the shape's coordinate, both broadcast.
    shape : str
        What the shape is called, "" where there is none.
    log_prior : callable
        Log density of the shape's coordinate.
    """

    name: str
    ratio: Callable[[Array, Array], Array]
    shape: str = ""
    log_prior: Callable[[Array], Array] = np.zeros_like


def _affine(ratio: Array, shape: Array) -> Array:
    share = special.expit(shape)
    return share * ratio + (1.0 - share)


def _power(ratio: Array, shape: Array) -> Array:
    return np.where(ratio > 0, np.power(np.where(ratio > 0, ratio, 1.0), shape), 0.0)


LAWS = {
    law.name: law
    for law in (
        Law("constant", lambda ratio, shape: np.ones_like(ratio + shape)),
        # F = K p: K = v(p0)/p0
        Law("proportional", lambda ratio, shape: ratio + 0.0 * shape),
        # σ0 = α p + σ0|p=0: of the value at p0 the share w is in proportion, w uniform in (0, 1)
        Law("affine", _affine, "share", lambda q: special.log_expit(q) + special.log_expit(-q)),
        # v = v(p0) (p/p0)^b, b ~ N(1, ½²)
        Law("power", _power, "exponent", lambda q: -0.5 * ((q - 1.0) / 0.5) ** 2),
    )
}

PAPER = {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine"}
"""The paper's choice. Static friction follows kinetic friction's law, F_s = F_c (1 + excess)."""
