"""The response of a building with dampers, as draws and as bands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import NotThereError
from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.rows import PROBABILITIES, UNITS, Passing, Row
from mfd_bayes.response.settling import Settled
from mfd_bayes.units import GRAVITY

__all__ = ["PROBABILITIES", "Passing", "Reference", "Response", "Row"]

Array = NDArray[np.float64]

OPEN = 0.005
"""Share of steps without equilibrium from which a draw is named."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Peaks of one building without uncertainty; `history` is the drift, (T, S), in."""

    drift: Array
    acceleration: Array
    base_shear: float
    residual: Array
    history: Array


@dataclass(frozen=True, eq=False)
class Response:
    """Response of n draws of a building to g ground motions.

    Attributes
    ----------
    drift : (n, g, S), in
        Largest storey drifts.
    acceleration : (n, g, N), in/s²
        Largest absolute accelerations of the floors.
    base_shear : (n, g), kip
    force, travel, energy : (n, g, m), kip, in, kip in
        Largest force and travel of each damper, and the energy that it took.
    residual : (n, g, S), in
        Mean drift over the last two periods.
    histories : tuple of (n, T, S), in
        Drift at the samples of each ground motion.
    loops : tuple of pairs of (k, T, m), in, kip
        Travel and force of the dampers of the first draws.
    unstable, unsettled : (n, g) bool
        Draws that ran away; draws whose peaks still changed by more than the tolerance, or in
        which steps ended without equilibrium.
    imbalance : (n, g)
        Largest energy that is not accounted for, over the largest input.
    change, steps : (n, g)
        Change of the peaks at the last halving of the step, and that step, s.
    """

    building: Building
    grounds: tuple[Ground, ...]
    dampers: Dampers
    drift: Array
    acceleration: Array
    base_shear: Array
    force: Array
    travel: Array
    energy: Array
    residual: Array
    histories: tuple[Array, ...]
    loops: tuple[tuple[Array, Array], ...]
    unstable: NDArray[np.bool_]
    unsettled: NDArray[np.bool_]
    imbalance: Array
    change: Array
    steps: Array
    bare: tuple[Reference, ...]
    plain: tuple[Reference, ...]
    tolerance: float
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        building: Building,
        grounds: Sequence[Ground],
        dampers: Dampers,
        found: Sequence[tuple[Settled, Reference, Reference]],
        tolerance: float,
    ) -> Response:
        """Response out of the histories of each ground motion.

        `found` has, for each, the draws' histories, that without dampers, and that with springs.
        """
        settled, bare, plain = zip(*found, strict=True)
        peaks = [s.peaks for s in settled]
        change = np.stack([s.change for s in settled], axis=1)
        unstable = np.stack([s.unstable for s in settled], axis=1)
        loose = np.stack([s.open for s in settled], axis=1) > OPEN
        return cls(
            building,
            tuple(grounds),
            dampers,
            np.stack([p.drift for p in peaks], axis=1),
            np.stack([p.acceleration for p in peaks], axis=1),
            np.stack([p.base_shear for p in peaks], axis=1),
            np.stack([p.force for p in peaks], axis=1),
            np.stack([p.travel for p in peaks], axis=1),
            np.stack([s.energies.dampers for s in settled], axis=1),
            np.stack([s.residual for s in settled], axis=1),
            tuple(s.drifts for s in settled),
            tuple((s.travels, s.forces) for s in settled),
            unstable,
            ((change > tolerance) | loose) & ~unstable,
            np.stack([s.imbalance for s in settled], axis=1),
            change,
            np.stack([s.steps for s in settled], axis=1),
            bare,
            plain,
            tolerance,
        )

    @property
    def draws(self) -> int:
        """Number of draws n."""
        return len(self.drift)

    def usable(self, ground: int) -> NDArray[np.bool_]:
        """Draws that did not run away, (n,), by the number of the ground motion."""
        try:
            return np.asarray(~self.unstable[:, ground])
        except IndexError as error:
            known = f"0 to {len(self.grounds) - 1}"
            raise NotThereError(f"no ground motion {ground!r}: there are {known}") from error

    @property
    def drift_ratio(self) -> Array:
        """Largest drifts over the storeys' heights, (n, g, S)."""
        return self.drift / self.building.heights

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with some draws, in sentences that name them."""
        found = []
        for g, ground in enumerate(self.grounds):
            for flags, words in (
                (self.unstable[:, g], "diverged and are left out of every figure"),
                (self.unsettled[:, g], f"still change by more than {self.tolerance:.2g}"),
            ):
                at = np.flatnonzero(flags)
                if at.size:
                    listed = ", ".join(map(str, at[:10])) + (", …" if at.size > 10 else "")
                    found.append(
                        f"{ground.name}: {at.size} of {self.draws} draws {words}: {listed}"
                    )
        return tuple(found)

    def rows(self) -> Iterator[Row]:
        """Peaks and residuals with their bands, for each record and place."""
        storeys = self.building.floors
        floors = tuple(f"floor {i + 1}" for i in range(self.building.freedoms))
        names = tuple(device.name for device in self.building.devices)
        for g in range(len(self.grounds)):
            bare, plain = self.bare[g], self.plain[g]
            heights = self.building.heights
            if np.all(np.isfinite(heights)):
                other = bare.drift / heights, plain.drift / heights
                yield from self._table("drift ratio", g, storeys, self.drift_ratio, other)
            yield from self._table("drift", g, storeys, self.drift, (bare.drift, plain.drift))
            other = bare.acceleration, plain.acceleration
            yield from self._table("acceleration", g, floors, self.acceleration, other)
            shear = np.array([bare.base_shear]), np.array([plain.base_shear])
            base = self.base_shear[..., None]
            yield from self._table("base shear", g, ("base",), base, shear)
            left = np.abs(bare.residual), np.abs(plain.residual)
            residual = np.abs(self.residual)
            yield from self._table("residual drift", g, storeys, residual, left)
            yield from self._table("damper travel", g, names, self.travel)
            yield from self._table("damper force", g, names, self.force)
            yield from self._table("damper energy", g, names, self.energy)

    def _table(
        self,
        quantity: str,
        g: int,
        places: Sequence[str],
        values: Array,
        others: tuple[Array, Array] | None = None,
    ) -> Iterator[Row]:
        """Rows of a quantity in ground motion g, one for each place."""
        used = values[self.usable(g), g]
        for i, place in enumerate(places):
            own = used[:, i]
            if not own.size:
                continue
            tails = [(0.5 * (1 - p), 0.5 * (1 + p)) for p in PROBABILITIES]
            bands = tuple((float(a), float(b)) for a, b in (np.quantile(own, t) for t in tails))
            beside = (float(others[0][i]), float(others[1][i])) if others else (np.nan, np.nan)
            name = self.grounds[g].name
            middle = float(np.median(own)), float(own.mean())
            yield Row(quantity, name, place, UNITS[quantity], *middle, bands, *beside)

    def limits(self) -> Iterator[Passing]:
        """Probability of passing each limit, under each ground motion, with its error."""
        for quantity, limit, unit, values in self._limited():
            for g, ground in enumerate(self.grounds):
                used = values[self.usable(g), g]
                n = len(used)
                p = float(np.mean(used.reshape(n, -1).max(axis=1) > limit)) if n else np.nan
                # of n draws; with the Agresti–Coull centre, so that 0 of n has an error too
                centre = (p * n + 2.0) / (n + 4.0)
                error = float(np.sqrt(centre * (1.0 - centre) / (n + 4.0)))
                yield Passing(quantity, ground.name, limit, unit, p, error)

    def _limited(self) -> Iterator[tuple[str, float, str, Array]]:
        asked = self.building.limits
        residual = np.abs(self.residual) / self.building.heights
        quantities: Mapping[str, tuple[float | None, str, Array]] = {
            "drift ratio": (asked.drift, "1", self.drift_ratio),
            "acceleration": (asked.acceleration, "in/s^2", self.acceleration),
            "base shear": (asked.base_shear, "kip", self.base_shear[..., None]),
            "damper travel": (asked.travel, "in", self.travel),
            "residual drift ratio": (asked.residual, "1", residual),
        }
        for name, (limit, unit, values) in quantities.items():
            if limit is not None and values.shape[-1]:
                yield name, limit, unit, values

    def measure(self, name: str) -> Array:
        """The largest of a quantity over the building, (n, g).

        It is one of "drift", in; "acceleration", g; "base_shear", kip; "travel", in.
        """
        measures = {
            "drift": self.drift,
            "acceleration": self.acceleration / GRAVITY,
            "base_shear": self.base_shear[..., None],
            "travel": self.travel,
        }
        if name not in measures:
            raise NotThereError(f"no measure {name!r}: there are {', '.join(measures)}")
        return np.asarray(measures[name].max(axis=-1))
