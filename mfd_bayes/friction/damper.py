"""The backlash model's parameters, and what follows from them alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.course import Plan
from mfd_bayes.friction.newton import Material
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]

RESOLVED = (2.0, 0.4)
"""Longest step near a turn: over the length in which slip sets in, and over n times that length.
Random walks and real records are then within 0.07 % of steps a tenth as long.
"""

SURE = 7.0
"""Lengths over which slip sets in, after which it surely has."""

LITTLE = 0.2
"""Share of the slip force that a device at rest without load bears at most.

The load cell shows less than 0.1 at the start of all 32 records of shared/data/brfd. The limit is
twice as much, since the corners of fitted springs are not exact: at the start of tests whose load
cell shows 0.02, some of these springs bear 0.1.
"""

POWERS = 5
"""Coefficients of the polynomial by which deflections in slip follow static friction."""


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

    @cached_property
    def unloaded(self) -> tuple[Array, Array, Array]:
        """Where the spring bears at most `LITTLE` of the slip force, as a part of the range.

        Its lower and upper end, and the length over which the force doubles there, the mean of both
        ends, (n,) each. The upper end is at least a thousandth above the lower one, also where it
        is then beyond the range.
        """
        (low, high), c = self.range, self.columns
        slip = np.stack([-c["Fc_bwd"], c["Fc_fwd"]])
        shares = np.array([LITTLE, 2.0 * LITTLE])[:, None, None]
        at = self.spring.deflection(shares * slip, close=1e-4)
        lower, upper = np.clip((at[0] - low) / (high - low), 0.0, 1.0)
        edge = 0.5 * np.abs(at[1] - at[0]).sum(axis=0) / (high - low)
        return lower, np.maximum(upper, lower + 1e-3), edge

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
