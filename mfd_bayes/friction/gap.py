"""Stages 2 and 3: the gap, a play operator that remembers on which side it last slipped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from mfd_bayes.friction.arrays import add_outer, rows_of, scratch
from mfd_bayes.friction.recurrence import solve
from mfd_bayes.records.motion import MotionPath

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

SATURATED = 26.0
"""Transition lengths after which a transition is taken as complete: exp(−26) is 5e-12."""

SHARP = 300.0
"""Gap width, in transition lengths, above which exponents are limited (to this) before exp."""


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

    @property
    def sharp(self) -> bool:
        """Whether any vector's transition is very short compared with its gap."""
        return bool(np.any(self.width > SHARP * self.transition))


@dataclass(frozen=True)
class Crossing:
    """State of the gap in each monotone stretch of motion, (K + 1, n) each.

    The gap lies between the displacements `edge` and `edge` + D. It is crossed in the
    direction `side` = ±1, so that the travel since the last slip is u = x − edge forward and
    edge + D − x backward. `carry` is the jump of the force, kip, at the last turning point,
    which fades as the gap is crossed.
    """

    side: Array
    edge: Array
    carry: Array

    def origin(self, gap: Gap) -> Array:
        """Displacement at which the travel is 0, (K + 1, n), in."""
        return np.where(self.side > 0, self.edge, self.edge + gap.width)

    def near(self, gap: Gap, displacement: Array, stretch: Rows) -> Rows:
        """Samples at which some vector is inside a transition or the gap, (N,), int.

        Elsewhere the force is F1: the carried force has faded, and the gap is crossed.

        Parameters
        ----------
        displacement : (T,), in
        stretch : (T,), int
            Stretch to which each sample belongs.
        """
        margin = SATURATED * gap.transition
        low = (self.edge - margin).min(axis=1)
        high = (self.edge + (gap.width + margin)).max(axis=1)
        return np.flatnonzero((displacement >= low[stretch]) & (displacement <= high[stretch]))


def follow(gap: Gap, path: MotionPath, start: Array, slip: Array) -> Crossing:
    """State of the gap in every stretch between turning points.

    At a turning point after slip (u ≥ D or u ≤ 0) the travel restarts at 0 in the new
    direction, and the force before minus the force after that restart is kept as `carry`.
    Inside the gap nothing is reset, so that the force retraces its path.

    Parameters
    ----------
    start : (n,), 1
        u/D at the first sample.
    slip : (K, n), kip
        F1 at the turning points.
    """
    first = begin(gap, float(path.displacement[0]), path.direction, start)
    return turn(gap, first, path.displacement[path.turning_points], path.direction, slip)


def travel(gap: Gap, path: MotionPath, start: Array) -> Array:
    """Travel u since the last slip at every sample, (T, n), in; see `follow`.

    Between 0 and D the gap is crossed; beyond D the device slips.
    """
    first = begin(gap, float(path.displacement[0]), path.direction, start)
    x = path.displacement[path.turning_points][:, None]
    directions = np.where(np.arange(len(x) + 1) % 2, -1.0, 1.0) * path.direction
    edge, slipped = _dragged(gap, first.edge, x, directions)
    side = _side(first, slipped, directions)[0]
    crossing = Crossing(side, edge, np.zeros(edge.shape))
    along = np.empty((path.samples.size, start.size))
    rows_of(side, path.stretch, out=along)
    along *= path.displacement[path.samples, None]
    along -= rows_of(side * crossing.origin(gap), path.stretch, out=np.empty(along.shape))
    return along


def place_at_end(gap: Gap, path: MotionPath, start: Array) -> Array:
    """Place in the gap at the last sample, (n,), 1: 0 at its backward end, 1 at its forward end.

    The play operator alone: motion beyond either end drags the gap along.
    """
    edge = begin(gap, float(path.displacement[0]), path.direction, start).edge[0]
    last = float(path.displacement[-1])
    for x in (*path.displacement[path.turning_points].tolist(), last):
        edge = np.minimum(np.maximum(edge, x - gap.width), x)
    width = gap.width
    place = np.divide(last - edge, width, out=np.full(edge.shape, 0.5), where=width > 0)
    return np.asarray(np.clip(place, 0.0, 1.0))


def _side(
    before: Crossing, slipped: NDArray[np.bool_], directions: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Direction of the crossing in each stretch, (K + 1, n), and the stretch that set it."""
    latest = np.zeros((len(slipped) + 1, slipped.shape[1]), dtype=np.intp)
    np.multiply(slipped, np.arange(1, len(latest))[:, None], out=latest[1:])
    np.maximum.accumulate(latest, axis=0, out=latest)
    return np.where(latest > 0, directions[latest], before.side), latest


def begin(gap: Gap, displacement: float, direction: int, start: Array) -> Crossing:
    """State in the one stretch before the first turning point; see `follow`."""
    behind = start if direction > 0 else 1.0 - start
    shape = (1, start.size)
    return Crossing(
        np.full(shape, float(direction)),
        (displacement - behind * gap.width).reshape(shape),
        np.zeros(shape),
    )


def turn(gap: Gap, before: Crossing, at: Array, direction: int, slip: Array) -> Crossing:
    """State of a stretch and of the K stretches that follow it, each after a turning point.

    Parameters
    ----------
    before : Crossing
        State of one stretch.
    at : (K,), in
        Turning points.
    direction : int
        +1 or -1, direction of motion before the first of them.
    slip : (K, n), kip
        F1 at the turning points.
    """
    x = at[:, None]
    directions = np.where(np.arange(len(x) + 1) % 2, -1.0, 1.0) * direction
    edge, slipped = _dragged(gap, before.edge, x, directions)
    side, latest = _side(before, slipped, directions)
    carry = np.zeros(edge.shape)
    left, faded = _left_over(gap, Crossing(side, edge, carry), x, slipped, slip)
    carry[0], carry[1:] = before.carry[0], left
    if faded is not None:
        # after slip carry_k = faded carry_{k−1} + jump; inside the gap carry_k = carry_{k−1}
        carry[1:] = solve(np.where(slipped, faded, 1.0), left * slipped, before.carry[0])
    elif not slipped.all():
        carry = np.take_along_axis(carry, latest, axis=0)
    return Crossing(side, edge, carry)


def _dragged(
    gap: Gap, first: Array, x: Array, directions: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Edge of the gap in each stretch, (K + 1, n), and whether each turning point ends a slip.

    Motion beyond either end of the gap drags the gap along.
    """
    # first as if every stretch crossed the whole gap; short stretches are corrected below
    beyond = x - gap.width
    edge = np.concatenate([first, np.where(directions[:-1, None] > 0, beyond, x)])
    slipped = np.ones(x.shape[:1] + first.shape[1:], dtype=bool)
    short = np.abs(np.diff(x[:, 0])) <= gap.width.max()
    for k in [0, *(np.flatnonzero(short) + 1).tolist()][: len(x)]:
        np.maximum(edge[k], beyond[k], out=edge[k + 1])
        np.minimum(edge[k + 1], x[k], out=edge[k + 1])
        slipped[k] = (edge[k + 1] == x[k]) | (edge[k + 1] == beyond[k])
    return edge, slipped


def _left_over(
    gap: Gap, crossing: Crossing, x: Array, slipped: NDArray[np.bool_], slip: Array
) -> tuple[Array, Array | None]:
    """Blended force before minus after each turning point that follows slip, (K, n), kip.

    Also the share of the previous `carry` that is left there, (K, n), or None if none is.
    """
    # after the turn, at u = 0
    build_up = expit(gap.width / gap.transition) * expit(-gap.d2 / gap.transition)
    left = build_up * (slip - crossing.side[1:] * ((gap.k2 - gap.k3) * gap.d2))
    u = crossing.side[:-1] * (x - crossing.origin(gap)[:-1])
    early = slipped & (u < gap.width + SATURATED * gap.transition)
    if not early.any():
        return left, None
    partly = np.flatnonzero(early.any(axis=1))
    before = slip[partly]
    blend(gap, crossing, partly, x[partly, 0], before)
    left[partly] += before - slip[partly]
    return left, 1.0 - np.tanh(np.abs(u) * (0.5 / gap.transition))


def blend(gap: Gap, crossing: Crossing, stretch: Rows, displacement: Array, force: Array) -> None:
    """Turn F1 into the force of the three stages (paper Eqs. 1 and 2; model.md section 4).

    With E = exp(−u/ℓ) the weights are m12 = (1 − E)/(1 + E) for u ≥ 0,
    m23 = 1/(1 + A) with A = E exp(d2/ℓ) and m31 = 1/(1 + B) with B = E exp(D/ℓ), so that

        F − F1 = {[A (1 − E) (F2 − F1) + (1 + E) (F3 − F1)] B / ((1 + A)(1 + B)) + 2 E ΔF} / (1 + E)

    For u < 0 (`backwards`) m12 is 0, as if E were 1 in it, and ΔF fades with |u|.

    Parameters
    ----------
    stretch : (N,), int
        Stretch to which each sample belongs.
    displacement : (N,), in
    force : (N, n), kip
        F1, overwritten by F.
    """
    if not force.size:
        return
    f2, a, e, f3, b = scratch(5, *force.shape)  # in this order, what is used again is in the cache
    origin = crossing.origin(gap)
    # −u/ℓ = −s (x − origin)/ℓ
    travel = _along(-origin, stretch, displacement, np.ones(len(gap.k2)), out=f2)
    np.multiply(rows_of(crossing.side / -gap.transition, stretch, out=a), travel, out=e)
    backwards = e.max() > 1e-9
    if backwards:
        np.minimum(e, SATURATED, out=e)
    if gap.sharp:
        np.exp(np.minimum(e + gap.width / gap.transition, SHARP), out=b)
        np.exp(np.minimum(e + gap.d2 / gap.transition, SHARP), out=a)
        np.exp(e, out=e)
    else:
        np.exp(e, out=e)
        np.multiply(e, np.exp(gap.d2 / gap.transition), out=a)
    # F2 − F1 = k2 (x − origin) − F1, times A (1 − E)
    f2 = _along(-gap.k2 * origin, stretch, displacement, gap.k2, out=f2)
    f2 -= force
    f2 *= a
    f2 *= np.subtract(1.0, np.minimum(e, 1.0, out=f3) if backwards else e, out=f3)
    # F3 − F1 = s (k2 − k3) d2 + k3 (x − origin) − F1
    at_zero = crossing.side * ((gap.k2 - gap.k3) * gap.d2) - gap.k3 * origin
    f3 = _along(at_zero, stretch, displacement, gap.k3, out=f3)
    f3 -= force
    if not gap.sharp:
        np.multiply(e, np.exp(gap.width / gap.transition), out=b)
    if backwards:
        fading = np.minimum(e, 1.0 / np.maximum(e, 1e-300))
        np.minimum(e, 1.0, out=e)
    # the braces, from the inside out
    e += 1.0
    f3 *= e
    f2 += f3
    f2 *= b
    a += 1.0
    b += 1.0
    a *= b
    f2 /= a
    carry = rows_of(2.0 * crossing.carry, stretch, out=f3)
    if backwards:
        f2 /= e
        carry *= fading / (1.0 + fading)
    else:  # (F + E 2 ΔF)/(1 + E) = (F − 2 ΔF)/(1 + E) + 2 ΔF
        f2 -= carry
        f2 /= e
    f2 += carry
    force += f2


def _along(table: Array, stretch: Rows, displacement: Array, slope: Array, out: Array) -> Array:
    """Straight lines, (N, n): the table's row of each sample's stretch + slope × displacement."""
    return add_outer(displacement, slope, rows_of(table, stretch, out=out))
