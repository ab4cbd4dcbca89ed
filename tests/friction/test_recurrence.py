import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfd_bayes.friction.recurrence import SHORT, Blocks, solve


def loop(decay, drive, first):
    states, z = [], first
    for a, b in zip(decay, drive, strict=True):
        z = a * z + b
        states.append(z)
    return np.array(states)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    steps=st.integers(1, 2000),
    vectors=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    stiff=st.booleans(),
)
def test_both_recurrences_equal_a_plain_loop(steps, vectors, seed, stiff):
    rng = np.random.default_rng(seed)
    decay = rng.uniform(size=(steps, vectors)) ** (20 if stiff else 0.1)
    drive, first = rng.normal(size=(steps, vectors)), rng.normal(size=vectors)
    np.testing.assert_allclose(
        solve(decay, drive, first), loop(decay, drive, first), rtol=1e-11, atol=1e-11
    )
    blocks = Blocks.of(steps)
    state = drive[blocks.order]
    blocks.relax(decay[blocks.order], state, first)
    np.testing.assert_allclose(
        state[blocks.place], loop(decay, drive * (1 - decay), first), rtol=1e-11, atol=1e-11
    )


def test_recurrence_without_decay_is_a_running_sum():
    drive = np.random.default_rng(1).normal(size=(1000, 3))
    states = solve(np.ones((1000, 3)), drive, np.zeros(3))
    np.testing.assert_allclose(states, np.cumsum(drive, axis=0), atol=1e-11)


@pytest.mark.parametrize("steps", [1, 2, SHORT, SHORT + 1, 1000, 2020])
def test_blocks_hold_every_step_once(steps):
    blocks = Blocks.of(steps)
    np.testing.assert_array_equal(blocks.order[blocks.place], np.arange(steps))
    assert np.unique(blocks.place).size == steps
    assert blocks.rows == blocks.length * blocks.count < steps + blocks.length
