"""A few steps of the backlash model one after the other: for a motion that comes step by step.

It solves the same rule as `slip.advance`, with fewer calls where there is no record to batch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.newton import CLOSE, OVER, STIFF, Material, push
from mfd_bayes.friction.slip import Rows, advance

Array = NDArray[np.float64]
Bent = tuple[Array, Array, Array]

ITERATIONS = 10
"""Most of Newton's steps here; what needs more is left to `advance`."""


def advance_few(material: Material, rows: Rows, bent: Bent) -> Bent:
    """Deflection, in, force, kip, and stiffness, kip/in, after some steps, (n,) each.

    Parameters
    ----------
    bent : (n,), (n,), (n,)
        The same before them.
    """
    first = bent[0]
    if rows.slip is None:
        for k in range(len(rows.sign)):
            found = _one(material, (rows.way[k], rows.sign[k, 0], rows.limit[k]), bent)
            if found is None:
                break
            bent = found
        else:
            return bent
    _, z, unsolved = advance(material, rows, first)
    z = np.where(unsolved, np.nan, z)
    return z, *material.spring.evaluate(z)


def _one(material: Material, row: tuple[Array, float, Array], bent: Bent) -> Bent | None:
    """After one step; None where it begins beyond slip or Newton's method is slow."""
    way, sign, limit = row
    z, force, slope = bent
    log, share = push(sign * force, material.exponent * slope, material.exponent)
    log -= limit
    if log.max() > OVER:
        return None
    power = np.exp(log, out=log)
    c = share * way * power
    ahead = (sign / 12.0) * way
    free = 1.0 - power
    base = z + ahead * free * (6.0 - c)
    return _solved(material, (way, sign, limit, ahead), base, z + 12.0 * ahead * free / (1.0 + c))


def _solved(
    material: Material, row: tuple[Array, float, Array, Array], base: Array, z: Array
) -> Bent | None:
    """Newton's method from a first guess z, (n,)."""
    way, sign, limit, ahead = row
    n = material.exponent
    for _ in range(ITERATIONS):
        force, slope = material.spring.evaluate(z)
        log, share = push(sign * force, n * slope, n)
        log -= limit
        share *= way
        power = np.exp(np.minimum(log, STIFF, out=log), out=log)
        c = share * power
        free = 1.0 - power
        weight = c + 6.0
        short = ahead * free
        short *= weight
        short += base
        short -= z
        share *= free
        share *= 1.0 - 1.0 / n
        weight -= share
        weight *= c
        weight += 12.0
        short *= 12.0
        short /= weight
        z += short
        if not (np.abs(short) * material.rate).max() > CLOSE:
            force += slope * short
            return z, force, slope
    return None
