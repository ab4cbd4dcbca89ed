"""posterior.nc as a user opens it, with the ArviZ that is installed: 0.2x or 1.x."""

import os
import subprocess
import sys

import numpy as np
import pytest

from mfd_bayes.calibration.priors import units
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import CalibratedTest, save_test

NAMES = ("Fc_fwd", "k3", "gamma2")
UNITS = {name: units()[name] for name in ThreeStage().parameters}

# What the user types; only what ArviZ says of its own future is not minded.
SESSION = """\
import sys
import warnings

import matplotlib

matplotlib.use("Agg")
warnings.filterwarnings("ignore", category=FutureWarning, message="(?s).*ArviZ is undergoing")
import arviz as az
import matplotlib.pyplot as plt

path, picture, *names = sys.argv[1:]
data = az.from_netcdf(path)
summary = az.summary(data, var_names=names, round_to="none")
for name in names:
    print(name, summary.loc[name, "mean"], summary.loc[name, "ess_bulk"])
az.plot_trace(data, var_names=names)
plt.savefig(picture + "_trace.png")
plt.close("all")
az.plot_forest(data, var_names=names)
plt.savefig(picture + "_forest.png")
print(data["posterior"][names[0]].attrs["units"], sorted(data["posterior"].dims))
"""


@pytest.fixture(scope="module")
def values():
    rng = np.random.default_rng(0)
    return {name: np.exp(0.1 * rng.normal(size=(4, 120))) for name in UNITS}


@pytest.fixture(scope="module")
def session(values, tmp_path_factory):
    """What a session printed, and the folder of its pictures."""
    folder = tmp_path_factory.mktemp("arviz")
    time = np.arange(0, 4, 0.02)
    motion = np.sin(np.pi * time)
    trace = Trace.from_arrays(time, motion, 0.8, force=np.sign(motion))
    stats = dict.fromkeys(("lp", "log_prior", "log_likelihood"), values["k3"])
    predictive = np.zeros((4, 5, time.size))
    test = CalibratedTest(values, UNITS, stats, trace, predictive, {})
    save_test(folder / "posterior.nc", test)
    words = [sys.executable, "-c", SESSION, str(folder / "posterior.nc"), str(folder / "look")]
    done = subprocess.run(
        [*words, *NAMES], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), folder


def test_a_user_reads_each_quantity_by_name_with_its_unit_and_draws_it(session, values):
    printed, folder = session
    for name, line in zip(NAMES, printed, strict=False):
        shown, mean, ess = line.split()
        assert shown == name
        assert float(mean) == pytest.approx(values[name].mean(), rel=1e-3)
        assert 200 < float(ess) < 1000  # of 480 independent draws
    assert printed[-1] == "kip ['chain', 'draw']"
    for picture in ["trace", "forest"]:
        path = folder / f"look_{picture}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 5000


MEASURE = """\
import sys

import numpy as np

from mfd_bayes.calibration.diagnostics import measure, psis

draws = np.random.default_rng(0).normal(size=(4, 50, 8, 2))
assert np.all(measure(draws).r_hat < 1.1)
psis(draws.ravel())
print("numba" in sys.modules)
"""


def test_numba_is_not_loaded_for_diagnostics(tmp_path):
    # it takes 100 MB of every process
    (tmp_path / "numba.py").write_text("def jit(*a, **k):\n    return lambda f: f\nvectorize = jit")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    for before, loaded in (
        ("", "False\n"),
        ("import numba\n", "True\n"),
    ):  # whoever has it keeps it
        words = [sys.executable, "-c", before + MEASURE]
        assert subprocess.check_output(words, text=True, timeout=300, env=env) == loaded
