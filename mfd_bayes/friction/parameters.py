"""The quantities of the models: what their parameters measure, and what is sampled for them."""

from __future__ import annotations

from types import MappingProxyType

from mfd_bayes.friction.quantity import Quantity

PARAMETERS = (
    "sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd",
    "k2", "k3", "d2", "d3", "gamma1", "gamma2", "v_s",
)  # fmt: skip
"""All parameters of the MFD paper, in its order."""

BACKLASH = (
    "k_fwd", "k_bwd", "gap", "ell", "k_0", "Fc_fwd", "Fc_bwd", "n", "sigma2",
    "static_excess_fwd", "static_excess_bwd", "v_s",
)  # fmt: skip
"""Parameters of LuGre with a backlash spring, in the order of model.md section 9."""

BOUC_WEN = ("k", "alpha", "Fy_fwd", "Fy_bwd", "beta", "exponent", "c")
"""Parameters of Bouc-Wen hysteresis."""

STATIC = MappingProxyType(
    {"Fs_fwd": ("Fc_fwd", "static_excess_fwd"), "Fs_bwd": ("Fc_bwd", "static_excess_bwd")}
)
"""F_s = F_c (1 + excess), so that F_s ≥ F_c holds: kinetic friction and excess of each F_s."""

_SIDES = {"fwd": "forward", "bwd": "backward"}

# name, kind, symbol, meaning; in the order in which they are sampled
_TABLE = (
    ("sigma0", "stiffness", r"\sigma_0", "aggregate bristle stiffness"),
    ("sigma1", "damping", r"\sigma_1", "micro-damping"),
    ("sigma2", "damping", r"\sigma_2", "viscous friction"),
    *(
        (f"Fc_{s}", "force", rf"F_{{c,\mathrm{{{s}}}}}", f"kinetic friction, {side}")
        for s, side in _SIDES.items()
    ),
    *(
        (
            f"static_excess_{s}",
            "dimensionless",
            rf"F_s/F_c - 1,\ \mathrm{{{s}}}",
            f"excess of static over kinetic friction, {side}",
        )
        for s, side in _SIDES.items()
    ),
    ("k2", "stiffness", "k_2", "stiffness of stage 2"),
    ("k3", "stiffness", "k_3", "stiffness of stage 3"),
    ("d2", "displacement", "d_2", "drum travel of stage 2"),
    ("d3", "displacement", "d_3", "drum travel of stage 3"),
    ("ell", "displacement", r"\ell", "transition length, γ2/γ1 of the three stages"),
    ("gamma1", "dimensionless", r"\gamma_1", "transition constant"),
    ("v_s", "velocity", r"\dot x_s", "Stribeck velocity"),
    *(
        (f"Fs_{s}", "force", rf"F_{{s,\mathrm{{{s}}}}}", f"static friction, {side}")
        for s, side in _SIDES.items()
    ),
    ("gamma2", "displacement", r"\gamma_2", "transition constant"),
    *(
        (f"k_{s}", "stiffness", rf"k_\mathrm{{{s}}}", f"stiffness beyond the gap, {side}")
        for s, side in _SIDES.items()
    ),
    ("gap", "displacement", "D", "width of the gap"),
    ("k_0", "stiffness", "k_0", "stiffness inside the gap"),
    ("n", "dimensionless", "n", "how sharply slip sets in"),
    ("k", "stiffness", "k", "stiffness of Bouc-Wen hysteresis"),
    ("alpha", "dimensionless", r"\alpha", "share of the stiffness that remains in slip"),
    *(
        (f"Fy_{s}", "force", rf"F_{{y,\mathrm{{{s}}}}}", f"yield force, {side}")
        for s, side in _SIDES.items()
    ),
    ("beta", "dimensionless", r"\beta", "shape of the unloading"),
    ("exponent", "dimensionless", "n", "sharpness of the knee"),
    ("c", "damping", "c", "viscous damping of Bouc-Wen hysteresis"),
)
_LEAST = {"n": 1.0, "beta": 0.5, "exponent": 1.0}
_MOST = {"alpha": 1.0, "beta": 1.0}


_HTML = {f"static_excess_{s}": f"(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>{s}</sub>" for s in _SIDES}

_QUANTITIES = {
    name: Quantity(
        *(name, kind, maths, _HTML.get(name, ""), meaning),
        least=_LEAST.get(name, 0.0),
        most=_MOST.get(name, float("inf")),
        sampled=name not in (*STATIC, "gamma2"),
    )
    for name, kind, maths, meaning in _TABLE
}


def quantities_of(parameters: tuple[str, ...]) -> tuple[Quantity, ...]:
    """Quantities of some parameters, and what is sampled in their place."""
    names = {*parameters, *(name for p in parameters for name in STATIC.get(p, ()))}
    if "gamma2" in names:
        names.add("ell")
    return tuple(quantity for name, quantity in _QUANTITIES.items() if name in names)


def quantities_in_order(parameters: tuple[str, ...]) -> tuple[Quantity, ...]:
    """Quantities of parameters that are all sampled, in their own order."""
    return tuple(_QUANTITIES[name] for name in parameters)
