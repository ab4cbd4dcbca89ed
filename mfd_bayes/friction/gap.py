"""Stages 2 and 3: the gap, a play operator with memory of the side on which it last slipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Path

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gap:
    """Parameters of the gap and of the transitions, (n,) each.

    `transition` is ℓ = γ2/γ1 in inches: only this quotient reaches the force.
    """

    k2: Array
    k3: Array
    d2: Array
    d3: Array
    transition: Array

    @property
    def width(self) -> Array:
        """D = d2 + d3, (n,), in."""
        return self.d2 + self.d3


@dataclass(frozen=True)
class Crossing:
    """State of the gap in each monotone stretch of motion, (K + 1, n) each.

    The travel since the last slip is u = `offset` + `side` x; `carry` is the force, kip,
    that the last turning point left over and that fades as the gap is crossed.
    """

    side: Array
    offset: Array
    carry: Array


def blend(gap: Gap, u: Array, side: Array, slip: Array) -> Array:
    """Force of the three stages at travel u (paper Eqs. 1 and 2; model.md section 4).

    Parameters
    ----------
    gap : Gap
    u, side, slip : (…, n)
        Travel since the last slip, in; direction of the crossing, ±1; F1, kip.

    Returns
    -------
    (…, n), kip
    """
    # m31, from build-up to slip at u = D
    weight = _logistic(u, gap.width, gap.transition)
    # F3 = s [k2 d2 + k3 (u − d2)]
    force = u * gap.k3
    force += (gap.k2 - gap.k3) * gap.d2
    force *= side
    # F2 = s k2 u, and m23, from stick to build-up at u = d2
    stick = u * gap.k2
    stick *= side
    building = _logistic(u, gap.d2, gap.transition)
    # m12 = tanh(u/2ℓ) for u ≥ 0: the upper half of a logistic, so that a reversal makes no jump
    sticking = np.tanh(np.maximum(u, 0.0) * (0.5 / gap.transition))
    # each transition is applied to the result of the one before
    stick -= slip
    stick *= sticking
    stick += slip
    force -= stick
    force *= building
    force += stick
    force -= slip
    weight -= 1.0
    force *= weight
    np.subtract(slip, force, out=force)
    return force


def fade(gap: Gap, u: Array) -> Array:
    """Share of the carried force that is left at travel u, 1 − tanh(|u|/2ℓ), (…, n)."""
    return 1.0 - np.tanh(np.abs(u) * (0.5 / gap.transition))


def _logistic(u: Array, centre: Array, scale: Array) -> Array:
    weight = (centre - u) / scale
    np.minimum(weight, 700.0, out=weight)
    np.exp(weight, out=weight)
    weight += 1.0
    return np.reciprocal(weight, out=weight)


def follow(gap: Gap, path: Path, start: Array, slip_at: Callable[[int], Array]) -> Crossing:
    """State of the gap in every stretch between turning points.

    At a turning point after slip (u ≥ D or u ≤ 0) the travel starts again at 0 in the new
    direction, and the force just before it less that just after it is carried on; inside the
    gap nothing is reset, so that the force retraces the path on which it came.

    Parameters
    ----------
    gap : Gap
    path : Path
    start : (n,), 1
        u/D at the first sample.
    slip_at : callable
        F1 at a sample, (n,), kip.
    """
    x, turns = path.displacement, path.turning_points
    stretches, n = turns.size + 1, gap.k2.size
    side, offset, carry = (np.empty((stretches, n)) for _ in range(3))
    side[0] = path.direction
    offset[0] = start * gap.width - path.direction * x[0]
    carry[0] = 0.0
    direction = path.direction
    for k, sample in enumerate(turns, start=1):
        direction = -direction
        slip = slip_at(int(sample))
        u = offset[k - 1] + side[k - 1] * x[sample]
        slipped = (u >= gap.width) | (u <= 0.0)
        left = blend(gap, u, side[k - 1], slip) + carry[k - 1] * fade(gap, u)
        left -= blend(gap, np.zeros_like(u), np.full_like(u, direction), slip)
        side[k] = np.where(slipped, direction, side[k - 1])
        offset[k] = np.where(slipped, -direction * x[sample], offset[k - 1])
        carry[k] = np.where(slipped, left, carry[k - 1])
    return Crossing(side, offset, carry)
