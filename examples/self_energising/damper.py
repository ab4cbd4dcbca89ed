"""A friction damper whose limit follows the force of its own anchor.

    model = "damper.py:SelfEnergising"

in a campaign beside this file, with `priors.toml`. The device is a spring G(z) with a gap whose end
is damped, f = G(z) + c dz/dt, and slips where f reaches F (1 − β) + β |G|: in steady slip that is
F, and after the gap has closed at speed v up to c v more, which fades within c/((1 − β) k). A step
is exponential in the local stiffness, hence stable at any length, and of first order.
"""

import numpy as np
from scipy.special import expit

import mfd_bayes as mb


class SelfEnergising(mb.Model):
    name = "self_energising"
    has_gap = True
    parameters = (
        mb.Parameter("k_f", "kip/in", meaning="stiffness of build-up, forward"),
        mb.Parameter("k_b", "kip/in", meaning="stiffness of build-up, backward"),
        mb.Parameter("width", "in", meaning="width of the gap"),
        mb.Parameter("rounding", "in", meaning="length over which the gap closes"),
        mb.Parameter("k_gap", "kip/in", meaning="stiffness in the gap"),
        mb.Parameter("F_f", "kip", follows_actuation="power", meaning="slip force, forward"),
        mb.Parameter("F_b", "kip", follows_actuation="power", meaning="slip force, backward"),
        mb.Parameter("damping", "kip*s/in", meaning="damping of the spring's end"),
        mb.Parameter("beta_f", prior="fraction", meaning="share of F from the anchor, forward"),
        mb.Parameter("beta_b", prior="fraction", meaning="share of F from the anchor, backward"),
    )

    def force(self, theta, trace, scales, start):
        """Force along a record, (n, T), kip."""
        low, high = self.ends(theta.T)
        state = {"theta": theta.T, "z": low + start * (high - low)}
        forces = np.empty((len(theta), trace.samples))
        steps, lengths = np.diff(trace.displacement), np.diff(trace.time)
        forces[:, 0] = self.spring(state["theta"], state["z"])[0]
        for k, (way, dt) in enumerate(zip(steps, lengths, strict=True), 1):
            now = {name: factor[:, k % factor.shape[1]] for name, factor in scales.items()}
            forces[:, k], state = self.slide(state, way, dt, now)
        return forces

    def start(self, theta):
        """A device in the middle of its gap, where the spring bears nothing."""
        zero = np.zeros(len(theta))
        return {"theta": theta.T, "z": zero, "x": zero}

    def step(self, state, displacement, velocity, dt, scales):
        """Force after a step, (n,), kip, and the new state."""
        if np.all(dt == 0.0):
            return self.spring(state["theta"], state["z"])[0], state | {"x": displacement}
        force, after = self.slide(state, displacement - state["x"], dt, scales)
        return force, after | {"x": displacement}

    def slide(self, state, way, dt, scales):
        """Force after a way, in, in the time dt, s, and the state with the new deflection."""
        _, _, _, _, _, forward, backward, damping, beta_f, beta_b = state["theta"]
        forward, backward = forward * scales["F_f"], backward * scales["F_b"]
        force, stiffness = self.spring(state["theta"], state["z"])

        def limits(force):
            up = forward * (1 - beta_f) + beta_f * np.maximum(force, 0.0)
            return -backward * (1 - beta_b) + beta_b * np.minimum(force, 0.0), up

        rate = dt * stiffness * (1 - np.where(force > 0, beta_f, beta_b)) / damping
        reach = dt / damping * np.where(rate > 1e-6, -np.expm1(-rate) / np.maximum(rate, 1e-6), 1.0)
        down, up = limits(force)
        moved = np.clip(way, (down - force) * reach, (up - force) * reach)
        z = state["z"] + moved
        force, _ = self.spring(state["theta"], z)
        return np.clip(force + damping * moved / dt, *limits(force)), state | {"z": z}

    @staticmethod
    def spring(theta, z):
        """Force, kip, and stiffness, kip/in, of the spring with a gap at deflections z, in."""
        k_f, k_b, width, rounding, k_gap, *_ = theta
        ahead, behind = (z - width / 2) / rounding, -(z + width / 2) / rounding
        force = k_f * rounding * np.logaddexp(0, ahead) - k_b * rounding * np.logaddexp(0, behind)
        return force + k_gap * z, k_f * expit(ahead) + k_b * expit(behind) + k_gap

    @staticmethod
    def ends(theta):
        """Deflections, in, between which a motion may begin."""
        k_f, k_b, width, _, _, forward, backward, *_ = theta
        return -width / 2 - backward / k_b, width / 2 + forward / k_f
