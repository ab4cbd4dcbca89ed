"""A bank of Bouc-Wen dampers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.banks.bank import Array, Scales, with_scales, with_state
from mfd_bayes.friction.banks.turns import turns_within
from mfd_bayes.friction.bouc_wen import FLOOR, BoucWen, State
from mfd_bayes.friction.hysteresis import Curve


@dataclass(frozen=True, eq=False)
class HystereticBank:
    """Bouc-Wen dampers, each with its own motion; equals `BoucWen.step` of each.

    Attributes
    ----------
    columns : dict of (n,)
        Parameters by name.
    curve : Curve
        Of all n.
    z, displacement, velocity : (n,), kip, in, in/s
    scales : dict of (n,)
        Factors of F_y at the last sample.
    """

    columns: dict[str, Array]
    curve: Curve
    z: Array
    displacement: Array
    velocity: Array
    scales: dict[str, Array]

    @classmethod
    def at_rest(cls, model: BoucWen, theta: ArrayLike) -> HystereticBank:
        """Dampers at rest at displacement 0, without force."""
        state: State = model.start(theta)
        zero = np.zeros(state.z.size)
        return cls(state.columns, state.curve, zero, zero, zero, {})

    @property
    def force(self) -> Array:
        """F = α k x + (1 − α) z + c v, (n,), kip."""
        alpha, k, c = (self.columns[name] for name in ("alpha", "k", "c"))
        return np.asarray(
            alpha * k * self.displacement + (1.0 - alpha) * self.z + c * self.velocity
        )

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> HystereticBank:
        """State at the next sample; see `Bank.step`."""
        after = dict(scales or {})
        before = {name: self.scales.get(name, np.ones(share.size)) for name, share in after.items()}
        z, x = self.z, self.displacement
        turns = turns_within(x, self.velocity, displacement, velocity, dt)
        if turns.rows.size:
            rows, early = turns.rows, turns.share < 0.5
            x, z = x.copy(), z.copy()
            start = {name: share[rows] for name, share in before.items()}
            middle = {n: np.where(early, start[n], late[rows]) for n, late in after.items()}
            z[rows] = self._advanced(z[rows], turns.vertex - x[rows], start, middle, rows)
            x[rows] = turns.vertex
            before = {n: share.copy() for n, share in before.items()}
            for name, share in before.items():
                share[rows] = middle[name]
        z = self._advanced(z, displacement - x, before, after)
        return replace(self, z=z, displacement=displacement, velocity=velocity, scales=after)

    def _advanced(
        self,
        z: Array,
        way: Array,
        before: Scales,
        after: Scales,
        rows: NDArray[np.intp] | None = None,
    ) -> Array:
        """Force z after a way, (n,) in, of all dampers or of some `rows`."""
        pick = slice(None) if rows is None else rows
        sign = np.where(way > 0, 1.0, -1.0)
        shares = {
            side: np.maximum(0.5 * (before[side] + after[side]), FLOOR) if after else 1.0
            for side in ("Fy_fwd", "Fy_bwd")
        }
        forward = self.columns["Fy_fwd"][pick] * shares["Fy_fwd"]
        strength = sign * np.where(
            way > 0, forward, self.columns["Fy_bwd"][pick] * shares["Fy_bwd"]
        )
        curve = self.curve if rows is None else chosen_curve(self.curve, rows)
        far = self.columns["k"][pick] / np.abs(strength) * np.abs(way)
        w = curve.value(curve.move(curve.place(z / strength)[:, None], far[:, None]))[:, 0]
        return np.where(way == 0.0, z, w * strength)

    def chosen(self, rows: NDArray[np.intp]) -> HystereticBank:
        """The bank of some of its dampers."""
        return HystereticBank(
            {name: column[rows] for name, column in self.columns.items()},
            chosen_curve(self.curve, rows),
            self.z[rows],
            self.displacement[rows],
            self.velocity[rows],
            {name: column[rows] for name, column in self.scales.items()},
        )

    def replaced(self, rows: NDArray[np.intp], part: HystereticBank) -> HystereticBank:
        """The bank with the state of some of its dampers replaced; see `Bank.replaced`."""
        whole = with_state(self, ("z", "displacement", "velocity"), rows, part)
        return replace(whole, scales=with_scales(self.scales, rows, part.scales))


def chosen_curve(curve: Curve, rows: NDArray[np.intp]) -> Curve:
    """The curves of some vectors."""
    n = len(curve.parts[0])
    tables = {
        name: getattr(curve, name).reshape(n, curve.cells)[rows].ravel()
        for name in ("low", "rise", "entry", "bend")
    }
    # keys of a vector begin at 4 times its number
    keys = curve.keys.reshape(n, curve.cells + 1)[rows]
    keys = keys + 4.0 * (np.arange(len(rows)) - rows)[:, None]
    parts = [part[rows] for part in curve.parts]
    return Curve(parts, curve.cells, **tables, keys=keys.ravel())
