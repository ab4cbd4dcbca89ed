"""Tests that are not yet made, simulated: loops, their summaries, and draws of the device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.bands import Drawn, Predictor
from mfd_bayes.population.design import Setting, setting_of
from mfd_bayes.records.trace import Trace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mfd_bayes.calibration.noise import Noise
    from mfd_bayes.friction.model import Model
    from mfd_bayes.planning.candidate import Candidate
    from mfd_bayes.population.population import Population

Array = NDArray[np.float64]

DENSE, LOOSE = 14, 8  # samples of a stroke up to `REACH` times the gap, and in the rest
REACH = 2.5
LEAD = 4  # every so many samples of a stroke are enough before the loop
FAST = (0.4, 0.8)
SLOW = (0.92, 1.0)  # shares of a stroke: slip near the peak speed, and slip just before the turn
IN_GAP = 0.4  # share of the typical gap at which the force in the gap is read
RISES = (0.3, 0.5, 0.8)  # shares of the slip force that the force reaches after a turn


@dataclass(frozen=True, eq=False)
class Loop:
    """A full stroke forward, and then a full loop of backward and forward stroke.

    The stroke before the loop makes the place at which the test began without effect.
    """

    trace: Trace  # with the actuation
    first: int  # sample at which the loop begins, at the forward end
    travel: Array  # (S + 1,), in: travel since the turn at the samples of one stroke of the loop

    @classmethod
    def of(cls, candidate: Candidate, gap: float) -> Loop:
        """Loop of a test of a damper with a gap of about this width, in."""
        stroke, amplitude = candidate.stroke, candidate.amplitude
        dense = min(REACH * gap, 0.5 * stroke)
        # closer towards the end, where a sine is slow
        rest = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, LOOSE + 1))[1:]
        build = np.linspace(0.0, dense, DENSE + 1)
        travel = np.concatenate([build, dense + (stroke - dense) * rest])
        lead = np.unique(np.append(travel[::LEAD], travel[-1]))
        time, place, speed, clock = [], [], [], 0.0
        for along, way in ((lead, 1.0), (travel[1:], -1.0), (travel[1:], 1.0)):
            if candidate.waveform == "triangle":
                since, fast = along / candidate.speed, np.full(along.size, candidate.speed)
            else:
                angle = np.arccos(np.clip(1.0 - along / amplitude, -1.0, 1.0))
                since, fast = angle / (2.0 * np.pi * candidate.frequency), np.sin(angle)
                fast = candidate.speed * fast
            time.append(clock + since)
            place.append(way * (along - amplitude))
            speed.append(way * fast)
            clock += since[-1]
        times, places, speeds = (np.concatenate(column) for column in (time, place, speed))
        trace = Trace.from_arrays(times, places, candidate.actuation, velocity=speeds)
        return cls(trace, lead.size - 1, travel)

    def halves(self, force: Array) -> tuple[Array, Array]:
        """Force along the backward and along the forward stroke of the loop, (n, S + 1) each.

        The backward one is given as a positive number where the force resists the motion.
        """
        strokes = self.travel.size - 1
        middle = self.first + strokes
        return -force[:, self.first : middle + 1], force[:, middle : middle + strokes + 1]

    def energy(self, force: Array) -> Array:
        """Energy dissipated in the loop, (n,), kip·in."""
        x = self.trace.displacement[self.first :]
        return np.asarray(np.trapezoid(force[:, self.first :], x, axis=1))

    def summaries(self, force: Array, gap: float) -> Mapping[str, Array]:
        """Summaries of forces (n, T), kip, that carry what a calibration would learn; (n,) each.

        Energy of the loop, kip·in; of each direction the peak, the slip force near the peak speed
        and just before the turn, and the force in the gap (of about this width, in), kip; the width
        of the gap, where half of the slip force is reached, and the travel of the build-up, in.
        """
        found = {"energy": self.energy(force)}
        travel, stroke = self.travel, float(self.travel[-1])
        share = travel / stroke
        place = min(IN_GAP * gap, 0.5 * stroke)
        for side, half in zip(("bwd", "fwd"), self.halves(force), strict=True):
            fast = half[:, (share >= FAST[0]) & (share <= FAST[1])].mean(axis=1)
            slow = half[:, (share >= SLOW[0]) & (share < SLOW[1])].mean(axis=1)
            low, middle, high = (_reached(travel, half, level * fast) for level in RISES)
            right = int(np.clip(np.searchsorted(travel, place), 1, travel.size - 1))
            part = (place - travel[right - 1]) / (travel[right] - travel[right - 1])
            found |= {
                f"peak_{side}": half.max(axis=1),
                f"slip_fast_{side}": fast,
                f"slip_slow_{side}": slow,
                f"in_gap_{side}": (1.0 - part) * half[:, right - 1] + part * half[:, right],
                f"gap_{side}": middle,
                f"rise_{side}": high - low,
            }
        return found


def _reached(travel: Array, force: Array, level: Array) -> Array:
    """Travel at which the force of each loop first reaches a level (n,), in."""
    above = force >= level[:, None]
    above[:, -1] = True
    right, row = np.maximum(np.argmax(above, axis=1), 1), np.arange(len(force))
    before, after = force[row, right - 1], force[row, right]
    rising = after > before
    part = np.where(rising, (level - before) / np.where(rising, after - before, 1.0), 0.0)
    left = travel[right - 1]
    return np.asarray(left + np.clip(part, 0.0, 1.0) * (travel[right] - left))


@dataclass(frozen=True, eq=False)
class Devices:
    """Draws of a device: laws, effects and discrepancy are the same for all that is asked of it."""

    predictor: Predictor
    index: NDArray[np.intp]  # (n,) int: draws of the population
    grid: Array  # (G,): actuations that will be asked for, ksi or kip
    effects: Mapping[str, Mapping[str, Array]]  # (n, G), by session and quantity
    # (n, d), standard normal: of sessions without a test, and, under "", of motions outside those
    unknown: Mapping[str, Array]
    knots: Array  # (n, K), kip: discrepancy

    @classmethod
    def draw(
        cls,
        population: Population,
        kinds: tuple[Model, Noise],
        settings: Sequence[Setting],
        draws: int,
        rng: np.random.Generator,
    ) -> Devices:
        """Devices for all settings that will be asked for.

        No draw of the population is taken twice, so there may be fewer than asked for.
        """
        count = min(draws, population.size)
        index = np.sort(rng.choice(population.size, size=count, replace=False))
        grid = np.unique([setting.actuation for setting in settings])
        effects, unknown = {}, {}
        for session in dict.fromkeys(["", *(setting.session for setting in settings)]):
            numbers = population.draw_numbers(count, grid.size, rng)
            effects[session] = population.level_effects(index, session, grid, numbers.level)
            unknown[session] = numbers.session
        knots = population.residual.draw_knots(rng, count)
        return cls(Predictor(population, *kinds), index, grid, effects, unknown, knots)

    def drawn(
        self, setting: Setting, rng: np.random.Generator, *, scattered: bool = False
    ) -> Drawn:
        """Ingredients of the force under a setting, without noise."""
        population = self.predictor.population
        d = len(population.design.names)
        chance = population.draw_numbers(self.index.size, 0, rng)
        flat = chance.flat.copy()
        flat[:, d : 2 * d], flat[:, 2 * d : 3 * d] = self.unknown[""], self.unknown[setting.session]
        numbers = replace(chance, flat=flat)
        at = int(np.argmin(np.abs(self.grid - setting.actuation)))
        effects = {name: v[:, at] for name, v in self.effects[setting.session].items()}
        parts = population.parts(setting, self.index, numbers, effects, scatter=scattered)
        x = parts.mean + parts.scatter
        unshared = population.unshared(self.predictor.model, x, numbers.start, setting)
        return Drawn(parts, unshared, {}, self.knots)

    def damper(self, loop: Loop, session: str, *, scattered: bool, seed: Sequence[int]) -> Array:
        """The damper's force along a loop, (n, T), kip: without offset and noise."""
        drawn = self.drawn(
            setting_of(loop.trace, session), np.random.default_rng(seed), scattered=scattered
        )
        return self.predictor.force(loop.trace, drawn)

    def measured(
        self, loop: Loop, session: str, device: str, cycles: float, seed: Sequence[int]
    ) -> Array:
        """The mean loop of a test's record, with its scatter, offset and noise, (n, T), kip."""
        rng, residual = np.random.default_rng(seed), self.predictor.population.residual
        drawn = self.drawn(setting_of(loop.trace, session, device), rng, scattered=True)
        sd = self.predictor.values(drawn)["noise_sd"]
        # variance of the mean of the noise over the time that a sample stands for, over its
        # variance, where its correlation falls by exp(-dt/τ)
        r = np.maximum(np.gradient(loop.trace.time) / residual.noise_time, 1e-6)
        averaged = np.minimum(2.0 * (r + np.expm1(-r)) / r**2, 1.0)
        rest, level = np.sqrt(averaged / cycles), float(np.sqrt(1.0 / cycles))
        noise = residual.draw_noise(rng, loop.trace, sd, rest, level)
        return self.predictor.total(loop.trace, replace(drawn, noise=noise))
