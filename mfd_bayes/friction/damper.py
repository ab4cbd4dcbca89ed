"""The backlash model's parameters, and its force along a course, for many vectors at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import outer
from mfd_bayes.friction.course import Course, Place, Plan, cut, side_by_side
from mfd_bayes.friction.newton import STIFF, Material
from mfd_bayes.friction.slip import Rows, advance
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]
Shares = dict[str, Array]

FLOOR = 1e-6
"""Least share of the slip force that is left at zero actuation, so that nothing divides by zero."""

PIECE = 1 << 16
"""Size of a piece's arrays, in numbers: larger ones leave the cache, smaller ones cost calls."""

RESOLVED = (2.0, 0.4)
"""Longest step near a turn: over the length in which slip sets in, and over n times that length.
Random walks and real records are then within 0.07 % of steps a tenth as long.
"""

SURE = 7.0
"""Lengths over which slip sets in, after which it surely has."""

WORTH = 2000
"""Numbers of an array whose computation takes as long as one more call for few vectors does."""

POWERS = 5
"""Coefficients of the polynomial by which deflections in slip follow static friction."""

GRID = 512
"""Deflections at which the spring is inverted for a first guess."""


@dataclass(frozen=True, eq=False)
class Damper:
    """n dampers by their parameters, (n,) each, at the reference actuation."""

    columns: dict[str, Array]

    @property
    def size(self) -> int:
        """Number of vectors n."""
        return self.columns["n"].size

    def of(self, chosen: NDArray[np.intp]) -> Damper:
        """Some of the dampers."""
        return Damper({name: column[chosen] for name, column in self.columns.items()})

    def along(self, chosen: NDArray[np.intp]) -> Damper:
        """As `of`, with what a motion needs worked out for all: for few it costs as much."""
        some = self.of(chosen)
        known = {"friction": tuple(part[:, chosen] for part in self.friction)}
        vars(some).update(known, onset=self.onset[:, chosen], slipping=self.slipping[..., chosen])
        return some

    @cached_property
    def spring(self) -> Spring:
        """Their springs."""
        return Spring(*(self.columns[name] for name in ("k_fwd", "k_bwd", "gap", "ell", "k_0")))

    @cached_property
    def material(self) -> Material:
        """What does not change along a motion.

        Slip sets in over F_c/(n G′) at the deflection where it does. Where ℓ is longer than F_c/k,
        G′ is well below k there. The length is the shorter one of both sides, at the reference
        actuation and kinetic friction; where friction is static it is longer, since G′/G falls.
        """
        kinetic = np.stack([self.columns["Fc_fwd"], self.columns["Fc_bwd"]])
        return Material(self.spring, self.columns["n"], np.max(self.onset / kinetic, axis=0))

    @cached_property
    def friction(self) -> tuple[Array, Array]:
        """Logarithm of F_c, and e, forward and backward, (2, n) each."""
        c = self.columns
        kinetic = np.stack([c["Fc_fwd"], c["Fc_bwd"]])
        return np.log(kinetic), np.stack([c["static_excess_fwd"], c["static_excess_bwd"]])

    @cached_property
    def slipping(self) -> Array:
        """Deflection s z in slip, in, as a polynomial of the share of static friction.

        Its coefficients from the highest power on, forward and backward, (`POWERS`, 2, n).
        """
        log, excess = self.friction
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, POWERS))
        sign = np.array([[1.0], [-1.0]])
        force = np.exp(log) * (1.0 + excess * share[:, None, None])
        at = sign * self.spring.deflection(sign * force, close=1e-4)
        return np.tensordot(np.linalg.inv(np.vander(share)), at, 1)

    @cached_property
    def onset(self) -> Array:
        """Exponent times slope of the spring in slip, forward and backward, (2, n), kip/in."""
        sign = np.array([[1.0], [-1.0]])
        return self.columns["n"] * self.spring.evaluate(sign * self.slipping[-1])[1]

    @cached_property
    def reach(self) -> Array:
        """Exponent times steepest slope, (n,), kip/in.

        Divided by a slip force it is at least the reciprocal of the length over which slip sets in
        there, whatever the actuation.
        """
        c = self.columns
        return np.asarray(c["n"] * (np.maximum(c["k_fwd"], c["k_bwd"]) + c["k_0"]))

    @cached_property
    def plans(self) -> list[tuple[NDArray[np.intp], Plan]]:
        """Vectors that share a plan, with it.

        A vector's plan depends on its own parameters alone, so that its force does not depend on
        the others in its batch. Lengths are rounded to powers of √2 and of 2, so few plans do.
        """
        c, rate = self.columns, self.material.rate
        fine, coarse = RESOLVED
        step = np.minimum(fine, coarse * c["n"]) / rate
        static = [c[f"Fc_{s}"] * (1.0 + c[f"static_excess_{s}"]) / c[f"k_{s}"] for s in SIDES]
        window = c["gap"] + sum(static) + SURE / rate
        fineness = np.clip(np.floor(2.0 * np.log2(step)), -99.0, 99.0)
        steps = np.clip(2.0 * np.ceil(np.log2(window)) - fineness, 0.0, 16.0)
        keys, which = np.unique(np.stack([fineness, steps], axis=1), axis=0, return_inverse=True)
        return [
            (np.flatnonzero(which.ravel() == i), Plan(2.0 ** (0.5 * h), 2.0 ** (0.5 * (h + w))))
            for i, (h, w) in enumerate(keys.tolist())
        ]

    @cached_property
    def plan_of_each(self) -> tuple[list[Plan], NDArray[np.intp]]:
        """The plans, and which of them each vector has, (n,)."""
        which = np.empty(self.size, dtype=np.intp)
        for i, (chosen, _) in enumerate(self.plans):
            which[chosen] = i
        return [plan for _, plan in self.plans], which

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """Deflections z, (n,) each, in, between which a motion may begin."""
        c = self.columns
        half = 0.5 * c["gap"]
        return -half - c["Fc_bwd"] / c["k_bwd"], half + c["Fc_fwd"] / c["k_fwd"]

    def begin(self, start: Array) -> Array:
        """Deflection z at the first sample, (n,), in, at a share of its range."""
        low, high = self.range
        return low + start * (high - low)

    def place(self, z: Array) -> Array:
        """Share of the range at a deflection z, (n,), in; what lies beyond is at its end."""
        low, high = self.range
        return np.clip((z - low) / (high - low), 0.0, 1.0)

    def taken_over(self, z: Array, other: Damper) -> Array:
        """Deflection z, (n,), in, that a deflection of other dampers is in these.

        Inside the gap it is the same share of the gap, and beyond it the spring keeps its
        deflection.
        """
        theirs, own = 0.5 * other.columns["gap"], 0.5 * self.columns["gap"]
        inside = np.clip(z, -theirs, theirs)
        share = np.divide(inside, theirs, out=np.zeros(z.shape), where=theirs > 0)
        return share * own + z - inside


SIDES = ("fwd", "bwd")


def courses(damper: Damper, moves: Array) -> Iterator[tuple[NDArray[np.intp], Course]]:
    """Courses of a motion's steps, (M,), in, each with the vectors that follow it.

    Vectors with similar plans go together, which is faster than one plan after the other.
    """
    cuts = [(chosen, cut(moves, plan, Place())) for chosen, plan in damper.plans]
    cuts.sort(key=lambda part: -part[1].sign.size)
    while cuts:
        longest = cuts[0][1].sign.size
        near = [(longest - c.sign.size) * some.size <= WORTH for some, c in cuts]
        chosen, those = zip(*[part for part, n in zip(cuts, near, strict=True) if n], strict=True)
        cuts = [part for part, n in zip(cuts, near, strict=True) if not n]
        which = np.repeat(np.arange(len(those)), [some.size for some in chosen])
        yield np.concatenate(chosen), side_by_side(list(those), which)


@dataclass(frozen=True, eq=False)
class Drive:
    """What drives dampers along a course: speeds and, where friction follows it, the actuation.

    Attributes
    ----------
    rate : (M,), in/s
        Velocity in each step of the uncut motion.
    shares : dict of (M + 1, n) or (M + 1, 1)
        Factors of the slip forces at the ends of those steps, by name; empty when constant.
    """

    rate: Array
    shares: Shares


def follow(damper: Damper, course: Course, drive: Drive, first: Array) -> tuple[Array, Array]:
    """Spring force after each step of the uncut motion, (M, n), kip, and the last z, (n,), in."""
    force = np.empty((course.ends.size, damper.size))
    z = first
    for begin, end, rows in _pieces(damper, course, drive):
        part, z = advance(damper.material, rows, z)
        low, high = np.searchsorted(course.ends, [begin + 1, end + 1])
        force[low:high] = part[course.ends[low:high] - begin - 1]
    return force, z


def _pieces(damper: Damper, course: Course, drive: Drive) -> Iterator[tuple[int, int, Rows]]:
    length = max(PIECE // max(damper.size, 1), 1)
    for begin in range(0, course.sign.size, length):
        end = min(begin + length, course.sign.size)
        part = slice(begin, end)
        yield begin, end, rows_of(damper, course, part, drive)


def rows_of(damper: Damper, course: Course, part: slice, drive: Drive) -> Rows:
    """Part of a course, with the slip force in each step."""
    n = damper.columns["n"]
    sign, origin = course.sign[part], course.origin[part]
    back = (sign < 0).astype(np.intp)
    room = np.empty((back.size, damper.size))
    static = outer(drive.rate[origin] ** 2, -1.0 / damper.columns["v_s"] ** 2, out=room)
    np.exp(static, out=static)
    kinetic, excess = damper.friction
    level = excess.take(back, axis=0)
    level *= static
    level += 1.0
    np.log(level, out=level)
    level += kinetic.take(back, axis=0)
    way, uneven = course.way[part], bool(drive.shares)
    if uneven:
        level += np.log(_shares(course, part, drive, back))
        force = np.exp(level)
        bound, length = _bounds(damper, force, sign), force / damper.reach
    else:
        bound, length = _in_slip(damper, static, back), 1.0 / damper.material.rate[None]
    slip, most = _at_once(damper, way, length, (level, sign)), 2.0 * length
    level *= n
    onset = None if uneven else damper.onset
    return Rows(way, sign[:, None], level, bound, most, slip, uneven, onset)


def _in_slip(damper: Damper, static: Array, back: NDArray[np.intp]) -> Array:
    """About the deflection s z in slip, (R, n), in, at shares of static friction."""
    bound: Array = damper.slipping[0].take(back, axis=0)
    for coefficient in damper.slipping[1:]:
        bound *= static
        bound += coefficient.take(back, axis=0)
    return bound


def _at_once(damper: Damper, way: Array, length: Array, slip: tuple[Array, Array]) -> Array | None:
    """Deflection s z in slip of steps far longer than the length over which it sets in, (R, n).

    NaN of all other steps; None where there are no such steps. `length` is (R, n), or (1, n) where
    it is the same in all steps; `slip` has the logarithm of the slip force and the direction.
    """
    if np.all(way.max(axis=0) <= STIFF * length.min(axis=0)):
        return None
    level, sign = slip
    row, column = np.nonzero(way > STIFF * length)
    found = np.full(level.shape, np.nan)
    force = sign[row] * np.exp(level[row, column])
    found[row, column] = sign[row] * damper.spring.of(column).deflection(force)
    return found


def _shares(course: Course, part: slice, drive: Drive, back: NDArray[np.intp]) -> Array:
    """Factor of the slip force in each step, (R, n) or (R, 1)."""
    origin, middle = course.origin[part], course.share[part]
    found = []
    for side in SIDES:
        share = drive.shares.get(f"Fc_{side}", np.ones((drive.rate.size + 1, 1)))
        found.append((1.0 - middle) * share[origin] + middle * share[origin + 1])
    return np.maximum(np.where(back[:, None] == 0, *found), FLOOR)


def _bounds(damper: Damper, level: Array, sign: Array) -> Array:
    """About the deflection s z at which the spring holds the slip forces, (R, n)."""
    spring, signed = damper.spring, sign[:, None] * level
    most = np.max(
        np.abs(spring.deflection(np.stack([signed.min(axis=0), signed.max(axis=0)]))), axis=0
    )
    z = np.linspace(-most, most, GRID)
    force = spring.force(z)
    found = [np.interp(signed[:, i], force[:, i], z[:, i]) for i in range(damper.size)]
    return sign[:, None] * np.stack(found, axis=1)
