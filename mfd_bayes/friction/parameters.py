"""The quantities of the models: what their parameters measure, and what is sampled for them."""

from __future__ import annotations

from types import MappingProxyType

from mfd_bayes.friction.quantity import Quantity

PARAMETERS = (
    *("sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd"),
    *("k2", "k3", "d2", "d3", "gamma1", "gamma2", "v_s"),
)
"""All parameters of the MFD paper, in its order."""

STATIC = MappingProxyType(
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
    names = {*parameters, *(name for p in parameters for name in STATIC.get(p, ()))}
    if "gamma2" in names:
        names.add("ell")
    return tuple(quantity for quantity in _QUANTITIES if quantity.name in names)


BACKLASH = (
    *("k_fwd", "k_bwd", "gap", "ell", "k_0", "Fc_fwd", "Fc_bwd", "n", "sigma2"),
    *("static_excess_fwd", "static_excess_bwd", "v_s"),
)
"""Parameters of LuGre with a backlash spring, in the order of model.md section 9."""

_SPRING = (
    Quantity(
        *("k_fwd", "stiffness", r"k_\mathrm{fwd}", "k<sub>fwd</sub>"),
        "stiffness beyond the gap, forward",
    ),
    Quantity(
        *("k_bwd", "stiffness", r"k_\mathrm{bwd}", "k<sub>bwd</sub>"),
        "stiffness beyond the gap, backward",
    ),
    Quantity("gap", "displacement", "D", "D", "width of the gap"),
    Quantity("k_0", "stiffness", "k_0", "k<sub>0</sub>", "stiffness inside the gap"),
    Quantity("n", "dimensionless", "n", "n", "how sharply slip sets in", least=1.0),
)

BACKLASH_QUANTITIES = tuple(
    sorted((*quantities_of(BACKLASH), *_SPRING), key=lambda quantity: BACKLASH.index(quantity.name))
)

BOUC_WEN_QUANTITIES = (
    Quantity("k", "stiffness", "k", "k", "stiffness of Bouc-Wen hysteresis"),
    Quantity(
        *("alpha", "dimensionless", r"\alpha", "α"),
        "share of the stiffness that remains in slip",
        most=1.0,
    ),
    Quantity(
        *("Fy_fwd", "force", r"F_{y,\mathrm{fwd}}", "F<sub>y,fwd</sub>"),
        "yield force, forward",
    ),
    Quantity(
        *("Fy_bwd", "force", r"F_{y,\mathrm{bwd}}", "F<sub>y,bwd</sub>"),
        "yield force, backward",
    ),
    Quantity(
        *("beta", "dimensionless", r"\beta", "β", "shape of the unloading"), least=0.5, most=1.0
    ),
    Quantity("exponent", "dimensionless", "n", "n", "sharpness of the knee", least=1.0),
    Quantity("c", "damping", "c", "c", "viscous damping of Bouc-Wen hysteresis"),
)
