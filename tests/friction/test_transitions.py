import numpy as np
import pytest

from mfd_bayes.friction.gap import follow
from mfd_bayes.friction.transitions import FARTHEST, Gap, Transitions, blend
from mfd_bayes.records.trace import Trace


def gaps(lengths):
    """Gaps that differ, of transition lengths in in."""
    around = np.random.default_rng(7).lognormal(0.0, 0.2, (4, len(lengths)))
    return Gap(*(np.array([2.3, 37.0, 0.28, 0.044])[:, None] * around), np.asarray(lengths))


def motion(kind):
    t = 0.01 * np.arange(1500)
    x = {
        "full reversals": np.sin(np.pi * t + 0.3),
        "inside the gap": 0.1 * np.sin(np.pi * t + 0.3),
        "many turns": 0.4 * np.sin(20.0 * t) + 0.3 * np.sin(33.0 * t + 1.0) + 0.2 * np.sin(7.0 * t),
        "drift": 3.0 * t + np.sin(np.pi * t),
        "far away": 50.0 * np.sin(np.pi * t),
    }[kind]
    return Trace.from_arrays(t, x)


LENGTHS = {
    "soft": np.full(40, 0.04),
    "usual": np.linspace(0.004, 0.01, 40),
    "sharp": np.linspace(1e-5, 0.003, 40),
    "mixed": np.geomspace(1e-4, 0.1, 40),
    "wide": np.geomspace(2.5e-3, 0.1, 40),
}


@pytest.mark.parametrize(
    "kind", ["full reversals", "inside the gap", "many turns", "drift", "far away"]
)
@pytest.mark.parametrize("lengths", LENGTHS)
def test_prepared_transitions_equal_the_plain_formulas(kind, lengths):
    # in parts, in stretches that have lines of their own, and before the gap as well as after it
    trace, gap = motion(kind), gaps(LENGTHS[lengths])
    path, n = trace.path, gap.k2.size
    rng = np.random.default_rng(8)
    slip = rng.normal(2.0, 0.5, (path.turning_points.size, n))
    crossing = follow(gap, path, np.linspace(0.0, 1.0, n), slip)
    force = rng.normal(2.0, 0.5, (trace.samples, n))
    rows = np.flatnonzero(rng.uniform(size=trace.samples) < 0.8)
    expected = force.copy()
    some = force[rows]
    blend(gap, crossing, path.stretch[rows], trace.displacement[rows], some)
    expected[rows] = some
    Transitions.of(gap, crossing).blend(path.stretch, trace.displacement, rows, force)
    np.testing.assert_allclose(force, expected, rtol=1e-10, atol=1e-10)


def test_consecutive_samples_are_blended_where_they_stand():
    trace, gap = motion("full reversals"), gaps(LENGTHS["soft"])
    path, n = trace.path, gap.k2.size
    crossing = follow(gap, path, np.full(n, 0.5), np.ones((path.turning_points.size, n)))
    every = np.arange(trace.samples)
    force, expected = np.ones((2, trace.samples, n))
    blend(gap, crossing, path.stretch, trace.displacement, expected)
    Transitions.of(gap, crossing).blend(path.stretch, trace.displacement, every, force)
    np.testing.assert_allclose(force, expected, rtol=1e-10, atol=1e-10)


def test_travel_is_limited_before_its_exponential_overflows():
    # the longest transitions keep samples near at which the shortest are complete long ago
    gap = gaps(np.array([0.0022, 2.0]))
    trace = motion("far away")
    path = trace.path
    crossing = follow(gap, path, np.full(2, 0.5), np.ones((path.turning_points.size, 2)))
    assert not gap.sharp
    assert FARTHEST < 100.0 / 0.0022
    force = np.ones((trace.samples, 2))
    Transitions.of(gap, crossing).blend(
        path.stretch, trace.displacement, np.arange(trace.samples), force
    )
    assert np.all(np.isfinite(force))


def test_no_samples_are_blended_into_nothing():
    gap, trace = gaps(LENGTHS["soft"]), motion("full reversals")
    path, n = trace.path, gap.k2.size
    crossing = follow(gap, path, np.full(n, 0.5), np.ones((path.turning_points.size, n)))
    none, force = np.zeros(0, dtype=np.intp), np.ones((trace.samples, n))
    Transitions.of(gap, crossing).blend(path.stretch, trace.displacement, none, force)
    np.testing.assert_array_equal(force, 1.0)
