"""How far a test lies off the laws along a history of actuation.

A level of actuation deviates from the law, and near levels do so alike (`effects`). A test whose
actuation changes passes through many levels: what is known at one of them is not known as well at
the others. The deviation along its history is a Gaussian process given those of the calibrated
levels; it is drawn as a few independent normal numbers for each quantity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.effects import BOUNDS, Effect
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.population import Population
from mfd_bayes.population.setting import Setting

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STEP = 0.25
"""Octaves between the actuations at which deviations are drawn, and those of calibrated levels;
straight lines join them."""

FARTHEST = 4.0
"""Octaves from the level within which deviations differ."""

NEAR = 0.02
"""Octaves within which two actuations are one."""

SAME = 1e-9
"""Change of the actuation, over the level, up to which it is constant."""

ENOUGH = 0.99
"""Share of the variance that the numbers which are drawn have."""


@dataclass(frozen=True, eq=False)
class _Process:
    """Deviation of one quantity at G actuations, of which that at `home` is the level.

    Attributes
    ----------
    name : str
    quantity : int
    columns : slice
        Of the effects' independent parts.
    known : (G, cells)
        Weights of these.
    root : (G, R)
        Weights of the numbers that are drawn, for an effect of sd 1.
    """

    name: str
    quantity: int
    columns: slice
    known: Array
    root: Array


@dataclass(frozen=True, eq=False)
class Along:
    """Deviations of the quantities that follow the actuation, around a level.

    Attributes
    ----------
    population : Population
    setting : Setting
        With the level.
    octaves : (G,)
        Of the actuations at which deviations are drawn, from the level.
    processes : tuple of _Process
        None where the actuation is constant, or where too few levels were tested to tell a
        deviation from a law: then the laws hold.
    """

    population: Population
    setting: Setting
    octaves: Array
    processes: tuple[_Process, ...] = ()

    @classmethod
    def of(cls, population: Population, setting: Setting, history: Array | None) -> Along:
        """Deviations around a setting's actuation along a history (T,), or without one."""
        level = setting.actuation
        if history is None or np.ptp(history) <= SAME * level:
            return cls(population, setting, np.zeros(1))
        octaves = _knots(population, level, history)
        found, begin = [], 0
        for effect in population.layout.effects:
            if effect.name == "level":
                own = effect.cell_of(setting, population.layout.settings)
                cells = [(own[0], level * 2.0**o) if o else own for o in octaves.tolist()]
                found += _processes(population, effect, begin, cells)
            begin += len(effect.cells)
        return cls(population, setting, octaves, tuple(found))

    @property
    def level(self) -> float:
        """Actuation, ksi or kip."""
        return self.setting.actuation

    @property
    def size(self) -> int:
        """How many numbers are drawn for each test."""
        return sum(one.root.shape[1] for one in self.processes)

    def at_level(self, index: Index, numbers: Array) -> Array:
        """What is unknown of the deviation at the level, in prior units, (n, d).

        Parameters
        ----------
        index : (n,) int
            Draws of the hyperparameters.
        numbers : (n, size)
            N(0, 1) in the prior.
        """
        found = np.zeros((len(index), len(self.population.layout.names)))
        home = int(np.searchsorted(self.octaves, 0.0))
        sd = self._sd(index)
        for one, own in self._each(numbers):
            found[:, one.quantity] += sd[:, one.columns.start, one.quantity] * (
                own @ one.root[home]
            )
        return found

    def factors(self, index: Index, numbers: Array, history: Array) -> dict[str, Array]:
        """Factors of quantities along a history (T,) for what they deviate more than at the level.

        They are (n, T) each, by name.
        """
        if not self.processes:
            return {}
        places = _octaves(history, self.level)
        lines = np.array(
            [np.interp(places, self.octaves, one) for one in np.eye(self.octaves.size)]
        )
        layout = self.population.layout
        latent = self.population.latent.reshape(-1, *self.population.latent.shape[2:])[index]
        home, sd = int(np.searchsorted(self.octaves, 0.0)), self._sd(index)
        found = {}
        for one, own in self._each(numbers):
            k, columns = one.quantity, one.columns
            known = latent[:, 1 + columns.start : 1 + columns.stop, k] @ one.known.T
            away = known + sd[:, columns.start, k, None] * (own @ one.root.T)
            away = layout.spread[k] * (away - away[:, home, None])
            found[one.name] = np.exp(away @ lines)
        return found

    def added(self, parts: Parts, index: Index, numbers: Array) -> Parts:
        """Parts of tests that were drawn without what is unknown of their level, with it."""
        if not self.size:
            return parts
        return Parts(parts.level, parts.law + self.at_level(index, numbers), parts.scatter)

    def _sd(self, index: Index) -> Array:
        """Sd of each part of the effects, in prior units, (n, cells, d)."""
        h = self.population.h.reshape(self.population.size, -1)
        return self.population.layout.effect_sd(h[index])

    def _each(self, numbers: Array) -> Iterator[tuple[_Process, Array]]:
        """Each process with its numbers."""
        begin = 0
        for one in self.processes:
            end = begin + one.root.shape[1]
            yield one, numbers[:, begin:end]
            begin = end


def _octaves(actuation: Array, level: float) -> Array:
    """Octaves from a level, up to `FARTHEST`."""
    least = level * 2.0**-FARTHEST
    return np.asarray(np.minimum(np.log2(np.maximum(actuation, least) / level), FARTHEST))


def _knots(population: Population, level: float, history: Array) -> Array:
    """Octaves from a level at which deviations along a history are drawn, with 0 among them.

    Besides even ones there are those at which deviations have a bend: of calibrated levels, and
    where their sd stops to change.
    """
    along = _octaves(history, level)
    low, high = min(float(along.min()), 0.0), max(float(along.max()), 0.0)
    even = STEP * np.arange(np.floor(low / STEP), np.ceil(high / STEP) + 1.0)
    effects = [effect for effect in population.layout.effects if effect.name == "level"]
    bends = [actuation for effect in effects for _, actuation in effect.cells]
    bends += [effect.reference / bound for effect in effects for bound in BOUNDS]
    found = even.tolist()
    for place in _octaves(np.array([bend for bend in bends if bend > 0.0]), level).tolist():
        if low < place < high and np.min(np.abs(np.array(found) - place)) > NEAR:
            found.append(place)
    return np.sort(found)


def _processes(
    population: Population, effect: Effect, begin: int, cells: list[tuple[str, float]]
) -> list[_Process]:
    """Processes of the members of an effect whose parts begin there, at some cells."""
    own = len(effect.cells)
    rows = effect.rows(cells)[own:]
    root = _few(rows[:, own:])
    columns = slice(begin, begin + own)
    names = population.layout.names
    return [_Process(names[k], k, columns, rows[:, :own], root) for k in effect.members]


def _few(root: Array) -> Array:
    """Weights (G, R) of few numbers that have almost the covariance of a root (G, G).

    Variances are the same.
    """
    values, vectors = np.linalg.eigh(root @ root.T)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    count = int(np.searchsorted(np.cumsum(values), ENOUGH * values.sum())) + 1
    found = vectors[:, :count] * np.sqrt(values[:count])
    wanted, kept = np.sum(root**2, axis=1), np.sum(found**2, axis=1)
    found = found * np.sqrt(wanted / np.maximum(kept, 1e-300))[:, None]
    return np.asarray(found * np.where(found.sum(axis=0) < 0.0, -1.0, 1.0))
