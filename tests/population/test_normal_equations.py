"""Steps of all tests together: what a dense solver finds of the whole system."""

from itertools import pairwise

import numpy as np
import pytest

from mfd_bayes.population.normal_equations import System, damped_steps

COMMON, FREE, SAMPLES = 3, (4, 2, 5), 30


@pytest.fixture
def made():
    """Slopes of the common and of the free coordinates, residuals, and where coordinates are."""
    rng = np.random.default_rng(3)
    tests = [tuple(rng.standard_normal((SAMPLES, n)) for n in (COMMON, free, 1)) for free in FREE]
    return tests, rng.standard_normal(COMMON), [rng.standard_normal(free) for free in FREE]


def systems_of(tests, free):
    return [
        System(a.T @ a, b.T @ b, a.T @ b, a.T @ left[:, 0], b.T @ left[:, 0] - x)
        for (a, b, left), x in zip(tests, free, strict=True)
    ]


def dense(made, damping):
    """The same steps by one matrix of all coordinates."""
    tests, common, free = made
    edges = COMMON + np.concatenate([[0], np.cumsum(FREE)])
    slopes = np.zeros((len(tests) * SAMPLES, edges[-1]))
    for j, (a, b, _) in enumerate(tests):
        rows = slice(j * SAMPLES, (j + 1) * SAMPLES)
        slopes[rows, :COMMON], slopes[rows, edges[j] : edges[j + 1]] = a, b
    gram = slopes.T @ slopes
    gram += np.diag(1.0 + damping * np.diag(gram))
    left = np.concatenate([left[:, 0] for *_, left in tests])
    step = np.linalg.solve(gram, slopes.T @ left - np.concatenate([common, *free]))
    return step[:COMMON], [step[i:k] for i, k in pairwise(edges)]


@pytest.mark.parametrize("damping", [0.0, 0.01, 5.0])
def test_steps_are_those_of_one_dense_system(made, damping):
    tests, common, free = made
    together, alone = damped_steps(systems_of(tests, free), common, damping)
    expected, others = dense(made, damping)
    np.testing.assert_allclose(together, expected, rtol=1e-9)
    for own, other in zip(alone, others, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9)
    control, _ = dense(made, 2.0 * damping + 0.1)
    assert not np.allclose(together, control, rtol=1e-3)


def test_damping_shortens_steps(made):
    tests, common, free = made
    lengths = [
        np.linalg.norm(damped_steps(systems_of(tests, free), common, damping)[0])
        for damping in (0.0, 1.0, 100.0)
    ]
    assert lengths[0] > lengths[1] > lengths[2]
