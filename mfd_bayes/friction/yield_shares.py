"""Factors of the slip forces of a model where they follow the actuation, checked."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Shares = dict[str, Array]

ACTUATED = ("Fy_fwd", "Fy_bwd")
"""The parameters of Bouc-Wen that follow the actuation."""

Names = tuple[str, ...]


def check_level(actuation: Any) -> float | None:
    """Actuation of a step, finite and not negative; None where none is given."""
    if actuation is None:
        return None
    return real_number("actuation of a step", actuation, FitError, (0.0, inf))


def check_step(displacement: Any, velocity: Any, dt: Any, *, first: bool) -> tuple[Any, ...]:
    """Displacement, velocity and dt of a step; the time before the first sample may be any."""
    x = real_number("displacement of a step", displacement, FitError)
    v = real_number("velocity of a step", velocity, FitError)
    if first:
        return x, v, dt
    return x, v, real_number("dt of a step", dt, FitError, (0.0, inf), inside=True)


def check_scales(scales: Any) -> Mapping[str, Any]:
    """Factors by name, unchanged."""
    if not isinstance(scales, Mapping):
        kind = type(scales).__name__
        raise FitError(f"scales must be a mapping from names of parameters to factors, got {kind}")
    return scales


def check_shares(
    scales: Mapping[str, ArrayLike], shapes: tuple[tuple[int, ...], ...], names: Names
) -> Shares:
    """Factors by name, checked: names, shapes, and that they are finite and not negative."""
    shares = {
        name: real_numbers(f"scales of {name}", share, FitError)
        for name, share in check_scales(scales).items()
    }
    expected = " or ".join(map(str, shapes))
    for name, share in shares.items():
        if name not in names or share.shape not in shapes:
            raise FitError(
                f"scales may hold {' and '.join(names)} with shape {expected}, "
                f"got {name} with {share.shape}"
            )
        if not np.all(np.isfinite(share) & (share >= 0)):
            raise FitError(f"scales of {name} must be finite and not negative")
    return shares


def shares_along(scales: Mapping[str, ArrayLike], trace: Trace, n: int, names: Names) -> Shares:
    """Factors of `names` along a record, (n, T) or (1, T) each, checked."""
    return check_shares(scales, ((n, trace.samples), (1, trace.samples)), names)


def trace_shares(
    trace: Trace, n: int, scales: Mapping[str, ArrayLike] | None, names: Names = ACTUATED
) -> Shares:
    """Factors of `names` at each sample, (n, T) or (1, T); empty when they are constant."""
    if scales is not None:
        return shares_along(scales, trace, n, names)
    if not trace.varying:
        return {}
    share = np.asarray(trace.actuation)[None] / (trace.reference_actuation or 1.0)
    return dict.fromkeys(names, share)


def reference_of(known: float | None, actuation: float | None) -> float | None:
    """Actuation that theta belongs to: the known one, else that of the first sample with any."""
    return known or actuation or None


def check_reference(actuation: Any) -> float | None:
    """A reference actuation, which something can be in proportion to; None where none is given."""
    if actuation is None:
        return None
    return real_number("reference_actuation", actuation, FitError, (0.0, inf), inside=True)


def step_shares(
    n: int,
    reference: float | None,
    actuation: float | None,
    scales: Mapping[str, ArrayLike] | None,
    names: Names = ACTUATED,
) -> Shares:
    """Factors of `names` at a sample, (n,), (1,) or (); empty when they are constant.

    They are the state's own, whatever the caller does with his arrays.
    """
    if scales is not None:
        shares = check_shares(scales, ((n,), (1,), ()), names)
        return {name: share.copy() for name, share in shares.items()}
    if actuation is None:
        return {}
    return dict.fromkeys(names, np.array([actuation / (reference or 1.0)]))
