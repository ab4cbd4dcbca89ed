"""A linear recurrence in time, for many vectors at once in few numpy calls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHORT = 24  # up to this many steps are taken one after the other


def solve(decay: Array, drive: Array, first: Array) -> Array:
    """States z_k = decay_k z_{k−1} + drive_k after each of N steps, (N, n).

    The steps are taken in blocks: a step in all of them at once, and then from block to block.

    Parameters
    ----------
    decay, drive : (N, n)
    first : (n,)
        z before the first step.
    """
    steps, n = decay.shape
    if steps <= SHORT:
        states, last = drive.copy(), first
        for a, z in zip(decay, states, strict=True):
            z += a * last
            last = z
        return states
    length = round(1.3 * steps ** (1 / 3) if steps > SHORT**2 else steps**0.5)
    count = -(-steps // length)
    # (length, count, n): the j-th steps of all blocks together; what fills up the last one is 0
    a, z = np.zeros((2, length, count, n))
    for blocks, given in ((a, decay), (z, drive)):
        by_block = blocks.swapaxes(0, 1)
        by_block[:-1] = given[: (count - 1) * length].reshape(count - 1, length, n)
        by_block[-1, : steps - (count - 1) * length] = given[(count - 1) * length :]
    for j in range(1, length):
        z[j] += a[j] * z[j - 1]
        a[j] *= a[j - 1]
    # the last block is followed by none, so that its end does not matter
    before = np.concatenate([first[None], solve(a[-1, :-1], z[-1, :-1], first)])
    a *= before
    z += a
    z = z.swapaxes(0, 1).reshape(-1, n)
    return np.asarray(z[:steps])
