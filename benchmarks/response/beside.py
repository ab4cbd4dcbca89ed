"""Largest drifts beside OpenSees: six storeys, a Bouc-Wen device in each, El Centro.

    python -m benchmarks.response.beside RECORD PYTHON > benchmarks/response/beside.txt

PYTHON is one (3.12 or later) in whose environment openseespy was installed.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.response import opensees
from benchmarks.response.speed import six_storeys
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.response.device_draws import Dampers
from mfd_bayes.response.ground import read_ground
from mfd_bayes.response.step_refinement import Accuracy, settle

PARTS = 20


def main(record: Path, python: str) -> None:
    """Print both, and how they differ."""
    rows = []
    for i in range(6):
        k, alpha, slip, n = opensees.device(i)
        rows.append([k, alpha, slip, slip, 0.6, n, 0.0])
    theta = np.array(rows)[None]
    dampers = Dampers(BoucWen(), theta, np.full((1, 6), 0.5), theta[..., 2])
    building = six_storeys()
    undamped = replace(building, damping=0.0 * building.damping)
    ground = read_ground(record)
    begun = time.process_time()
    ours = settle(undamped, ground, dampers, Accuracy())
    seconds = time.process_time() - begun
    with tempfile.TemporaryDirectory() as folder:
        values = Path(folder) / "values.txt"
        values.write_text("\n".join(f"{a / opensees.GRAVITY:.12g}" for a in ground.acceleration))
        words = [python, opensees.__file__, str(values), str(ground.step), str(PARTS)]
        begun = time.perf_counter()
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    theirs = np.array([float(word) for word in said.split()[-6:]])
    print("six storeys, a Bouc-Wen device in each, no other damping, El Centro; largest drift, in")
    print(f"{'storey':>8s}{'ours':>10s}{'OpenSees':>10s}{'apart':>9s}")
    for i, (a, b) in enumerate(zip(ours.drift[0, 0], theirs, strict=True), start=1):
        print(f"{i:8d}{a:10.4f}{b:10.4f}{100 * (a / b - 1):8.3f}%")
    print(f"ours: shortest step {ours.steps[0, 0]:g} s, processor {seconds:.1f} s for one draw")
    took = time.perf_counter() - begun
    print(f"OpenSees: step {ground.step / PARTS:g} s, {took:.1f} s by the clock")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
