"""What every friction model offers, and the checks that all of them share."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

UNITS = {
    "sigma0": "kip/in",
    "sigma1": "kip*s/in",
    "sigma2": "kip*s/in",
    "Fs_fwd": "kip",
    "Fc_fwd": "kip",
    "Fs_bwd": "kip",
    "Fc_bwd": "kip",
    "k2": "kip/in",
    "k3": "kip/in",
    "d2": "in",
    "d3": "in",
    "gamma1": "1",
    "gamma2": "in",
    "v_s": "in/s",
}
"""Unit of every parameter, in the paper's order."""

FRICTION_FORCES = ("Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd")
ACTUATED = ("sigma0", *FRICTION_FORCES)
"""The parameters that follow the actuation (paper Eq. 5)."""


_POSITIVE = frozenset({"sigma0", "gamma1", "gamma2", "v_s"})  # the model divides by them


class Model(Protocol):
    """A friction model: a name, its parameters in order, and their force."""

    @property
    def name(self) -> str:
        """Name in campaign files."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of theta's columns."""

    @property
    def has_gap(self) -> bool:
        """Whether `start`, the place in the gap at the first sample, matters."""

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector, (n, T), kip."""

    def travel(self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None) -> Array:
        """Travel since the last slip, or turn, of every parameter vector, (n, T), in."""


def travel_since_turn(theta: ArrayLike, trace: Trace) -> Array:
    """Travel since the last turning point, (n, T), in: that of a device without a gap."""
    path = trace.path
    turns = np.concatenate([path.displacement[:1], path.displacement[path.turning_points]])
    travel = np.abs(trace.displacement - turns[path.stretch])
    return np.broadcast_to(travel, (len(np.asarray(theta)), trace.samples))


def check_theta(model: Model, theta: ArrayLike) -> dict[str, Array]:
    """Columns of theta by name, (1, n) each.

    A model with fewer parameters takes its own from a theta in the paper's order, (n, 14), too.

    Raises
    ------
    FitError
        When the shape does not fit, or a value is negative or not finite, or F_s < F_c.
    """
    values = np.asarray(theta, dtype=np.float64)
    width = len(model.parameters)
    if values.ndim == 2 and values.shape[1] == len(UNITS) != width:
        values = values[:, [list(UNITS).index(name) for name in model.parameters]]
    if values.ndim != 2 or values.shape[1] != width:
        raise FitError(f"theta must have shape (n, {width}) for {model.name}, got {values.shape}")
    columns = dict(zip(model.parameters, np.ascontiguousarray(values.T)[:, None], strict=True))
    if not np.all((values >= _least(model.parameters)) & (values < np.inf)):
        _refuse(columns)
    for side in ("fwd", "bwd"):
        short = columns[f"Fs_{side}"] < columns[f"Fc_{side}"] * (1 - 1e-12)
        if np.any(short):
            raise FitError(f"static friction Fs_{side} must be at least kinetic Fc_{side}")
    return columns


@lru_cache
def _least(parameters: tuple[str, ...]) -> Array:
    """Least value of each parameter: 0, or the least positive number."""
    return np.array([np.nextafter(0.0, 1.0) if name in _POSITIVE else 0.0 for name in parameters])


def _refuse(columns: dict[str, Array]) -> None:
    for name, column in columns.items():
        least = "positive" if name in _POSITIVE else "not negative"
        bad = ~((column >= _least((name,))) & (column < np.inf))
        if np.any(bad):
            raise FitError(f"parameter {name} must be finite and {least}, got {column[bad][0]}")


def actuate(
    columns: dict[str, Array], trace: Trace, scales: Mapping[str, Array] | None
) -> dict[str, Array]:
    """Columns with those that follow a varying actuation made histories along the path, (P, n).

    Parameters
    ----------
    columns : dict of (1, n)
        Values at the trace's reference actuation.
    trace : Trace
    scales : mapping of (n, T) or (1, T), optional
        Factor of each actuated parameter at each sample. When left out and the actuation
        varies, friction is in proportion to it (paper Eq. 5) and σ0 stays constant, since
        one test cannot tell σ0's slope from its intercept.

    Raises
    ------
    FitError
        When a name or a shape in `scales` does not fit.
    """
    if scales is None:
        if not trace.varying:
            return columns
        reference = trace.reference_actuation
        share = np.asarray(trace.actuation)[None] / (reference if reference > 0 else 1.0)
        scales = dict.fromkeys(FRICTION_FORCES, share)
    n = next(iter(columns.values())).shape[1]
    for name, factor in scales.items():
        if name not in ACTUATED or factor.shape not in ((n, trace.samples), (1, trace.samples)):
            raise FitError(
                f"scales may hold {', '.join(ACTUATED)} with shape ({n}, {trace.samples}) or "
                f"(1, {trace.samples}), got {name} with {factor.shape}"
            )
    nearest = trace.path.nearest
    return columns | {name: columns[name] * factor.T[nearest] for name, factor in scales.items()}
