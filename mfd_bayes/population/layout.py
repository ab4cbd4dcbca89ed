"""Layout of the hyperparameters of a population: which there are, their order and their priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.effects import Effect
from mfd_bayes.population.laws import LAWS, log_prior, ratio, shapes_of, value_of
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.zeros import informs_of

Array = NDArray[np.float64]
Choice = NDArray[np.intp]

LAW_NAMES = tuple(LAWS)

ODD = 0.01
"""Probability that a quantity of a test stands apart from the others."""

WIDER = 10.0
"""Scatter of what stands apart, over that of the others."""

NONE = 1e-5
"""Scatter, in prior units, of a quantity that is the same in all tests."""

_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of the hyperparameters h of a population of tests.

    The coordinate of quantity k of test j is, in prior units,

        x_jk = level_k + law_k(p_j) + effects of the test's cells + scatter_k N(0, 1)

    h holds the logarithms of the quantities' scatter, those of the effects' sd, and the
    coordinates of the laws' shapes and of the dependences, in this order.

    Attributes
    ----------
    coordinates : Coordinates
        Of the d quantities that the tests share.
    centre, spread : (d,)
        Mean and sd of their coordinates under the test prior, which is that of the levels.
    laws : mapping of str to str
        Law of each quantity that follows the actuation; "compare" for a mixture of them.
    weights : mapping of str to mapping of str to float
        Weights of the laws of each such quantity.
    groups : tuple of str
        Scatter groups: quantities whose effects have one sd.
    member : (d,) int
        Group of each quantity.
    scatter_sd : (d,)
        Scale of the prior of each quantity's scatter, and of the effects on it.
    reference : float, ksi or kip
        Actuation p0 at which levels are medians over tests, above zero.
    settings : tuple of Setting
        Of the calibrated tests.
    effects : tuple of Effect
    dependence : mapping of str to tuple of str
        Covariates that quantities follow.
    covariate_reference : mapping of str to float
        Values of the covariates at which levels are medians over tests.
    sparse : tuple of bool
        Whether each quantity's scatter prior prefers none: exponential, not half-normal.
    common : tuple of bool
        Whether each quantity is the same in all tests; its scatter is then `NONE`.
    odd : float
        Probability that a quantity of a test stands apart from the other tests', with `WIDER` times
        their scatter, so that it hardly widens what is expected of others.
    """

    coordinates: Coordinates
    centre: Array
    spread: Array
    laws: Mapping[str, str]
    weights: Mapping[str, Mapping[str, float]]
    groups: tuple[str, ...]
    member: NDArray[np.intp]
    scatter_sd: Array
    reference: float
    settings: tuple[Setting, ...]
    effects: tuple[Effect, ...] = ()
    dependence: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    covariate_reference: Mapping[str, float] = field(default_factory=dict)
    sparse: tuple[bool, ...] = ()
    common: tuple[bool, ...] = ()
    odd: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Quantities that the tests share."""
        return self.coordinates.names

    @cached_property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each shape coordinate."""
        found = [(name, s) for name, law in self.laws.items() for s in shapes_of(law)]
        return (*found, *((n, c) for n, those in self.dependence.items() for c in those))

    @cached_property
    def informs(self) -> NDArray[np.bool_]:
        """Whether each test informs level, scatter and law of each quantity, (J, d)."""
        return informs_of(self.settings, self.names, self.weights)

    @property
    def dim(self) -> int:
        """Number of hyperparameters in h."""
        return len(self.names) + len(self.effects) + len(self.shapes)

    @cached_property
    def inferred(self) -> NDArray[np.bool_]:
        """Whether each coordinate of h is inferred, (dim,): not the scatter of what is common."""
        inferred = np.ones(self.dim, dtype=np.bool_)
        inferred[np.flatnonzero(self.common)] = False
        return inferred

    @cached_property
    def block(self) -> NDArray[np.intp]:
        """Scatter group to which each coordinate of h belongs, (dim,)."""
        shaped = [self.member[self.names.index(name)] for name, _ in self.shapes]
        effects = [effect.group for effect in self.effects]
        return np.array([*self.member, *effects, *shaped], dtype=np.intp)

    @cached_property
    def sd_scale(self) -> Array:
        """Prior scale of the scatter of each quantity and of the sd of each effect."""
        effects = [self.scatter_sd[e.members[0]] * e.scale for e in self.effects]
        return np.concatenate([self.scatter_sd, effects])

    def scatter(self, h: Array) -> Array:
        """Scatter of each quantity in prior units, (n, d)."""
        tau: Array = np.exp(h[:, : len(self.names)]) / self.spread
        return tau

    def without(self, effect: str) -> Layout:
        """The layout without the effects of a name."""
        return replace(self, effects=tuple(e for e in self.effects if e.name != effect))

    def effect_sd(self, h: Array) -> Array:
        """Sd of each part of the effects on each quantity in prior units, (n, cells, d)."""
        cells = [len(effect.cells) for effect in self.effects]
        sd = np.zeros((len(h), sum(cells), len(self.names)))
        begin = 0
        for i, effect in enumerate(self.effects):
            omega = np.exp(h[:, len(self.names) + i])
            for k in effect.members:
                sd[:, begin : begin + cells[i], k] = (omega / self.spread[k])[:, None]
            begin += cells[i]
        return sd

    def design(self) -> Array:
        """Weights of level and effects' independent parts in each test, (J, 1 + cells)."""
        effects = [effect.root[list(effect.home)] for effect in self.effects]
        return np.concatenate([np.ones((len(self.settings), 1)), *effects], axis=1)

    def columns(self) -> NDArray[np.intp]:
        """Columns of the design for each quantity, (d, p): those that it has, then some others."""
        cells = [len(effect.cells) for effect in self.effects]
        having = np.zeros((len(self.names), 1 + sum(cells)), dtype=np.bool_)
        having[:, 0] = True
        begin = 1
        for effect, count in zip(self.effects, cells, strict=True):
            having[list(effect.members), begin : begin + count] = True
            begin += count
        first = np.argsort(~having, axis=1, kind="stable")
        return first[:, : int(having.sum(axis=1).max())]

    def log_prior(self, h: Array) -> Array:
        """Log prior density of each block of h, without constants, (n, G).

        Scatter and effects' sd are half-normal, or exponential, with the Jacobian of their logs.
        """
        sd = self.sd_scale
        log_sd = h[:, : len(sd)]
        size = np.exp(log_sd) / sd
        sparse = np.zeros(len(sd), dtype=np.bool_)
        sparse[np.flatnonzero(self.sparse)] = True
        terms = log_sd - np.where(sparse, size, 0.5 * size**2)
        member = self.block[: len(sd), None] == np.arange(len(self.groups))
        density: Array = terms @ member.astype(np.float64)
        for i, (_, shape) in enumerate(self.shapes):
            at = len(sd) + i
            density[:, self.block[at]] += log_prior(shape, h[:, at])
        return density

    def law_shapes(self, h: Array, choice: Choice, name: str) -> tuple[Array, Array]:
        """Share and exponent of a quantity's law in each row of h, (n,) each.

        Parameters
        ----------
        h : (n, dim)
        choice : (n, L) int
            Law of each quantity in `laws`, as an index of `LAW_NAMES`.
        name : str
        """
        column = list(self.laws).index(name)
        begin = len(self.names) + len(self.effects)
        free = {s: h[:, begin + i] for i, (n, s) in enumerate(self.shapes) if n == name}
        found = []
        for shape in ("share", "exponent"):
            given = np.array([getattr(LAWS[law], shape) for law in LAW_NAMES], dtype=np.float64)
            fixed = given[choice[:, column]]
            inferred = value_of(shape, free[shape]) if shape in free else fixed
            found.append(np.where(np.isnan(fixed), inferred, fixed))
        return found[0], found[1]

    def offsets(self, h: Array, choice: Choice, settings: Sequence[Setting] | None = None) -> Array:
        """Laws and dependences in prior units under the tests' settings or others, (n, m, d)."""
        chosen = self.settings if settings is None else settings
        actuations = np.array([s.actuation for s in chosen])
        levels, level = np.unique(actuations / self.reference, return_inverse=True)
        at_levels = np.zeros((len(h), len(levels), len(self.names)))
        for name in self.laws:
            k = self.names.index(name)
            share, exponent = self.law_shapes(h, choice, name)
            followed = ratio(levels, share[:, None], exponent[:, None])
            at_levels[..., k] = np.log(np.maximum(followed, 1e-300)) / self.spread[k]
        offsets = np.take(at_levels, level, axis=1)
        begin = len(self.names) + len(self.effects)
        for i, (name, shape) in enumerate(self.shapes):
            if shape in self.covariate_reference:
                k = self.names.index(name)
                reference = self.covariate_reference[shape]
                among = [s.covariates[shape] for s in self.settings]  # not followed beyond
                within = np.clip([s.covariates[shape] for s in chosen], min(among), max(among))
                folds = np.log(within / reference)
                offsets[..., k] += h[:, begin + i, None] * folds / self.spread[k]
        if settings is None:
            offsets[:, ~self.informs] = 0.0
        return offsets

    def draw_choice(self, n: int) -> Choice:
        """Laws of n chains in proportion to the weights, (n, L) int; no random numbers."""
        choice = np.zeros((n, len(self.laws)), dtype=np.intp)
        for column, name in enumerate(self.laws):
            weights = self.weights[name]
            edges = np.cumsum([weights.get(law, 0.0) for law in LAW_NAMES])
            # a low-discrepancy sequence for each quantity, so that their laws are independent
            place = (0.5 + np.arange(n) * np.sqrt(_PRIMES[column % len(_PRIMES)])) % 1.0
            choice[:, column] = np.searchsorted(edges / edges[-1], place, side="right")
        return choice
