"""Blocks of draws as jobs of processes, which store their histories in files."""

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.response.building import read_building
from mfd_bayes.response.device_draws import plain_friction
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.time_integration import Accuracy, Analysis, Block

BUILDING = """
[building]
[[storey]]
weight = "20 kip"
stiffness = "8 kip/in"
[[damper]]
storey = 1
actuation = "1000 psi"
"""
ONCE = Accuracy(tolerance=0.05)


@pytest.fixture
def building(tmp_path):
    path = tmp_path / "building.toml"
    path.write_text(BUILDING)
    return read_building(path)


def ground(name):
    return Ground(name, 0.02, 100.0 * np.sin(np.arange(50) / 5.0))


def test_the_name_of_a_ground_motion_may_be_long_and_hold_anything(building):
    grounds = [ground("g" * 250), ground("a/b"), ground("a b"), ground("a_b")]
    asked = Analysis(building, grounds, plain_friction(np.ones(1)), ONCE)
    here, there = asked.respond(jobs=1), asked.respond(jobs=2)
    np.testing.assert_array_equal(there.drift, here.drift)


def test_a_full_disk_for_temporary_files_is_said_in_a_sentence(building, tmp_path, monkeypatch):
    block = Block("part 1", building, ground("g"), plain_friction(np.ones(1)), ONCE)

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(StoreError, match=r"cannot write .*: No space left on device"):
        block.run(tmp_path, lambda _: None)
