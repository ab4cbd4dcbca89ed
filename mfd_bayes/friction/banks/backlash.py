"""A bank of LuGre dampers with a backlash spring (model.md section 9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.banks.bank import Array, Scales, with_scales, with_state
from mfd_bayes.friction.banks.turns import turns_within
from mfd_bayes.friction.damper import Damper
from mfd_bayes.friction.driven import FLOOR

Rows = NDArray[np.intp]

LONGEST = 0.4
"""Longest part of a step, over the length in which slip sets in."""

PARTS = 24
"""Most parts of a step; what is longer ends in slip whatever the parts are."""

ITERATIONS = 12
CLOSE = 1e-10
"""Newton's iterations end when deflections change by less than this, in."""

_ROOT = 1.0 - 0.5 * np.sqrt(2.0)
"""γ of the two-stage, stiffly accurate method of order two of Alexander (1977)."""


@dataclass(frozen=True, eq=False)
class BacklashBank:
    """Dampers with a backlash spring, each with its own motion; as `BacklashLuGre.step` of each.

    Between samples the velocity is constant, so the deflection follows the way: dz/dw = s f with
    f = 1 − ½ [1 + sgn(s G)] |G/g|ⁿ, direction s. Unloading, f = 1; else it is integrated by an
    L-stable method in parts of `LONGEST` of the length in which slip sets in.

    Attributes
    ----------
    damper : Damper
    z, displacement, velocity : (n,), in, in, in/s
    spring : (n,), kip
        Force G(z).
    scales : dict of (n,)
        Factors of F_c at the last sample.
    """

    damper: Damper
    z: Array
    displacement: Array
    velocity: Array
    spring: Array
    scales: dict[str, Array]

    @classmethod
    def at_rest(
        cls, model: BacklashLuGre, theta: ArrayLike, start: ArrayLike | None = None
    ) -> BacklashBank:
        """Dampers at rest at displacement 0."""
        places = None if start is None else np.asarray(start, dtype=np.float64)
        state = model.start(theta, places)
        z, force, _ = state.bent
        zero = np.zeros(z.size)
        return cls(state.damper, z, zero, zero, force, {})

    @property
    def force(self) -> Array:
        """F = G(z) + σ2 v, (n,), kip."""
        return np.asarray(self.spring + self.damper.columns["sigma2"] * self.velocity)

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> BacklashBank:
        """State at the next sample; see `Bank.step`."""
        x, z, left = self.displacement, self.z, np.full(self.z.size, dt)
        turns = turns_within(x, self.velocity, displacement, velocity, dt)
        late = dict(scales or {})
        early = {name: self.scales.get(name, np.ones(z.size)) for name in late}
        if turns.rows.size:
            rows = turns.rows
            part = self.chosen(rows)
            x, z = x.copy(), z.copy()
            early = {name: share.copy() for name, share in early.items()}
            begin = {name: share[rows] for name, share in early.items()}
            for name, share in early.items():  # that at the turn, of the nearer sample
                share[rows] = np.where(turns.share < 0.5, share[rows], late[name][rows])
            end = {name: share[rows] for name, share in early.items()}
            way = turns.vertex - x[rows]
            z[rows] = part._moved(z[rows], way, turns.share * dt, (begin, end))
            x[rows] = turns.vertex
            left[rows] *= 1.0 - turns.share
        z = self._moved(z, displacement - x, left, (early, late))
        spring = self.damper.spring.force(z)
        return replace(
            self,
            z=z,
            displacement=displacement,
            velocity=velocity,
            spring=spring,
            scales=late,
        )

    def _moved(self, z: Array, way: Array, dt: Array, scales: tuple[Scales, Scales]) -> Array:
        """Deflection after a straight way, (n,), in; factors of F_c before and after it."""
        sign = np.where(way < 0, -1.0, 1.0)
        after = z + way
        # where the spring still pushes with the motion at the end, nothing slid
        rows = np.flatnonzero(sign * self.damper.spring.force(after) > 0)
        if not rows.size:
            return after
        some, speed = self.damper.of(rows), np.abs(way[rows]) / dt[rows]
        ends = [{name: share[rows] for name, share in s.items()} for s in scales]
        slide = _Slide(some, sign[rows], *(slip_force(some, sign[rows], speed, e) for e in ends))
        after[rows] = slide.after(z[rows], np.abs(way[rows]))
        return after

    def chosen(self, rows: Rows) -> BacklashBank:
        """The bank of some of its dampers."""
        return BacklashBank(
            self.damper.of(rows),
            self.z[rows],
            self.displacement[rows],
            self.velocity[rows],
            self.spring[rows],
            {name: share[rows] for name, share in self.scales.items()},
        )

    def replaced(self, rows: Rows, part: BacklashBank) -> BacklashBank:
        """The bank with the state of some of its dampers replaced; see `Bank.replaced`."""
        whole = with_state(self, ("z", "displacement", "velocity", "spring"), rows, part)
        return replace(whole, scales=with_scales(self.scales, rows, part.scales))


@dataclass(frozen=True, eq=False)
class _Slide:
    """Dampers that are pushed in the directions `sign`; g at the begin and end of a step, kip."""

    damper: Damper
    sign: Array
    begin: Array
    end: Array

    def after(self, z: Array, way: Array) -> Array:
        """Deflection after a way, of each in as many parts as it needs."""
        n = self.damper.columns["n"]
        steepest = np.maximum(self.damper.columns["k_fwd"], self.damper.columns["k_bwd"])
        parts = np.clip(np.ceil(way * n * steepest / self.begin / LONGEST), 1, PARTS)
        for part in range(int(parts.max())):
            step = np.where(part < parts, way / parts, 0.0)
            middle, end = (self._slip(part + share, parts) for share in (_ROOT, 1.0))
            first, rate = self._stage(z, z, _ROOT * step, middle)
            known = z + (1.0 - _ROOT) * step * self.sign * rate
            z = self._stage(known, first, _ROOT * step, end)[0]
        return z

    def _slip(self, part: float, parts: Array) -> Array:
        """Slip force g within a step, (n,), kip."""
        share = np.minimum(part / parts, 1.0)
        return np.asarray(self.begin + share * (self.end - self.begin))

    def _stage(self, known: Array, z: Array, step: Array, g: Array) -> tuple[Array, Array]:
        """Solution of z = known + step s f(z) by Newton's method, and f there."""
        n = self.damper.columns["n"]
        for _ in range(ITERATIONS):
            force, slope = self.damper.spring.evaluate(z)
            push = np.maximum(self.sign * force / g, 0.0)
            raised = np.minimum(push, 2.0) ** n
            f = 1.0 - raised
            steep = n * raised / np.maximum(push, 1e-12) * slope / g
            change = (known + step * self.sign * f - z) / (1.0 + step * steep)
            z = z + change
            if np.max(np.abs(change)) < CLOSE:
                break
        return z, np.asarray(f)


def slip_force(damper: Damper, sign: Array, speed: Array, scales: Scales) -> Array:
    """g(v) = F_c [1 + e exp(−(v/v_s)²)] in the directions `sign`, (n,), kip."""
    c = damper.columns
    sides = []
    for side in ("fwd", "bwd"):
        kinetic = c[f"Fc_{side}"] * np.maximum(scales.get(f"Fc_{side}", 1.0), FLOOR)
        static = c[f"static_excess_{side}"] * np.exp(-((speed / c["v_s"]) ** 2))
        sides.append(kinetic * (1.0 + static))
    return np.where(sign > 0, *sides)
