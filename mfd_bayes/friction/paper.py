"""The quantities of the MFD paper, which the three-stage model and LuGre share."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.columns import columns_in_order, named_vectors
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.yield_shares import shares_along
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

PARAMETERS = (
    *("sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd"),
    *("k2", "k3", "d2", "d3", "gamma1", "gamma2", "v_s"),
)
"""All parameters, in the paper's order."""

FRICTION_FORCES = ("Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd")
ACTUATED = ("sigma0", *FRICTION_FORCES)
"""The parameters that follow the actuation (paper Eq. 5)."""

_POSITIVE = frozenset({"sigma0", "gamma1", "gamma2", "v_s"})  # the model divides by them

_EXCESS = MappingProxyType(
    {"Fs_fwd": ("Fc_fwd", "static_excess_fwd"), "Fs_bwd": ("Fc_bwd", "static_excess_bwd")}
)
"""F_s = F_c (1 + excess), so that F_s ≥ F_c holds: kinetic friction and excess of each F_s."""

_QUANTITIES = (
    Quantity("sigma0", "stiffness", r"\sigma_0", "σ<sub>0</sub>", "aggregate bristle stiffness"),
    Quantity("sigma1", "damping", r"\sigma_1", "σ<sub>1</sub>", "micro-damping"),
    Quantity("sigma2", "damping", r"\sigma_2", "σ<sub>2</sub>", "viscous friction"),
    Quantity(
        *("Fc_fwd", "force", r"F_{c,\mathrm{fwd}}", "F<sub>c,fwd</sub>"),
        "kinetic friction, forward",
    ),
    Quantity(
        *("Fc_bwd", "force", r"F_{c,\mathrm{bwd}}", "F<sub>c,bwd</sub>"),
        "kinetic friction, backward",
    ),
    Quantity(
        *("static_excess_fwd", "dimensionless", r"F_s/F_c - 1,\ \mathrm{fwd}"),
        "(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>fwd</sub>",
        "excess of static over kinetic friction, forward",
    ),
    Quantity(
        *("static_excess_bwd", "dimensionless", r"F_s/F_c - 1,\ \mathrm{bwd}"),
        "(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>bwd</sub>",
        "excess of static over kinetic friction, backward",
    ),
    Quantity("k2", "stiffness", "k_2", "k<sub>2</sub>", "stiffness of stage 2"),
    Quantity("k3", "stiffness", "k_3", "k<sub>3</sub>", "stiffness of stage 3"),
    Quantity("d2", "displacement", "d_2", "d<sub>2</sub>", "drum travel of stage 2"),
    Quantity("d3", "displacement", "d_3", "d<sub>3</sub>", "drum travel of stage 3"),
    Quantity(
        *("ell", "displacement", r"\ell", "ℓ"),
        "transition length, γ2/γ1 of the three stages",
    ),
    Quantity("gamma1", "dimensionless", r"\gamma_1", "γ<sub>1</sub>", "transition constant"),
    Quantity("v_s", "velocity", r"\dot x_s", "ẋ<sub>s</sub>", "Stribeck velocity"),
    Quantity(
        *("Fs_fwd", "force", r"F_{s,\mathrm{fwd}}", "F<sub>s,fwd</sub>"),
        "static friction, forward",
        sampled=False,
    ),
    Quantity(
        *("Fs_bwd", "force", r"F_{s,\mathrm{bwd}}", "F<sub>s,bwd</sub>"),
        "static friction, backward",
        sampled=False,
    ),
    Quantity(
        *("gamma2", "displacement", r"\gamma_2", "γ<sub>2</sub>", "transition constant"),
        sampled=False,
    ),
)


def quantities_of(parameters: tuple[str, ...]) -> tuple[Quantity, ...]:
    """Some of the paper's parameters, and what is sampled in their place."""
    names = {*parameters, *(name for p in parameters for name in _EXCESS.get(p, ()))}
    if "gamma2" in names:
        names.add("ell")
    return tuple(quantity for quantity in _QUANTITIES if quantity.name in names)


class PaperModel(Model):
    """What the models with the paper's friction have in common."""

    laws: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"Fc_fwd": "proportional", "Fc_bwd": "proportional", "sigma0": "affine"}
    )
    tied_laws: ClassVar[Mapping[str, str]] = MappingProxyType(
        {static: kinetic for static, (kinetic, _) in _EXCESS.items()}
    )
    slip_forces: ClassVar[tuple[str, ...]] = ("Fc_fwd", "Fc_bwd")

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p): F_s = F_c (1 + excess), γ2 = ℓ γ1."""
        known = named_vectors(values, [q.name for q in self.quantities if q.sampled])
        for static, (kinetic, excess) in _EXCESS.items():
            known[static] = known[kinetic] * (1.0 + known[excess])
        if "gamma2" in self.parameters:
            known["gamma2"] = known["ell"] * known["gamma1"]
        return super().theta(known)

    def vectors(self, theta: ArrayLike) -> Array:
        """Theta as numbers, (n, p).

        A model with fewer parameters takes its own from a theta in the paper's order, (n, 14), too.
        """
        values = columns_in_order("theta", theta, self.parameters)
        if values.ndim == 2 and values.shape[1] == len(PARAMETERS) != len(self.parameters):
            values = values[:, [PARAMETERS.index(name) for name in self.parameters]]
        return super().vectors(values)

    def _sound(self, theta: ArrayLike) -> int:
        """As `Model._sound`, of dampers that `check_theta` takes."""
        return int(check_theta(self, theta)["v_s"].size)

    def composed(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Static friction, where its excess is sampled."""
        return tuple(static for static, (_, excess) in _EXCESS.items() if excess in names)


def check_theta(model: Model, theta: ArrayLike) -> dict[str, Array]:
    """Columns of theta by name, (1, n) each.

    Raises
    ------
    FitError
        When the shape does not fit, or a value is negative or not finite, or F_s < F_c.
    """
    values = model.vectors(theta)
    columns = dict(zip(model.parameters, np.array(values.T, order="C")[:, None], strict=True))
    if not np.all((values >= _least(model.parameters)) & (values < np.inf)):
        _refuse(columns)
    for static, (kinetic, _) in _EXCESS.items():
        if np.any(columns[static] < columns[kinetic] * (1 - 1e-12)):
            raise FitError(f"static friction {static} must be at least kinetic {kinetic}")
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
    scales = shares_along(scales, trace, n, ACTUATED)
    nearest, followed = trace.path.nearest, {}
    for name, factor in scales.items():
        along = factor.T.take(nearest, axis=0)
        own = len(factor) == n  # else the product is larger
        followed[name] = np.multiply(along, columns[name], out=along if own else None)
    return columns | followed
