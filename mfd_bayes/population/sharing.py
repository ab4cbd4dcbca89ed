"""Which quantities are the same in all tests.

A quantity whose scatter prior prefers none is one per device unless the tests say otherwise. They
are asked with the Gaussians near their likelihoods: the marginal density of all tests with the
quantity's scatter integrated over its prior, against that without scatter. One quantity after the
other is freed, the one with the most evidence first, as long as the evidence is `EVIDENCE` to one.
What the likelihoods themselves gain by it less than their Gaussians is taken off the evidence,
and it has to stand without any one of the tests: one test that stands apart is no scatter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]
Index = NDArray[np.intp]

EVIDENCE = 20.0
"""Evidence for scatter, as odds, above which a quantity differs between tests."""

POINTS = 40
"""Values of a scatter over which its prior is integrated."""


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Gaussians of J tests in s quantities: log density −x'Ax/2 + b'x.

    Attributes
    ----------
    precision : (J, s, s)
    pull : (J, s)
    """

    precision: Array
    pull: Array

    def evidence(self, scatter: Mapping[int, float], k: int, unit: float) -> tuple[float, float]:
        """Log odds for a scatter of quantity k beside others, and its likeliest size."""
        sizes = _sizes(unit)
        log = np.array([self.log_marginal({**scatter, k: size}) for size in sizes])
        odds = float(logsumexp(log)) - np.log(POINTS) - self.log_marginal(scatter)
        return odds, float(sizes[np.argmax(log)])

    def evidence_without(self, scatter: Mapping[int, float], k: int, unit: float) -> Array:
        """The log odds without each one of the tests, (J,)."""
        log = np.array([self.log_marginal_without({**scatter, k: x}) for x in _sizes(unit)])
        odds = logsumexp(log, axis=0) - np.log(POINTS) - self.log_marginal_without(scatter)
        return np.asarray(odds)

    def log_marginal(self, scatter: Mapping[int, float]) -> float:
        """Log density of the tests with these scatters, levels N(0, 1), without constants."""
        a, b, gain = self._eliminated(scatter)
        matrix, vector = a.sum(axis=0) + np.eye(a.shape[1]), b.sum(axis=0)
        total = float(gain.sum()) + 0.5 * float(vector @ np.linalg.solve(matrix, vector))
        return total - 0.5 * float(np.linalg.slogdet(matrix)[1])

    def log_marginal_without(self, scatter: Mapping[int, float]) -> Array:
        """The same without each one of the tests, (J,)."""
        a, b, gain = self._eliminated(scatter)
        matrix, vector = a.sum(axis=0) + np.eye(a.shape[1]) - a, b.sum(axis=0) - b
        solved = np.linalg.solve(matrix, vector[..., None])[..., 0]
        total = gain.sum() - gain + 0.5 * np.einsum("js,js->j", vector, solved)
        return np.asarray(total - 0.5 * np.linalg.slogdet(matrix)[1])

    def _eliminated(self, scatter: Mapping[int, float]) -> tuple[Array, Array, Array]:
        """Each test's precision and pull with its deviations integrated out, and what that adds."""
        a, b, gain = self.precision, self.pull, np.zeros(len(self.pull))
        for k, tau in scatter.items():
            column, pull = a[:, :, k], b[:, k]
            shrink = tau**2 / (1.0 + tau**2 * column[:, k])
            gain = gain + 0.5 * (shrink * pull**2 - np.log1p(tau**2 * column[:, k]))
            b = b - (shrink * pull)[:, None] * column
            a = a - shrink[:, None, None] * column[:, :, None] * column[:, None, :]
        return a, b, gain

    def places(self, scatter: Mapping[int, float]) -> tuple[Array, Array]:
        """Most likely level (s,) with these scatters, and the tests' deviations from it, (J, s)."""
        differ = list(scatter)
        wide = np.diag(np.array([scatter[k] ** -2.0 for k in differ]))
        inside = self.precision[:, differ][:, :, differ] + wide
        across = self.precision[:, differ]  # (J, f, s)
        gain = np.swapaxes(np.linalg.solve(inside, across), 1, 2)
        matrix = (self.precision - gain @ across).sum(axis=0) + np.eye(self.pull.shape[1])
        vector = (self.pull - (gain @ self.pull[:, differ, None])[..., 0]).sum(axis=0)
        level = np.linalg.solve(matrix, vector)
        deviations = np.zeros_like(self.pull)
        left = self.pull[:, differ] - across @ level
        deviations[:, differ] = np.linalg.solve(inside, left[..., None])[..., 0]
        return level, deviations


def _sizes(unit: float) -> Array:
    """Values of a scatter that are equally likely by an exponential prior of mean `unit`."""
    quantiles = (np.arange(POINTS) + 0.5) / POINTS
    return np.asarray(-unit * np.log1p(-quantiles))


def share(layout: Layout, tests: Sequence[TestLikelihood]) -> Layout:
    """The layout with what the tests leave common, and without effects on it.

    Parameters
    ----------
    layout : Layout
    tests : sequence of TestLikelihood
        With Gaussians near each other's common values.
    """
    followed = {*layout.laws, *layout.dependence}
    sparse = np.array(layout.sparse, dtype=np.bool_)
    sparse &= np.array([name not in followed for name in layout.names])
    those = np.flatnonzero(sparse)
    if those.size == 0:
        return layout
    unit = (layout.scatter_sd / layout.spread)[those]
    sparse[those[_differing(tests, those, unit)]] = False
    common = np.flatnonzero(sparse)
    effects = [
        replace(effect, members=tuple(k for k in effect.members if k not in common))
        for effect in layout.effects
    ]
    return replace(
        layout,
        common=tuple(sparse.tolist()),
        effects=tuple(effect for effect in effects if effect.members),
    )


def draw_common(
    layout: Layout, tests: Sequence[TestLikelihood], rng: np.random.Generator, n: int
) -> Array:
    """Draws of what is common, (n, common), with the tests' Gaussians and nothing else shared."""
    those = np.flatnonzero(layout.common)
    reduced = _reduce(tests, those)
    precision = reduced.precision.sum(axis=0) + np.eye(those.size)
    mean = np.linalg.solve(precision, reduced.pull.sum(axis=0))
    root = np.linalg.cholesky(precision)
    noise = np.linalg.solve(root.T, rng.standard_normal((those.size, n)))
    return np.asarray(mean + noise.T)


def _reduce(tests: Sequence[TestLikelihood], those: Index) -> _Reduced:
    """Gaussians of some quantities, all others of each test integrated over a N(0, 1) prior."""
    precisions, pulls = [], []
    for test in tests:
        rest = np.setdiff1d(np.arange(len(test.mean)), those)
        pull = test.precision @ test.mean
        within = test.precision[np.ix_(rest, rest)] + np.eye(rest.size)
        gain = np.linalg.solve(within, test.precision[np.ix_(rest, those)]).T
        precisions.append(
            test.precision[np.ix_(those, those)] - gain @ test.precision[np.ix_(rest, those)]
        )
        pulls.append(pull[those] - gain @ pull[rest])
    return _Reduced(np.array(precisions), np.array(pulls))


def _differing(tests: Sequence[TestLikelihood], those: Index, unit: Array) -> list[int]:
    """Which of some quantities differ between tests; `unit` is the mean of their scatter's prior.

    Parameters
    ----------
    tests : sequence of TestLikelihood
    those : (s,) int
    unit : (s,)
    """
    reduced = _reduce(tests, those)
    found: dict[int, float] = {}
    asked = list(range(those.size))
    while asked:
        told = {k: reduced.evidence(found, k, unit[k]) for k in asked}
        best = max(told, key=lambda k: told[k][0])
        if told[best][0] < np.log(EVIDENCE):
            break
        asked.remove(best)
        wider = {**found, best: told[best][1]}
        doubt = _promised_too_much(tests, those, reduced, wider)
        left = reduced.evidence_without(found, best, unit[best]) - doubt.sum() + doubt
        if np.min(left) > np.log(EVIDENCE):
            found = wider
    return list(found)


def _promised_too_much(
    tests: Sequence[TestLikelihood], those: Index, reduced: _Reduced, scatter: Mapping[int, float]
) -> Array:
    """Log likelihood that Gaussians gain by the last deviation less the tests' own gain, (J,)."""
    level, deviations = reduced.places(scatter)
    *_, last = scatter
    found = []
    for test, apart in zip(tests, deviations, strict=True):
        same = apart.copy()
        same[last] = 0.0
        points = np.stack([_complete(test, those, level + away) for away in (same, apart)])
        near, exact = test.approximated().log_likelihood(points), test.log_likelihood(points)
        found.append(float(np.diff(near)[0] - np.diff(exact)[0]))
    return np.where(np.isfinite(found), found, 1e9)


def _complete(test: TestLikelihood, those: Index, values: Array) -> Array:
    """Coordinates of a test (D,) with these values, the others where its Gaussian has them."""
    rest = np.setdiff1d(np.arange(len(test.mean)), those)
    pull = test.precision[np.ix_(rest, those)] @ (test.mean[those] - values)
    within = test.precision[np.ix_(rest, rest)]
    x = np.zeros_like(test.mean)
    x[those] = values
    x[rest] = np.linalg.solve(within + np.eye(rest.size), within @ test.mean[rest] + pull)
    return x
