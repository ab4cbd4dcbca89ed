"""Draws of the population that goals and simulated tests have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import Noise
from mfd_bayes.friction.model import Model
from mfd_bayes.planning.loop import Loop
from mfd_bayes.population.drawn import Drawn
from mfd_bayes.population.effects import Cell, Effect
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.population import Population
from mfd_bayes.population.predict import Predictor
from mfd_bayes.population.sequel import standing_of
from mfd_bayes.population.setting import Setting, setting_of
from mfd_bayes.population.unshared import unknown_of

Array = NDArray[np.float64]

RATE = 64.0
"""Rate at which a record is taken to be sampled where its noise is independent, Hz."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """An effect of levels or sessions, with the cells of settings that no test has had.

    Attributes
    ----------
    effect : Effect
    cells : tuple of (str, float)
        Its own, then the new ones.
    rows : (cells, cells)
        Weights of the independent parts.
    parts : (n, cells, members)
        Draws of the independent parts, in prior units.
    """

    effect: Effect
    cells: tuple[Cell, ...]
    rows: Array
    parts: Array

    def of(self, cell: Cell, *, scattered: bool) -> Array:
        """Its draws for a cell, (n, members); a new session is scatter, a new level is not."""
        at = self.cells.index(cell)
        if at >= len(self.effect.cells) and self.effect.name != "level" and not scattered:
            return np.zeros_like(self.parts[:, 0])
        return np.asarray(np.einsum("ncm,c->nm", self.parts, self.rows[at]))


@dataclass(frozen=True, eq=False)
class Devices:
    """Draws of a device: laws, effects and discrepancy are the same for all that is asked of it.

    Attributes
    ----------
    predictor : Predictor
    index : (n,) int
        Draws of the population.
    deviations : tuple of Deviation
    discrepancy : (n, K), kip, or None
        Coefficients of what the model leaves over.
    """

    predictor: Predictor
    index: NDArray[np.intp]
    deviations: tuple[Deviation, ...]
    discrepancy: Array | None

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
        deviations = tuple(
            _deviation(population, number, settings, index, rng)
            for number in range(len(population.layout.effects))
        )
        residual = population.residual
        learned = None if residual is None else residual.draw_coefficients(rng, count)
        return cls(Predictor(population, *kinds), index, deviations, learned)

    @property
    def population(self) -> Population:
        """The population that they are drawn from."""
        return self.predictor.population

    def parts(self, setting: Setting, rng: np.random.Generator, *, scattered: bool) -> Parts:
        """What tests under a setting are made of; see `Population.draw_parts`."""
        population, layout = self.population, self.population.layout
        h = population.h.reshape(population.size, -1)[self.index]
        choice = population.choice.reshape(population.size, -1)[self.index]
        latent = population.latent.reshape(population.size, *population.latent.shape[2:])
        law = layout.offsets(h, choice, [setting])[:, 0]
        for deviation in self.deviations:
            cell = deviation.effect.cell_of(setting, layout.settings)
            law[:, list(deviation.effect.members)] += deviation.of(cell, scattered=scattered)
        scatter = np.zeros_like(law)
        if scattered:
            together = population.together.reshape(population.size, *population.together.shape[2:])
            chance = rng.standard_normal(law.shape)
            scatter = layout.scatter(h) * np.einsum("nij,nj->ni", together[self.index], chance)
        return Parts(latent[self.index, 0], law, scatter)

    def drawn(
        self, setting: Setting, rng: np.random.Generator, *, scattered: bool = False
    ) -> Drawn:
        """Ingredients of the force under a setting, without noise."""
        parts = self.parts(setting, rng, scattered=scattered)
        standing = standing_of(self.population, self.predictor.model, self.population.values(parts))
        unknown = unknown_of(self.population, self.index.size, rng, setting, standing)
        return Drawn(parts, unknown, {}, discrepancy=self.discrepancy)

    def damper(self, loop: Loop, session: str, *, scattered: bool, seed: Sequence[int]) -> Array:
        """The damper's force along a loop, (n, T), kip: without offset and noise."""
        rng = np.random.default_rng(seed)
        setting = setting_of(loop.trace, session)
        return self.predictor.force(loop.trace, self.drawn(setting, rng, scattered=scattered))

    def measured(self, loop: Loop, session: str, cycles: float, seed: Sequence[int]) -> Array:
        """The mean loop of a test's record, with its scatter, offset and noise, (n, T), kip."""
        rng = np.random.default_rng(seed)
        drawn = self.drawn(setting_of(loop.trace, session), rng, scattered=True)
        damper = self.predictor.force(loop.trace, drawn)
        values = self.predictor.values(drawn)
        noise = self._mean_noise(rng, loop, values, cycles)
        return self.predictor.total(loop.trace, replace(drawn, noise=noise), damper)[0]

    def _mean_noise(
        self, rng: np.random.Generator, loop: Loop, values: dict[str, Array], cycles: float
    ) -> Array:
        """Draws of the noise in the mean of so many cycles, (n, T), kip."""
        residual, trace = self.population.residual, loop.trace
        scale = np.sqrt(self._averaged(loop, values) / cycles)
        if residual is None:
            return np.asarray(self.predictor.draw_noise(rng, trace, values) * scale)
        sd, levels = values["noise_sd"], np.sqrt(residual.levels.averaged(cycles))
        rest = residual.draw_rest(rng, trace, sd) * scale
        return np.asarray(rest + residual.draw_levels(rng, trace, sd) * levels)

    def _averaged(self, loop: Loop, values: dict[str, Array]) -> Array:
        """Variance of the mean of the noise over each sample's step over its variance, (n, T).

        For noise with a correlation that falls by exp(−Δt/τ): 2 (r − 1 + exp(−r))/r², r = Δt/τ.
        """
        residual = self.population.residual
        if residual is not None:
            time = np.full(self.index.size, residual.noise_time)
        elif "noise_time" in values:
            time = values["noise_time"]
        else:
            return np.broadcast_to(1.0 / np.maximum(RATE * loop.steps, 1.0), (1, loop.steps.size))
        r = np.maximum(loop.steps / np.maximum(time[:, None], 1e-12), 1e-6)
        return np.asarray(np.minimum(2.0 * (r + np.expm1(-r)) / r**2, 1.0))


def _deviation(
    population: Population,
    number: int,
    settings: Sequence[Setting],
    index: NDArray[np.intp],
    rng: np.random.Generator,
) -> Deviation:
    """An effect with the cells of the settings, drawn together for the new ones."""
    layout = population.layout
    effect = layout.effects[number]
    begin = sum(len(e.cells) for e in layout.effects[:number])
    asked = (effect.cell_of(setting, layout.settings) for setting in settings)
    new = tuple(cell for cell in dict.fromkeys(asked) if cell not in effect.cells)
    members = list(effect.members)
    latent = population.latent.reshape(population.size, *population.latent.shape[2:])[index]
    own = latent[:, 1 + begin : 1 + begin + len(effect.cells)][:, :, members]
    sd = layout.effect_sd(population.h.reshape(population.size, -1)[index])[:, begin, members]
    chance = rng.standard_normal((index.size, len(new), len(members)))
    parts = np.concatenate([own, sd[:, None, :] * chance], axis=1)
    return Deviation(effect, (*effect.cells, *new), effect.rows(new), parts)
