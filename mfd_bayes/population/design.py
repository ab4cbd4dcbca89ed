"""Which levels, laws, covariates, effects and scatter the tests of a campaign call for.

In prior units the coordinate of quantity k of test j is

    x_jk = level_k + law_k(p_j) + b_k' covariates_j + level effect_k(p_j, session_j)
           + session effect_k(session_j) + d_jk,      d_jk ~ N(0, τ_k²)

Level, slopes b and effects are linear; the shapes of laws (share, exponent) are not. Quantities
that are the same in all tests (`sparse` in the prior file) have no scatter and no effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import known_quantities
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.laws import (
    COMPARE,
    LAW_NAMES,
    LAWS,
    SENSITIVITY,
    default_laws,
    ratio,
    shape_prior,
    shapes_of,
)
from mfd_bayes.population.settings import (
    Setting,
    geometric_mean,
    levels_of,
    same_level,
    varies,
    with_zeros,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ALIKE = float(np.log(2.0))
"""Correlation length of a level's effect along the logarithm of the actuation."""

WIDER = 2.0
"""Scale of the sd of a level's effect, over that of scatter: real levels lie farther from a law
than repeats from each other."""

BOUNDS = (0.5, 2.0)
"""Least and largest sd of a level's effect, over that at the reference actuation."""

LEVELS = 3
"""Fewest levels at which a deviation from a law can be told from the law."""

TESTS = 4
"""Fewest tests in which a dependence on a covariate is looked for."""

USUAL_SPEED = 2.0 / np.pi
"""Mean over peak speed of a sine: where on the Stribeck curve slip forces are compared."""


class Effect(NamedTuple):
    """Deviations that tests of a level or of a session have in common, with one sd.

    A level's deviation is like that of a wrong actuation, wrong by as much at every level: in the
    logarithm of a force its sd is in inverse proportion to the actuation.
    """

    name: str
    group: str
    members: tuple[int, ...]
    scale: float


@dataclass(frozen=True, eq=False)
class Design:
    """Layout of the mixed model of a campaign's tests; see `design_of`.

    Attributes
    ----------
    names : tuple of str
        The d quantities that tests share, the first of the coordinates.
    coordinates : Coordinates
        Of these, and of what is each test's own: the start in the gap, shapes of laws.
    spread : (d,)
        Prior units of these.
    laws : mapping of str to str
        Law of each quantity that follows the actuation, or "compare".
    dependence : mapping of str to tuple of str
        Covariates that quantities follow.
    settings : tuple of Setting
        Of the J calibrated tests.
    groups : mapping of str to str
        Scatter group of each quantity.
    scatter_sd : (d,)
        Scale of the prior of τ.
    common : (d,) bool
        Quantities that are the same in all tests.
    reference : float, ksi or kip
        Actuation p0 of the levels.
    leveled : bool
        Whether levels may deviate from the laws.
    """

    names: tuple[str, ...]
    coordinates: Coordinates
    spread: Array
    laws: Mapping[str, str]
    dependence: Mapping[str, tuple[str, ...]]
    settings: tuple[Setting, ...]
    groups: Mapping[str, str]
    scatter_sd: Array
    common: NDArray[np.bool_]
    reference: float
    leveled: bool = True
    covariates: Mapping[str, float] = field(init=False)
    cells: tuple[tuple[str, float], ...] = field(init=False)
    sessions: tuple[str, ...] = field(init=False)
    effects: tuple[Effect, ...] = field(init=False)
    informs: NDArray[np.bool_] = field(init=False)
    quantity: Index = field(init=False)
    effect: Index = field(init=False)

    def __post_init__(self) -> None:
        used = {c for those in self.dependence.values() for c in those} | {"amplitude", "velocity"}
        known = {c: [s.covariates.get(c, 0.0) for s in self.settings] for c in sorted(used)}
        means = {c: geometric_mean(v) for c, v in known.items() if min(v) > 0}
        self._set("covariates", means)
        self._set("cells", tuple(dict.fromkeys(self.cell_of(s) for s in self.settings)))
        self._set("sessions", tuple(dict.fromkeys(s.session for s in self.settings)))
        self._set("informs", self._informs())
        self._set("effects", (*self._effects("level"), *self._effects("session")))
        quantity, effect = list(range(len(self.names))), [-1] * len(self.names)
        for name, those in self.dependence.items():
            quantity += [self.names.index(name)] * len(those)
            effect += [-1] * len(those)
        for e, one in enumerate(self.effects):
            size = len(self.cells if one.name == "level" else self.sessions)
            quantity += [k for k in one.members for _ in range(size)]
            effect += [e] * size * len(one.members)
        self._set("quantity", np.array(quantity))
        self._set("effect", np.array(effect))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _informs(self) -> NDArray[np.bool_]:
        """Whether each test informs each quantity, (J, d).

        A law without an intercept says nothing of a test at zero actuation: there the quantity has
        the prior of a test by itself.
        """
        found = np.ones((len(self.settings), len(self.names)), dtype=bool)
        zero = [s.actuation == 0 for s in self.settings]
        for name, law in self.laws.items():
            if not all(LAWS[one].intercept for one in self.considered(law)):
                found[zero, self.names.index(name)] = False
        return found

    def considered(self, law: str) -> tuple[str, ...]:
        """Laws that a name stands for; with tests at zero actuation those that hold there."""
        if law != COMPARE:
            return (law,)
        zero = any(s.actuation == 0 for s in self.settings)
        return tuple(name for name in LAWS if LAWS[name].intercept or not zero)

    def _effects(self, name: str) -> list[Effect]:
        """Effects of levels on what has a law, or of sessions on all that differs between tests."""
        free = [k for k in range(len(self.names)) if not self.common[k]]
        followers = [self.names.index(n) for n in self.laws] if self.leveled else []
        likely = followers if name == "level" else free
        by_group: dict[str, list[int]] = {}
        for k in likely:
            told = [s for s, tells in zip(self.settings, self.informs[:, k], strict=True) if tells]
            kinds = len(levels_of(told)) if name == "level" else len({s.session for s in told})
            if kinds >= (LEVELS if name == "level" else 2):
                by_group.setdefault(self.groups[self.names[k]], []).append(k)
        wider = WIDER if name == "level" else 1.0
        return [
            Effect(name, group, tuple(members), wider * float(self.scatter_sd[members[0]]))
            for group, members in by_group.items()
        ]

    @property
    def free(self) -> Index:
        """Columns of the quantities that differ between tests, (F,)."""
        return np.flatnonzero(~self.common)

    @property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each shape that is inferred."""
        return tuple((name, s) for name, law in self.laws.items() for s in shapes_of(law))

    def cell_of(self, setting: Setting) -> tuple[str, float]:
        """Session, and the actuation of calibrated tests at the setting's level, if any."""
        near = [s.actuation for s in self.settings if same_level(s.actuation, setting.actuation)]
        return setting.session, near[0] if near else setting.actuation

    def level_covariance(
        self, one: Sequence[tuple[str, float]], two: Sequence[tuple[str, float]]
    ) -> Array:
        """Covariance of a level's effect between cells, for an sd of 1 at the reference.

        Matérn 3/2 over the logarithm of the actuation, within a session; zero actuation is far from
        all others.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = [np.log([actuation for _, actuation in cells]) for cells in (one, two)]
            apart = np.abs(np.subtract.outer(*logs))
            sizes = [np.clip(self.reference / np.exp(log), *BOUNDS) for log in logs]
        apart[np.isnan(apart)] = 0.0  # zero and zero
        r = np.minimum(np.sqrt(3.0) * apart / ALIKE, 1e3)
        same = np.array([[a[0] == b[0] for b in two] for a in one])
        return np.asarray(np.outer(*sizes) * same * (1.0 + r) * np.exp(-r))

    def row(self, setting: Setting, level: Array | None = None) -> Array:
        """Weights of the linear coefficients z under a setting, (len(z),).

        Column c belongs to quantity `quantity[c]`. Weights of level effects, `level` (cells,), are
        those expected given the tested levels.
        """
        spread = self.spread
        parts: list[Array] = [np.ones(len(self.names))]
        for name, those in self.dependence.items():
            k = self.names.index(name)
            for c in those:
                among = [s.covariates[c] for s in self.settings]
                within = np.clip(setting.covariates[c], min(among), max(among))
                parts.append(np.array([np.log(within / self.covariates[c]) / spread[k]]))
        if level is None:
            level, _ = self.krige([self.cell_of(setting)])
            level = level[0]
        session = np.array([float(setting.session == s) for s in self.sessions])
        for effect in self.effects:
            weights = level if effect.name == "level" else session
            parts += [weights / spread[k] for k in effect.members]
        return np.concatenate(parts)

    def krige(self, cells: Sequence[tuple[str, float]]) -> tuple[Array, Array]:
        """Level effects of cells given those of the tests' cells.

        Returns
        -------
        weights, covariance : (m, cells), (m, m)
            The covariance is that of what the tests' cells do not tell, for an sd of 1.
        """
        own = self.level_covariance(self.cells, self.cells) + 1e-9 * np.eye(len(self.cells))
        across = self.level_covariance(cells, self.cells)
        weights = np.asarray(np.linalg.solve(own, across.T).T)
        for i, cell in enumerate(cells):
            if cell in self.cells:
                weights[i] = np.eye(len(self.cells))[self.cells.index(cell)]
        rest = self.level_covariance(cells, cells) - weights @ across.T
        tested = np.array([cell in self.cells for cell in cells])
        rest[tested], rest[:, tested] = 0.0, 0.0
        return weights, 0.5 * (rest + rest.T)

    def law_shapes(self, h_shapes: Array, choice: Index) -> tuple[Array, Array]:
        """Share and exponent of each law, (n, L) each.

        Parameters
        ----------
        h_shapes : (n, S)
            Coordinates of `shapes`.
        choice : (n, L) int
            Number of the law of each quantity of `laws`.
        """
        found: list[Array] = []
        for shape in ("share", "exponent"):
            given = np.array([getattr(LAWS[law], shape) for law in LAW_NAMES], dtype=np.float64)
            value: Array = given[choice]  # NaN where it is inferred
            for column, name in enumerate(self.laws):
                if (name, shape) in self.shapes:
                    q = h_shapes[:, self.shapes.index((name, shape))]
                    q = expit(q) if shape == "share" else q
                    value[:, column] = np.where(np.isnan(value[:, column]), q, value[:, column])
            found.append(value)
        share, exponent = found
        return share, exponent

    def offsets(self, share: Array, exponent: Array, actuation: Array) -> Array:
        """Laws (n, L) in prior units at actuations (m,), (n, m, d)."""
        found = np.zeros((len(share), actuation.size, len(self.names)))
        for column, name in enumerate(self.laws):
            k = self.names.index(name)
            shape = share[:, [column]], exponent[:, [column]]
            followed = ratio(actuation / self.reference, *shape)
            found[..., k] = np.log(np.maximum(followed, 1e-300)) / self.spread[k]
        return found

    def under(self, laws: Mapping[str, str]) -> Design:
        """The design with other laws."""
        return replace(self, laws={**self.laws, **laws})

    def restricted(
        self, name: str, law: str, follows: Sequence[str] | None = None, *, leveled: bool = False
    ) -> Design:
        """The design of one quantity by itself, under a law and with covariates."""
        k = [self.names.index(name)]
        follows = self.dependence.get(name, ()) if follows is None else tuple(follows)
        return replace(
            self,
            names=(name,),
            spread=self.spread[k],
            laws={name: law} if law else {},
            dependence={name: follows} if follows else {},
            scatter_sd=self.scatter_sd[k],
            common=np.zeros(1, dtype=bool),
            leveled=leveled,
        )

    @property
    def z_sd(self) -> Array:
        """Prior sd of the linear coefficients that are no effects; 1 for effects."""
        dependent = sum(len(those) for those in self.dependence.values())
        sd = np.ones(self.quantity.size)
        sd[len(self.names) : len(self.names) + dependent] = SENSITIVITY
        return sd


def design_of(
    priors: PriorFile,
    names: Sequence[str],
    settings: Sequence[Setting],
    laws: Mapping[str, str] | None = None,
    dependence: Mapping[str, Sequence[str]] | None = None,
) -> Design:
    """Design of the mixed model of tests under these settings.

    Parameters
    ----------
    priors : PriorFile
    names : sequence of str
        Quantities of the tests; also the shapes, such as "exponent_Fc_fwd", that tests have to
        themselves along a changing actuation.
    settings : sequence of Setting
        Of each test.
    laws : mapping of str to str, optional
        Laws by quantity, instead of the paper's.
    dependence : mapping of str to sequence of str, optional
        Covariates that quantities follow.

    Raises
    ------
    PriorError
        When a shared quantity has no scatter prior.
    FitError
        When a law's quantity can be negative, an actuation is negative, or all are zero.
    """
    quantities = known_quantities()
    own = {f"{shape}_{law}": shape for law in default_laws() for shape in ("share", "exponent")}
    pooled = (n for n in names if n not in own)
    shared = tuple(n for n in pooled if n not in quantities or quantities[n].pooled)
    chosen = {n: law for n, law in (default_laws() | dict(laws or {})).items() if n in shared}
    for name in chosen:
        if priors.parameters[name].lower != 0.0 or np.isfinite(priors.parameters[name].upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")
    home = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    for name in shared:
        if name not in home:
            raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {name}")
    settings = with_zeros(settings)
    speeds = [s.covariates.get("velocity", 0.0) for s in settings]
    speed = geometric_mean([v for v in speeds if v > 0] or [1.0])
    everything = (*shared, *(n for n in names if n == "start" or n in own))
    known = {n: shape_prior(own[n]) if n in own else priors.parameters[n] for n in everything}
    coordinates = Coordinates(everything, known, USUAL_SPEED * speed)
    return Design(
        names=shared,
        coordinates=coordinates,
        spread=coordinates.spread[: len(shared)],
        laws=chosen,
        dependence={n: tuple(c) for n, c in (dependence or {}).items() if n in shared and c},
        settings=settings,
        groups={n: home[n] for n in shared},
        scatter_sd=np.array([priors.scatter[home[n]].sd for n in shared]),
        common=np.array([priors.scatter[home[n]].sparse for n in shared]),
        reference=geometric_mean([s.actuation for s in settings if s.actuation > 0]),
    )


def usual_dependence(
    slip_forces: Sequence[str], settings: Sequence[Setting]
) -> dict[str, tuple[str, ...]]:
    """Covariates that slip forces follow by default: the stroke, if it varies.

    No friction model here knows of the stroke, and all of them know of the speed.
    """
    if len(settings) < TESTS or not varies(settings, "amplitude"):
        return {}
    return dict.fromkeys(slip_forces, ("amplitude",))
