"""`SelfEnergising` of mechanisms.py in C, so that a whole calibration takes minutes, not a night.

    model = "compiled.py:SelfEnergising"

A C compiler is needed. `benchmarks.slip.bands` compares it with mechanisms.py before it begins.
"""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import mfd_bayes as mb

SOURCE = r"""
#include <math.h>
static double side(double a, double *share) {
  if (a < -30) return *share = 0;
  double e = exp(-fabs(a));
  *share = (a > 0 ? 1 : e) / (1 + e);
  return (a > 0 ? a : 0) + log1p(e);
}
static double spring(const double *p, double z, double *stiffness) {
  double ahead, behind, a = side((z - p[2] / 2) / p[3], &ahead);
  double b = side(-(z + p[2] / 2) / p[3], &behind);
  *stiffness = p[0] * ahead + p[1] * behind + p[4];
  return p[0] * p[3] * a - p[1] * p[3] * b + p[4] * z;
}
static double clip(double a, double low, double high) {
  return a < low ? low : a > high ? high : a;
}
void along(int n, int samples, int substeps, const double *x, const double *t,
           const double *theta, const double *start, double *force) {
  for (int i = 0; i < n; i++) {
    const double *p = theta + 14 * i;
    double low = -p[2] / 2 - p[6] / p[1], high = p[2] / 2 + p[5] / p[0], k;
    double z = low + start[i] * (high - low), g = spring(p, z, &k), f = g;
    double *out = force + (long)samples * i;
    out[0] = g;
    for (int j = 1; j < samples; j++) {
      double h = (t[j] - t[j - 1]) / substeps, v = (x[j] - x[j - 1]) / (t[j] - t[j - 1]);
      double e = exp(-v * v / (p[10] * p[10]));
      double forward = p[5] * (1 + p[8] * e), backward = p[6] * (1 + p[9] * e);
      for (int s = 0; s < substeps; s++) {
        double up = forward * (1 - p[12]) + p[12] * fmax(g, 0);
        double down = -backward * (1 - p[13]) + p[13] * fmin(g, 0);
        double rate = h * k * (1 - (g > 0 ? p[12] : p[13])) / p[11];
        double reach = h / p[11] * (rate > 1e-6 ? -expm1(-rate) / rate : 1);
        double way = clip(v * h, (down - g) * reach, (up - g) * reach);
        z += way;
        g = spring(p, z, &k);
        up = forward * (1 - p[12]) + p[12] * fmax(g, 0);
        down = -backward * (1 - p[13]) + p[13] * fmin(g, 0);
        f = clip(g + p[11] * way / h, down, up);
      }
      out[j] = f + p[7] * v;
    }
  }
}
"""
SUBSTEPS = 2


def compiled():
    """The function `along`."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "slip.so"
        words = ["cc", "-O2", "-shared", "-fPIC", "-x", "c", "-", "-lm", "-o", str(library)]
        subprocess.run(words, input=SOURCE, text=True, check=True)
        return ctypes.CDLL(str(library)).along


ALONG = compiled()


class SelfEnergising(mb.Model):
    name = "self_energising"
    has_gap = True
    parameters = (
        mb.Parameter("k_f", "kip/in"),
        mb.Parameter("k_b", "kip/in"),
        mb.Parameter("width", "in"),
        mb.Parameter("rounding", "in"),
        mb.Parameter("k_gap", "kip/in"),
        mb.Parameter("F_f", "kip", follows_actuation="power"),
        mb.Parameter("F_b", "kip", follows_actuation="power"),
        mb.Parameter("drag", "kip*s/in"),
        mb.Parameter("e_f", prior="fraction"),
        mb.Parameter("e_b", prior="fraction"),
        mb.Parameter("v_0", "in/s"),
        mb.Parameter("damping", "kip*s/in"),
        mb.Parameter("beta_f", prior="fraction"),
        mb.Parameter("beta_b", prior="fraction"),
    )

    def force(self, theta, trace, scales, start):
        """Force along a record, (n, T), kip; a constant actuation alone."""
        theta = np.array(theta, order="C")
        for name, column in (("F_f", 5), ("F_b", 6)):
            theta[:, column] *= scales[name][:, 0]
        x, t, start = (
            np.ascontiguousarray(a, dtype=float) for a in (trace.displacement, trace.time, start)
        )
        force = np.empty((len(theta), trace.samples))
        arrays = [a.ctypes.data_as(ctypes.c_void_p) for a in (x, t, theta, start, force)]
        ALONG(len(theta), trace.samples, SUBSTEPS, *arrays)
        return force
