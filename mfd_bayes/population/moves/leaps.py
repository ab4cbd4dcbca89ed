"""Leaps of effects' sd and shapes between far modes, given the tests.

What a law does not say, large effects of the levels can: a posterior of few levels has modes that
lie far from each other, and steps do not cross between them. A leap does not start from where its
chain is. It is drawn from the other half of the chain's ensemble, smoothed, or from the prior, and
accepted by Metropolis and Hastings with levels and effects integrated out. The share that comes
from the prior reaches every mode, and lets a chain leave a mode that no other chain is in
(defensive mixture: Hesterberg, 1995).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.laws import prior_of
from mfd_bayes.population.layout import Layout

Array = NDArray[np.float64]

FROM_PRIOR = 0.3
"""Share of the leaps that come from the prior."""

WIDTH = 0.6
"""Width of the smoothing, over the sd of the other half."""

TO_SD = 0.7413
"""Sd of a normal density over its interquartile range."""


def leap(joint: Joint, chains: Chains, rng: np.random.Generator, density: Array) -> Accepted:
    """Leaps of effects' sd and of shapes by block, with levels and effects integrated out.

    The density of each chain's blocks, as `Joint.log_blocks` has it, is brought up to date.
    """
    layout = joint.layout
    begin = len(layout.names)
    if layout.dim == begin:
        return []
    blocks = layout.block[begin:]
    groups = np.unique(blocks)
    everything = joint.given(chains)
    accepted: Accepted = []
    for own, other in chains.halves(rng):
        leaps = _Leaps(layout, chains.h[other][..., begin:], blocks)
        half, h = own.ravel(), chains.h[own.ravel()]
        leapt = leaps.draw(rng, own.shape[1])
        new = leapt.reshape(len(half), -1)
        proposed = np.concatenate([h[:, :begin], new], axis=1)
        ratio = leaps.log(chains.h[own][..., begin:]) - leaps.log(leapt)  # (E, n, G)
        before, after = density[half], joint.log_blocks(everything.of(half), proposed)
        gain = after - before + ratio.reshape(before.shape)
        yes = np.log(rng.random(gain.shape)) < gain
        chains.h[half, begin:] = np.where(yes[:, blocks], new, h[:, begin:])
        density[half] = np.where(yes, after, before)
        accepted.append(("leap", yes[:, groups]))
    return accepted


@cache
def log_half_normal(sd: float) -> Any:
    """Distribution of the logarithm of what is half-normal, as one of scipy.stats."""
    from scipy import stats  # which takes long to import

    return stats.loggamma(0.5, np.log(np.sqrt(2.0) * sd), 0.5)


class _Leaps:
    """Density of leaps, for each ensemble and each block.

    Parameters
    ----------
    layout : Layout
    others : (ensembles, n, C)
        The C coordinates of the other half.
    blocks : (C,) int
    """

    def __init__(self, layout: Layout, others: Array, blocks: NDArray[np.intp]) -> None:
        low, high = np.quantile(others, [0.25, 0.75], axis=1)
        self.width = WIDTH * TO_SD * (high - low)[:, None] + 1e-6  # (E, 1, C)
        self.others, self.blocks = others, blocks
        self.member = (blocks[:, None] == np.arange(len(layout.groups))).astype(np.float64)
        sds = [log_half_normal(float(sd)) for sd in layout.sd_scale[len(layout.names) :]]
        self.priors = [*sds, *(prior_of(shape) for _, shape in layout.shapes)]

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Leaps of n chains of each ensemble, (ensembles, n, C)."""
        ensembles, m, size = self.others.shape
        groups = self.member.shape[1]
        picks = rng.integers(m, size=(ensembles, n, groups))[..., self.blocks]
        near = np.take_along_axis(self.others, picks, axis=1)
        near = near + self.width * rng.standard_normal(near.shape)
        uniform = rng.random((ensembles, n, size))
        prior = np.stack([p.ppf(uniform[..., i]) for i, p in enumerate(self.priors)], axis=-1)
        far = rng.random((ensembles, n, groups))[..., self.blocks] < FROM_PRIOR
        return np.asarray(np.where(far, prior, near))

    def log(self, at: Array) -> Array:
        """Log density of each block at (ensembles, n, C), (ensembles, n, groups)."""
        prior = np.stack([p.logpdf(at[..., i]) for i, p in enumerate(self.priors)], axis=-1)
        apart = (at[:, :, None] - self.others[:, None]) / self.width[:, None]
        terms = -0.5 * apart**2 - np.log(np.sqrt(2.0 * np.pi) * self.width[:, None])
        near = logsumexp(terms @ self.member, axis=2) - np.log(self.others.shape[1])
        far = np.log(FROM_PRIOR) + prior @ self.member
        return np.asarray(np.logaddexp(far, np.log1p(-FROM_PRIOR) + near))
