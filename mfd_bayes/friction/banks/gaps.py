"""Gaps of a bank of three-stage dampers, each at its own place; see `friction.gap`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from mfd_bayes.friction.banks.bank import with_rows
from mfd_bayes.friction.transitions import LARGEST, SATURATED

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


MANY = 500
"""Dampers from which those that slip are left out of the blend; of fewer, choosing takes longer."""


@dataclass(frozen=True, eq=False)
class Gaps:
    """Parameters of the gaps, (n,) each; `early` and `late` are d2/ℓ and D/ℓ.

    `build_up` is the weight of stage 3 less that of slip at a turn, and `jump` its force.
    """

    k2: Array
    k3: Array
    d2: Array
    width: Array
    transition: Array
    early: Array
    late: Array
    build_up: Array
    jump: Array

    @classmethod
    def of(cls, columns: dict[str, Array]) -> Gaps:
        """Gaps of a model's columns by name, (n,) each."""
        k2, k3, d2, d3 = (columns[name] for name in ("k2", "k3", "d2", "d3"))
        ell = columns["gamma2"] / columns["gamma1"]
        early, late = d2 / ell, (d2 + d3) / ell
        return cls(
            k2, k3, d2, d2 + d3, ell, early, late, expit(late) * expit(-early), (k2 - k3) * d2
        )

    def chosen(self, rows: Rows) -> Gaps:
        """Those of some dampers."""
        return Gaps(*(column[rows] for column in vars(self).values()))


class Places(NamedTuple):
    """State of each gap, (n,) each; see `friction.transitions.Crossing`.

    `origin` is where the travel since the last slip is 0, in.
    """

    side: Array
    edge: Array
    carry: Array
    origin: Array

    @classmethod
    def begun(cls, gaps: Gaps, displacement: Array, direction: Array, start: Array) -> Places:
        """State before the first turning point; `start` is the place in the gap."""
        behind = np.where(direction > 0, start, 1.0 - start)
        edge = displacement - behind * gaps.width
        side = direction.astype(np.float64)
        return cls(side, edge, np.zeros(edge.size), _origin(gaps, side, edge))

    def chosen(self, rows: Rows) -> Places:
        """Those of some dampers."""
        return Places(*(column[rows] for column in self))

    def replaced(self, rows: Rows, new: Places) -> Places:
        """The same with other places of some dampers."""
        pairs = zip(self, new, strict=True)
        return Places(*(with_rows(column, rows, values) for column, values in pairs))

    def travel(self, displacement: Array) -> Array:
        """Travel u since the last slip, (n,), in."""
        return np.asarray(self.side * (displacement - self.origin))


def _origin(gaps: Gaps, side: Array, edge: Array) -> Array:
    return np.where(side > 0, edge, edge + gaps.width)


def turned(gaps: Gaps, before: Places, at: Array, direction: Array, slip: Array) -> Places:
    """State after a turn of each damper at `at`, in, into its new `direction`.

    After slip the travel restarts at 0, and what the force would jump by is carried on; inside
    the gap nothing is reset. `slip` is the force F1 there, (n,), kip.
    """
    edge = np.minimum(np.maximum(before.edge, at - gaps.width), at)
    slipped = (edge == at) | (edge == at - gaps.width)
    u = before.travel(at)
    left = gaps.build_up * (slip - direction * gaps.jump)
    soon = slipped & (u < gaps.width + SATURATED * gaps.transition)
    if soon.any():
        clean = before._replace(carry=np.zeros(u.size))
        left = np.where(soon, left + blended(gaps, clean, at, slip) - slip, left)
    faded = 1.0 - np.tanh(np.abs(u) * (0.5 / gaps.transition))
    carry = np.where(slipped, faded * before.carry + left, before.carry)
    side = np.where(slipped, direction, before.side)
    return Places(side, edge, carry, _origin(gaps, side, edge))


def blended(gaps: Gaps, places: Places, displacement: Array, slip: Array) -> Array:
    """Force of the three stages, (n,), kip, of the force F1 in slip; see `friction.transitions`."""
    u = places.travel(displacement)
    reach = SATURATED * gaps.transition
    if u.size > MANY:
        (rows,) = ((u <= gaps.width + reach) & (u >= -reach)).nonzero()
        if not rows.size:
            return slip
        if rows.size < 0.7 * u.size:
            force = slip.copy()
            force[rows] = _blend(gaps.chosen(rows), places.chosen(rows), u[rows], slip[rows])
            return force
    return _blend(gaps, places, np.maximum(u, -reach), slip)


def _blend(gaps: Gaps, places: Places, u: Array, slip: Array) -> Array:
    x = -u / gaps.transition
    e = np.exp(np.minimum(x, SATURATED))
    a = np.exp(np.minimum(x + gaps.early, LARGEST))
    b = np.exp(np.minimum(x + gaps.late, LARGEST))
    f2 = places.side * (gaps.k2 * u) - slip
    f3 = places.side * (gaps.jump + gaps.k3 * u) - slip
    inside = np.minimum(e, 1.0)
    plus = 1.0 + inside
    fading = np.minimum(e, 1.0 / np.maximum(e, 1e-300))
    total = (a * (1.0 - inside) * f2 + plus * f3) * b / ((1.0 + a) * (1.0 + b))
    total /= plus
    total += 2.0 * places.carry * fading / (1.0 + fading)
    return np.asarray(slip + total)
