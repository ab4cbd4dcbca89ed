"""Prototypes and production devices whose truth is known.

    python -m benchmarks.accept.simulated FOLDER [--seeds 4] [--scatter 0.02]

writes campaigns of twelve tests of one prototype, FOLDER/s1 and so on, and calibrates them there
(quick). `run` then judges production devices against these runs.
"""

import argparse
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.campaign import synthetic
from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values, write_campaign

Array = NDArray[np.float64]

MATRIX = Matrix((600.0, 1000.0, 1400.0), (0.1, 0.25, 0.5, 1.0), (2, 3, 3, 4), (800.0, 0.5))
ACTUATION, FREQUENCY, CYCLES = 1.0, 0.5, 3  # ksi and Hz of a production test


def set_scatter(scatter: float) -> None:
    """Tests of a device scatter by so much in slip force, and half of it in the gap."""
    wide = synthetic._SCATTER
    names = ("Fc_fwd", "Fc_bwd", "d2", "d3", "ell", "k2", "k3", "sigma0")
    wide |= dict.fromkeys(names, scatter)
    wide |= dict.fromkeys(("static_excess_fwd", "static_excess_bwd"), 2.0 * scatter)


def production_test(rng: np.random.Generator, fault: Mapping[str, float]) -> tuple[Array, ...]:
    """Time, displacement and force of one test of a device, whose quantities have factors."""
    values = draw_values(ACTUATION, MATRIX.laws, rng)
    for name, factor in fault.items():
        values[name] = values[name] * factor
    return draw_record(values, FREQUENCY, CYCLES, rng)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--scatter", type=float, default=0.02)
    args = parser.parse_args()
    set_scatter(args.scatter)
    for seed in range(1, args.seeds + 1):
        home = args.folder / f"s{seed}"
        if (home / "out" / "report.html").exists():
            continue
        (home / "campaign").mkdir(parents=True, exist_ok=True)
        write_campaign(home / "campaign", seed, MATRIX)
        path = home / "campaign" / "campaign.toml"
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace('"ou"', '"ou"\nrate = "50 Hz"\nnoise_check = false'), "utf-8")
        command = [sys.executable, "-m", "mfd_bayes", "calibrate", path, "-o", home / "out"]
        subprocess.run([*map(str, command), "--effort", "quick", "--force", "-q"], check=False)


if __name__ == "__main__":
    main()
