"""What the hyperparameters of a population are, and how they are laid out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import known_quantities
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.laws import (
    COMPARE,
    LAWS,
    default_laws,
    log_prior,
    ratio,
    shapes_of,
    value_of,
)

Array = NDArray[np.float64]
Choice = NDArray[np.intp]

SAME_LEVEL = 0.01
"""Tests whose actuation differs by less than this share are at one level."""

ALIKE = float(np.log(2.0))
"""Distance of the logarithm of actuations over which deviations from a law stay alike."""

USUAL = 2.0 / np.pi
"""Mean speed of a sine over its peak: where on the Stribeck curve tests are compared."""

LEVELS = 3
"""Fewest levels at which a deviation from a law can be told from the law."""

LAW_NAMES = tuple(LAWS)

_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)


@dataclass(frozen=True)
class Setting:
    """Under what a test was made.

    Attributes
    ----------
    actuation : float, ksi or kip
    session : str
        Tests of one session share what changes between sessions; "" where none is declared.
    covariates : mapping of str to float
        What parameters may follow besides the actuation: "velocity" (in/s, its peak) and
        "amplitude" (in, half the stroke).
    """

    actuation: float
    session: str = ""
    covariates: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Effect:
    """What tests have in common beyond the law, for the members of a scatter group.

    Tests of one session share an effect. Those of one level of actuation do too, and levels
    are alike the nearer they are: over the logarithm of the actuation the effect is a Gaussian
    process of correlation exp(−|log p − log p'| / log 2), within a session.

    Attributes
    ----------
    name : "level" or "session"
    group : int
    members : tuple of int
        Quantities that have it.
    cells : tuple of (str, float)
        Session and actuation (0 where it does not matter) of each cell.
    home : tuple of int
        Cell of each test.
    """

    name: str
    group: int
    members: tuple[int, ...]
    cells: tuple[tuple[str, float], ...]
    home: tuple[int, ...]

    @cached_property
    def root(self) -> Array:
        """Cholesky factor of the cells' correlation, (cells, cells)."""
        return np.asarray(np.linalg.cholesky(self._correlation(self.cells)))

    def _correlation(self, others: Sequence[tuple[str, float]]) -> Array:
        if self.name == "session":
            return np.array([[float(a == b) for b in self.cells] for a in others])
        sessions = np.array([[a[0] == b[0] for b in self.cells] for a in others])
        with np.errstate(divide="ignore"):  # without actuation, as far from all levels as can be
            at = np.log(np.array([[actuation] for _, actuation in others]))
        apart = np.abs(at - np.log(np.array([actuation for _, actuation in self.cells])))
        return np.asarray(sessions * np.exp(-apart / ALIKE))

    def row(self, cell: tuple[str, float]) -> tuple[Array, float]:
        """What a test of a cell has of the independent parts, (cells,), and sd of what is new."""
        if cell in self.cells:
            return self.root[self.cells.index(cell)], 0.0
        row = solve_triangular(self.root, self._correlation([cell])[0], lower=True)
        return row, float(np.sqrt(np.maximum(1.0 - row @ row, 0.0)))


@dataclass(frozen=True, eq=False)
class Layout:
    """What the hyperparameters are, and how they are laid out.

    A test's coordinates are, for quantity k of test j, in prior units,

        x_jk = level_k + law_k(p_j) + effects of the test's cells + scatter_k N(0, 1)

    A point h of the hyperparameters holds the logarithms of the quantities' scatter, those of
    the effects' sd, and the coordinates of the shapes, in this order.

    Attributes
    ----------
    coordinates : Coordinates
        Of the pooled quantities, d of them.
    centre, spread : (d,)
        Mean and sd of their coordinates under the test prior, which is that of the levels.
    laws : mapping of str to str
        Law of each quantity that follows the actuation; "compare" for a mixture of them.
    weights : mapping of str to mapping of str to float
        Weights of the laws of each such quantity.
    groups : tuple of (str, ...)
        Scatter groups: quantities whose effects have one sd.
    member : (d,) int
        Group of each quantity.
    scatter_sd : (d,)
        Half-normal scale of each quantity's scatter, and of the effects on it.
    reference : float, ksi or kip
        Actuation p0 to which levels belong.
    settings : tuple of Setting
        Those of the calibrated tests.
    effects : tuple of Effect
    dependence : mapping of str to tuple of str
        Covariates that quantities follow.
    covariate_reference : mapping of str to float
        Values of the covariates to which levels belong.
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

    @property
    def names(self) -> tuple[str, ...]:
        """The pooled quantities."""
        return self.coordinates.names

    @property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each shape coordinate."""
        found = [(name, s) for name, law in self.laws.items() for s in shapes_of(law)]
        return (*found, *((n, c) for n, those in self.dependence.items() for c in those))

    @property
    def dim(self) -> int:
        """Number of hyperparameters in h."""
        return len(self.names) + len(self.effects) + len(self.shapes)

    @property
    def block(self) -> NDArray[np.intp]:
        """Scatter group to which each coordinate of h belongs, (dim,)."""
        shaped = [self.member[self.names.index(name)] for name, _ in self.shapes]
        effects = [effect.group for effect in self.effects]
        return np.array([*self.member, *effects, *shaped], dtype=np.intp)

    @property
    def sd_scale(self) -> Array:
        """Half-normal scale of the scatter of each quantity and of the sd of each effect."""
        effects = [self.scatter_sd[effect.members[0]] for effect in self.effects]
        return np.concatenate([self.scatter_sd, effects])

    def scatter(self, h: Array) -> Array:
        """Scatter of each quantity in prior units, (n, d)."""
        tau: Array = np.exp(h[:, : len(self.names)]) / self.spread
        return tau

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
        """What of the level and the effects' independent parts each test has, (J, 1 + cells)."""
        columns = [np.ones((len(self.settings), 1))]
        for effect in self.effects:
            columns.append(effect.root[list(effect.home)])
        return np.concatenate(columns, axis=1)

    def cell_of(self, effect: Effect, setting: Setting) -> tuple[str, float]:
        """Cell of a setting: its session, and the actuation of the tests at its level if any."""
        return _cell(effect.name, setting, self.settings)

    def log_prior(self, h: Array) -> Array:
        """Log density of each block of h, without constants, (n, G).

        Half-normal scatter and effects, with the Jacobian of their logarithms, and shapes.
        """
        density = np.zeros((len(h), len(self.groups)))
        sd = self.sd_scale
        for i in range(len(sd)):
            density[:, self.block[i]] += h[:, i] - 0.5 * (np.exp(h[:, i]) / sd[i]) ** 2
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
        """Laws and dependences under the calibrated tests' settings or others, (n, m, d)."""
        chosen = self.settings if settings is None else settings
        relative = np.array([s.actuation for s in chosen]) / self.reference
        offsets = np.zeros((len(h), len(chosen), len(self.names)))
        for name in self.laws:
            k = self.names.index(name)
            share, exponent = self.law_shapes(h, choice, name)
            followed = ratio(relative, share[:, None], exponent[:, None])
            offsets[..., k] += np.log(np.maximum(followed, 1e-300)) / self.spread[k]
        begin = len(self.names) + len(self.effects)
        for i, (name, shape) in enumerate(self.shapes):
            if shape in self.covariate_reference:
                k = self.names.index(name)
                reference = self.covariate_reference[shape]
                folds = np.log([s.covariates[shape] / reference for s in chosen])
                offsets[..., k] += h[:, begin + i, None] * folds / self.spread[k]
        return offsets

    def draw_choice(self, n: int) -> Choice:
        """Laws of n chains in the proportion of the weights, (n, L) int; always the same."""
        choice = np.zeros((n, len(self.laws)), dtype=np.intp)
        for column, name in enumerate(self.laws):
            weights = self.weights[name]
            edges = np.cumsum([weights.get(law, 0.0) for law in LAW_NAMES])
            # a low-discrepancy sequence for each quantity, so that their laws are independent
            place = (0.5 + np.arange(n) * np.sqrt(_PRIMES[column % len(_PRIMES)])) % 1.0
            choice[:, column] = np.searchsorted(edges / edges[-1], place, side="right")
        return choice


def lay_out(
    priors: PriorFile,
    names: Sequence[str],
    settings: Sequence[Setting],
    laws: Mapping[str, str] | None = None,
    dependence: Mapping[str, Sequence[str]] | None = None,
) -> Layout:
    """Layout of the population of tests.

    Tests at one level in one session share an effect on what follows a law, where a level has
    several tests; tests of one session share an effect on everything, where there are several.

    Raises
    ------
    PriorError
        When a quantity to be pooled has no scatter prior.
    FitError
        When a law needs what there is not: a positive quantity, or positive actuations.
    """
    quantities = known_quantities()
    pooled = tuple(n for n in names if n not in quantities or quantities[n].pooled)
    chosen = {n: law for n, law in (default_laws() | dict(laws or {})).items() if n in pooled}
    for name in chosen:
        prior = priors.parameters[name]
        if prior.lower != 0.0 or np.isfinite(prior.upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")
    levels = np.array([s.actuation for s in settings])
    if not np.all(levels > 0):
        raise FitError("every calibrated test needs an actuation above zero for the pressure laws")
    groups, member = _group(priors, pooled)
    rng = np.random.default_rng(0)
    known = priors.parameters
    coordinates = Coordinates(pooled, {n: known[n] for n in pooled}, USUAL * _typical(settings))
    drawn = coordinates.of({n: known[n].draw(rng, 4000) for n in pooled})
    follows = {n: tuple(c) for n, c in (dependence or {}).items() if n in pooled and c}
    used = sorted({c for those in follows.values() for c in those})
    return Layout(
        coordinates=coordinates,
        centre=drawn.mean(axis=0),
        spread=drawn.std(axis=0),
        laws=chosen,
        weights={
            n: dict.fromkeys(LAWS, 1.0 / len(LAWS)) if law == COMPARE else {law: 1.0}
            for n, law in chosen.items()
        },
        groups=groups,
        member=member,
        scatter_sd=np.array([priors.scatter[groups[g]].sd for g in member]),
        reference=float(np.exp(np.mean(np.log(levels)))),
        settings=tuple(settings),
        effects=_effects(settings, pooled, member, chosen),
        dependence=follows,
        covariate_reference={
            c: float(np.exp(np.mean([np.log(s.covariates[c]) for s in settings]))) for c in used
        },
    )


def _typical(settings: Sequence[Setting]) -> float:
    """Geometric mean of the tests' peak speeds, in/s."""
    speeds = [s.covariates["velocity"] for s in settings if s.covariates.get("velocity", 0.0) > 0]
    return float(np.exp(np.mean(np.log(speeds)))) if speeds else 1.0


def _cell(effect: str, setting: Setting, others: Sequence[Setting]) -> tuple[str, float]:
    if effect == "session":
        return setting.session, 0.0
    near = [o.actuation for o in others if same_level(o.actuation, setting.actuation)]
    return setting.session, near[0] if near else setting.actuation


def same_level(actuation: float, other: float) -> bool:
    """Whether two actuations are at one level."""
    return abs(actuation - other) <= SAME_LEVEL * max(actuation, other)


def levels_of(settings: Sequence[Setting]) -> list[list[int]]:
    """Tests at each level of actuation, lowest first."""
    folds: list[list[int]] = []
    for j in np.argsort([setting.actuation for setting in settings]).tolist():
        if folds and same_level(settings[folds[-1][0]].actuation, settings[j].actuation):
            folds[-1].append(j)
        else:
            folds.append([j])
    return folds


def _effects(
    settings: Sequence[Setting], names: tuple[str, ...], member: Choice, laws: Mapping[str, str]
) -> tuple[Effect, ...]:
    followers = [names.index(name) for name in laws]
    found = []
    for name, members in (("level", followers), ("session", list(range(len(names))))):
        keys = [_cell(name, setting, settings) for setting in settings]
        cells = tuple(dict.fromkeys(keys))
        if len(cells) < (LEVELS if name == "level" else 2):
            continue
        home = tuple(cells.index(key) for key in keys)
        for group in dict.fromkeys(member[members].tolist()):
            those = tuple(k for k in members if member[k] == group)
            found.append(Effect(name, group, those, cells, home))
    return tuple(found)


def _group(priors: PriorFile, names: tuple[str, ...]) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    home = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    lost = [name for name in names if name not in home]
    if lost:
        raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {lost[0]}")
    groups = tuple(dict.fromkeys(home[name] for name in names))
    return groups, np.array([groups.index(home[name]) for name in names], dtype=np.intp)
