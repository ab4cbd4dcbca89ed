"""Factors of the slip forces of a model where they follow the actuation, checked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Shares = dict[str, Array]

ACTUATED = ("Fy_fwd", "Fy_bwd")
"""The parameters of Bouc-Wen that follow the actuation."""

Names = tuple[str, ...]


def check_number(name: str, value: float, *, least: float = -np.inf) -> None:
    """Refuse a number that is not finite or below its least value, by a FitError with its name."""
    if not (np.isfinite(value) and value >= least):
        words = "finite" if least < 0 else "finite and not negative"
        raise FitError(f"{name} must be {words}, got {value}")


def check_step(displacement: float, velocity: float, dt: float, *, first: bool) -> None:
    """Refuse a sample that no step leads to; the time before the first does not matter."""
    check_number("displacement", displacement)
    check_number("velocity", velocity)
    if first:
        return
    check_number("dt", dt)
    if dt <= 0:
        raise FitError(f"dt must be positive, got {dt} s")


def check_shares(
    scales: Mapping[str, ArrayLike], shapes: tuple[tuple[int, ...], ...], names: Names
) -> Shares:
    """Factors by name, checked: names, shapes, and that they are finite and not negative."""
    shares = {
        name: real_numbers(f"scales of {name}", share, FitError) for name, share in scales.items()
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


def trace_shares(
    trace: Trace, n: int, scales: Mapping[str, ArrayLike] | None, names: Names = ACTUATED
) -> Shares:
    """Factors of `names` at each sample, (n, T) or (1, T); empty when they are constant."""
    if scales is not None:
        return check_shares(scales, ((n, trace.samples), (1, trace.samples)), names)
    if not trace.varying:
        return {}
    share = np.asarray(trace.actuation)[None] / (trace.reference_actuation or 1.0)
    return dict.fromkeys(names, share)


def reference_of(known: float | None, actuation: float | None) -> float | None:
    """Actuation that theta belongs to: the known one, else that of the first sample with any."""
    return known or actuation or None


def check_reference(actuation: float | None) -> None:
    """Refuse a reference actuation that nothing can be in proportion to."""
    if actuation is not None and not (np.isfinite(actuation) and actuation > 0):
        raise FitError(f"reference_actuation must be finite and positive, got {actuation}")


def step_shares(
    n: int,
    reference: float | None,
    actuation: float | None,
    scales: Mapping[str, ArrayLike] | None,
    names: Names = ACTUATED,
) -> Shares:
    """Factors of `names` at a sample, (n,), (1,) or (); empty when they are constant."""
    if actuation is not None:
        check_number("actuation", actuation, least=0.0)
    if scales is not None:
        return check_shares(scales, ((n,), (1,), ()), names)
    if actuation is None:
        return {}
    return dict.fromkeys(names, np.array([actuation / (reference or 1.0)]))
