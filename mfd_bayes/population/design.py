"""Which levels, laws, covariates, effects and scatter the tests of a campaign call for.

In prior units the coordinate of quantity k of test j is

    x_jk = level_k + law_k(p_j) + b_k' covariates_j + level effect_k(p_j, session_j)
           + session effect_k(session_j) + device effect_k(device_j) + d_jk,   d_jk ~ N(0, τ_k²)

Level, slopes b and effects are linear; the shapes of laws (share, exponent) are not. Quantities
that are the same in all tests (`sparse` in the prior file) have no scatter and no effects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from mfd_bayes.calibration.priors import PriorFile, known_quantities
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.friction.model import Model
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
    CONDITIONS,
    Setting,
    geometric_mean,
    levels_of,
    same_level,
    with_zeros,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Cell = tuple[str, float]

# correlation length of a level's effect along the logarithm of the actuation
ALIKE = float(np.log(2.0))
# scale of the sd of a level's effect, over that of scatter: real levels lie farther from a law
# than repeats from each other
WIDER = 2.0
# least and largest sd of a level's effect, over that at the reference actuation
BOUNDS = (0.5, 2.0)
LEVELS = 3  # fewest levels at which a deviation from a law can be told from the law
TESTS = 4  # fewest tests in which a dependence on a covariate is looked for
# prior sd of the change of a logarithm over the span of dates, counts or temperatures of the tests
DRIFT = 0.3
# Mean over peak speed of a sine: where on the Stribeck curve slip forces are compared
USUAL_SPEED = 2.0 / np.pi


class Effect(NamedTuple):
    """Random effect of levels, sessions or devices on some quantities, with one sd.

    `name` is "level", "session" or "device".

    `scale` is that of the half-normal prior of the sd. A level's effect is like that of a wrong
    actuation, wrong by as much at every level: in the logarithm of a force its sd is in inverse
    proportion to the actuation.
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

    @cached_property
    def covariates(self) -> dict[str, float]:
        """Geometric mean of each covariate over the tests."""
        used = {c for those in self.dependence.values() for c in those} - {*CONDITIONS}
        used |= {"amplitude", "velocity"}
        values = {c: [s.covariates.get(c, 0.0) for s in self.settings] for c in sorted(used)}
        return {c: geometric_mean(v) for c, v in values.items() if min(v) > 0}

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Session and level of the tests, each once."""
        return tuple(dict.fromkeys(self.cell_of(s) for s in self.settings))

    @cached_property
    def sessions(self) -> tuple[str, ...]:
        """Sessions of the tests, each once."""
        return tuple(dict.fromkeys(s.session for s in self.settings))

    @cached_property
    def devices(self) -> tuple[str, ...]:
        """Devices of the tests, each once."""
        return tuple(dict.fromkeys(s.device for s in self.settings))

    def groups_of(self, effect: Effect) -> Sequence[object]:
        """Cells, sessions or devices that an effect differs between."""
        groups: dict[str, Sequence[object]] = {
            "level": self.cells,
            "session": self.sessions,
            "device": self.devices,
        }
        return groups[effect.name]

    @cached_property
    def informs(self) -> NDArray[np.bool_]:
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

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of levels on what has a law, of sessions and devices on all that has scatter."""
        found: dict[tuple[str, str], list[int]] = {}
        followers = [self.names.index(n) for n in self.laws] if self.leveled else []
        free = self.free.tolist()
        for name, members in (("level", followers), ("session", free), ("device", free)):
            for k in members:
                those = [self.settings[j] for j in np.flatnonzero(self.informs[:, k])]
                groups = {s.session if name == "session" else s.device for s in those}
                if len(levels_of(those)) >= LEVELS if name == "level" else len(groups) >= 2:
                    found.setdefault((name, self.groups[self.names[k]]), []).append(k)
        wider = {"level": WIDER, "session": 1.0, "device": 1.0}
        return tuple(
            Effect(name, group, tuple(members), wider[name] * float(self.scatter_sd[members[0]]))
            for (name, group), members in found.items()
        )

    @cached_property
    def _columns(self) -> Index:
        """Quantity and effect (-1 for none) of each linear coefficient, (2, Z)."""
        found = [(k, -1) for k in range(len(self.names))]
        found += [(self.names.index(n), -1) for n, those in self.dependence.items() for _ in those]
        for e, effect in enumerate(self.effects):
            size = len(self.groups_of(effect))
            found += [(k, e) for k in effect.members for _ in range(size)]
        return np.array(found).T

    @property
    def quantity(self) -> Index:
        """Quantity of each linear coefficient, (Z,)."""
        return np.asarray(self._columns[0])

    def columns(self, effect: int) -> Index:
        """Numbers of the coefficients of an effect: (its quantities, cells or sessions)."""
        own = np.flatnonzero(self._columns[1] == effect)
        return own.reshape(len(self.effects[effect].members), -1)

    @property
    def z_sd(self) -> Array:
        """Prior sd of the linear coefficients that are no effects: levels and slopes."""
        sd = np.full(np.count_nonzero(self._columns[1] < 0), SENSITIVITY)
        sd[: len(self.names)] = 1.0
        pairs = [c for those in self.dependence.values() for c in those]
        sd[len(self.names) :][[c in CONDITIONS for c in pairs]] = DRIFT
        return sd

    def changed(self, covariate: str, setting: Setting) -> float:
        """Change of a condition from the mean of the tests, over their span.

        A setting that does not say it has the latest date or count of the tests, and their mean
        temperature.
        """
        values = np.array([s.covariates[covariate] for s in self.settings])
        usual = values.mean() if covariate == "temperature" else values.max()
        here = setting.covariates.get(covariate, usual)
        return float((here - values.mean()) / (np.ptp(values) or 1.0))

    @property
    def free(self) -> Index:
        """Columns of the quantities that differ between tests, (F,)."""
        return np.flatnonzero(~self.common)

    @property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each shape that is inferred."""
        return tuple((name, s) for name, law in self.laws.items() for s in shapes_of(law))

    def considered(self, law: str) -> tuple[str, ...]:
        """Laws that a name stands for; with tests at zero actuation those that hold there."""
        if law != COMPARE:
            return (law,)
        zero = any(s.actuation == 0 for s in self.settings)
        return tuple(name for name in LAWS if LAWS[name].intercept or not zero)

    def cell_of(self, setting: Setting) -> Cell:
        """Session, and the actuation of calibrated tests at the setting's level, if any."""
        near = [s.actuation for s in self.settings if same_level(s.actuation, setting.actuation)]
        return setting.session, near[0] if near else setting.actuation

    def level_covariance(self, one: Sequence[Cell], two: Sequence[Cell]) -> Array:
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

    def krige(self, session: str, actuations: ArrayLike) -> tuple[Array, Array]:
        """Level effects of a session at actuations (m,) given those of the tests' cells (kriging).

        Returns
        -------
        weights, covariance : (m, cells), (m, m)
            The covariance is that of what the tests' cells do not tell, for an sd of 1.
        """
        levels = np.atleast_1d(actuations)
        cells = [self.cell_of(Setting(float(level), session)) for level in levels]
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

    def row(self, setting: Setting, *, level_effects: bool = True) -> Array:
        """Weights of the linear coefficients z under a setting, (Z,), of a tested level or none."""
        parts: list[Array] = [np.ones(len(self.names))]
        for name, those in self.dependence.items():
            for c in those:
                spread = self.spread[self.names.index(name)]
                if c in CONDITIONS:
                    parts.append(np.array([self.changed(c, setting) / spread]))
                    continue
                among = [s.covariates[c] for s in self.settings]
                within = np.clip(setting.covariates[c], min(among), max(among))
                parts.append(np.array([np.log(within / self.covariates[c]) / spread]))
        cell = self.cell_of(setting) if level_effects else None
        level = np.array([float(cell == one) for one in self.cells])
        session = np.array([float(setting.session == s) for s in self.sessions])
        device = np.array([float(setting.device == d) for d in self.devices])
        weights = {"level": level, "session": session, "device": device}
        for effect in self.effects:
            parts += [weights[effect.name] / self.spread[k] for k in effect.members]
        return np.concatenate(parts)

    def linear(self, z: Array, rows: Array) -> Array:
        """Levels, slopes and effects A z of coefficients (n, Z) and rows (m, Z), (n, m, d)."""
        found, quantity = np.zeros((len(z), len(rows), len(self.names))), self.quantity
        for k in range(len(self.names)):
            own = quantity == k
            found[..., k] = z[:, own] @ rows[:, own].T
        return found

    def law_shapes(self, q: Array, choice: Index) -> tuple[Array, Array]:
        """Share and exponent of each law, (n, L) each.

        Parameters
        ----------
        q : (n, S)
            Coordinates of `shapes`.
        choice : (L,) or (n, L) int
            Number of the law of each quantity of `laws`.
        """
        found: list[Array] = []
        for shape in ("share", "exponent"):
            given = np.array([getattr(LAWS[law], shape) for law in LAW_NAMES], dtype=np.float64)
            value: Array = given[np.broadcast_to(choice, (len(q), choice.shape[-1]))]
            # NaN where it is inferred
            for column, name in enumerate(self.laws):
                if (name, shape) in self.shapes:
                    drawn = q[:, self.shapes.index((name, shape))]
                    drawn = expit(drawn) if shape == "share" else drawn
                    value[:, column] = np.where(np.isnan(value[:, column]), drawn, value[:, column])
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


def design_of(
    priors: PriorFile,
    names: Sequence[str],
    settings: Sequence[Setting],
    laws: Mapping[str, str] | None = None,
    dependence: Mapping[str, Sequence[str]] | None = None,
    model: Model | None = None,
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
    model : Model, optional
        What the quantities are of; the package's models by default.

    Raises
    ------
    PriorError
        When a shared quantity has no scatter prior.
    FitError
        When a law's quantity can be negative, an actuation is negative, or all are zero.
    """
    quantities, usual = known_quantities(model), default_laws(model)
    shapes = {f"{shape}_{law}": shape for law in usual for shape in ("share", "exponent")}
    pooled = (n for n in names if n not in shapes)
    shared = tuple(n for n in pooled if n not in quantities or quantities[n].pooled)
    chosen = {n: law for n, law in (usual | dict(laws or {})).items() if n in shared}
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
    everything = (*shared, *(n for n in names if n == "start" or n in shapes))
    each = {n: shape_prior(shapes[n]) if n in shapes else priors.parameters[n] for n in everything}
    coordinates = Coordinates(everything, each, USUAL_SPEED * speed, not (model and model.own))
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
