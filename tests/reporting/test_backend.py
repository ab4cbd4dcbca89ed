"""Figures depend neither on the environment's backend of Matplotlib nor on its home.

An environment is set before a process starts, so that each test here is a process of its own.
"""

import os
import subprocess
import sys

import pytest

HOMES = ("MPLCONFIGDIR", "HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
DRAW = """\
import os

import numpy as np
from mfd_bayes.reporting.figures import new_figure, to_png

figure = new_figure(3, 3)
figure.subplots().plot(np.arange(9), label="2 \u00b5")
assert to_png(figure).startswith(b"\\x89PNG")
print(os.environ["MPLBACKEND"])
"""


@pytest.mark.parametrize(
    ("backend", "home"),
    [
        ("module://matplotlib_inline.backend_inline", "/proc/none"),
        pytest.param("nonsense", "/proc/none", marks=pytest.mark.slow),
        pytest.param("TkAgg", "", marks=pytest.mark.slow),
    ],
)
def test_figures_are_drawn_in_silence_and_the_backend_is_left_to_others(tmp_path, backend, home):
    changes = dict.fromkeys(HOMES, home) | {"MPLBACKEND": backend}
    command, env = [sys.executable, "-c", DRAW], {**os.environ, **changes}
    process = subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, text=True)
    assert (process.returncode, process.stderr, process.stdout) == (0, "", f"{backend}\n")
    assert not any(tmp_path.iterdir())
