"""The response of a building with dampers: draws of its peaks, their bands, and its histories."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import NotThereError
from mfd_bayes.response.building import Building
from mfd_bayes.response.device_draws import Dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.units import GRAVITY

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.9, 0.95)  # of the equal-tailed bands
OPEN = 0.005  # share of the time in steps that should have been shorter, from which a draw is named
PER_DRAW = (
    *("drift", "acceleration", "base_shear", "force", "travel", "energy", "residual"),
    *("unstable", "open", "imbalance", "change", "steps"),
)
"""Arrays (n, g, …) of a response."""

PER_GROUND = ("histories", "travels", "forces")
"""Tuples of arrays (n, T, …), one for each ground motion."""


@dataclass(frozen=True)
class Row:
    """A peak and its bands.

    Attributes
    ----------
    quantity, ground, place : str
    unit : str
        Internal, or "1" of a ratio.
    median, mean : float
    bands : tuple of (lower, upper)
        For `PROBABILITIES`.
    bare, plain : float
        The same without dampers, and with plain friction of the median slip force; NaN where it
        has no meaning.
    lower, upper : float
        The same with all dampers at their lower, and at their upper, design value; NaN where the
        bounds are not known.
    """

    quantity: str
    ground: str
    place: str
    unit: str
    median: float
    mean: float
    bands: tuple[tuple[float, float], ...]
    bare: float = np.nan
    plain: float = np.nan
    lower: float = np.nan
    upper: float = np.nan


@dataclass(frozen=True)
class Passing:
    """Probability that a limit is passed somewhere in the building, and its standard error."""

    quantity: str
    ground: str
    limit: float
    unit: str
    probability: float
    error: float


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
        The largest of inertia.
    force, travel, energy : (n, g, m), kip, in, kip in
        Largest force and travel of each damper, and the energy that it took.
    residual : (n, g, S), in
        Mean drift over the last two fundamental periods.
    unstable : (n, g) bool
        Draws that ran away.
    open : (n, g)
        Share of the time in steps that should have been shorter still.
    imbalance : (n, g)
        Largest energy that is not accounted for, over the largest input.
    change : (n, g)
        Estimated error of the largest drift, relative.
    steps : (n, g), s
        Shortest step of each.
    histories : tuple of (n, T, S), in
        Drift at the samples of each ground motion.
    travels, forces : tuple of (k, T, m), in, kip
        Of the dampers of the first k draws.
    references : mapping of str to Response
        Of one draw each: "bare", without dampers; "plain", with plain friction of the median
        slip forces; "lower" and "upper", with all dampers at those design values.
    tolerance : float
        Error up to which a draw counts as settled.
    remarks : tuple of str
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
    unstable: NDArray[np.bool_]
    open: Array
    imbalance: Array
    change: Array
    steps: Array
    histories: tuple[Array, ...]
    travels: tuple[Array, ...]
    forces: tuple[Array, ...]
    references: Mapping[str, Response] = field(default_factory=dict)
    tolerance: float = 0.01
    remarks: tuple[str, ...] = ()

    @classmethod
    def of_ground(
        cls, building: Building, ground: Ground, dampers: Dampers, arrays: Mapping[str, Array]
    ) -> Response:
        """Response to one ground motion, from arrays (n, …) by name; see `arrays`."""
        found: dict[str, Any] = {name: arrays[name][:, None] for name in PER_DRAW}
        found |= {name: (arrays[name],) for name in PER_GROUND}
        return cls(building, (ground,), dampers, **found)

    def put(self, rows: NDArray[np.intp], part: Response) -> None:
        """Put the response of some draws to its first ground motion in place."""
        for name, new in part.arrays.items():
            self.arrays[name][rows[: len(new)]] = new

    @property
    def arrays(self) -> dict[str, Array]:
        """What was computed under the first ground motion, (n, …) by name."""
        found = {name: getattr(self, name)[:, 0] for name in PER_DRAW}
        return found | {name: getattr(self, name)[0] for name in PER_GROUND}

    @property
    def bare(self) -> Response:
        """Of the building without dampers, one draw."""
        return self.references["bare"]

    @property
    def plain(self) -> Response:
        """Of the building with plain friction of the median slip forces, one draw."""
        return self.references["plain"]

    @property
    def draws(self) -> int:
        """Number of draws n."""
        return len(self.drift)

    @property
    def unsettled(self) -> NDArray[np.bool_]:
        """Draws with a larger error than the tolerance, or steps that should be shorter, (n, g)."""
        return np.asarray(((self.change > self.tolerance) | (self.open > OPEN)) & ~self.unstable)

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
                (self.unstable, "diverged and are left out of every figure"),
                (self.unsettled, f"may be off by more than {self.tolerance:.2g}"),
            ):
                at = np.flatnonzero(flags[:, g])
                if at.size:
                    listed = ", ".join(map(str, at[:10])) + (", …" if at.size > 10 else "")
                    found.append(
                        f"{ground.name}: {at.size} of {self.draws} draws {words}: {listed}"
                    )
        return tuple(found)

    def quantities(self) -> dict[str, tuple[str, tuple[str, ...], Array]]:
        """Unit, names of the places and values (n, g, places) of each quantity of the tables."""
        storeys = self.building.floors
        floors = tuple(f"floor {i + 1}" for i in range(self.building.freedoms))
        names = tuple(device.name for device in self.building.devices)
        found = {
            "drift ratio": ("1", storeys, self.drift_ratio),
            "drift": ("in", storeys, self.drift),
            "acceleration": ("in/s^2", floors, self.acceleration),
            "base shear": ("kip", ("base",), self.base_shear[..., None]),
            "residual drift": ("in", storeys, np.abs(self.residual)),
            "residual drift ratio": ("1", storeys, np.abs(self.residual) / self.building.heights),
            "damper travel": ("in", names, self.travel),
            "damper force": ("kip", names, self.force),
            "damper energy": ("kip*in", names, self.energy),
        }
        if not np.all(np.isfinite(self.building.heights)):
            del found["drift ratio"], found["residual drift ratio"]
        return found

    def rows(self) -> Iterator[Row]:
        """Peaks and residuals with their bands, for each record and place."""
        references = {name: one.quantities() for name, one in self.references.items()}
        for g, ground in enumerate(self.grounds):
            for quantity, (unit, places, values) in self.quantities().items():
                used = values[self.usable(g), g]
                if quantity == "residual drift ratio" or not len(used):
                    continue
                for i, place in enumerate(places):
                    own = used[:, i]
                    tails = ((0.5 * (1 - p), 0.5 * (1 + p)) for p in PROBABILITIES)
                    ends = (np.quantile(own, tail).tolist() for tail in tails)
                    of_damper = quantity.startswith("damper")
                    others = [
                        np.nan
                        if name not in references or (of_damper and name in ("bare", "plain"))
                        else float(references[name][quantity][2][0, g, i])
                        for name in ("bare", "plain", "lower", "upper")
                    ]
                    yield Row(
                        *(quantity, ground.name, place, unit),
                        float(np.median(own)),
                        float(own.mean()),
                        tuple((low, high) for low, high in ends),
                        *others,
                    )

    def limits(self) -> Iterator[Passing]:
        """Probability of passing each limit, under each ground motion, with its error."""
        given, quantities = self.building.limits, self.quantities()
        limits = {
            "drift ratio": given.drift,
            "acceleration": given.acceleration,
            "base shear": given.base_shear,
            "damper travel": given.travel,
            "residual drift ratio": given.residual,
        }
        for quantity, limit in limits.items():
            if limit is None or not quantities[quantity][1]:
                continue
            unit, _, values = quantities[quantity]
            for g, ground in enumerate(self.grounds):
                passed = (values[self.usable(g), g] > limit).any(axis=1)
                n = len(passed)
                p = float(passed.mean()) if n else np.nan
                # with the centre of Agresti and Coull, so that 0 of n has an error too
                centre = (p * n + 2.0) / (n + 4.0)
                error = float(np.sqrt(centre * (1.0 - centre) / (n + 4.0)))
                yield Passing(quantity, ground.name, limit, unit, p, error)

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


def combined(parts: Sequence[Sequence[Response]], dampers: Dampers) -> Response:
    """Response of all dampers to all ground motions, from parts.

    For each ground motion there is one part after another of the draws, with the response to it.
    """
    found: dict[str, Any] = {
        name: np.concatenate(
            [np.concatenate([getattr(part, name) for part in one]) for one in parts], axis=1
        )
        for name in PER_DRAW
    }
    for name in PER_GROUND:
        found[name] = tuple(
            np.concatenate([getattr(part, name)[0] for part in one]) for one in parts
        )
    grounds = tuple(one[0].grounds[0] for one in parts)
    return replace(parts[0][0], grounds=grounds, dampers=dampers, **found)


# --- which uncertainty matters

ORDERS = 24  # orders in which sources are added; the share of each is its mean gain
FEWEST = 30  # fewest draws, of those that did not run away, of which there are shares
PLACES = 6  # dampers whose own values are columns of the regression, beside the mean over all
REST = "interactions and the rest"


@dataclass(frozen=True)
class Shares:
    """Shares of the sources in the variance of a peak, within one ground motion."""

    quantity: str
    ground: str
    shares: Mapping[str, float]


def variance_shares(
    response: Response, quantity: str = "drift", ground: int = 0, seed: int = 0
) -> dict[str, float]:
    """Shares of the sources in the variance of the largest of a quantity; their sum is 1.

    They are those within one ground motion, by its number from 0. Empty where there are fewer than
    `FEWEST` draws, or all are equal.

    The peak is regressed on the dampers' values (linear and quadratic, as means over the dampers
    and of each by itself), and the explained variance, adjusted for the number of columns, is
    divided by the mean gain over orders of adding the sources (Lindeman, Merenda and Gold, 1980).
    What no source explains stays as "interactions and the rest".

    Parameters
    ----------
    quantity : {"drift", "acceleration", "base_shear", "travel"}
    """
    good = response.usable(ground)
    values = response.measure(quantity)[good, ground]
    if len(values) < FEWEST or np.ptp(values) <= 0.0:
        return {}
    columns = {}
    for name, about in response.dampers.about.items():
        mean = about[good].mean(axis=1)
        column = np.column_stack([mean, (mean - mean.mean()) ** 2, about[good][:, :PLACES]])
        spread = column.std(axis=0)
        if np.any(spread > 0):
            columns[name] = ((column - column.mean(axis=0))[:, spread > 0]) / spread[spread > 0]
    within = values - values.mean()

    def explained(names: list[str]) -> float:
        design = np.concatenate([columns[name] for name in names], axis=1)
        fit, _, rank, _ = np.linalg.lstsq(design, within, rcond=1e-8)
        freedom = len(within) - 1 - int(rank)
        if freedom <= 0:
            return 0.0
        left = np.sum((within - design @ fit) ** 2) / np.sum(within**2)
        return max(0.0, 1.0 - float(left) * (len(within) - 1) / freedom)

    gains, rng = dict.fromkeys(columns, 0.0), np.random.default_rng(seed)
    for _ in range(ORDERS):
        order, before = rng.permutation(list(columns)).tolist(), 0.0
        for k, name in enumerate(order, start=1):
            after = max(before, explained(order[:k]))
            gains[name] += (after - before) / ORDERS
            before = after
    return {**gains, REST: max(0.0, 1.0 - sum(gains.values()))}
