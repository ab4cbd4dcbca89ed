"""The six-storey building with a Bouc-Wen device in each storey, in OpenSees, run by run.py.

This file is run by a Python that has openseespy, which is no dependency of this project:

    PYTHON benchmarks/response/opensees.py RECORD STEP_S PARTS

prints the largest drift of every storey, in. It imports nothing of mfd_bayes.
"""

from __future__ import annotations

import sys
from pathlib import Path

WEIGHTS = (100.0, 100.0, 100.0, 100.0, 100.0, 50.0)
GRAVITY, STIFFNESS = 386.09, 326.32


def device(storey: int) -> tuple[float, float, float, float]:
    """Stiffness, share after yield, slip force and n of the device in a storey, from 0."""
    slip = 0.05 * sum(WEIGHTS[storey:])
    return slip / 0.1, 0.02, slip, 1.5


def main(record: Path, step: float, substeps: int) -> list[float]:
    """Largest drifts of the storeys, in."""
    import openseespy.opensees as ops

    values = [float(word) for word in record.read_text().split()]
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for i in range(7):
        ops.node(i, 0.0)
    ops.fix(0, 1)
    for i, weight in enumerate(WEIGHTS):
        ops.mass(i + 1, weight / GRAVITY)
        k, alpha, slip, n = device(i)
        ops.uniaxialMaterial("Elastic", 2 * i + 1, STIFFNESS)
        scale = (k / slip) ** n
        shape = (0.4 * scale, 0.6 * scale, 1.0, 0.0, 0.0, 0.0)
        ops.uniaxialMaterial("BoucWen", 2 * i + 2, alpha, k, n, *shape)
        for tag in (2 * i + 1, 2 * i + 2):
            ops.element("zeroLength", tag, i, i + 1, "-mat", tag, "-dir", 1)
    ops.timeSeries("Path", 1, "-dt", step, "-values", *values, "-factor", GRAVITY)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.test("NormDispIncr", 1e-10, 100)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    peaks = [0.0] * 6
    for _ in range(substeps * (len(values) - 1)):
        if ops.analyze(1, step / substeps) != 0:
            raise RuntimeError("OpenSees did not converge")
        x = [ops.nodeDisp(i, 1) for i in range(7)]
        peaks = [max(m, abs(x[i + 1] - x[i])) for i, m in enumerate(peaks)]
    return peaks


if __name__ == "__main__":
    print(*main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])))
