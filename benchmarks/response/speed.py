"""How long draws of a building take: 500 draws × six storeys × six dampers × El Centro.

    python -m benchmarks.response.speed DRAWS JOBS RECORD > benchmarks/response/speed.txt

The six-storey building of the ground motions' README: floors of 100 kip, the roof 50 kip, and
326.32 kip/in in each storey; 2 % Rayleigh damping. Three-stage dampers with random parameters,
which slip at about 5 % of the weight above them.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.response.cases import GRAVITY, three_stage_row
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.response.analysis import respond
from mfd_bayes.response.building import Building, Device
from mfd_bayes.response.damping import damping_matrix
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.ground import read_ground
from mfd_bayes.response.modes import modes_of
from mfd_bayes.response.schema import Damping, Limits
from mfd_bayes.response.settling import Accuracy
from mfd_bayes.response.structures import Skeleton

WEIGHTS = (100.0, 100.0, 100.0, 100.0, 100.0, 50.0)


def six_storeys() -> Building:
    """The public building, with a damper in each storey."""
    drifts = np.eye(6) - np.eye(6, k=-1)
    mass, springs = np.diag(WEIGHTS) / GRAVITY, np.full(6, 326.32)
    frame = Skeleton(
        *(mass, drifts.T @ np.diag(springs) @ drifts, 0 * mass, np.ones(6), drifts),
        *(np.full(6, 144.0), np.full(6, np.inf), springs),
    )
    damping = damping_matrix(Damping(), frame, modes_of(mass, frame.stiffness), "")
    devices = tuple(Device(f"storey {i}", i, i - 1, 1.0, "ksi") for i in range(1, 7))
    return Building(
        *("six storeys", mass, damping, frame.stiffness, frame.influence, drifts),
        *(frame.heights, frame.yields, springs, devices, Limits()),
    )


def dampers(draws: int, seed: int = 1) -> Dampers:
    """Three-stage dampers of every draw and storey."""
    rng = np.random.default_rng(seed)
    above = np.cumsum(WEIGHTS[::-1])[::-1]
    theta = np.array([[three_stage_row(rng, 0.05 * w) for w in above] for _ in range(draws)])
    return Dampers(ThreeStage(), theta, rng.random((draws, 6)), theta[..., 4])


def main(draws: int, jobs: int, record: Path) -> None:
    """Print the time and what it was spent on."""
    ground = read_ground(record)
    begun = time.perf_counter()
    found = respond(six_storeys(), [ground], dampers(draws), accuracy=Accuracy(), jobs=jobs)
    seconds = time.perf_counter() - begun
    size = (
        f"{draws} draws x 6 storeys x 6 dampers x {ground.acceleration.size} samples, {jobs} jobs"
    )
    steps, count = np.unique(found.steps.round(6), return_counts=True)
    print(f"{size}: {seconds:.1f} s, processor {time.process_time():.1f} s in this process")
    print(f"last step, s: draws  {dict(zip(steps.tolist(), count.tolist(), strict=True))}")
    print(f"not settled within 1 %: {int(found.unsettled.sum())}; ran away: {found.unstable.sum()}")
    print(f"largest energy not accounted for: {found.imbalance.max():.1e} of the input")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
