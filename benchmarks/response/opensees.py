"""The six-storey building with a Bouc-Wen device in each storey, in OpenSees; run by `beside.py`.

This file is run by a Python that has openseespy, which is no dependency of this project:

    PYTHON benchmarks/response/opensees.py RECORD STEP_S PARTS [SLIPS]

prints the largest drift of every storey, in. With SLIPS, a file of six slip forces a line, kip, and
PARTS such as 2,4, it prints the processor time of a line, s. It imports nothing of mfd_bayes.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

WEIGHTS = (100.0, 100.0, 100.0, 100.0, 100.0, 50.0)
GRAVITY, STIFFNESS = 386.09, 326.32


def device(storey: int, slip: float | None = None) -> tuple[float, float, float, float]:
    """Stiffness, share after yield, slip force and n of the device in a storey, from 0."""
    slip = 0.05 * sum(WEIGHTS[storey:]) if slip is None else slip
    return slip / 0.1, 0.02, slip, 1.5


def main(record: Path, step: float, parts: int, slips: list[float] | None = None) -> list[float]:
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
        k, alpha, slip, n = device(i, None if slips is None else slips[i])
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
    most = [0.0] * 6
    for _ in range(parts * (len(values) - 1)):
        if ops.analyze(1, step / parts) != 0:
            raise RuntimeError("OpenSees did not converge")
        x = [ops.nodeDisp(i, 1) for i in range(7)]
        most = [max(m, abs(x[i + 1] - x[i])) for i, m in enumerate(most)]
    return most


def timed(record: Path, step: float, parts: list[int], slips: Path) -> float:
    """Processor time of one line of slip forces, s, at all numbers of parts of a step."""
    lines = [[float(w) for w in line.split()] for line in slips.read_text().splitlines()]
    begun = time.process_time()
    for line in lines:
        for number in parts:
            main(record, step, number, line)
    return (time.process_time() - begun) / len(lines)


if __name__ == "__main__":
    given = Path(sys.argv[1]), float(sys.argv[2])
    several = [int(word) for word in sys.argv[3].split(",")]
    if len(sys.argv) > 4:
        print(timed(*given, several, Path(sys.argv[4])))
    else:
        print(*main(*given, several[0]))
