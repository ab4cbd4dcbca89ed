"""The steel of examples/coupons beside OpenSees' Steel02, written out step by step."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.friction.models import find_model

EXAMPLE = Path(__file__).parents[2] / "examples" / "coupons"
THETA = np.array(
    [[2.0e5, 450.0, 0.02, 0.9, 0.1, 0.03, 0.02], [1.8e5, 520.0, 0.005, 0.85, 0.2, 0, 0.1]]
)


def steel02(strain, modulus, yielding, b, c1, c2, a1, a3, r0=20.0):
    """Stress after Steel02's sequence of conditions, one sample after the other."""
    hard, first = b * modulus, yielding / modulus
    highest, lowest, way, stress = first, -first, 0, [0.0]
    begun, base = strain[0], 0.0
    for before, now in pairwise(strain):
        up = np.sign(now - before) or way
        if up != way:
            shift = 1.0
            if way:
                begun, base = before, stress[-1]
                highest, lowest = max(highest, begun), min(lowest, begun)
                shift += (a3 if up > 0 else a1) * ((highest - lowest) / (2 * first)) ** 0.8
            way = up
            level = up * shift * (yielding - hard * first)
            knee = (level - base + modulus * begun) / (modulus - hard)
            top = level + hard * knee
            xi = abs(((highest if up > 0 else lowest) - knee) / first)
            r = r0 * (1 - c1 * xi / (c2 + xi))
        x = (now - begun) / (knee - begun)
        stress.append(base + (b * x + (1 - b) * x / (1 + abs(x) ** r) ** (1 / r)) * (top - base))
    return np.array(stress)


@pytest.fixture(scope="module")
def trace():
    rng = np.random.default_rng(2)
    turns = np.append(0.0, 0.01 * np.cumsum(rng.normal(0, 1, 30)))
    strain = np.interp(np.arange(0, 30, 0.1), np.arange(31), turns)
    strain[40] = strain[39]  # a sample that is there twice keeps the direction
    return mb.Trace.from_arrays(np.arange(strain.size, dtype=float), strain)


def test_the_example_agrees_with_steel02_in_steps(trace):
    stress = find_model("steel.py:Steel", EXAMPLE).force(THETA, trace)
    for row, (modulus, yielding, *rest) in zip(stress, THETA, strict=True):
        expected = steel02(trace.displacement, modulus, yielding, *rest)
        assert np.max(np.abs(row - expected)) < 1e-8
        # the control: another hardening is another stress
        other = steel02(trace.displacement, modulus, yielding, *rest[:-1], rest[-1] + 0.01)
        assert np.max(np.abs(row - other)) > 1.0
