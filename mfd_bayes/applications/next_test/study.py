"""Candidates simulated, and judged one by one and together: the table of advice.

Goal and simulated tests come from one set of draws of the population; what a test would leave
unknown is found by regression of the goal on the principal directions of its simulated loops.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.priors import units
from mfd_bayes.campaign.candidate import GAP, OF_LAWS, Candidate, Goal, Limits, repeats, typical_of
from mfd_bayes.errors import MOST_DRAWS, CampaignError, FitError, NotThereError, whole_number
from mfd_bayes.population.bands import PredictiveDraws, Predictor
from mfd_bayes.population.design import TestConditions, setting_of
from mfd_bayes.population.population import Latents, slip_force_of
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

TOGETHER = 3  # largest of the best sets that are listed
CURVE = 6  # number of further tests up to which the expected width is given
SHORTLIST = 12  # best candidates that are simulated again, so that a second copy can be chosen
COPIES = 2  # further copies of each of them
AFRESH = 3  # times that each of the best sets is simulated again, to judge it
TOO_STRONG = 0.025  # a candidate may pass the limit of the force with this probability
FEWEST = 200  # fewest draws
NO_GAP = 0.1  # length that stands for the gap of a model without one, in
EVERY = 2  # of the samples of a loop, every so many have a band whose width counts
NEXT = "(the session of the next test)"  # session of candidates, where tests were made in several
# marks of random numbers, after the seed; a seed of NumPy has two numbers or four, for it takes a
# shorter one for one with zeros at its end
DEVICES, TESTS, BOOTSTRAP, GOALS = range(4)
COLUMNS = ("candidate", "reduction", "error", "information", "information_error", "cost")
DENSE, LOOSE = 14, 8  # samples of a stroke up to `REACH` times the gap, and in the rest
REACH = 2.5
FLAT = 1e-9  # a summary whose sd is below this share of its size does not vary
# a direction of the summaries with less than this share of their variance is noise, or repeats
# others
SAME = 1e-3
PENALTIES = (1e-6, 1e-2, 1e-1, 1.0, 1e1)  # of the ridge regression, over the number of draws
RESAMPLES = 200  # number of bootstrap resamples of the draws
# information is about the principal directions of the goals with this share of their variance, at
# most so many
EXPLAINED, MOST = 0.99, 5
SMALL = 1e-3  # penalty of the regression by which sets of tests are chosen


# --- simulated tests ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Loop:
    """A full stroke forward, and then a full loop of backward and forward stroke.

    The stroke before the loop makes the place at which the test began without effect.
    """

    trace: Trace  # with the actuation
    first: int  # sample at which the loop begins, at the forward end

    @classmethod
    def of(cls, candidate: Candidate, gap: float) -> Loop:
        """Loop of a test of a damper with a gap of about this width, in."""
        stroke, amplitude = candidate.stroke, candidate.amplitude
        dense = min(REACH * gap, 0.5 * stroke)
        # closer towards the end, where a sine is slow
        spacing = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, LOOSE + 1))[1:]
        build = np.linspace(0.0, dense, DENSE + 1)
        travel = np.concatenate([build, dense + (stroke - dense) * spacing])
        time, position, speed, clock = [], [], [], 0.0
        for distance, way in ((travel, 1.0), (travel[1:], -1.0), (travel[1:], 1.0)):
            if candidate.waveform == "triangle":
                elapsed, fast = distance / candidate.speed, np.full(distance.size, candidate.speed)
            else:
                angle = np.arccos(np.clip(1.0 - distance / amplitude, -1.0, 1.0))
                elapsed = angle / (2.0 * np.pi * candidate.frequency)
                fast = candidate.speed * np.sin(angle)
            time.append(clock + elapsed)
            position.append(way * (distance - amplitude))
            speed.append(way * fast)
            clock += elapsed[-1]
        times, places, speeds = (np.concatenate(column) for column in (time, position, speed))
        trace = Trace.from_arrays(times, places, candidate.actuation, velocity=speeds)
        return cls(trace, travel.size - 1)

    def peaks(self, force: Array) -> tuple[Array, Array]:
        """Largest resistance forward and backward in the loop, (n,) each, kip."""
        middle = (self.first + self.trace.samples) // 2
        return force[:, middle:].max(axis=1), -force[:, self.first : middle + 1].min(axis=1)

    def energy(self, force: Array) -> Array:
        """Energy dissipated in the loop, (n,), kip·in."""
        x = self.trace.displacement[self.first :]
        return np.asarray(np.trapezoid(force[:, self.first :], x, axis=1))


@dataclass(frozen=True, eq=False)
class SimulatedDevices:
    """Draws of a device: laws, effects and discrepancy are the same for all that is asked of it."""

    predictor: Predictor
    index: NDArray[np.intp]  # (n,) int: draws of the population
    grid: Array  # (G,): actuations that will be asked for, ksi or kip
    # of the effects of each session; of a motion outside those of the tests, under ""
    numbers: Mapping[str, Latents]

    @classmethod
    def draw(
        cls,
        predictor: Predictor,
        settings: Sequence[TestConditions],
        draws: int,
        rng: np.random.Generator,
    ) -> SimulatedDevices:
        """Devices for all settings that will be asked for.

        No draw of the population is taken twice, so there may be fewer than asked for.
        """
        population = predictor.population
        count = min(draws, population.size)
        index = np.sort(rng.choice(population.size, size=count, replace=False))
        grid = np.unique([setting.actuation for setting in settings])
        sessions = dict.fromkeys(["", *(setting.session for setting in settings)])
        numbers = {session: population.draw_numbers(count, grid.size, rng) for session in sessions}
        return cls(predictor, index, grid, numbers)

    def sample_conditional(
        self,
        trace: Trace,
        setting: TestConditions,
        rng: np.random.Generator,
        *,
        scattered: bool = False,
    ) -> PredictiveDraws:
        """Ingredients of the force under a motion, without noise."""
        numbers = self.predictor.population.draw_numbers(self.index.size, 0, rng)
        numbers = numbers._replace(
            level=self.numbers[setting.session].level,
            session=self.numbers[setting.session].session,
            extrapolation=self.numbers[""].extrapolation,
        )
        return self.predictor.sample_conditional(
            trace, setting, self.index, numbers, self.grid, scatter=scattered
        )

    def damper(self, loop: Loop, session: str, *, scattered: bool, seed: Sequence[int]) -> Array:
        """The damper's force along a loop, (n, T), kip: without offset and noise."""
        setting, rng = setting_of(loop.trace, session), np.random.default_rng(seed)
        sample = self.sample_conditional(loop.trace, setting, rng, scattered=scattered)
        return self.predictor.force(loop.trace, sample)

    def measured(
        self, loop: Loop, session: str, device: str, cycles: float, seed: Sequence[int]
    ) -> Array:
        """The mean loop of a test's record, with its scatter, offset and noise, (n, T), kip."""
        rng, residual = np.random.default_rng(seed), self.predictor.population.residual
        setting = setting_of(loop.trace, session, device)
        sample = self.sample_conditional(loop.trace, setting, rng, scattered=True)
        sd = self.predictor.values(sample)["noise_sd"]
        # variance of the mean of the noise over the time that a sample stands for, over its
        # variance, where its correlation falls by exp(-dt/τ)
        r = np.maximum(np.gradient(loop.trace.time) / residual.noise_time, 1e-6)
        averaged = np.minimum(2.0 * (r + np.expm1(-r)) / r**2, 1.0)
        factors, level = np.sqrt(averaged / cycles), float(np.sqrt(1.0 / cycles))
        noise = residual.draw_noise(rng, loop.trace, sd, factors, level)
        return self.predictor.total(loop.trace, replace(sample, noise=noise))


# --- what tests tell of goals ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals as draws."""

    values: Array  # (n, m): draws of each goal, internal units
    probability: float = 0.95  # of the band whose width is to be reduced
    seed: int | Sequence[int] = 0  # of the bootstrap

    @cached_property
    def widths(self) -> Array:
        """Width of each goal's equal-tailed band as it is known now, (m,)."""
        tail = 0.5 * (1.0 - self.probability)
        low, high = np.quantile(self.values, [tail, 1.0 - tail], axis=0)
        return np.asarray(high - low)

    @property
    def width(self) -> float:
        """Mean of the widths."""
        return float(self.widths.mean())

    def narrower(self, share: Array) -> Array:
        """Reduction of the mean width, (…), by shares of the variances that are left, (…, m)."""
        widths = self.widths
        return 1.0 - np.sqrt(share) @ widths / max(float(widths.sum()), 1e-300)

    @cached_property
    def centred(self) -> Array:
        """Each draw less the mean of all others, (n, m): as far off as what is left out."""
        n = len(self.values)
        return np.asarray((self.values - self.values.mean(axis=0)) * (n / (n - 1.0)))

    @cached_property
    def weights(self) -> Array:
        """Weights of the draws, (1 + RESAMPLES, n): all alike, then those of the bootstrap."""
        n, rng = len(self.values), np.random.default_rng(self.seed)
        counts = rng.multinomial(n, np.full(n, 1.0 / n), RESAMPLES)
        return np.concatenate([np.ones((1, n)), counts])

    @cached_property
    def squares(self) -> Array:
        """Weighted sums of the squares of what is known now, (1 + RESAMPLES, m)."""
        return np.maximum(self.weights @ self.centred**2, 1e-300)

    @cached_property
    def _ways(self) -> Array:
        """Principal directions of the goals over their sd, (up to MOST, m)."""
        scale = np.maximum(self.centred.std(axis=0), 1e-300)
        _, sizes, ways = np.linalg.svd(self.centred / scale, full_matrices=False)
        explained = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
        rank = min(int(np.searchsorted(explained, EXPLAINED)) + 1, MOST, len(sizes))
        return np.asarray(ways[:rank] / scale)

    def log_determinants(self, values: Array) -> Array:
        """Of the covariance of deviations (n, m) in the principal directions, (1 + RESAMPLES,)."""
        scores, rank = values @ self._ways.T, len(self._ways)
        products = np.einsum("ni,nj->nij", scores, scores).reshape(len(values), -1)
        sums = (self.weights @ products).reshape(-1, rank, rank)
        return np.asarray(np.linalg.slogdet(sums / self.weights.sum(axis=1)[:, None, None])[1])

    @cached_property
    def known(self) -> Array:
        """Logarithms of the determinants of what is known now, (1 + RESAMPLES,)."""
        return self.log_determinants(self.centred)


@dataclass(frozen=True)
class Gain:
    """What is expected of a test, or of several."""

    reduction: float  # expected reduction of the mean width, as a share of it; 0 or more
    error: float  # its standard error, by the bootstrap
    information: float  # Gaussian expected information gain about the goals, nat
    information_error: float


def directions_of(summaries: Array) -> Array:
    """Independent directions of summaries (n, k), each of mean 0 and sd 1, (n, up to k).

    Each summary is replaced by the normal score of its rank, so that its form and outliers do not
    matter; what does not vary, and what repeats others, is dropped.
    """
    n, size = len(summaries), np.maximum(np.abs(summaries).max(axis=0, initial=0.0), 1e-300)
    varies = summaries.std(axis=0) > FLAT * size
    if not varies.any():
        return np.empty((n, 0))
    order, scores = np.argsort(summaries[:, varies], axis=0), np.empty((n, np.sum(varies)))
    np.put_along_axis(scores, order, special.ndtri((np.arange(n) + 0.5) / n)[:, None], axis=0)
    u, sizes, _ = np.linalg.svd(scores, full_matrices=False)
    return np.asarray(u[:, sizes**2 > SAME * np.sum(sizes**2)] * np.sqrt(n))


def fit_left_out(goals: Array, directions: Array) -> Array:
    """Goals (n, m) less their prediction from directions of summaries (n, k), (n, m).

    Each draw is predicted from all others, by ridge regression. Of several penalties the one with
    the least error on draws left out one by one, in closed form (PRESS), summed over the goals in
    units of their variance, is taken. Where summaries tell nothing the mean of the goals is as
    good, and is what is taken.

    Source: Strong, Oakley and Brennan, Medical Decision Making 34 (2014) 311, with ridge
    regression instead of splines, since there are many summaries.
    """
    n = len(goals)
    centred = goals - goals.mean(axis=0)
    scale = np.maximum(np.mean(centred**2, axis=0), 1e-300)
    residuals = [centred * (n / (n - 1.0))]
    u, sizes, _ = np.linalg.svd(directions, full_matrices=False)
    projection = u.T @ centred
    for penalty in PENALTIES:
        shrink = sizes**2 / (sizes**2 + penalty * n)
        leverage = 1.0 / n + u**2 @ shrink
        residual = centred - u @ (shrink[:, None] * projection)
        residuals.append(residual / np.maximum(1.0 - leverage, 1e-6)[:, None])
    return min(residuals, key=lambda residual: float(np.sum(np.mean(residual**2, axis=0) / scale)))


def gain_of(goals: Goals, residuals: Array) -> Gain:
    """Gain of the test that leaves so much of the goals, (n, m); see `fit_left_out`.

    The expected remaining variance of a goal is the mean square of what is left; a band's width
    goes with its root. Information is half the logarithm of the ratio of the determinants of the
    goals' covariance before and after, in their principal directions.
    """
    # both are means of squares over draws that were left out: without information they are equal
    share = goals.weights @ residuals**2 / goals.squares
    figures = []
    for values in (goals.narrower(share), 0.5 * (goals.known - goals.log_determinants(residuals))):
        figures += [max(float(values[0]), 0.0), float(np.std(values[1:], ddof=1))]
    return Gain(*figures)


def greedy(goals: Goals, tests: Sequence[Array], size: int) -> list[tuple[int, ...]]:
    """Sets of 1, 2, … up to `size` tests, each with the one that adds most to the set before."""
    values = goals.values - goals.values.mean(axis=0)
    design, n = np.concatenate(tests, axis=1), len(values)
    ends = np.cumsum([0, *(test.shape[1] for test in tests)])
    gram, cross, total = design.T @ design, design.T @ values, np.sum(values**2, axis=0)

    def reduction(subset: tuple[int, ...]) -> float:
        """Expected reduction of the mean width, corrected for the number of columns."""
        columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in subset])
        q = columns.size
        if not q or n <= q + 2:
            return 0.0
        matrix = gram[np.ix_(columns, columns)] + SMALL * n * np.eye(q)
        rhs = cross[columns]
        explained = np.sum(rhs * np.linalg.solve(matrix, rhs), axis=0)
        share = (total - explained) / (n - 1.0 - q) * (n - 1.0) / np.maximum(total, 1e-300)
        return float(goals.narrower(np.clip(share, 0.0, None)))

    sets: list[tuple[int, ...]] = []
    subset: tuple[int, ...] = ()
    for _ in range(min(size, len(tests))):
        candidates = (k for k in range(len(tests)) if k not in subset)
        subset = max(((*subset, k) for k in candidates), key=reduction)
        sets.append(subset)
    return sets


# --- advice ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Row(Gain):
    """A candidate, what is expected of it, and whether it is like a test that was made."""

    candidate: Candidate
    repeat: bool

    @property
    def cost(self) -> float:
        """What the candidate costs, h of frame time or as the user gave it."""
        return self.candidate.cost

    @property
    def per_hour(self) -> float:
        """Expected reduction by an hour of its cost; infinite where it costs nothing."""
        return self.reduction / self.cost if self.cost > 0.0 else np.inf


@dataclass(frozen=True, kw_only=True)
class Together(Gain):
    """Tests that are good together, and what is expected of them."""

    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class Advice(Sequence[Row]):
    """A table of candidates, the best first; `advice["reduction"]` is a column.

    Attributes
    ----------
    goal : Goal
    unit : str
        Internal unit of the goal.
    width : float
        Mean width of the goal's bands as it is known now.
    rows : tuple of Row
    together : tuple of Together
        The best test, then one more after another.
    ruled_out : tuple of (Candidate, str)
        Candidates that the limits forbid, and which limit.
    tests : tuple of Candidate
        The tests that were made.
    draws : int
        Draws of the population that all is computed from.
    remarks : tuple of str
        Where candidates that were asked for lie outside what was tested.
    """

    goal: Goal
    unit: str
    width: float
    rows: tuple[Row, ...]
    together: tuple[Together, ...]
    ruled_out: tuple[tuple[Candidate, str], ...]
    tests: tuple[Candidate, ...]
    draws: int
    remarks: tuple[str, ...] = ()

    columns = COLUMNS

    @property
    def curve(self) -> Array:
        """Expected width after 0, 1, 2, … further tests, in `unit`."""
        return self.width * np.array([1.0, *(1.0 - t.reduction for t in self.together)])

    def __len__(self) -> int:
        """Number of candidates."""
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        """Rows, the best first."""
        return iter(self.rows)

    def __getitem__(self, key: Any) -> Any:
        """A row by its number, some rows by a slice, or a column by its name."""
        if isinstance(key, str) and key in COLUMNS:
            return [getattr(row, key) for row in self.rows]
        try:
            return self.rows[key]
        except (IndexError, TypeError) as error:
            raise NotThereError(
                f"no row or column {key!r}: rows have the numbers 0 to {len(self.rows) - 1}, and "
                f"columns the names {', '.join(COLUMNS)}"
            ) from error


class Study:
    """One question about a campaign: draws of the device and of the goal, and simulated tests."""

    def __init__(
        self,
        predictor: Predictor,
        tests: Sequence[Candidate],
        goal: Goal,
        candidates: Sequence[Candidate] = (),
        *,
        draws: int = 2000,
        seed: int = 0,
    ) -> None:
        whole_number("draws", draws, FEWEST, FitError, MOST_DRAWS)
        whole_number("seed", seed, 0, FitError)
        population, self.model = predictor.population, predictor.model
        self.candidates, self.seed = candidates, seed
        levels = population.draws.z[..., : len(population.design.names)]
        gap = self.model.gap(population.values(levels.reshape(population.size, -1)))
        self.gap = NO_GAP if gap is None else float(np.median(gap))
        now, self.session = goal.session, NEXT
        if len(population.design.sessions) == 1:
            now = self.session = population.design.sessions[0]
        places = goal.places(typical_of(tests))
        settings = [
            setting_of(Loop.of(candidate, self.gap).trace, session)
            for session, group in ((now, places), (self.session, candidates))
            for candidate in group
        ]
        rng = np.random.default_rng([seed, DEVICES])
        self.devices = SimulatedDevices.draw(predictor, settings, draws, rng)
        values = self._goal(goal, places, now)
        size = np.maximum(np.abs(values).max(axis=0, initial=0.0), 1e-300)
        varying = np.ptp(values, axis=0) > 1e-9 * size
        self.goals = Goals(values[:, varying], goal.probability, [seed, BOOTSTRAP])
        if not varying.any():
            raise CampaignError(
                f"the {goal.words} is the same in all draws of this run: its law or its prior "
                "fixes it, and no test can make it better known"
            )

    def _goal(self, goal: Goal, places: Sequence[Candidate], session: str) -> Array:
        """Draws of the goal, (n, m)."""
        devices, population = self.devices, self.devices.predictor.population
        if goal.quantity in OF_LAWS:
            if goal.of not in population.design.laws:
                names = ", ".join(population.design.laws) or "nothing"
                raise CampaignError(
                    f"no law of {goal.of!r} was inferred in this run: those that were are of "
                    f"{names}"
                )
            if goal.quantity == "exponent":
                return population.shapes(goal.of)[1].reshape(-1, 1)[devices.index]
            levels = [candidate.actuation for candidate in places]
            low, high = min(levels), max(levels)
            low = 0.0 if not high > low else low
            medians = population.median(goal.of, np.array([low, high])).reshape(-1, 2)[
                devices.index
            ]
            return np.diff(medians, axis=1) / (high - low)
        draws = []
        for number, candidate in enumerate(places[:1] if goal.quantity == GAP else places):
            loop, seed = Loop.of(candidate, self.gap), (self.seed, GOALS, number, 0)
            if goal.quantity in ("slip", GAP):
                setting, rng = setting_of(loop.trace, session), np.random.default_rng(seed)
                sample = devices.sample_conditional(loop.trace, setting, rng)
                values, slips = devices.predictor.values(sample), bool(self.model.slip_forces)
                column = self.model.gap(values) if goal.quantity == GAP else None
                if goal.quantity == "slip" and slips:
                    column = slip_force_of(self.model, values)
                if column is None:
                    quantity = "gap" if goal.quantity == GAP else "slip force"
                    raise CampaignError(
                        f"the model {self.model.name} has no {quantity} to be known"
                    )
                draws.append(column[:, None])
                continue
            scattered = goal.kind == "new_test"
            force = devices.damper(loop, session, scattered=scattered, seed=seed)
            forward, backward = loop.peaks(force)
            columns = {
                "band": list(force[:, loop.first :: EVERY].T),
                "energy": [loop.energy(force)],
                "peak_fwd": [forward],
                "peak_bwd": [backward],
                "peak": [forward, backward],
            }
            draws.append(np.stack(columns[goal.quantity], axis=1))
        return np.concatenate(draws, axis=1)

    def simulated(self, number: int, copy: int) -> tuple[Array, Array]:
        """Largest forces of a copy of a candidate, (n,), kip, and directions of its summaries."""
        candidate = self.candidates[number]
        loop = Loop.of(candidate, self.gap)
        seed = (self.seed, TESTS, number, copy)
        force = self.devices.measured(loop, self.session, candidate.device, candidate.cycles, seed)
        return np.abs(force).max(axis=1), directions_of(force[:, loop.first :])

    def gain(self, *copies: Array) -> Gain:
        """Gain of tests whose summaries have these directions: the mean of several copies."""
        gains = []
        for directions in copies:
            gain = gain_of(self.goals, fit_left_out(self.goals.values, directions))
            gains.append(list(vars(gain).values()))
        return Gain(*np.mean(gains, axis=0).tolist())

    def gain_of_set(self, numbers: Sequence[int]) -> Gain:
        """Gain of a set of candidates, by new copies of them.

        Of many sets the best owes part of its worth to the chance in its copies, so that these
        copies must not judge it too.
        """
        sets = []
        for again in range(AFRESH):
            base = COPIES + 1 + again * CURVE
            tests = [self.simulated(n, base + i)[1] for i, n in enumerate(numbers)]
            sets.append(np.concatenate(tests, axis=1))
        return self.gain(*sets)


def advise(
    predictor: Predictor,
    tests: Sequence[Candidate],
    goal: Goal,
    candidates: Sequence[Candidate],
    limits: Limits,
    *,
    draws: int = 2000,
    seed: int = 0,
) -> Advice:
    """Candidates with what each is expected to tell of a goal, the best first.

    `tests` are those that were made.
    """
    unique = list(dict.fromkeys(candidates))
    ruled_out = {item: limit for item in unique if (limit := limits.forbids(item))}
    allowed = [item for item in unique if item not in ruled_out]
    if not allowed:
        raise CampaignError(
            "the limits of velocity and stroke forbid every candidate: give other candidates, or "
            "check the limits' units"
        )
    study = Study(predictor, tests, goal, allowed, draws=draws, seed=seed)
    simulated: list[tuple[int, Array]] = []
    gains: dict[int, Gain] = {}
    for number, candidate in enumerate(allowed):
        peaks, directions = study.simulated(number, 0)
        if limits.force is not None and np.quantile(peaks, 1.0 - TOO_STRONG) > limits.force:
            ruled_out[candidate] = "force"
            continue
        gains[number] = study.gain(directions)
        simulated.append((number, directions))
    if not gains:
        raise CampaignError(
            f"the limit of the force, {limits.force:.4g} kip, forbids every candidate: give "
            "candidates of less actuation, or check its unit"
        )
    simulated.sort(key=lambda test: -gains[test[0]].reduction)
    for number, _ in simulated[:SHORTLIST]:
        # the first copy has put a candidate on the list: it must not judge it too
        copies = [study.simulated(number, copy)[1] for copy in range(1, COPIES + 1)]
        gains[number] = study.gain(*copies)
        simulated += [(number, directions) for directions in copies]
    sets = greedy(study.goals, [directions for _, directions in simulated], CURVE)
    together = []
    for item in sets:
        numbers = [simulated[k][0] for k in item]
        candidates_of = tuple(allowed[n] for n in numbers)
        together.append(Together(**vars(study.gain_of_set(numbers)), candidates=candidates_of))
    rows = [
        Row(**vars(gain), candidate=allowed[n], repeat=repeats(allowed[n], tests))
        for n, gain in gains.items()
    ]
    return Advice(
        goal=goal,
        unit=goal.unit(predictor.population.actuation_unit, units(predictor.model)),
        width=study.goals.width,
        rows=tuple(sorted(rows, key=lambda row: -row.reduction)),
        together=tuple(together),
        ruled_out=tuple((item, ruled_out[item]) for item in unique if item in ruled_out),
        tests=tuple(tests),
        draws=study.devices.index.size,
    )
