"""How slip begins behind a spring with a gap: eight mechanisms, each a model of the user's own.

    model = "mechanisms.py:SelfEnergising"

in a campaign beside this file. All share the spring G(z) and the slip force of `backlash`
(docs/pages/model.md), z being the deflection of what bends before the device slips. `Exponent` is
`backlash` itself, as a check. A step is exponential in the local stiffness, hence stable at any
length; it is of first order.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

import mfd_bayes as mb

Parameter = mb.Parameter
SPRING = (
    Parameter("k_f", "kip/in", meaning="stiffness of build-up, forward"),
    Parameter("k_b", "kip/in", meaning="stiffness of build-up, backward"),
    Parameter("width", "in", meaning="width of the gap"),
    Parameter("rounding", "in", meaning="length over which the gap closes"),
    Parameter("k_gap", "kip/in", meaning="stiffness in the gap"),
    Parameter("F_f", "kip", follows_actuation="power", meaning="slip force, forward"),
    Parameter("F_b", "kip", follows_actuation="power", meaning="slip force, backward"),
    Parameter("drag", "kip*s/in", meaning="viscous friction"),
)
STATIC = (
    Parameter("e_f", meaning="excess of static friction, forward"),
    Parameter("e_b", meaning="excess of static friction, backward"),
)
STRIBECK = (*STATIC, Parameter("v_0", "in/s", meaning="velocity at which the excess fades"))
SHARPNESS = Parameter("sharpness", meaning="exponent of the onset of slip")
DAMPING = Parameter("damping", "kip*s/in", meaning="damping of the band's end")
CONTACT = Parameter("damping", "s/in", meaning="damping over the spring's force")
FEEDBACK = (
    Parameter("beta_f", prior="fraction", meaning="share of friction from the anchor, forward"),
    Parameter("beta_b", prior="fraction", meaning="share of friction from the anchor, backward"),
)
WRAP = Parameter("wrap", meaning="friction coefficient times the angle of wrap")
SUBSTEPS = 2  # of a sample
SMALL = 1e-6


def fading(x):
    """(1 − e^−x)/x of x ≥ 0: what is left of a rate over a step in which it decays."""
    return np.where(x > SMALL, -np.expm1(-x) / np.maximum(x, SMALL), 1.0)


def spring(c, z):
    """Force G, kip, and stiffness, kip/in, of the spring at deflections z, in."""
    ahead, behind = (z - c["width"] / 2) / c["rounding"], -(z + c["width"] / 2) / c["rounding"]
    forward, backward = c["k_f"] * c["rounding"], c["k_b"] * c["rounding"]
    force = forward * np.logaddexp(0, ahead) - backward * np.logaddexp(0, behind) + c["k_gap"] * z
    return force, c["k_f"] * expit(ahead) + c["k_b"] * expit(behind) + c["k_gap"]


class Mechanism(mb.Model):
    """What all have in common; one of them gives `parameters` and `slide`."""

    has_gap = True

    def excess(self, c, state, slip_speed, h):
        """Excess of static friction over kinetic, as a share of its largest."""
        return np.exp(-np.square(slip_speed / c["v_0"]))

    def limits(self, c, state, velocity, h):
        """Slip forces forward and backward, (n,) each, kip."""
        share = self.excess(c, state, velocity, h)
        return c["F_f"] * (1 + c["e_f"] * share), c["F_b"] * (1 + c["e_b"] * share)

    def begin(self, c, start):
        """State at the first sample: the deflection at a share of its range."""
        low, high = -c["width"] / 2 - c["F_b"] / c["k_b"], c["width"] / 2 + c["F_f"] / c["k_f"]
        return {
            "z": low + start * (high - low),
            "slip": np.zeros_like(start),
            "rest": 1.0 + 0 * low,
        }

    def along(self, c, displacement, time, start):
        """Force, (T, n), kip, where every column may have a motion of its own, (T, n or 1)."""
        state, forces = self.begin(c, start), np.empty((len(displacement), start.size))
        forces[0] = spring(c, state["z"])[0]
        steps, lengths = np.diff(displacement, axis=0), np.diff(time, axis=0) / SUBSTEPS
        for k, (way, h) in enumerate(zip(steps, lengths, strict=True)):
            velocity = way / (SUBSTEPS * h)
            for _ in range(SUBSTEPS):
                state, forces[k + 1] = self.slide(c, state, velocity, h)
            forces[k + 1] += c["drag"] * velocity
        return forces

    def force(self, theta, trace, scales, start):
        """Force along a record, (n, T), kip; a constant actuation alone."""
        c = dict(zip(self.parameters, theta.T, strict=True))
        c |= {name: c[name] * np.ravel(factor)[0] for name, factor in scales.items()}
        return self.along(c, trace.displacement[:, None], trace.time[:, None], start).T


class Exponent(Mechanism):
    """Slip sets in with a power of the force: `backlash`. dz/dx = 1 − (G/g)^n under load."""

    name = "exponent"
    parameters = (*SPRING, *STRIBECK, SHARPNESS)

    def slide(self, c, state, velocity, h):
        z, n = state["z"], c["sharpness"]
        force, stiffness = spring(c, z)
        forward, backward = self.limits(c, state, velocity, h)
        load = np.abs(force) / np.where(force > 0, forward, backward)
        slip = np.where(velocity * force > 0, np.minimum(load, 1.5) ** n, 0.0)
        rate = np.abs(velocity) * n * slip * stiffness / np.maximum(np.abs(force), SMALL)
        z = z + velocity * (1 - slip) * h * fading(rate * h)
        return self.remember(c, state | {"z": z}, velocity * slip, h), spring(c, z)[0]

    def remember(self, c, state, slip_velocity, h):
        """State after a step, with what friction keeps of it."""
        return state


class Lagging(Exponent):
    """Friction follows the velocity of slip after a delay (Hess and Soom, 1990)."""

    name = "lagging"
    parameters = (*SPRING, *STRIBECK, SHARPNESS, Parameter("delay", "s"))

    def excess(self, c, state, slip_speed, h):
        return super().excess(c, state, state["slip"], h)

    def remember(self, c, state, slip_velocity, h):
        share = -np.expm1(-h / c["delay"])
        return state | {"slip": state["slip"] + share * (np.abs(slip_velocity) - state["slip"])}


class Healing(Exponent):
    """Friction gains strength at rest, and loses it over a length of slip (Dieterich, 1979)."""

    name = "healing"
    parameters = (
        *SPRING,
        *STATIC,
        SHARPNESS,
        Parameter("healing_time", "s"),
        Parameter("wear_in", "in", meaning="length of slip over which the strength is lost"),
    )

    def excess(self, c, state, slip_speed, h):
        return state["rest"]

    def remember(self, c, state, slip_velocity, h):
        heal, wear = 1 / c["healing_time"], np.abs(slip_velocity) / c["wear_in"]
        end = heal / (heal + wear)
        return state | {"rest": end + (state["rest"] - end) * np.exp(-h * (heal + wear))}


class Damped(Mechanism):
    """The band's end is damped: f = G + c ż, and slips at a limit F(1 − β) + β|G|; here β = 0."""

    name = "damped"
    parameters = (*SPRING, *STRIBECK, DAMPING)

    def shares(self, c):
        """β forward and backward."""
        return 0.0, 0.0

    def resistance(self, c, force):
        """Damping of the band's end, kip s/in."""
        return c["damping"]

    def slide(self, c, state, velocity, h):
        z = state["z"]
        force, stiffness = spring(c, z)
        forward, backward = self.limits(c, state, velocity, h)
        beta_f, beta_b = self.shares(c)
        damping = self.resistance(c, force)

        def limit(force):
            up = forward * (1 - beta_f) + beta_f * np.maximum(force, 0.0)
            return up, -backward * (1 - beta_b) + beta_b * np.minimum(force, 0.0)

        up, down = limit(force)
        rate = stiffness * (1 - np.where(force > 0, beta_f, beta_b)) / damping
        reach = h * fading(rate * h) / damping
        most, least = (up - force) * reach, (down - force) * reach
        way = np.clip(velocity * h, least, most)
        z = z + way
        force = spring(c, z)[0]
        up, down = limit(force)
        return state | {"z": z}, np.clip(force + self.resistance(c, force) * way / h, down, up)


class SelfEnergising(Damped):
    """The limit follows the force of the anchor, by a share in each direction."""

    name = "self_energising"
    parameters = (*SPRING, *STRIBECK, DAMPING, *FEEDBACK)

    def shares(self, c):
        return c["beta_f"], c["beta_b"]


class Wrapped(Damped):
    """The same share both ways, of a band wrapped around a drum: β = 1 − e^{−μφ}."""

    name = "wrapped"
    parameters = (*SPRING, *STRIBECK, DAMPING, WRAP)

    def shares(self, c):
        share = -np.expm1(-c["wrap"])
        return share, share


class Contact(Damped):
    """Damping in proportion to the force of contact (Hunt and Crossley, 1975)."""

    name = "contact"
    parameters = (*SPRING, *STRIBECK, CONTACT)

    def resistance(self, c, force):
        return c["damping"] * np.abs(force) + 1e-4


class ContactSelf(Contact):
    """Damping in proportion to the force, and a limit that follows the anchor."""

    name = "contact_self"
    parameters = (*SPRING, *STRIBECK, CONTACT, *FEEDBACK)

    def shares(self, c):
        return c["beta_f"], c["beta_b"]


ALL = (Exponent, Lagging, Healing, Damped, SelfEnergising, Wrapped, Contact, ContactSelf)
