"""Are buildings with dampers stepped exactly, and how long do draws take?

    python -m benchmarks.response.run [--opensees PYTHON]

takes a quarter of an hour (--quick: half a minute). Three tables: random buildings of one storey
with each model beside solve_ivp (rtol 1e-9; cases.txt); six storeys with a Bouc-Wen device in each
and no other damping beside OpenSees, where PYTHON is one in whose environment openseespy was
installed (beside.txt); the time of 500 draws of the six storeys with three-stage dampers that slip
at 5 % of the weight above them, in El Centro of --data (speed.txt). Exit status 1: a peak is more
than 0.5 % off solve_ivp's.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import os
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.response import opensees
from benchmarks.response.oscillators import CASES, errors_of, three_stage_row
from mfd_bayes.applications.buildings.building import Content, building_of
from mfd_bayes.applications.buildings.dampers import Dampers
from mfd_bayes.applications.buildings.ground import read_ground
from mfd_bayes.applications.buildings.time_integration import response_of, settle
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.three_stage import ThreeStage

PARTS = 20


def cases(count):
    """Print a table of errors over random cases; which are too large."""
    print(f"{count} random oscillators each; error of the peak over solve_ivp's (rtol 1e-9)")
    heads = ("model", "travel median", "travel worst", "force median", "force worst")
    print("".join(f"{h:>15s}" for h in heads))
    failed = []
    for name in CASES:
        errors = np.array([errors_of(name, seed, 300) for seed in range(count)])
        cells = [f(errors[:, k]) for k in (0, 1) for f in (np.median, np.max)]
        print(f"{name:>15s}" + "".join(f"{100 * c:14.4f}%" for c in cells), flush=True)
        if errors.max() > 0.005:
            failed.append(f"{name}: {100 * errors.max():.2f} % off solve_ivp")
    return failed


def six_storeys():
    """The building of the ground motions' README, with a damper in each storey."""
    storey = {"stiffness": f"{opensees.STIFFNESS} kip/in", "height": "144 in"}
    content = {
        "storey": [storey | {"weight": f"{weight} kip"} for weight in opensees.WEIGHTS],
        "damper": [{"storey": i, "actuation": "1 ksi"} for i in range(1, 7)],
    }
    return building_of(Content.model_validate(content), Path("six storeys"))


def beside_opensees(ground, python):
    """Print the largest drifts of ours and of OpenSees."""
    devices = [opensees.device(i) for i in range(6)]
    theta = np.array([[k, alpha, slip, slip, 0.6, n, 0.0] for k, alpha, slip, n in devices])[None]
    dampers = Dampers(BoucWen(), theta, np.full((1, 6), 0.5), theta[..., 2])
    building = six_storeys()
    undamped = replace(building, damping=0.0 * building.damping)
    ours = settle(undamped, ground, dampers)
    with tempfile.TemporaryDirectory() as folder:
        values = Path(folder) / "values.txt"
        np.savetxt(values, ground.acceleration / opensees.GRAVITY)
        words = [python, opensees.__file__, str(values), str(ground.step), str(PARTS)]
        output = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    theirs = [float(word) for word in output.split()[-6:]]
    print("\nsix storeys, a Bouc-Wen device in each, no other damping; largest drift, in")
    print(f"{'storey':>8s}{'ours':>10s}{'OpenSees':>10s}{'apart':>9s}")
    for i, (a, b) in enumerate(zip(ours.drift[0, 0], theirs, strict=True), start=1):
        print(f"{i:8d}{a:10.4f}{b:10.4f}{100 * (a / b - 1):8.3f}%")


def speed(ground, draws, jobs):
    """Print the time of draws of the building, and whether they settled."""
    rng = np.random.default_rng(1)
    totals = np.cumsum(opensees.WEIGHTS[::-1])[::-1]
    theta = np.array([[three_stage_row(rng, 0.05 * w) for w in totals] for _ in range(draws)])
    dampers = Dampers(ThreeStage(), theta, rng.random((draws, 6)), theta[..., 4])
    started = os.times()
    result = response_of(six_storeys(), [ground], dampers, jobs=jobs)
    ended = os.times()
    cpu, clock = sum(ended[:4]) - sum(started[:4]), ended.elapsed - started.elapsed
    print(f"\n{draws} draws x 6 storeys x 6 dampers x {ground.acceleration.size} samples", end="")
    print(
        f", {jobs} jobs\nprocessor {cpu:.0f} s, clock {clock:.0f} s, load {os.getloadavg()[1]:.1f}"
    )
    print(
        f"not settled within 1 %: {int(result.unsettled.sum())}; ran away: {result.unstable.sum()}"
    )
    print(f"largest energy not accounted for: {result.imbalance.max():.1e} of the input")


def main():
    parser = common.parser_of(__doc__, data=True, jobs=2)
    parser.add_argument("--opensees", metavar="PYTHON", help="a Python that has openseespy")
    options = common.begin(parser)
    failed = cases(1 if options.quick else 50)
    ground = read_ground(options.data / "ground_motions" / "el_centro.AT2")
    if options.quick:
        ground = replace(ground, acceleration=ground.acceleration[:150])
    if options.opensees:
        beside_opensees(ground, options.opensees)
    speed(ground, 4 if options.quick else 500, options.jobs)
    common.finish(failed)


if __name__ == "__main__":
    main()
