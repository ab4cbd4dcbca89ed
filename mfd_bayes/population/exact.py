"""The exact joint posterior of population and tests, from the Gaussian one.

Under the Gaussian approximation the population's h has known draws, and given h the coefficients z
and the tests' own coordinates are affine in standard normal numbers e. Moves change these numbers
by the preconditioned Crank-Nicolson step e' = √(1 - β²) e + β ξ, which leaves the approximation as
it is, and are accepted by the exact over the approximate likelihoods (Rudolf and Sprungk, 2018):

1. the numbers of each test, each accepted by its own likelihood;
2. those of z, with h from its draws under the approximation, accepted by all tests; then those of
   z alone, in shorter steps. The mean and covariance of the numbers of the levels are learned while
   warming up, and then kept;
3. each coordinate of h given all tests, by random-walk Metropolis, which needs no force.

With Gaussian likelihoods every move of the first two kinds is accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, measure
from mfd_bayes.population.joint_fit import JointFit
from mfd_bayes.population.mixed_model import LARGEST, MixedModel

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Evaluate = Callable[[Iterable[tuple[int, "Array"]]], Iterator["Array"]]

CHAINS = 4
"""Groups of independent chains; R̂ is taken across groups."""

STORED = 2**26
"""Most numbers of the tests' coordinates that are held; of more, only some sweeps are kept."""

WARM_UP, BLOCK = 80, 40
"""Sweeps in which steps are tuned, in two halves, and sweeps between looks at the convergence."""

TRUST, WIDER = 0.8, 1.5
"""Weight of the covariance that is learned, against that of the approximation, and its factor: a
wide one, since chains stay long where the reference has thinner tails than the posterior."""

ACCEPT = 0.3
"""Share of moves of the tests that is to be accepted."""

ACCEPT_Z = (0.2, 0.5)
"""The same of z, with another h and with its own."""

EVERY = 3
"""Sweeps between random walks of h, which moves in every sweep with the levels too."""

RANDOM_WALK = 0.6
"""Sd of the random walk of the coordinates of h."""


@dataclass(frozen=True, eq=False)
class State:
    """All chains, n of them.

    Attributes
    ----------
    h, z : (n, dim), (n, Z)
    e_z, e : (n, Z), (n, J, L)
        Standard normal numbers of z, and of the tests' local coordinates.
    x : (n, J, D)
    excess : (n, J)
        Exact less approximate log density of each test.
    """

    h: Array
    z: Array
    e_z: Array
    e: Array
    x: Array
    excess: Array

    def where(self, accepted: NDArray[np.bool_], other: State) -> State:
        """The other state where it was accepted: chains (n,), or tests of chains (n, J)."""

        def choose(mine: Array, its: Array) -> Array:
            if accepted.ndim > 1 and mine.shape[:2] != accepted.shape:
                return mine
            shape = (*accepted.shape, *[1] * (mine.ndim - accepted.ndim))
            return np.where(accepted.reshape(shape), its, mine)

        return State(
            *(choose(a, b) for a, b in zip(vars(self).values(), vars(other).values(), strict=True))
        )


@dataclass(frozen=True, eq=False)
class Draws:
    """Kept draws, (chain, draw, …), ordered by walker, and their convergence.

    Attributes
    ----------
    h, z, x : (chain, draw, dim), (chain, draw, Z), (chain, draw, J, D)
    convergence : Convergence
        Of h and of the levels in z.
    sweeps : int
    accepted : (2,)
        Shares of accepted moves of tests and of the population.
    walkers : int
        Chains of each group.
    """

    h: Array
    z: Array
    x: Array
    convergence: Convergence
    sweeps: int
    accepted: tuple[float, float]
    walkers: int


class ExactSampler:
    """Chains of the exact posterior.

    Parameters
    ----------
    mixed : MixedModel
    fit : JointFit
    own : (J, D) bool
        Coordinates that do not follow the population: they have their own priors.
    choice : (n, L) int
        Laws of each chain.
    pool : sequence of (m, dim)
        For each chain, draws of h under the Gaussian approximation and the chain's laws.
    rng : numpy.random.Generator
    evaluate : callable, optional
        Computes log likelihoods of pairs of a test's number and x, in several processes.
    """

    def __init__(
        self,
        mixed: MixedModel,
        fit: JointFit,
        own: NDArray[np.bool_],
        choice: Index,
        pool: list[Array],
        rng: np.random.Generator,
        evaluate: Evaluate | None = None,
    ) -> None:
        self.mixed, self.fit, self.own, self.choice, self.pool, self.rng = (
            mixed, fit, own, choice, pool, rng,
        )  # fmt: skip
        self.evaluate = evaluate or (
            lambda pairs: (fit.tests[j].log_likelihood(x) for j, x in pairs)
        )
        local = np.any(own, axis=0)
        local[mixed.free] = True
        self.local = np.flatnonzero(local)
        self.scatters = np.searchsorted(
            self.local, mixed.free
        )  # places of the free among the local
        self.beta, self.beta_z = np.full(len(fit.mean), 0.8), np.array([0.8, 0.4])
        self.rates: list[tuple[Array, Array]] = []  # accepted shares: tests, and moves of z
        n, z = len(choice), mixed.design.quantity.size
        self.shift, self.root = np.zeros(z), np.eye(z)  # of the reference of e_z
        h = self._fresh_h()
        e = rng.standard_normal((n, len(fit.mean), self.local.size))
        self.state = self._at(h, rng.standard_normal((n, z)), e)

    def _fresh_h(self) -> Array:
        """Draws of h of every chain under the approximation."""
        return np.stack([pool[self.rng.integers(len(pool))] for pool in self.pool])

    def _base(self, h: Array, z: Array) -> Array:
        """What the population says of the tests' coordinates, (n, J, D); 0 for their own."""
        d = len(self.mixed.design.names)
        base = np.zeros((len(h), *self.own.shape))
        base[..., :d] = self.mixed.offsets(h, self.choice) + self.mixed.fixed(z)
        return np.where(self.own, 0.0, base)

    def _local_sd(self, h: Array) -> Array:
        """Prior sd of the local coordinates around the base, (n, J, L)."""
        sd = np.ones((len(h), len(self.own), self.local.size))
        sd[..., self.scatters] = self.mixed.tau(h)[:, None] / np.sqrt(self.mixed.weight)
        return np.where(self.own[:, self.local], 1.0, sd)

    def _conditional(self, h: Array, z: Array) -> tuple[Array, Array, Array]:
        """Base, and mean and factor of precision of the local coordinates, approximately."""
        base, local = self._base(h, z), self.local
        p = self.fit.precision[:, local]
        inner = p[:, :, local] + self._local_sd(h)[..., None] ** -2.0 * np.eye(local.size)
        pull = np.einsum("jla,nja->njl", p, self.fit.mean - base)
        mean = np.asarray(np.linalg.solve(inner, pull[..., None])[..., 0])
        return base, mean, np.asarray(np.linalg.cholesky(inner))

    def _at(self, h: Array, e_z: Array, e: Array) -> State:
        """State of these numbers; the forces of all tests are computed."""
        gaussian = self.mixed.marginal(h, self.choice)[1]
        turned = np.linalg.solve(np.swapaxes(gaussian.factor, 1, 2), e_z[..., None])[..., 0]
        return self._of(h, gaussian.mean + turned, e_z, e)

    def _of(self, h: Array, z: Array, e_z: Array, e: Array) -> State:
        base, mean, factor = self._conditional(h, z)
        x = base
        x[..., self.local] += (
            mean + np.linalg.solve(np.swapaxes(factor, -1, -2), e[..., None])[..., 0]
        )
        return State(h, z, e_z, e, x, self._excess(x))

    def _excess(self, x: Array) -> Array:
        """Exact less approximate log density of each test at x (n, J, D), (n, J)."""
        away = x - self.fit.mean
        gaussian = -0.5 * np.einsum(
            "nja,jab,njb->nj", away, self.fit.precision, away, optimize=True
        )
        exact = self.evaluate((j, np.ascontiguousarray(x[:, j])) for j in range(x.shape[1]))
        found = np.stack(list(exact), axis=1) - gaussian
        for j, own in enumerate(self.own):
            if np.any(own):
                found[:, j] += self.fit.tests[j].coordinates.log_prior(x[:, j], own)
                found[:, j] += 0.5 * np.sum(x[:, j][:, own] ** 2, axis=1)
        return np.where(np.isnan(found), -np.inf, found)

    def sweep(self) -> None:
        """One move of each kind."""
        s, rng = self.state, self.rng
        beta = self.beta[:, None]
        e = np.sqrt(1.0 - beta**2) * s.e + beta * rng.standard_normal(s.e.shape)
        new = self._of(s.h, s.z, s.e_z, e)
        accepted = np.log(rng.random(s.excess.shape)) < new.excess - s.excess
        self.state = s.where(accepted, new)
        together = [self._move_z(beta, fresh=k == 0) for k, beta in enumerate(self.beta_z)]
        self.rates.append((accepted.mean(axis=0), np.array(together)))
        if len(self.rates) % EVERY == 0:
            self._move_h()

    def _move_z(self, beta: float, *, fresh: bool) -> float:
        """Move z, and h to a fresh draw if asked for; gives the accepted share."""
        s, rng = self.state, self.rng
        mine = np.linalg.solve(self.root, (s.e_z - self.shift).T).T
        moved = np.sqrt(1.0 - beta**2) * mine + beta * rng.standard_normal(mine.shape)
        e_z = self.shift + moved @ self.root.T
        new = self._at(self._fresh_h() if fresh else s.h, e_z, s.e)
        better = new.excess.sum(axis=1) - s.excess.sum(axis=1)
        better -= 0.5 * np.sum(e_z**2 - moved**2 - s.e_z**2 + mine**2, axis=1)
        accepted = np.log(rng.random(len(better))) < better
        self.state = s.where(accepted, new)
        return float(accepted.mean())

    def tune(self) -> None:
        """Step sizes by the shares of the last moves that were accepted."""
        tests, together = (np.mean(r, axis=0) for r in zip(*self.rates[-10:], strict=True))
        self.beta = np.clip(self.beta * np.exp(tests - ACCEPT), 0.05, 1.0)
        self.beta_z = np.clip(self.beta_z * np.exp(together - ACCEPT_Z), 0.02, 1.0)

    def learn(self, history: list[Array]) -> None:
        """Take the mean and covariance of the levels' numbers from sweeps (n, Z)."""
        d = len(self.mixed.design.names)
        e = np.concatenate(history)[:, :d]
        covariance = TRUST * np.cov(e.T) + (1.0 - TRUST) * np.eye(d)
        self.shift[:d] = e.mean(axis=0)
        self.root[:d, :d] = np.linalg.cholesky(WIDER * covariance)

    def _move_h(self) -> None:
        """Random-walk Metropolis of each coordinate of h with z and x as they are."""
        mixed, s, rng = self.mixed, self.state, self.rng
        h, d = s.h.copy(), len(mixed.design.names)
        without_law = s.x[..., :d] - mixed.fixed(s.z)
        names = mixed.design.names
        shapes = [names.index(name) in mixed.free for name, _ in mixed.design.shapes]
        moving = np.flatnonzero([*[True] * (mixed.f + mixed.e), *shapes])
        for i in moving.tolist():
            new = h.copy()
            new[:, i] += (
                RANDOM_WALK * rng.standard_normal(len(h)) * (1.0 if i < mixed.f + mixed.e else 0.3)
            )
            change = self._log_given_tests(new, s.z, without_law) - self._log_given_tests(
                h, s.z, without_law
            )
            accepted = np.log(rng.random(len(h))) < change
            h[accepted] = new[accepted]
        self.state = self._renumbered(replace(s, h=h))

    def _log_given_tests(self, h: Array, z: Array, without_law: Array) -> Array:
        """Log density of h given z and the tests' coordinates, (n,)."""
        mixed, free = self.mixed, self.mixed.free
        away = (without_law - mixed.offsets(h, self.choice))[..., free]
        sd = mixed.tau(h)[:, None] / np.sqrt(mixed.weight)
        terms = np.where(self.own[:, free], 0.0, -0.5 * (away / sd) ** 2 - np.log(sd))
        total = mixed.log_prior(h) + terms.sum(axis=(1, 2))
        total += np.where(np.all(np.abs(h) < LARGEST, axis=1), 0.0, -np.inf)
        omega = mixed.omega(h)
        for e, effect in enumerate(mixed.design.effects):
            own = np.flatnonzero(mixed.design.effect == e).reshape(len(effect.members), -1)
            level = effect.name == "level"
            precision = mixed.level_precision if level else np.eye(own.shape[1])
            u = z[:, own]
            squares = np.einsum("nmc,cd,nmd->n", u, precision, u, optimize=True)
            total += -own.size * np.log(omega[:, e]) - 0.5 * squares / omega[:, e] ** 2
        return np.asarray(total)

    def _renumbered(self, s: State) -> State:
        """The state with the numbers e that belong to its h, z and x."""
        gaussian = self.mixed.marginal(s.h, self.choice)[1]
        e_z = np.einsum("nji,nj->ni", gaussian.factor, s.z - gaussian.mean)
        base, mean, factor = self._conditional(s.h, s.z)
        away = (s.x - base)[..., self.local] - mean
        return replace(s, e_z=e_z, e=np.einsum("njab,nja->njb", factor, away))

    def run(
        self,
        r_hat: float,
        ess: float,
        limit: int,
        kept: int,
        report: Callable[[int, Convergence], None],
    ) -> Draws:
        """Sweep until targets or limit are reached; `kept` draws of each group are kept."""
        history: list[Array] = []
        for step in range(1, WARM_UP + 1):
            self.sweep()
            history.append(self.state.e_z)
            if step % 10 == 0:
                self.tune()
            if step % (WARM_UP // 2) == 0:
                self.learn(history[len(history) // 2 :])
        self.rates.clear()
        walkers = len(self.choice) // CHAINS
        stride = max(1, self.state.x.size * limit // STORED)
        h: list[Array] = []
        z: list[Array] = []
        x: list[Any] = []  # in single precision
        while True:
            for _ in range(BLOCK):
                self.sweep()
                h.append(self.state.h)
                z.append(self.state.z)
                if len(h) % stride == 1 or stride == 1:
                    x.append(np.asarray(self.state.x, dtype=np.float32))
            found = self._convergence(np.array(h), np.array(z))
            report(len(h), found)
            if found.reached(r_hat, ess) or len(h) >= limit:
                break
        steps = np.linspace(0, len(x) - 1, max(1, min(len(x), kept // walkers))).astype(int)

        def by_chain(history: list[Array]) -> Array:
            some = np.stack([history[t] for t in steps], axis=1).astype(np.float64)
            return some.reshape(CHAINS, -1, *some.shape[2:])

        tests, together = (float(np.mean(r)) for r in zip(*self.rates, strict=True))
        h_kept, z_kept = by_chain(h[::stride]), by_chain(z[::stride])
        rates = tests, together
        return Draws(h_kept, z_kept, by_chain(x), found, len(h), rates, walkers)

    def _convergence(self, h: Array, z: Array) -> Convergence:
        """Of the coordinates of h and of the levels; (step, n, …) each."""
        levels = z[..., : len(self.mixed.design.names)]
        every = np.concatenate([h, levels], axis=2)
        return measure(
            np.swapaxes(every.reshape(len(h), CHAINS, every.shape[1] // CHAINS, -1), 0, 1)
        )
