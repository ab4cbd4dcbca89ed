"""The population of tests: levels, laws and test-to-test scatter, as draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.population import checks
from mfd_bayes.population.beyond import unknown_beyond
from mfd_bayes.population.laws import TIED, ratio, ratios_along
from mfd_bayes.population.layout import Choice, Layout
from mfd_bayes.population.parts import Expected, Parts
from mfd_bayes.population.residual import Residual
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.starts import UNKNOWN, Standing, StartDensity, anywhere, fixed, learned
from mfd_bayes.population.straight import StraightLaws

Array = NDArray[np.float64]

SHORTER = 0.9
"""Share of the smallest calibrated stroke below which a motion counts as shorter than all."""


@dataclass(frozen=True, eq=False)
class Population(StraightLaws):
    """Draws of the hyperparameters, (chain, draw) first.

    Attributes
    ----------
    layout : Layout
    h : (chain, draw, dim)
        Scatter, effects' sd and shapes, as in `Layout`.
    latent : (chain, draw, 1 + cells, d)
        Levels at the reference actuation, then the cells' effects, in prior units.
    choice : (chain, draw, L) int
        Law of each quantity that follows the actuation.
    together : (chain, draw, d, d)
        Cholesky factor of the correlation of the scatter between quantities.
    priors : mapping of str to Prior
    actuation_unit : str
    walkers : int
        Walkers of each chain, by which its draws are ordered.
    convergence : Convergence
        Of scatter, effects' sd, shapes and levels.
    residual : Residual, optional
        Discrepancy and noise that the tests have in common; runs of older versions have none.
    starts : (chain, draw, J), optional
        Places in the gap at which the tests began; none with a model or a run without them.
    left : (J,), optional
        Places at which their own motions leave the device.
    unloaded : float
        Probability that tests begin without load (`chance_of`); 0 where nothing is known of it.
    """

    layout: Layout
    h: Array
    latent: Array
    choice: Choice
    together: Array
    priors: Mapping[str, Prior]
    actuation_unit: str
    walkers: int
    convergence: Convergence
    residual: Residual | None = None
    starts: Array | None = None
    left: Array | None = None
    unloaded: float = 0.0

    @property
    def size(self) -> int:
        """Number of draws of all chains."""
        return int(self.h.shape[0] * self.h.shape[1])

    @property
    def levels(self) -> Array:
        """Shared coordinates of the medians at the reference actuation, (chain, draw, d)."""
        return self.layout.centre + self.layout.spread * self.latent[:, :, 0]

    @property
    def scatters(self) -> dict[str, Array]:
        """Test-to-test scatter of each quantity that differs between tests, (chain, draw).

        It is the sd of the logarithm of a positive quantity, and in kip for the offset.
        """
        return {
            name: np.exp(self.h[..., k])
            for k, name in enumerate(self.layout.names)
            if name not in self.common
        }

    @property
    def common(self) -> tuple[str, ...]:
        """Quantities that are the same in all tests."""
        return tuple(self.layout.names[k] for k in np.flatnonzero(self.layout.common))

    @property
    def effect_sds(self) -> dict[str, Array]:
        """Sd of each effect, by "name_group", (chain, draw)."""
        begin = len(self.layout.names)
        return {
            f"{effect.name}_{self.layout.groups[effect.group]}": np.exp(self.h[..., begin + i])
            for i, effect in enumerate(self.layout.effects)
        }

    @property
    def dependences(self) -> dict[str, Array]:
        """Change of a quantity's coordinate per e-fold of a covariate, (chain, draw)."""
        begin = len(self.layout.names) + len(self.layout.effects)
        return {
            f"{name}_{shape}": self.h[..., begin + i]
            for i, (name, shape) in enumerate(self.layout.shapes)
            if shape in self.layout.covariate_reference
        }

    def shapes(self, name: str) -> tuple[Array, Array]:
        """Share and exponent of a quantity's law, (chain, draw) each.

        Raises
        ------
        NotThereError
            When it has no law.
        """
        checks.check_known("law of", name, self.layout.laws)
        shape = self.h.shape[:2]
        flat = self.h.reshape(self.size, -1), self.choice.reshape(self.size, -1)
        share, exponent = self.layout.law_shapes(*flat, name)
        return share.reshape(shape), exponent.reshape(shape)

    def ratio(self, name: str, actuation: Array) -> Array:
        """Law's value at each actuation over that at the reference, (chain, draw, m).

        It is 1 for a quantity without a law. What follows another, such as static friction, has
        its law.

        Raises
        ------
        NotThereError
            When there is no such quantity.
        FitError
            When an actuation is no number, 0 or more.
        """
        names = self.layout.names
        checks.check_known("quantity", name, (*names, *(n for n in TIED if TIED[n] in names)))
        name = name if name in names else TIED[name]
        relative = checks.check_actuations(actuation) / self.layout.reference
        if name not in self.layout.laws:
            return np.ones((*self.h.shape[:2], relative.size))
        share, exponent = self.shapes(name)
        return ratio(relative, share[..., None], exponent[..., None])

    def ratio_of(self, name: str, actuation: Array, index: NDArray[np.intp]) -> Array:
        """The same of draws by number (n,), of a quantity with a law, (n, m)."""
        share, exponent = (shape.reshape(-1, 1)[index] for shape in self.shapes(name))
        return ratio(np.asarray(actuation) / self.layout.reference, share, exponent)

    def ratios_along(self, name: str, history: Array, index: NDArray[np.intp]) -> Array:
        """The same along a history of actuation (T,), time first, (T, n)."""
        share, exponent = (shape.ravel()[index] for shape in self.shapes(name))
        return ratios_along(history / self.layout.reference, share, exponent)

    def median(self, name: str, actuation: Array) -> Array:
        """Median over tests of a quantity at each actuation, (chain, draw, m).

        Raises
        ------
        NotThereError
            When there is no such quantity.
        FitError
            When an actuation is no number, 0 or more.
        """
        checks.check_known("quantity", name, self.layout.names)
        level = self.layout.coordinates.values(self.levels.reshape(self.size, -1))[name]
        return level.reshape(*self.h.shape[:2], 1) * self.ratio(name, actuation)

    @property
    def law_weights(self) -> dict[str, dict[str, float]]:
        """Weight of each law that was considered, by quantity."""
        return {name: dict(weights) for name, weights in self.layout.weights.items()}

    def start_density(
        self,
        rng: np.random.Generator,
        n: int,
        setting: Setting | None = None,
        standing: Standing = UNKNOWN,
    ) -> StartDensity:
        """Densities of the places in the gap where n tests begin.

        They are learned from the calibrated tests (`learned`). A motion that is shorter
        than all of theirs, or of which no setting is known, begins anywhere, or anywhere without
        load: its start decides the force for long, and nothing says that such tests begin like the
        others. A start that the prior file fixes is kept.
        """
        prior = self.priors.get("start")
        if prior is not None and prior.fixed:
            return fixed(n, prior.typical)
        if self.starts is None or setting is None or self._shorter(setting):
            return anywhere(rng, n, self.unloaded, standing.luck)
        known = self.starts.reshape(-1, self.starts.shape[-1])[rng.integers(self.size, size=n)]
        left = None if self.left is None else standing.left()
        both = None if self.left is None or left is None else (self.left, left)
        return learned(known, both, rng)

    def draw_starts(
        self,
        rng: np.random.Generator,
        n: int,
        setting: Setting | None = None,
        standing: Standing = UNKNOWN,
    ) -> Array:
        """Places in the gap at which n tests begin, (n,); see `start_density`."""
        return self.start_density(rng, n, setting, standing).draw(rng, standing.unloaded)

    def _shorter(self, setting: Setting) -> bool:
        """Whether a test's stroke is shorter than that of every calibrated test."""
        strokes = [tested.covariates.get("amplitude", 0.0) for tested in self.layout.settings]
        return setting.covariates.get("amplitude", 0.0) < SHORTER * min(strokes)

    def draw_test(
        self,
        setting: Setting,
        index: NDArray[np.intp],
        rng: np.random.Generator,
        *,
        scattered: bool = True,
    ) -> dict[str, Array]:
        """Quantities of tests under a setting, by name, (n,) each; see `draw_parts`.

        Raises
        ------
        FitError
            When the setting, a number of a draw or the generator is none.
        """
        checks.check_generator(rng)
        return self.values(self.draw_parts(setting, index, rng, scattered=scattered))

    def values(self, parts: Parts) -> dict[str, Array]:
        """Quantities of drawn tests, by name, (n,) each, internal units."""
        layout = self.layout
        return layout.coordinates.values(layout.centre + layout.spread * parts.total)

    def draw_parts(
        self,
        setting: Setting,
        index: NDArray[np.intp],
        rng: np.random.Generator,
        *,
        scattered: bool = True,
        leveled: bool = True,
    ) -> Parts:
        """What tests under a setting are made of.

        Parameters
        ----------
        setting : Setting
            Of calibrated tests or a new one.
        index : (n,) int
            Number of the draw of the hyperparameters for each.
        rng : numpy.random.Generator
        scattered : bool
            Whether to add test-to-test scatter, and what is unknown of a new session; without
            it, the median over tests, with what is unknown of a new level and of a motion outside
            those of the tests.
        leveled : bool
            Whether to add what is unknown of a new level.
        """
        expected = self.expected(setting, index)
        return expected.parts(lambda *_: rng, scattered=scattered, leveled=leveled)

    def expected(self, setting: Setting, index: NDArray[np.intp]) -> Expected:
        """What draws of the hyperparameters, (n,) by number, say of a test under a setting."""
        checks.check_setting(setting, self.layout.covariate_reference)
        index = checks.check_draws(index, self.size)
        layout, h = self.layout, self.h.reshape(self.size, -1)[index]
        latent = self.latent.reshape(self.size, *self.latent.shape[2:])[index]
        choice = self.choice.reshape(self.size, -1)[index]
        law = layout.offsets(h, choice, [setting])[:, 0]
        sd, begin, unknown = layout.effect_sd(h), 0, []
        for effect in layout.effects:
            row, new = effect.row(effect.cell_of(setting, layout.settings))
            parts = latent[:, 1 + begin : 1 + begin + len(row)]
            for k in effect.members:
                law[:, k] += parts[:, :, k] @ row
                if new > 0:
                    unknown.append((effect.name, k, new * sd[:, begin, k]))
            begin += len(row)
        unknown += unknown_beyond(layout, setting, len(law))
        together = self.together.reshape(self.size, *self.together.shape[2:])[index]
        return Expected(latent[:, 0], law, tuple(unknown), layout.scatter(h), together)
