"""Simulation-based calibration, reduced: truths are ranked evenly by their posteriors.

The study is that of benchmarks/sbc, which does the same with all parameters and 300 tests.
"""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from mfd_bayes.calibration.effort import EFFORTS
from mfd_bayes.records.trace import Trace

SAMPLED = ("Fc_fwd", "d2", "start", "offset", "noise_sd", "noise_time")
TESTS, CONTROLS = 40, 12
DRAWS = 31


@pytest.fixture(scope="module")
def sbc(benchmark_module) -> ModuleType:
    return benchmark_module("sbc.study")


@pytest.fixture(scope="module")
def uniform(benchmark_module) -> ModuleType:
    return benchmark_module("common.uniformity")


@pytest.fixture(scope="module")
def ranks(sbc: ModuleType) -> dict[str, dict[str, list[int]]]:
    """Ranks by noise that the posterior assumes, and quantity; the records are the same."""
    time = np.arange(80) / 16.0
    study = sbc.Study(
        priors=sbc.narrow_priors(SAMPLED, noise_time=0.4),
        motion=Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.25 * time)),
        effort=replace(EFFORTS["quick"], ess=90, limit=800, r_hat=1.05, ensembles=2),
        draws=DRAWS,
        seed=5,
    )
    tests = {
        noise: [sbc.run_test(study, index, noise) for index in range(count)]
        for noise, count in ((sbc.TRUE, TESTS), (sbc.WRONG, CONTROLS))
    }
    assert not any(test.error for series in tests.values() for test in series)
    return {noise: sbc.ranks_by_quantity(series) for noise, series in tests.items()}


@pytest.mark.slow
def test_every_quantity_that_varies_is_ranked(
    sbc: ModuleType, ranks: dict[str, dict[str, list[int]]]
) -> None:
    found = ranks[sbc.TRUE]
    assert set(found) == {*SAMPLED, sbc.LIKELIHOOD}
    assert {len(values) for values in found.values()} == {TESTS}


@pytest.mark.slow
