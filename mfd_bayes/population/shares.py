"""What makes a band wide: the share of each source in the variance of a prediction.

One source after another is frozen, with the same random numbers for all others. What a source adds
to the variance depends on which others vary, so its share is the mean over orders in which they are
set free (Shapley values, by some permutations and their reverses). Shares add up to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.drawn import Drawn

Array = NDArray[np.float64]

PERMUTATIONS = 8
"""Number of orders, unless asked otherwise."""

DRAWS = 500
FEWEST = 200
VALUES = 1_000_000
"""Most and fewest draws, and about how many values of the force one evaluation computes."""

NOTHING = 1e-20
"""A variance up to this, kip², is rounding."""


@dataclass(frozen=True)
class Source:
    """Something that makes a band wide.

    Attributes
    ----------
    name : str
        In tables: "test-to-test scatter of the gap".
    advice : str
        What a user could do about it, as a sentence.
    freeze : callable
        The draws with this source frozen, given the draws and the names of the shared
        quantities; the same object where the source is not in them.
    inside : bool
        Whether the model's force must be computed anew; False for what is added to it.
    """

    name: str
    advice: str
    freeze: Callable[[Drawn, Sequence[str]], Drawn]
    inside: bool = True


GROUPS: dict[str, tuple[str, ...]] = {
    "forward slip force": ("Fc_fwd", "static_excess_fwd", "Fy_fwd", "weakening_fwd"),
    "backward slip force": ("Fc_bwd", "static_excess_bwd", "Fy_bwd", "weakening_bwd"),
    "gap": ("d2", "d3", "gap"),
    "sigma0": ("sigma0",),
    "stiffness beyond the gap": ("k_fwd", "k_bwd"),
}
"""Quantities whose scatter has a line of its own; that of the noise counts to the noise."""

_OWN = {name for group in GROUPS.values() for name in group} | {"offset"}
_REPEATS = (
    "If few tests were calibrated, more tests make it smaller. If many were, it is the true "
    "difference between tests of this device: find out what differed (temperature, wear, "
    "bedding-in), or declare sessions. The kind this_test does not contain it."
)


def _scatter(drawn: Drawn, columns: list[int]) -> Drawn:
    """Draws without test-to-test scatter of some quantities."""
    parts = drawn.parts
    if not np.any(parts.scatter[:, columns]):
        return drawn
    scatter = parts.scatter.copy()
    scatter[:, columns] = 0.0
    return replace(drawn, parts=replace(parts, scatter=scatter))


def _scatter_of(group: Sequence[str]) -> Callable[[Drawn, Sequence[str]], Drawn]:
    return lambda drawn, names: _scatter(drawn, [k for k, n in enumerate(names) if n in group])


def _other_scatter(drawn: Drawn, names: Sequence[str]) -> Drawn:
    others = [k for k, n in enumerate(names) if n not in _OWN and not n.startswith("noise_")]
    return _scatter(drawn, others)


def _offset(drawn: Drawn, names: Sequence[str]) -> Drawn:
    return drawn if drawn.noise is None else _scatter_of(["offset"])(drawn, names)


def _law(drawn: Drawn, names: Sequence[str]) -> Drawn:
    parts = drawn.parts
    scales = {name: _middle(factors) for name, factors in drawn.scales.items()}
    if not np.any(np.ptp(parts.law, axis=0)) and not scales:
        return drawn
    return replace(drawn, parts=replace(parts, law=_middle(parts.law)), scales=scales)


def _parameters(drawn: Drawn, names: Sequence[str]) -> Drawn:
    return replace(drawn, parts=replace(drawn.parts, level=_middle(drawn.parts.level)))


def _start(drawn: Drawn, names: Sequence[str]) -> Drawn:
    start = drawn.unknown["start"]
    if not np.ptp(start):
        return drawn
    return replace(drawn, unknown={**drawn.unknown, "start": np.full(start.size, np.median(start))})


def _discrepancy(drawn: Drawn, names: Sequence[str]) -> Drawn:
    if drawn.discrepancy is None:
        return drawn
    return replace(drawn, discrepancy=_middle(drawn.discrepancy))


def _noise(drawn: Drawn, names: Sequence[str]) -> Drawn:
    return drawn if drawn.noise is None else replace(drawn, noise=np.zeros((len(drawn.noise), 1)))


def _middle(values: Array) -> Array:
    return np.broadcast_to(values.mean(axis=0), values.shape)


SOURCES = (
    *(Source(f"test-to-test scatter of {n}", _REPEATS, _scatter_of(g)) for n, g in GROUPS.items()),
    Source("test-to-test scatter of other quantities", _REPEATS, _other_scatter),
    Source(
        "test-to-test scatter of the offset",
        "Zero the load cell before each test, or ask for the kind new_test, which leaves it out.",
        _offset,
        inside=False,
    ),
    Source(
        "law, level and session effects",
        "Calibrate a test at or near this actuation, with such a stroke, in this session.",
        _law,
    ),
    Source(
        "parameters", "Calibrate more tests, with larger strokes or several speeds.", _parameters
    ),
    Source(
        "start in the gap",
        "Begin the motion with a stroke that crosses the whole gap: that makes the start known.",
        _start,
    ),
    Source(
        "discrepancy of the model",
        "Calibrate more tests with full strokes: it repeats in every cycle.",
        _discrepancy,
    ),
    Source(
        "noise",
        "It is the record's, not the damper's: the kind new_test leaves it out.",
        _noise,
        False,
    ),
)
"""All sources, in the order of tables. A new one is one more line here."""

ADVICE = {source.name: source.advice for source in SOURCES}


def shares_of(
    drawn: Drawn,
    names: Sequence[str],
    total: Callable[[Drawn, Array | None], tuple[Array, Array]],
    permutations: int = PERMUTATIONS,
    seed: int = 0,
) -> dict[str, float]:
    """Share of each source in the variance of a prediction, averaged over the samples.

    Parameters
    ----------
    drawn : Drawn
    names : sequence of str
        Shared quantities, in the order of the columns of `drawn.parts`.
    total : callable
        Predicted force, and the damper's part of it, (n, T) each, of draws; given the damper's
        part, it does not compute that again.
    permutations, seed : int

    Returns
    -------
    dict
        By the names of `SOURCES`, without those that are not in the draws; their sum is 1.
        Empty where nothing varies.
    """
    apart = drawn.untangled()
    sources = {s.name: s for s in SOURCES if s.freeze(apart, names) is not apart}
    inside = {name for name, source in sources.items() if source.inside}
    known: dict[frozenset[str], float] = {}
    last: tuple[frozenset[str], Array] | None = None

    def variance(free: frozenset[str]) -> float:
        nonlocal last
        if free not in known:
            frozen = apart
            for name, source in sources.items():
                if name not in free:
                    frozen = source.freeze(frozen, names)
            key = free & inside
            force, damper = total(frozen, last[1] if last and last[0] == key else None)
            last = key, damper
            known[free] = float(np.mean(np.var(force, axis=0)))
        return known[free]

    return shapley(list(sources), variance, permutations, np.random.default_rng(seed))


def shapley(
    players: Sequence[str],
    value: Callable[[frozenset[str]], float],
    permutations: int,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Shapley values over their sum, by permutations and their reverses.

    Values below 0, which chance or correlated players may give, are taken for 0.
    """
    gain = dict.fromkeys(players, 0.0)
    order = np.arange(len(players))
    for turn in range(max(permutations, 1)):
        order = rng.permutation(len(players)) if turn % 2 == 0 else order[::-1]
        free, before = frozenset[str](), value(frozenset())
        for name in (players[k] for k in order.tolist()):
            free |= {name}
            after = value(free)
            gain[name] += after - before
            before = after
    positive = {name: max(g, 0.0) for name, g in gain.items()}
    whole = sum(positive.values())
    return {name: g / whole for name, g in positive.items()} if whole > NOTHING else {}
