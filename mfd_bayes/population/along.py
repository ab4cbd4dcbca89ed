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
"""Octaves between the actuations at which deviations are drawn, besides those of calibrated levels;
between them they are interpolated."""

FARTHEST = 4.0
"""Octaves from the level beyond which the deviation stays as it is there."""

NEAR = 0.02
"""Octaves within which two actuations are one."""

SAME = 1e-9
"""Change of the actuation, over the level, up to which it is constant."""

ENOUGH = 0.99
"""Share of the variance of all actuations that is kept where few numbers are drawn for them."""

LEAST = 0.2
"""Sd of a deviation, over that of the effect, below which it need not be kept."""


@dataclass(frozen=True, eq=False)
class _Process:
    """Deviation of one quantity at G actuations.

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
    """Deviations of the quantities that follow the actuation, between the actuations of a history.

    Attributes
    ----------
    population : Population
    setting : Setting
        With the level to which a test's parameters belong.
    octaves : (G,)
        Of the actuations at which deviations are drawn, from the level, which is among them.
    processes : tuple of _Process
        Empty where the actuation is constant, or where too few levels were tested to tell a
        deviation from a law: then the laws hold.
    """

    population: Population
    setting: Setting
    octaves: Array
    processes: tuple[_Process, ...] = ()

    @classmethod
    def of(cls, population: Population, setting: Setting, history: Array | None) -> Along:
        """Deviations at a setting's actuation and along a history (T,), or without one."""
        level = setting.actuation
        # without any actuation slip forces stay at their level
        if history is None or level <= 0 or np.max(np.abs(history - level)) <= SAME * level:
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

    def unknown(self, index: Index, numbers: Array, level: float | None = None) -> Array:
        """What is unknown of the deviation at a level, in prior units, (n, d).

        Parameters
        ----------
        index : (n,) int
            Draws of the hyperparameters.
        numbers : (n, size)
            N(0, 1) in the prior.
        level : float, optional
            Another than that of the setting.
        """
        found = np.zeros((len(index), len(self.population.layout.names)))
        lines = self._lines(np.array([self.level if level is None else level]))[:, 0]
        sd = self._sd(index)
        for one, own in self._each(numbers):
            k = one.quantity
            found[:, k] += sd[:, one.columns.start, k] * (own @ (lines @ one.root))
        return found

    def log_factors(
        self, index: Index, numbers: Array, history: Array, level: float | None = None
    ) -> dict[str, Array]:
        """Logarithms of quantities along a history (T,), less those at a level.

        They are (T, n) each, by name.
        """
        if not self.processes:
            return {}
        lines = self._lines(history)
        lines = lines - self._lines(np.array([self.level if level is None else level]))
        layout = self.population.layout
        latent = self.population.latent.reshape(-1, *self.population.latent.shape[2:])[index]
        found, sd = {}, self._sd(index)
        for one, own in self._each(numbers):
            k, columns = one.quantity, one.columns
            known = latent[:, 1 + columns.start : 1 + columns.stop, k]
            drawn = sd[:, columns.start, k, None] * own
            weights = layout.spread[k] * (lines.T @ np.hstack([one.known, one.root]))
            found[one.name] = weights @ np.hstack([known, drawn]).T
        return found

    def trends(self, index: Index) -> Array:
        """What draws expect at both ends of the history: logarithms over the level, (n, q)."""
        if not self.processes:
            return np.zeros((len(index), 0))
        ends = self.level * 2.0 ** self.octaves[[0, -1]]
        logs = self.log_factors(index, np.zeros((len(index), self.size)), ends)
        found = []
        for name in self.population.layout.laws:
            law = self.population.ratio_of(name, ends, index)
            law = law / self.population.ratio_of(name, np.array([self.level]), index)
            found.append(np.log(np.maximum(law, 1e-300)) + logs.get(name, np.zeros((2, 1))).T)
        return np.concatenate(found, axis=1)

    def added(
        self, parts: Parts, index: Index, numbers: Array, level: float | None = None
    ) -> Parts:
        """Parts of tests that were drawn without what is unknown of their level, with it."""
        if not self.size:
            return parts
        return Parts(parts.level, parts.law + self.unknown(index, numbers, level), parts.scatter)

    def _lines(self, actuation: Array) -> Array:
        """Weights of the G actuations in deviations at others (T,), (G, T)."""
        places = _octaves(actuation, self.level)
        return np.array([np.interp(places, self.octaves, one) for one in np.eye(len(self.octaves))])

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
    reached = _octaves(history, level)
    low, high = min(float(reached.min()), 0.0), max(float(reached.max()), 0.0)
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

    Variances are the same. Actuations count alike, however large their variance is.
    """
    wanted = np.sum(root**2, axis=1)
    size = np.sqrt(wanted + LEAST**2)[:, None]
    vectors, values, _ = np.linalg.svd(root / size)
    share = np.cumsum(values**2) / np.sum(values**2)
    count = int(np.searchsorted(share, ENOUGH)) + 1
    found = size * vectors[:, :count] * values[:count]
    kept = np.sum(found**2, axis=1)
    return np.asarray(found * np.sqrt(wanted / np.maximum(kept, 1e-300))[:, None])
