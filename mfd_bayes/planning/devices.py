"""Draws of the population that goals and simulated tests have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import Noise
from mfd_bayes.friction.model import Model
from mfd_bayes.planning.loop import Loop
from mfd_bayes.population.bands import Drawn, Predictor
from mfd_bayes.population.population import Numbers, Population
from mfd_bayes.population.settings import Setting, setting_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Devices:
    """Draws of a device: laws, effects and discrepancy are the same for all that is asked of it.

    Attributes
    ----------
    predictor : Predictor
    index : (n,) int
        Draws of the population.
    grid : (G,)
        Actuations that will be asked for, ksi or kip.
    effects : mapping of str to mapping of str to (n, G)
        Level effects of quantities on the grid, by session.
    unknown : mapping of str to (n, d)
        Standard normal numbers of each session, for one that no test was made in, and, under "", of
        motions outside those of the tests.
    knots : (n, K), kip
        Discrepancy.
    """

    predictor: Predictor
    index: NDArray[np.intp]
    grid: Array
    effects: Mapping[str, Mapping[str, Array]]
    unknown: Mapping[str, Array]
    knots: Array

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

    @property
    def population(self) -> Population:
        """The population that they are drawn from."""
        return self.predictor.population

    def drawn(
        self, setting: Setting, rng: np.random.Generator, *, scattered: bool = False
    ) -> Drawn:
        """Ingredients of the force under a setting, without noise."""
        population, d = self.population, len(self.population.design.names)
        chance = population.draw_numbers(self.index.size, 0, rng)
        flat = chance.flat.copy()
        flat[:, d : 2 * d], flat[:, 2 * d : 3 * d] = self.unknown[""], self.unknown[setting.session]
        numbers = Numbers(flat, chance.quantities, chance.leveled, 0)
        at = int(np.argmin(np.abs(self.grid - setting.actuation)))
        effects = {name: v[:, at] for name, v in self.effects[setting.session].items()}
        parts = population.parts(setting, self.index, numbers, effects, scatter=scattered)
        x = parts.mean + parts.scatter
        unshared = population.unshared(self.predictor.model, x, numbers.start, setting)
        return Drawn(parts, unshared, {}, self.knots)

    def damper(self, loop: Loop, session: str, *, scattered: bool, seed: Sequence[int]) -> Array:
        """The damper's force along a loop, (n, T), kip: without offset and noise."""
        rng = np.random.default_rng(seed)
        setting = setting_of(loop.trace, session)
        return self.predictor.force(loop.trace, self.drawn(setting, rng, scattered=scattered))

    def measured(self, loop: Loop, session: str, cycles: float, seed: Sequence[int]) -> Array:
        """The mean loop of a test's record, with its scatter, offset and noise, (n, T), kip."""
        rng, residual = np.random.default_rng(seed), self.population.residual
        drawn = self.drawn(setting_of(loop.trace, session), rng, scattered=True)
        sd = self.predictor.values(drawn)["noise_sd"]
        # variance of the mean of the noise over a sample's step, over its variance, where its
        # correlation falls by exp(-dt/τ)
        r = np.maximum(loop.steps / residual.noise_time, 1e-6)
        averaged = np.minimum(2.0 * (r + np.expm1(-r)) / r**2, 1.0)
        rest, level = np.sqrt(averaged / cycles), float(np.sqrt(1.0 / cycles))
        noise = residual.draw_noise(rng, loop.trace, sd, rest, level)
        return self.predictor.total(loop.trace, replace(drawn, noise=noise))
