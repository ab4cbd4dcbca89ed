"""Reinforcing steel after Giuffré, Menegotto and Pinto, with isotropic hardening (Filippou, 1983).

As OpenSees' Steel02 with R0 = 20 and a2 = a4 = 1. Between two turns of the strain the stress is a
closed formula, so that Python loops over turns only, and NumPy does all draws and samples at once.
"""

from itertools import pairwise

import numpy as np

import mfd_bayes as mb

R0 = 20.0


class Steel(mb.Model):
    name = "steel"
    motion, response, rate_independent = "strain", "stress, MPa", True
    parameters = (
        mb.Parameter("E", "MPa", meaning="Young's modulus"),
        mb.Parameter("fy", "MPa", symbol="f_y", meaning="yield strength"),
        mb.Parameter("b", meaning="hardening over Young's modulus"),
        mb.Parameter("cR1", symbol="c_{R1}", meaning="sharpness of the knee after a turn"),
        mb.Parameter("cR2", symbol="c_{R2}", meaning="strain in which the knee softens"),
        mb.Parameter("a1", symbol="a_1", meaning="isotropic hardening in compression"),
        mb.Parameter("a3", symbol="a_3", meaning="isotropic hardening in tension"),
    )

    def force(self, theta, trace):
        E, fy, b, cR1, cR2, a1, a3 = theta.T[:, :, None]  # (n, 1) each
        strain, ey, Eh = trace.displacement, fy / E, b * E
        steps = np.sign(np.diff(strain))
        moving = np.flatnonzero(steps)  # equal samples keep their direction
        turns = moving[:-1][np.diff(steps[moving]) != 0] + 1
        bounds = np.array([moving[0], *turns, strain.size - 1])
        # of every branch at once, (n, branches)
        begun, up = strain[bounds[:-1]], np.sign(np.diff(strain[bounds]))
        highest = np.maximum(ey, np.maximum.accumulate(begun))
        lowest = np.minimum(-ey, np.minimum.accumulate(begun))
        shift = 1.0 + np.where(up > 0, a3, a1) * ((highest - lowest) / (2.0 * ey)) ** 0.8
        shift[:, 0] = 1.0
        yields, plastic = up * shift * (fy - Eh * ey), np.where(up > 0, highest, lowest)
        stress = np.zeros((len(theta), strain.size))
        for k, (begin, end) in enumerate(pairwise(bounds.tolist())):
            start, base, at = begun[k], stress[:, [begin]], yields[:, [k]]
            knee = (at - base + E * start) / (E - Eh)
            xi = np.abs(plastic[:, [k]] - knee) / ey
            R = R0 * (1.0 - cR1 * xi / (cR2 + xi))
            x = (strain[begin + 1 : end + 1] - start) / (knee - start)
            with np.errstate(divide="ignore"):
                curve = x * np.exp(-np.log1p(np.exp(R * np.log(np.abs(x)))) / R)
            rise = (b * x + (1.0 - b) * curve) * (at + Eh * knee - base)
            stress[:, begin + 1 : end + 1] = base + rise
        return stress
