"""The priors that all populations here have."""

import pytest

from mfd_bayes.calibration.priors import PriorFile, load_priors


@pytest.fixture(scope="session")
def priors() -> PriorFile:
    return load_priors("mfd")
