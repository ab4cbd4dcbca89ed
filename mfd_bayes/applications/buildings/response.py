"""Response of a building, for many draws of its dampers, and over a range of actuations."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from mfd_bayes.applications.buildings.building import Building, ResponseLimits
from mfd_bayes.applications.buildings.dampers import BOUND, Dampers
from mfd_bayes.errors import BuildingError, NotThereError, UnitError
from mfd_bayes.units import GRAVITY, parse_actuation, percent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mfd_bayes.applications.buildings.ground import Ground
    from mfd_bayes.population.peaks import Peaks


Array = NDArray[np.float64]

Row = dict[str, Any]

PROBABILITIES = (0.5, 0.9, 0.95)  # of the equal-tailed bands
BOUNDS = {"lower": 0.5 * (1.0 - BOUND), "upper": 0.5 * (1.0 + BOUND)}
"""Probability that a new test lies below each bound."""

REFERENCES = ("bare", "plain", *BOUNDS)
STANDARD = ("lambda_min", "lambda_max")
"""References with all dampers at the factors of a standard, where the campaign names one."""
OPEN = 0.005  # share of the time in steps that should have been shorter, from which a draw is named
PER_DRAW = (
    *("drift", "acceleration", "base_shear", "peak_fwd", "peak_bwd", "speed", "travel"),
    *("energy", "residual"),
    *("unstable", "open", "imbalance", "change", "steps"),
)
"""Arrays (n, g, …) of a response."""

PER_GROUND = ("histories", "travels", "forces")
"""Tuples of arrays (n, T, …), one for each ground motion."""


@dataclass(frozen=True, eq=False)
class Response:
    """Response of n draws of a building to g ground motions."""

    building: Building
    grounds: tuple[Ground, ...]
    dampers: Dampers
    drift: Array  # (n, g, S), in, largest storey drifts
    acceleration: Array  # (n, g, N), in/s², largest absolute accelerations of the floors
    base_shear: Array  # (n, g), kip, the largest of inertia
    # (n, g, m), kip, in/s, in, kip in: largest force of each damper by direction, computed or as a
    # load cell sees it; its largest speed and travel, and the energy that it took
    peak_fwd: Array
    peak_bwd: Array
    speed: Array
    travel: Array
    energy: Array
    residual: Array  # (n, g, S), in, mean drift over the last two fundamental periods
    unstable: NDArray[np.bool_]  # (n, g), draws that ran away
    open: Array  # (n, g), share of the time in steps that should have been shorter still
    imbalance: Array  # (n, g), largest energy that is not accounted for, over the largest input
    change: Array  # (n, g), estimated error of the largest drift, relative
    steps: Array  # (n, g), s, shortest step of each
    histories: tuple[Array, ...]  # (n, T, S), in, drift at the samples of each ground motion
    # (k, T, m), in, kip, of the dampers of the first k draws
    travels: tuple[Array, ...]
    forces: tuple[Array, ...]
    # of one draw each: "bare", without dampers; "plain", with plain friction of the median
    # slip forces; "lower" and "upper", with all dampers at those design values; "lambda_min" and
    # "lambda_max" at the mean property times the factors of a standard, where there is one
    references: Mapping[str, Response] = field(default_factory=dict)
    tolerance: float = 0.01  # error up to which a draw counts as settled
    remarks: tuple[str, ...] = ()

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
    def force(self) -> Array:
        """Largest force of each damper, (n, g, m), kip."""
        return np.maximum(self.peak_fwd, self.peak_bwd)

    @property
    def unsettled(self) -> NDArray[np.bool_]:
        """Draws with a larger error than the tolerance, or steps that should be shorter, (n, g)."""
        return ((self.change > self.tolerance) | (self.open > OPEN)) & ~self.unstable

    def usable(self, ground: int) -> NDArray[np.bool_]:
        """Draws that did not run away, (n,), by the number of the ground motion."""
        try:
            return ~self.unstable[:, ground]
        except IndexError as error:
            numbers = f"0 to {len(self.grounds) - 1}"
            raise NotThereError(f"no ground motion {ground!r}: there are {numbers}") from error

    @property
    def drift_ratio(self) -> Array:
        """Largest drifts over the storeys' heights, (n, g, S)."""
        return self.drift / self.building.heights

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with some draws, in sentences that name them."""
        messages = []
        for g, ground in enumerate(self.grounds):
            for flags, words in (
                (self.unstable, "diverged and are left out of every figure"),
                (
                    self.unsettled,
                    f"have a drift that may be off by more than {100.0 * self.tolerance:.2g} %",
                ),
            ):
                indices = np.flatnonzero(flags[:, g])
                if indices.size:
                    listed = ", ".join(map(str, indices[:10])) + (
                        ", …" if indices.size > 10 else ""
                    )
                    messages.append(
                        f"{ground.name}: {indices.size} of {self.draws} draws {words}: {listed}"
                    )
        return tuple(messages)

    def quantities(self) -> dict[str, tuple[str, tuple[str, ...], Array]]:
        """Unit, names of the places and values (n, g, places) of each quantity of the tables."""
        storeys = self.building.floors
        floors = tuple(f"floor {i + 1}" for i in range(self.building.freedoms))
        names = tuple(device.name for device in self.building.devices)
        table = {
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
            del table["drift ratio"], table["residual drift ratio"]
        return table

    def rows(self) -> list[Row]:
        """Median, mean and bands of peaks and residuals, under each ground motion at each place.

        With those of the references, NaN where they have no meaning. A unit of "1" is a ratio's.
        """
        references = {name: of.quantities() for name, of in self.references.items()}
        tails = [(0.5 * (1.0 - p), 0.5 * (1.0 + p)) for p in PROBABILITIES]
        names, rows = [percent(p) for p in PROBABILITIES], []
        for g, ground in enumerate(self.grounds):
            for quantity, (unit, places, values) in self.quantities().items():
                peaks = values[self.usable(g), g]
                if quantity == "residual drift ratio" or not len(peaks):
                    continue
                skipped = ("bare", "plain") if quantity.startswith("damper") else ()
                for i, location in enumerate(places):
                    column = peaks[:, i]
                    bands = [tuple(np.quantile(column, tail).tolist()) for tail in tails]
                    row: Row = {
                        "quantity": quantity,
                        "ground": ground.name,
                        "place": location,
                        "unit": unit,
                        "median": float(np.median(column)),
                        "mean": float(column.mean()),
                        "bands": dict(zip(names, bands, strict=True)),
                        **dict.fromkeys(REFERENCES, np.nan),
                    }
                    for name, of in references.items():
                        if name not in skipped:
                            row[name] = float(of[quantity][2][0, g, i])
                    rows.append(row)
        return rows

    def limits(self) -> list[Row]:
        """Probability of passing each limit in the building, under each motion.

        It is the share of the draws, with its 95 % interval for their number (Jeffreys).
        """
        settings, quantities, rows = self.building.limits, self.quantities(), []
        limits = {
            "drift ratio": settings.drift,
            "acceleration": settings.acceleration,
            "base shear": settings.base_shear,
            "damper travel": settings.travel,
            "residual drift ratio": settings.residual,
        }
        for quantity, limit in limits.items():
            if limit is None or not quantities[quantity][1]:
                continue
            unit, _, values = quantities[quantity]
            for g, ground in enumerate(self.grounds):
                passed = (values[self.usable(g), g] > limit).any(axis=1)
                n = len(passed)
                row = {"quantity": quantity, "ground": ground.name, "limit": limit, "unit": unit}
                counts = {"passed": int(passed.sum()), "draws": n}
                probability = float(passed.mean()) if n else np.nan
                interval = share_interval(counts["passed"], n)
                rows.append(row | counts | {"probability": probability, "interval": interval})
        return rows

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


def share_interval(count: int, n: int) -> tuple[float, float]:
    """Jeffreys interval of a probability of which `count` of n draws are: inside 0 to 1.

    It reaches to 0 where none are, and to 1 where all are (Brown, Cai and DasGupta, 2001).
    """
    tails = 0.5 * (1.0 - 0.95), 0.5 * (1.0 + 0.95)
    low, high = betaincinv(count + 0.5, n - count + 0.5, tails)
    return (float(low) if count else 0.0, float(high) if count < n else 1.0)


def combined(blocks: Sequence[Sequence[Response]], dampers: Dampers) -> Response:
    """Response of all dampers to all ground motions, of parts of the draws under each."""
    by_ground = list(zip(*blocks, strict=True))
    arrays: dict[str, Any] = {
        name: np.concatenate(
            [np.concatenate([getattr(block, name) for block in group]) for group in by_ground],
            axis=1,
        )
        for name in PER_DRAW
    }
    for name in PER_GROUND:
        arrays[name] = tuple(
            np.concatenate([getattr(block, name)[0] for block in group]) for group in by_ground
        )
    grounds = tuple(block.grounds[0] for block in blocks[0])
    return replace(blocks[0][0], grounds=grounds, dampers=dampers, **arrays)


def seen_peaks(response: Response, peaks: Peaks, seed: int, *, scatter: bool) -> Response:
    """The response with the dampers' largest forces as a load cell sees them, as predictions are.

    Each damper of a draw has its own excess, without `scatter` the mean one; all at a bound have a
    bound of the sum of computed force and excess. It is no part of the equation of motion: an
    impact is short.
    """
    rng = np.random.default_rng([seed, 5])
    middle = np.median(response.dampers.slip_forces(), axis=1)

    def seen(of: Response, probability: float | None = None) -> Response:
        sides = []
        computed, slips = (of.peak_fwd, of.peak_bwd), of.dampers.slip_forces()[:, :, None]
        for excess, largest, slip, typical in zip(
            peaks.values(), computed, slips, middle, strict=True
        ):
            if probability is None:
                scores = excess.scores(rng, slip.shape) * scatter
            else:
                spread = largest * np.nan_to_num(np.abs(1.0 - typical / slip))
                scores = excess.bound(probability, spread, of.speed)
            sides.append(excess.seen(largest, of.speed, slip, scores))
        return replace(of, peak_fwd=sides[0], peak_bwd=sides[1])

    references = {
        name: seen(of, BOUNDS.get(name, 0.5)) if name in (*BOUNDS, *STANDARD) else of
        for name, of in response.references.items()
    }
    return replace(seen(response), references=references)


# --- which uncertainty matters

ORDERS = 24  # orders in which sources are added; the share of each is its mean gain
FEWEST = 30  # fewest draws, of those that did not run away, of which there are shares
PLACES = 6  # dampers whose own values are columns of the regression, beside the mean over all
REST = "interactions and the rest"


def variance_shares(
    response: Response, quantity: str = "drift", ground: int = 0
) -> dict[str, float]:
    """Shares of the sources in the variance of the largest of a quantity; their sum is 1.

    They are those within one ground motion, by its number from 0. Empty where there are fewer than
    `FEWEST` draws, or all are equal.

    The peak is regressed on the dampers' values (linear and quadratic, as means over the dampers
    and of each by itself), and the explained variance, adjusted for the number of columns, is
    divided by the mean gain over orders of adding the sources (Lindeman, Merenda and Gold, 1980).
    What no source explains stays as "interactions and the rest".
    """
    usable = response.usable(ground)
    values = response.measure(quantity)[usable, ground]
    if len(values) < FEWEST or np.ptp(values) <= 0.0:
        return {}
    columns = {}
    for name, source in response.dampers.about.items():
        mean = source[usable].mean(axis=1)
        column = np.column_stack([mean, (mean - mean.mean()) ** 2, source[usable][:, :PLACES]])
        spread = column.std(axis=0)
        if np.any(spread > 0):
            columns[name] = ((column - column.mean(axis=0))[:, spread > 0]) / spread[spread > 0]
    centred = values - values.mean()

    def explained(names: list[str]) -> float:
        design = np.concatenate([columns[name] for name in names], axis=1)
        fit, _, rank, _ = np.linalg.lstsq(design, centred, rcond=1e-8)
        freedom = len(centred) - 1 - int(rank)
        if freedom <= 0:
            return 0.0
        unexplained = np.sum((centred - design @ fit) ** 2) / np.sum(centred**2)
        return max(0.0, 1.0 - float(unexplained) * (len(centred) - 1) / freedom)

    gains, rng = dict.fromkeys(columns, 0.0), np.random.default_rng(0)
    for _ in range(ORDERS):
        order, previous = rng.permutation(list(columns)).tolist(), 0.0
        for k, name in enumerate(order, start=1):
            current = max(previous, explained(order[:k]))
            gains[name] += (current - previous) / ORDERS
            previous = current
    return {**gains, REST: max(0.0, 1.0 - sum(gains.values()))}


# --- against the actuation of the dampers, and which is best

STEPS = 8  # steps of a sweep that does not say how many
MOST_STEPS = 100

QUANTITIES = ("drift", "acceleration")
"""What may be made small: the largest of these over the building."""

MOST_AWAY = 0.1  # largest share of draws that may run away at a level
RESAMPLES = 400

GOALS: Mapping[str, Callable[[Array, float], Array]] = MappingProxyType(
    {
        "mean": lambda values, limit: values.mean(axis=-1),
        "q90": lambda values, limit: np.quantile(values, 0.9, axis=-1),
        "passing": lambda values, limit: np.mean(values > limit, axis=-1),
    }
)
"""What is made small: the mean, the 90 % quantile, or the probability of passing a limit."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Peaks at several actuations, with the same random numbers."""

    levels: Array  # (L,), ksi or kip
    unit: str  # "ksi" or "kip"
    # the largest over the building of "drift", in, and "acceleration", g, of the draws that
    # ran away at no other level; NaN at levels that are left out
    values: Mapping[str, Array]
    quantity: str
    goal: str
    # (L,), what is made small, over all ground motions; infinite at levels that are left out
    scores: Array
    best: float  # the actuation at which it is smallest; NaN where it is so at several levels alike
    # equal-tailed 90 % interval of the best actuation, over resampled draws;
    # levels that are best alike are all in it
    interval: tuple[float, float]
    remarks: tuple[str, ...] = ()  # what it leaves out

    @property
    def lowest(self) -> Array:
        """Levels that have the smallest score, (k,); several where they tie."""
        return np.asarray(self.levels[self.scores == self.scores.min()])


def parse_sweep(text: str) -> tuple[Array, str]:
    """Levels, (L,), and unit of ``actuation="500 psi to 1500 psi"``, perhaps ``in 5 steps``."""
    form = r"\s*actuation\s*=\s*(.+?)\s+to\s+(.+?)(?:\s+in\s+(\d+)\s+steps)?\s*"
    match = re.fullmatch(form, re.sub("[\"']", "", text))
    if match is None:
        raise BuildingError(
            f'--sweep {text!r}: expected actuation="500 psi to 1500 psi", or the same with '
            "'in 5 steps' after it"
        )
    try:
        (low, unit), (high, high_unit) = (parse_actuation(match[i], of="--sweep") for i in (1, 2))
    except UnitError as error:
        raise BuildingError(str(error)) from error
    if unit != high_unit or not 0 < low < high:
        raise BuildingError(
            f"--sweep {text!r}: expected two levels above 0 of one kind, the lower one first"
        )
    steps = int(match[3] or STEPS)
    if not 1 <= steps <= MOST_STEPS:
        raise BuildingError(f"--sweep {text!r}: expected 1 to {MOST_STEPS} steps, got {steps}")
    return np.linspace(low, high, steps + 1), unit


def check_goal(quantity: str, goal: str, limits: ResponseLimits) -> float:
    """The limit that a quantity may not pass; NaN where the goal needs none."""
    if quantity not in QUANTITIES:
        raise BuildingError(f"unknown quantity {quantity!r}: expected {' or '.join(QUANTITIES)}")
    if goal not in GOALS:
        raise BuildingError(f"unknown goal {goal!r}: expected one of {', '.join(GOALS)}")
    limit = limits.drift if quantity == "drift" else limits.acceleration
    if goal == "passing" and limit is None:
        raise BuildingError(f"the goal 'passing' needs limits.{quantity} in the building file")
    return np.nan if limit is None else limit


def sweep_of(
    swept: tuple[Array, str], responses: list[Response], quantity: str, goal: str, seed: int = 0
) -> Sweep:
    """The best actuation among the levels, between which a parabola is drawn, if there is one.

    `swept` is the levels and their unit, as `parse_sweep` has them. Draws are the same at every
    level, so that resampling them compares like with like.
    """
    levels, unit = swept
    limit = check_goal(quantity, goal, responses[0].building.limits)
    diverged = np.array([r.unstable.any(axis=1) for r in responses])
    lost = diverged.mean(axis=1) > MOST_AWAY
    if lost.all():
        raise BuildingError("the sweep says nothing: many draws ran away at every level")
    # a draw that ran away at one level is left out at all: the others are of the same dampers
    usable = ~diverged[~lost].any(axis=0)
    values = {name: np.stack([r.measure(name)[usable] for r in responses]) for name in QUANTITIES}
    for value in values.values():
        value[lost] = np.nan
    objective = values[quantity]
    if goal == "passing":  # limits are of ratios of drifts, and of accelerations in in/s²
        peaks = [r.drift_ratio if quantity == "drift" else r.acceleration for r in responses]
        objective = np.stack([peak.max(axis=-1)[usable] for peak in peaks])
    n = objective.shape[1]

    def score(of: Array) -> Array:
        return np.where(lost, np.inf, GOALS[goal](of.reshape(len(levels), -1), limit))

    scores, rng = score(objective), np.random.default_rng(seed)
    resampled = [
        _lowest(levels, score(objective[:, rng.integers(n, size=n)])) for _ in range(RESAMPLES)
    ]
    firsts, lasts = np.transpose(resampled)
    lower, upper = _lowest(levels, scores)
    low, high = float(np.quantile(firsts, 0.05)), float(np.quantile(lasts, 0.95))
    best = lower
    if lower < upper:
        best, low, high = np.nan, min(lower, low), max(upper, high)
    remarks = []
    if count := int((~usable).sum()):
        remarks.append(
            f"the sweep leaves out {count} of {usable.size} draws, which diverged at one of its "
            "levels"
        )
    if lost.any():
        remarks.append(
            f"the sweep leaves out {lost.sum()} of its levels, at which more than "
            f"{100 * MOST_AWAY:.0f} % of the draws diverged"
        )
    return Sweep(levels, unit, values, quantity, goal, scores, best, (low, high), tuple(remarks))


def _lowest(levels: Array, scores: Array) -> tuple[float, float]:
    """First and last place of the minimum; they differ where levels have the same score.

    One level's place is that of a parabola through it and its neighbours.
    """
    k = int(np.argmin(scores))
    ties = levels[scores == scores[k]]
    if ties.size > 1:
        return float(ties[0]), float(ties[-1])
    level = float(levels[k])
    if 0 < k < len(levels) - 1:
        a, b, c = scores[k - 1 : k + 2]
        bend = a - 2.0 * b + c
        if np.isfinite(a + c) and bend > 0:
            level += float(0.5 * (a - c) / bend * (levels[1] - levels[0]))
    return level, level
