"""Effects: deviations from the laws that the tests of a session or of a level have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mfd_bayes.population.setting import Setting, same_level

Array = NDArray[np.float64]
Cell = tuple[str, float]
"""Session and actuation of tests that share an effect; the actuation is 0 where it is for all."""

ALIKE = float(np.log(2.0))
"""Correlation length of a level's effect, along the logarithm of the actuation."""

_FAR = 1e3  # exp(−r) is 0 there

WIDER = 2.0
"""Scale of the sd of a level's effect, over that of scatter from test to test: real levels lie
farther from a law than repeats from each other."""

BOUNDS = (0.5, 2.0)
"""Least and largest sd of a level's effect, over that at the reference actuation. They hold from
twice the reference upwards, and from half of it down to zero."""

LEVELS = 3
"""Fewest levels at which a deviation from a law can be told from the law."""


@dataclass(frozen=True, eq=False)
class Effect:
    """Deviation that tests have in common, for the quantities of one scatter group.

    Tests of one session share an effect. So do those of one level of actuation, and effects of
    near levels are similar: over the logarithm of the actuation they are a smooth Gaussian process,
    within a session, of correlation (1 + r) exp(−r), r = √3 |log p − log p'| / log 2 (Matérn 3/2).
    Zero has no logarithm: the effect of that level is independent of all others.

    A level's deviation is like that of a wrong actuation, wrong by as much at every level (a load
    cell's zero, a threshold): in the logarithm of a force its sd is in inverse proportion to the
    actuation.

    Attributes
    ----------
    name : "level" or "session"
    group : int
    members : tuple of int
        Quantities that have it.
    cells : tuple of (str, float)
    home : tuple of int
        Index of each test's cell.
    kernel : "matern" or "exponential"
        Correlation along the actuation; exp(−|log p − log p'| / log 2) in populations that earlier
        versions have stored.
    scale : float
        Scale of the prior of its sd, over that of the group's scatter.
    reference : float
        Actuation at which its sd is 1, kip or ksi; 0 where the sd is the same at every actuation,
        as for sessions, and for levels in populations that earlier versions have stored.
    """

    name: str
    group: int
    members: tuple[int, ...]
    cells: tuple[Cell, ...]
    home: tuple[int, ...]
    kernel: str = "matern"
    scale: float = 1.0
    reference: float = 0.0

    @cached_property
    def root(self) -> Array:
        """Cholesky factor of the cells' covariance, (cells, cells)."""
        return np.asarray(np.linalg.cholesky(self._covariance(self.cells)))

    def _size(self, cells: Sequence[Cell]) -> Array:
        """Sd of the effect in cells, over that at the reference actuation, (cells,)."""
        if not self.reference:
            return np.ones(len(cells))
        actuation = np.array([actuation for _, actuation in cells])
        with np.errstate(divide="ignore"):
            return np.clip(self.reference / actuation, *BOUNDS)

    def _covariance(self, others: Sequence[Cell]) -> Array:
        """Covariance of the effect between other cells and its own, (others, cells)."""
        sizes = self._size(others)[:, None] * self._size(self.cells)
        return np.asarray(sizes * self._correlation(others))

    def _correlation(self, others: Sequence[Cell]) -> Array:
        """Correlation of the effect between other cells and its own, (others, cells)."""
        if self.name == "session":
            return np.array([[float(a == b) for b in self.cells] for a in others])
        sessions = np.array([[a[0] == b[0] for b in self.cells] for a in others])
        there = np.array([[actuation] for _, actuation in others])
        here = np.array([actuation for _, actuation in self.cells])
        with np.errstate(divide="ignore", invalid="ignore"):  # zero: infinitely far, but for itself
            apart = np.where(there == here, 0.0, np.abs(np.log(there) - np.log(here))) / ALIKE
        if self.kernel == "exponential":
            return np.asarray(sessions * np.exp(-apart))
        r = np.minimum(np.sqrt(3.0) * apart, _FAR)
        return np.asarray(sessions * (1.0 + r) * np.exp(-r))

    def row(self, cell: Cell) -> tuple[Array, float]:
        """Weights of the independent parts in a cell's effect, (cells,), and sd of the rest."""
        if cell in self.cells:
            return self.root[self.cells.index(cell)], 0.0
        row = solve_triangular(self.root, self._covariance([cell])[0], lower=True)
        return row, float(np.sqrt(np.maximum(self._size([cell])[0] ** 2 - row @ row, 0.0)))

    def rows(self, cells: Sequence[Cell]) -> Array:
        """Weights of independent parts in its own cells' effects and then in those of others.

        (own + others, own + others), lower triangular; others are not among its own.
        """
        every = (*self.cells, *cells)
        new = replace(self, cells=every, home=())
        near = 1e-12 * np.eye(len(every))  # effects of very near levels are the same but for this
        rows = np.linalg.cholesky(new._covariance(every) + near)
        rows[: len(self.cells), : len(self.cells)] = self.root
        return np.asarray(rows)

    def cell_of(self, setting: Setting, others: Sequence[Setting]) -> Cell:
        """Cell of a setting: its session, and the actuation of others at its level, if any."""
        return _cell(self.name, setting, others)


def _cell(effect: str, setting: Setting, others: Sequence[Setting]) -> Cell:
    if effect == "session":
        return setting.session, 0.0
    near = [o.actuation for o in others if same_level(o.actuation, setting.actuation)]
    return setting.session, near[0] if near else setting.actuation


def effects_of(
    settings: Sequence[Setting],
    names: tuple[str, ...],
    member: NDArray[np.intp],
    laws: Mapping[str, str],
    informs: NDArray[np.bool_],
) -> tuple[Effect, ...]:
    """Effects of levels, on quantities with a law, and of sessions, on every quantity.

    Only those that the settings can tell: of `LEVELS` levels, or of two sessions. `informs`
    says which tests inform each quantity, (J, d).
    """
    found = []
    followers = [names.index(name) for name in laws]
    for name, likely in (("level", followers), ("session", list(range(len(names))))):
        keys = [_cell(name, setting, settings) for setting in settings]
        cells = tuple(dict.fromkeys(keys))
        # one level in two sessions is one level: it cannot be told from the sessions
        kinds = [level for _, level in keys] if name == "level" else keys
        told = [{kinds[j] for j in np.flatnonzero(informs[:, k])} for k in range(len(names))]
        members = [k for k in likely if len(told[k]) >= (LEVELS if name == "level" else 2)]
        home = tuple(cells.index(key) for key in keys)
        for group in dict.fromkeys(member[members].tolist()):
            those = tuple(k for k in members if member[k] == group)
            effect = Effect(name, group, those, cells, home)
            found.append(_of_levels(effect) if name == "level" else effect)
    return tuple(found)


def _of_levels(effect: Effect) -> Effect:
    """An effect of levels, with the scale and the reference of its sd."""
    above_zero = [actuation for _, actuation in effect.cells if actuation > 0]
    reference = float(np.exp(np.mean(np.log(above_zero))))
    return replace(effect, scale=WIDER, reference=reference)
