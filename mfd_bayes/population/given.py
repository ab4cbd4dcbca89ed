"""Predictions of a test of which a first part is known, or arrives sample by sample.

Draws of the population are weighted by the likelihood of the known force. Where the weights of a
few draws take over, the draws are resampled and moved by some Metropolis steps, and the force goes
on to be taken in (iterated batch importance sampling: Chopin, 2002).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.errors import FitError
from mfd_bayes.population.bands import Band, Drawn, Forecast, Predictor
from mfd_bayes.population.discrepancy import Residual, slip_force_of, strokes_of
from mfd_bayes.population.population import Numbers, Population
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.records.clock import checked_window
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

PARTICLES = 1500
"""Draws of the population that take in a given part."""

LEAST_EFFECTIVE = 0.3
"""Share of effective draws below which they are resampled and moved."""

MOVES = 5
"""Metropolis steps after each resampling."""

LARGEST_K = 0.7
"""Pareto k above which weights cannot be trusted (Vehtari et al., 2024)."""

FEWEST = 100
"""Effective draws below which a band is said not to be reliable."""

QUIET = 0.25
"""Share of the slip force below which a device is taken to be in its gap."""

SAMPLES = 3
"""Fewest samples of a given part, at the rate of the calibrated tests."""

ALLOWED = ("new_test", "observation")
"""Kinds of bands of which a given part says something."""


@dataclass(frozen=True)
class Conditioned:
    """The given part of a record, and how the population's draws took it in.

    Attributes
    ----------
    window : (float, float), s
    samples : int
        At the rate of the calibrated tests.
    pareto_k : float
        Of the last importance weights.
    method : {"weights", "sampling"}
        Importance weights alone, or resampled and moved too.
    effective : float
        Effective number of draws behind the band.
    stages : int
        How often the draws were resampled and moved.
    accepted : float
        Share of the last moves that were accepted; 1 for weights alone.
    """

    window: tuple[float, float]
    samples: int
    pareto_k: float
    method: str
    effective: float
    stages: int = 0
    accepted: float = 1.0

    def holds(self, time: Array) -> NDArray[np.bool_]:
        """Whether times (T,), s, are in the given part."""
        return (time >= self.window[0]) & (time <= self.window[1])

    @property
    def sentence(self) -> str:
        """What was given, and how it was used, for the source of a band."""
        text = f"the force given from {self.window[0]:.4g} s to {self.window[1]:.4g} s"
        if self.method == "weights":
            return f"{text} (importance weights, Pareto k {self.pareto_k:.2f})"
        return f"{text} (resampled and moved {self.stages} times)"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reason to trust the band less, if there is one."""
        if self.effective >= FEWEST and self.pareto_k <= LARGEST_K and self.accepted >= 0.02:
            return ()
        return (
            f"the band is not reliable: {self.effective:.0f} effective draws (Pareto k "
            f"{self.pareto_k:.2f}) hold what the given part says",
        )


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums of standardised residuals over the strokes, of n draws: all that the likelihood needs.

    Attributes
    ----------
    count : (S,)
        Independent samples of each stroke.
    first, second : (n, S)
        Sums of the residuals and of their squares, times the count of each sample.
    """

    count: Array
    first: Array
    second: Array

    @classmethod
    def of(cls, left: Array, count: Array, strokes: Index, size: int) -> Sums:
        """Of residuals (n, T) with counts (T,) in strokes (T,) of `size` strokes."""
        home = (strokes[:, None] == np.arange(size)) * count[:, None]
        return cls(home.sum(axis=0), left @ home, left**2 @ home)

    def __add__(self, other: Sums) -> Sums:
        more = other.count.size - self.count.size
        mine = [np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, more)]) for a in vars(self).values()]
        return Sums(*(a + b for a, b in zip(mine, vars(other).values(), strict=True)))

    def log_likelihood(self, sd: Array, share: float) -> Array:
        """Log likelihood for noise of sd (n,) with a random level of each stroke, (n,)."""
        rest, level = 1.0 - share**2, share**2
        known = 1.0 + level * self.count / rest
        first, second = self.first / sd[:, None], self.second / sd[:, None] ** 2
        squares = second / rest - level / rest**2 * first**2 / known
        log = np.log(known) + self.count * np.log(rest)
        total = -0.5 * (squares + log).sum(axis=1) - self.count.sum() * np.log(sd)
        return np.asarray(total)


@dataclass(frozen=True, eq=False)
class Particles:
    """Draws of one test: numbers of draws of the population (n,), and standard normal numbers."""

    index: Index
    numbers: Numbers

    def of(self, chosen: Index) -> Particles:
        """Some of them."""
        return Particles(self.index[chosen], replace(self.numbers, flat=self.numbers.flat[chosen]))


@dataclass(frozen=True, eq=False)
class KnownTest:
    """A test of which a part is known.

    Attributes
    ----------
    predictor : Predictor
    setting : Setting
    trace : Trace
        Motion of the whole test, which says where it begins.
    grid : (G,)
        Actuations at which deviations from the laws are drawn.
    """

    predictor: Predictor
    setting: Setting
    trace: Trace | None
    grid: Array

    @property
    def population(self) -> Population:
        """The population that the test is of."""
        return self.predictor.population

    def begin(self, n: int, rng: np.random.Generator) -> Particles:
        """Particles of which nothing is known."""
        index = self.population.draw_index(n, self.setting.actuation, rng)
        return Particles(index, self.population.draw_numbers(n, self.grid.size, rng))

    def drawn(self, p: Particles, part: Trace) -> Drawn:
        """Tests of the particles under a part of the motion; δ is at its mean."""
        mean = self.population.residual.mean
        knots = np.broadcast_to(mean, (len(p.index), mean.size))
        found = self.predictor.drawn(part, self.setting, p.index, p.numbers, knots, self.grid)
        if self.trace is None or self.trace is part:
            return found
        x = found.parts.mean + found.parts.scatter
        model = self.predictor.model
        unshared = self.population.unshared(model, x, p.numbers.start, self.setting, self.trace)
        return replace(found, unshared=unshared)

    def log_likelihood(self, p: Particles, part: Trace, counted: NDArray[np.bool_]) -> Array:
        """Log likelihood of the counted samples so far, at the end of each block, (n, blocks)."""
        residual, size = self.population.residual, int(strokes_of(part)[-1]) + 1
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            drawn = self.drawn(p, part)
            values = self.predictor.values(drawn)
            left = np.asarray(part.force) - self.predictor.force(part, drawn)
            slip = slip_force_of(self.predictor.model, values)
            left = (left - values["offset"][:, None]) / noise_shape(residual, part, slip)
            left = np.where(np.isfinite(left), left, 1e6)
        count, sd, found = counts(residual, part, counted), values["noise_sd"], []
        total: Sums | None = None
        for block in np.array_split(np.flatnonzero(counted), blocks_of(count)):
            sums = Sums.of(left[:, block], count[block], strokes_of(part)[block], size)
            total = sums if total is None else total + sums
            found.append(total.log_likelihood(sd, residual.stroke_share))
        return np.stack(found, axis=1)


def counts(residual: Residual, part: Trace, counted: NDArray[np.bool_]) -> Array:
    """Independent samples that each sample counts for, (T,): the first one that counts is one."""
    count = np.where(counted, residual.counts(part), 0.0)
    count[np.argmax(counted)] = 1.0
    return count


def blocks_of(count: Array) -> int:
    """Number of blocks in which samples are taken in: of about one independent sample each."""
    return int(np.clip(count.sum(), 1, 40))


def noise_shape(residual: Residual, part: Trace, slip: Array) -> Array:
    """Shape g, (T,): before a full stroke a device far below slip is as quiet as in its gap."""
    functions = residual.basis(part)
    shape = np.exp(functions @ residual.log_shape)
    quiet = np.abs(np.asarray(part.force)) < QUIET * np.median(slip)
    unknown = ~np.any(functions, axis=1) & quiet
    shape[unknown] = min(float(np.exp(residual.log_shape.min())), 1.0)
    return np.asarray(shape)


def take_in(
    test: KnownTest, part: Trace, counted: NDArray[np.bool_], n: int, rng: np.random.Generator
) -> tuple[Particles, Array, Conditioned]:
    """Particles given the counted samples of a part, with their log weights (n,)."""
    p = test.begin(n, rng)
    log = test.log_likelihood(p, part, counted)
    active, done, stages, accepted = test.population.active(test.setting, test.grid), -1, 0, 1.0
    taken = np.zeros(n)  # log likelihood that the particles have been drawn with
    while True:
        weights = log[:, done + 1 :] - taken[:, None]
        effective = effective_draws(weights)
        low = np.flatnonzero(effective < LEAST_EFFECTIVE * n)
        if not low.size:
            break
        done = done + 1 + max(int(low[0]) - 1, 0) if low[0] else done + 1
        p = p.of(systematic(weights[:, max(int(low[0]) - 1, 0)], n, rng))
        log = test.log_likelihood(p, part, counted)
        for step in range(MOVES):
            p, log, accepted = _move(test, part, counted, (p, log), done, active, step, rng)
        taken, stages = log[:, done].copy(), stages + 1
        if done == log.shape[1] - 1:
            break
    last = log[:, -1] - taken
    smooth, k = psis(np.maximum(last, last.max() - 600.0))
    window = float(part.time[counted][0]), float(part.time[counted][-1])
    method = "sampling" if stages else "weights"
    number = float(effective_draws(smooth[:, None])[0])
    told = Conditioned(window, int(counted.sum()), k, method, number, stages, accepted)
    return p, smooth, told


def _move(
    test: KnownTest,
    part: Trace,
    counted: NDArray[np.bool_],
    known: tuple[Particles, Array],
    done: int,
    active: Index,
    step: int,
    rng: np.random.Generator,
) -> tuple[Particles, Array, float]:
    """A Metropolis step given the first blocks: a random walk, or other draws of the population."""
    p, log = known
    flat, index = p.numbers.flat.copy(), p.index
    if step % 2:
        index = test.population.draw_index(len(index), test.setting.actuation, rng)
    scale = (0.5 if step % 2 else 2.38) / np.sqrt(active.size)
    spread = np.cov(flat[:, active].T) + 1e-9 * np.eye(active.size)
    walk = rng.standard_normal((len(flat), active.size)) @ np.linalg.cholesky(spread).T
    flat[:, active] += scale * walk
    new = Particles(index, replace(p.numbers, flat=flat))
    found = test.log_likelihood(new, part, counted)
    prior = 0.5 * np.sum(p.numbers.flat[:, active] ** 2 - flat[:, active] ** 2, axis=1)
    accepted = np.log(rng.random(len(flat))) < found[:, done] - log[:, done] + prior
    kept = np.where(accepted[:, None], flat, p.numbers.flat)
    p = Particles(np.where(accepted, index, p.index), replace(p.numbers, flat=kept))
    return p, np.where(accepted[:, None], found, log), float(accepted.mean())


def effective_draws(log_weights: Array) -> Array:
    """Effective number of draws of log weights (n, m), (m,)."""
    w = np.exp(log_weights - log_weights.max(axis=0))
    return np.asarray(w.sum(axis=0) ** 2 / np.sum(w**2, axis=0))


def systematic(log_weights: Array, n: int, rng: np.random.Generator) -> Index:
    """Numbers of n draws by their log weights, by systematic resampling."""
    edges = np.cumsum(np.exp(log_weights - log_weights.max()))
    places = (rng.random() + np.arange(n)) / n * edges[-1]
    return np.asarray(np.minimum(np.searchsorted(edges, places), len(edges) - 1))


def predict_given(
    predictor: Predictor, trace: Trace, forecast: Forecast, window: tuple[float, float]
) -> Band:
    """Band of a record of which a part is known; all of it, with the given part.

    Parameters
    ----------
    predictor : Predictor
    trace : Trace
        With its actuation, and with the force in the window.
    forecast : Forecast
        Of the kind `new_test` or `observation`.
    window : (float, float), s
        What is given.

    Raises
    ------
    FitError
        When the kind does not allow it, the window is none, or there is no force in it.
    """
    check_kind(forecast)
    setting, population = setting_of(trace, forecast.session), predictor.population
    part, counted = given_part(trace, window, usual_step(population.residual, setting))
    rng = np.random.default_rng(forecast.seed)
    grid = population.grid(setting.actuation, trace.actuation if trace.varying else None)
    test = KnownTest(predictor, setting, trace, grid)
    p, log_weights, told = take_in(test, part, counted, max(PARTICLES, forecast.draws), rng)
    told = replace(told, window=checked_window(window, "given", FitError))
    drawn = test.drawn(p.of(systematic(log_weights, forecast.draws, rng)), trace)
    drawn = replace(drawn, knots=population.residual.draw_knots(rng, forecast.draws))
    source = f"population laws with scatter, and {told.sentence}"
    band = predictor.finish(trace, forecast, drawn, rng, source)
    return replace(band, given=told, remarks=(*band.remarks, *told.remarks))


def check_kind(forecast: Forecast) -> None:
    """Refuse kinds of which a given part says nothing."""
    if forecast.kind not in ALLOWED:
        raise FitError(
            f"given is for the kinds {' and '.join(ALLOWED)}, not for {forecast.kind}: a first "
            "part shows the force of one new test"
        )


def usual_step(residual: Residual, setting: Setting) -> float:
    """Time between samples, s, at which a motion of such a peak speed would be fitted."""
    own = -residual.noise_time * np.log(residual.lag_one)
    speed = setting.covariates["velocity"]
    usual = 0.5 * np.pi * residual.travel / speed if speed > 0 else np.inf
    return float(np.clip(usual, 0.25 * own, 4.0 * own))


def given_part(
    trace: Trace, window: tuple[float, float], step: float
) -> tuple[Trace, NDArray[np.bool_]]:
    """The motion up to the end of a window, as means over about `step` s, and which count, (T,).

    It goes on to the second turn, so that its first direction is known.

    Raises
    ------
    FitError
        When the window is none, not within the record or too short, or has no force.
    """
    begin, end = checked_window(window, "given", FitError)
    words = f"from {begin:g} s to {end:g} s"
    if trace.force is None:
        raise FitError(f"the trace has no force: given {words} needs the force measured there")
    first, last = float(trace.time[0]), float(trace.time[-1])
    if begin < first - step or end > last + step:
        raise FitError(
            f"the given part {words} must lie within the record, which goes from {first:g} s to "
            f"{last:g} s"
        )
    inside = np.flatnonzero((trace.time >= begin) & (trace.time <= end))
    size = block_size(float(np.median(np.diff(trace.time))), step)
    if inside.size < SAMPLES * size:
        raise FitError(
            f"the given part {words} holds {inside.size} samples, too few: at least "
            f"{SAMPLES * size} are expected"
        )
    if not np.any(np.asarray(trace.force)[inside]):
        raise FitError(
            f"the force is zero in the whole given part {words}: expected a measured force"
        )
    turns = trace.turning_points
    stop = max(int(inside[-1]), int(turns[1]) if turns.size > 1 else trace.samples - 1) + 1
    edges = np.unique([0, *range(int(inside[0]) % size, stop, size)])
    edges = edges[edges + size <= stop]
    part = block_means(trace, edges, int(edges[-1]) + size)
    return part, (edges >= inside[0]) & (edges + size <= inside[-1] + 1)


def block_size(own: float, step: float) -> int:
    """Samples `own` s apart that are averaged, so that means are at most about `step` s apart."""
    return max(1, int(step / own + 0.25))


def block_means(trace: Trace, edges: Index, stop: int) -> Trace:
    """Means of a trace over the samples from each edge to the next, up to sample `stop`."""
    sizes = np.diff([*edges.tolist(), stop])

    def mean(values: ArrayLike) -> Array:
        return np.asarray(np.add.reduceat(np.asarray(values)[:stop], edges) / sizes)

    actuation = mean(trace.actuation) if trace.varying else trace.actuation
    return Trace.from_arrays(
        mean(trace.time),
        mean(trace.displacement),
        actuation,
        mean(np.asarray(trace.force)),
        mean(trace.velocity),
        hysteresis=trace.hysteresis,
    )
