"""Dampers with a backlash spring driven along a motion, for many vectors at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import outer
from mfd_bayes.friction.course import Course, Place, cut, side_by_side
from mfd_bayes.friction.damper import SIDES, Damper
from mfd_bayes.friction.newton import STIFF
from mfd_bayes.friction.slip import Rows, advance

Array = NDArray[np.float64]
Shares = dict[str, Array]

FLOOR = 1e-6
"""Least share of the slip force that is left at zero actuation, so that nothing divides by zero."""

PIECE = 1 << 16
"""Size of a piece's arrays, in numbers: larger ones leave the cache, smaller ones cost calls."""

WORTH = 2000
"""Numbers of an array whose computation takes as long as one more call for few vectors does."""

GRID = 128
"""Deflections at which the spring is inverted for a first guess."""


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
    """Spring force after each step of the uncut motion, (M, n), kip, and the last z, (n,), in.

    Both are NaN for vectors that cannot be solved.
    """
    force, lost = np.empty((course.ends.size, damper.size)), np.zeros(damper.size, dtype=bool)
    z = first
    for begin, end, rows in _pieces(damper, course, drive):
        part, z, unsolved = advance(damper.material, rows, z)
        lost |= unsolved
        z[lost] = 0.0
        low, high = np.searchsorted(course.ends, [begin + 1, end + 1])
        force[low:high] = part[course.ends[low:high] - begin - 1]
    force[:, lost] = np.nan
    return force, np.where(lost, np.nan, z)


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
