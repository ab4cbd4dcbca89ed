"""A storey in OpenSees with the calibrated damper, stepped by the exported C in a user's loop.

    mfd-bayes export out --to c --actuation "1000 psi" -o damper
    PYTHON examples/opensees/storey.py damper GROUND.AT2 0.02 --parts 20

PYTHON is one that has openseespy; neither mfd_bayes nor numpy is needed there, but a compiler of C.
Prints the largest drift, in, with each parameter set. The damper is a load on the storey: in each
step its force is predicted at the place and speed that the storey would reach by its acceleration,
OpenSees takes the step, and the damper follows to where the storey is. Nothing is iterated, so
that the building may be any model of OpenSees; the error falls with the step.
"""

from __future__ import annotations

import argparse
import ctypes
import re
import subprocess
import sys
import tempfile
from math import sqrt
from pathlib import Path

WEIGHT, STIFFNESS, RATIO, GRAVITY = 20.0, 8.0, 0.02, 386.0886  # kip, kip/in, damping ratio, in/s²


class Damper:
    """The device of an exported folder with a parameter set, in kip, in, s."""

    def __init__(self, library: ctypes.CDLL, name: str, direction: int) -> None:
        library.damper_find.restype = ctypes.c_void_p
        library.damper_step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 4]
        self.step = library.damper_step
        self.device = ctypes.create_string_buffer(library.damper_size())
        self.state = ctypes.create_string_buffer(library.damper_state_size())
        found = ctypes.c_void_p(library.damper_find(name.encode()))
        if library.damper_prepare(self.device, found):
            raise SystemExit(f"there is no set {name!r}")
        library.damper_start(self.state, self.device, direction)

    def force(self, state: ctypes.Array, step: float, x: float, v: float, p: float) -> float:
        """Force at the next sample; the state goes there."""
        if (code := self.step(state, step, x, v, p)) < 0:
            raise SystemExit(f"the damper refuses a step with the code {code}")
        return ctypes.c_double.from_buffer(state, 8).value  # after the pointer to the device

    def trial(self, step: float, x: float, v: float, p: float) -> float:
        """Force at a sample to which the damper does not go yet."""
        copy = ctypes.create_string_buffer(self.state.raw, len(self.state))
        return self.force(copy, step, x, v, p)


def compiled(folder: Path) -> ctypes.CDLL:
    """The exported C as a library."""
    sources = [str(folder / name) for name in ("damper.c", "damper_sets.c", "shared.c")]
    with tempfile.TemporaryDirectory() as place:
        library = Path(place) / "damper.so"
        flags = ["-std=c99", "-O2", "-shared", "-fPIC"]
        subprocess.run(["cc", *flags, *sources, "-o", str(library), "-lm"], check=True)
        return ctypes.CDLL(str(library))


def drift(damper: Damper, values: list[float], step: float, parts: int, actuation: float) -> float:
    """Largest drift of the storey, in, under accelerations in in/s² with a step in s."""
    import openseespy.opensees as ops

    mass, size = WEIGHT / GRAVITY, step / parts
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for node in (1, 2):
        ops.node(node, 0.0)
    ops.fix(1, 1)
    ops.mass(2, mass)
    damping = 2.0 * RATIO * sqrt(STIFFNESS * mass)
    ops.uniaxialMaterial("Elastic", 1, STIFFNESS, damping)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.timeSeries("Path", 1, "-dt", step, "-values", *values)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.timeSeries("Constant", 2)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.algorithm("Linear")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient", "-noWarnings")
    x = v = peak = 0.0
    a = -values[0]
    rest = damper.force(damper.state, 0.0, 0.0, 0.0, actuation)
    for _ in range(parts * (len(values) - 1)):
        ahead = x + size * v + 0.5 * size**2 * a, v + size * a
        load = rest - damper.trial(size, *ahead, actuation)
        ops.remove("loadPattern", 2)
        ops.pattern("Plain", 2, 2)
        ops.load(2, load)
        if ops.analyze(1, size) != 0:
            raise SystemExit("OpenSees did not converge")
        x, v, a = ops.nodeDisp(2, 1), ops.nodeVel(2, 1), ops.nodeAccel(2, 1)
        damper.force(damper.state, size, x, v, actuation)
        peak = max(peak, abs(x))
    return peak


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of mfd-bayes export OUT --to c")
    parser.add_argument("ground", type=Path, help="a file of accelerations, in g")
    parser.add_argument("step", type=float, help="of the file, in s")
    parser.add_argument("--sets", nargs="+", default=["nominal", "lower", "upper"])
    parser.add_argument("--actuation", type=float, default=1.0, help="in ksi, or kip")
    parser.add_argument("--parts", type=int, default=20, help="steps for each of the file's")
    options = parser.parse_args()
    number = re.compile(r"\s*[-+\d.eE]+")
    lines = options.ground.read_text().splitlines()
    rows = [line.split() for line in lines if all(map(number.fullmatch, line.split()))]
    values = [float(word) * GRAVITY for row in rows for word in row]
    library = compiled(options.folder)
    first = next(value for value in values if value)
    for name in options.sets:
        damper = Damper(library, name, -1 if first > 0 else 1)
        largest = drift(damper, values, options.step, options.parts, options.actuation)
        sys.stdout.write(f"{name} {largest:.9g}\n")


if __name__ == "__main__":
    main()
