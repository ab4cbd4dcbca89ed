"""The example in OpenSees beside `respond`, and the misfit of the materials that are fitted."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.applications.buildings.building import Content, building_of
from mfd_bayes.applications.buildings.dampers import Dampers
from mfd_bayes.applications.buildings.ground import read_ground
from mfd_bayes.applications.buildings.time_integration import settle
from mfd_bayes.applications.export.sets import parameter_sets
from mfd_bayes.store.files import read_json
from tests.command_line import said
from tests.export.made import needs_compiler

EXAMPLE = Path(__file__).parents[2] / "examples" / "opensees" / "storey.py"
PYTHON = os.environ.get("MFD_BAYES_OPENSEES", sys.executable if find_spec("openseespy") else "")


@needs_compiler
def test_the_example_has_the_drift_of_respond(finished_run, tmp_path):
    opens = [PYTHON, "-c", "import openseespy.opensees"]  # Python 3.11 gets one that does not
    if not (PYTHON and subprocess.run(opens, capture_output=True, check=False).returncode == 0):
        pytest.skip("no openseespy here: MFD_BAYES_OPENSEES may name a Python that has it")
    ground = Path(__file__).parents[2] / "mfd_bayes/applications/buildings/example.AT2"
    words = ("--to", "c", "--draws", 10, "--actuation", "1000 psi", "-o", tmp_path / "damper")
    said("export", finished_run.out, *words)
    command = [PYTHON, EXAMPLE, tmp_path / "damper", ground, "0.02", "--parts", "20"]
    ended = subprocess.run([*map(str, command)], capture_output=True, text=True, check=True)
    lines = [line.split() for line in ended.stdout.splitlines()]
    drifts = {words[0]: float(words[1]) for words in lines if len(words) == 2}
    sets = parameter_sets(open_run(finished_run.out), 1.0, 10)
    content = {
        "storey": [{"weight": "20 kip", "stiffness": "8 kip/in"}],
        "damper": [{"storey": 1, "actuation": "1 ksi"}],
        "building": {"damping": {"kind": "modal", "ratio": 0.02}},
    }
    building = building_of(Content.model_validate(content), Path("storey"))
    theta, start = sets.theta[:3, None], sets.start[:3, None]
    dampers = Dampers(sets.model, theta, start, np.full((3, 1), 1.4))
    ours = settle(building, read_ground(ground), dampers, 0.001).drift[:, 0, 0]
    np.testing.assert_allclose([drifts[n] for n in sets.names[:3]], ours, rtol=1e-3)
    assert np.ptp(ours) > 0.05 * ours.mean()


def test_a_fitted_material_says_how_far_it_is_off_in_the_tests(small_run, tmp_path, monkeypatch):
    monkeypatch.setattr("mfd_bayes.applications.export.samples.FITS", 2)
    words = ("--to", "opensees", "--draws", 10, "--actuation", "500 psi", "-o", tmp_path / "m")
    text = said("export", small_run, *words)
    assert text.count("in the motions of the tests") == 2
    assert "give --to c" in text
    facts = read_json(tmp_path / "m" / "about.json")
    assert facts["misfit_of_tests"].keys() == {"BoucWen", "ElasticPP"}
    for misfits in facts["misfit_of_tests"].values():
        assert misfits.keys() == {"a"}
        assert 0.0 < misfits["a"] < 1.0
