"""How long draws of a building take: 500 draws × six storeys × six dampers × El Centro.

    python -m benchmarks.response.speed DRAWS JOBS RECORD [PYTHON] > benchmarks/response/speed.txt

The six-storey building of the ground motions' README: floors of 100 kip, the roof 50 kip, and
326.32 kip/in in each storey; 2 % Rayleigh damping. Three-stage dampers with random parameters,
which slip at about 5 % of the weight above them. PYTHON is one (3.12 or later) with openseespy:
it has no such model, so it runs Bouc-Wen devices of the same slip forces.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.response import opensees
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.response.analysis import Analysis
from mfd_bayes.response.building import Building, building_of
from mfd_bayes.response.device_draws import Dampers
from mfd_bayes.response.ground import Ground, read_ground
from mfd_bayes.response.schema import Content
from tests.response.oscillators import three_stage_row

SOME = 10
WEIGHTS = (100.0, 100.0, 100.0, 100.0, 100.0, 50.0)


def six_storeys() -> Building:
    """The public building, with a damper in each storey."""
    storey = {"stiffness": "326.32 kip/in", "height": "144 in"}
    content = {
        "storey": [storey | {"weight": f"{weight} kip"} for weight in WEIGHTS],
        "damper": [{"storey": i, "actuation": "1 ksi"} for i in range(1, 7)],
    }
    return building_of(Content.model_validate(content), Path("six storeys"))


def dampers(draws: int, seed: int = 1) -> Dampers:
    """Three-stage dampers of every draw and storey."""
    rng = np.random.default_rng(seed)
    above = np.cumsum(WEIGHTS[::-1])[::-1]
    theta = np.array([[three_stage_row(rng, 0.05 * w) for w in above] for _ in range(draws)])
    return Dampers(ThreeStage(), theta, rng.random((draws, 6)), theta[..., 4])


def main(draws: int, jobs: int, record: Path, python: str | None = None) -> None:
    """Print the time and what it was spent on."""
    ground, drawn = read_ground(record), dampers(draws)
    begun, clock = _spent(), time.perf_counter()
    found = Analysis(six_storeys(), [ground], drawn).respond(jobs)
    spent, clock = _spent() - begun, time.perf_counter() - clock
    samples = ground.acceleration.size
    print(f"{draws} draws x 6 storeys x 6 dampers x {samples} samples, {jobs} jobs")
    print(f"processor {spent:.0f} s, so {spent / 2:.0f} s on two cores; clock {clock:.0f} s")
    print(f"all of it: without dampers and with plain friction too; load {os.getloadavg()[1]:.1f}")
    steps, count = np.unique(found.steps.round(6), return_counts=True)
    print(f"shortest step, s: draws  {dict(zip(steps.tolist(), count.tolist(), strict=True))}")
    print(f"not settled within 1 %: {int(found.unsettled.sum())}; ran away: {found.unstable.sum()}")
    print(f"largest energy not accounted for: {found.imbalance.max():.1e} of the input")
    if python is not None:
        _beside_opensees(drawn, ground, python, spent)


def _spent() -> float:
    """Processor time of this process and of those that it started and that ended, s."""
    both = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(resource.getrusage(who).ru_utime for who in both)


def _beside_opensees(drawn: Dampers, ground: Ground, python: str, spent: float) -> None:
    """Print the time of OpenSees for the same slip forces at the same steps."""
    with tempfile.TemporaryDirectory() as folder:
        values, slips = Path(folder) / "values.txt", Path(folder) / "slips.txt"
        np.savetxt(values, ground.acceleration / opensees.GRAVITY)
        np.savetxt(slips, drawn.slip[:SOME])
        words = [python, opensees.__file__, str(values), str(ground.step), "2,4", str(slips)]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    one = float(said.split()[-1])
    count = drawn.draws
    print("OpenSeesPy, Bouc-Wen devices of the same slip forces, at steps of 0.01 and 0.005 s:")
    print(
        f"{one:.2f} s of processor a draw ({SOME} draws); a loop over {count}: {count * one:.0f} s,"
    )
    print(f"{count * one / spent:.2f} times ours")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), *sys.argv[4:])
