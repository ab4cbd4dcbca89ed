"""What the model must do on real records of the band brake."""

from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.proposal import find_modes
from mfd_bayes.records.record import read_record


def misfit(path: Path, model: str) -> float:
    """Residual rms of the best mode over the force's standard deviation."""
    record = read_record(path, actuation="30 lbf")
    posterior = Posterior(record.trace(64.0), "brfd", "ou", model)
    best = find_modes(posterior, np.random.default_rng(1))[0]
    residual = posterior.residual(best.q[None])[0]
    return float(np.std(residual) / np.std(np.asarray(posterior.trace.force)))


@pytest.mark.slow
def test_three_stages_fit_where_lugre_alone_does_not(data_folder: Path) -> None:
    path = data_folder / "2023_30lb_0.25Hz_1.0in.csv"
    assert misfit(path, "three_stage") <= 0.09
    assert misfit(path, "lugre") >= 0.14
