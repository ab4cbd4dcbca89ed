"""Blocks of draws as jobs of processes."""

import numpy as np
import pytest

from mfd_bayes.response.building import read_building
from mfd_bayes.response.device_draws import plain_friction
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.time_integration import response_of

BUILDING = """
[building]
[[storey]]
weight = "20 kip"
stiffness = "8 kip/in"
[[damper]]
storey = 1
actuation = "1000 psi"
"""
ROUGH = 0.05


@pytest.fixture
def building(tmp_path):
    path = tmp_path / "building.toml"
    path.write_text(BUILDING)
    return read_building(path)


def ground(name):
    return Ground(name, 0.02, 100.0 * np.sin(np.arange(50) / 5.0))


def test_the_name_of_a_ground_motion_may_be_long_and_hold_anything(building):
    grounds = [ground("g" * 250), ground("a/b"), ground("a b"), ground("a_b")]
    here, there = (
        response_of(building, grounds, plain_friction(np.ones(1)), ROUGH, jobs=jobs)
        for jobs in (1, 2)
    )
    np.testing.assert_array_equal(there.drift, here.drift)
