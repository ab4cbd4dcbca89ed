"""Figures depend neither on the environment's backend of Matplotlib nor on its home.

An environment is set before a process starts, so that each test here is a process of its own.
"""

import os
import subprocess
import sys

import pytest

INLINE = {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
NOWHERE = "/proc/none"
HOMELESS = {"MPLCONFIGDIR": NOWHERE, "HOME": NOWHERE} | {
    "XDG_CONFIG_HOME": NOWHERE,
    "XDG_CACHE_HOME": NOWHERE,
}

DRAW = """\
import os

import numpy as np
from mfd_bayes.reporting.figures.style import new_figure, to_png

figure = new_figure(3, 3)
figure.subplots().plot(np.arange(9), label="2 \u00b5")
assert to_png(figure).startswith(b"\\x89PNG")
print(os.environ["MPLBACKEND"])
"""

MOTION = "time_s,displacement_in\n" + "".join(
    f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100)
)


@pytest.mark.parametrize(
    "changes",
    [
        {"MPLBACKEND": "nonsense", **HOMELESS},
        pytest.param(INLINE, marks=pytest.mark.slow),
        pytest.param({"MPLBACKEND": "TkAgg"}, marks=pytest.mark.slow),
        pytest.param({"MPLBACKEND": "svg"}, marks=pytest.mark.slow),
    ],
    ids=lambda changes: changes["MPLBACKEND"],
)
def test_figures_are_drawn_in_silence_and_the_backend_is_left_to_others(changes):
    done = subprocess.run(
        [sys.executable, "-c", DRAW],
        env={**os.environ, **changes},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{changes['MPLBACKEND']}\n"


@pytest.mark.parametrize(
    "changes",
    [INLINE | HOMELESS, pytest.param({"HOME": ""}, marks=pytest.mark.slow)],
    ids=["no home", "an empty home"],
)
def test_a_command_draws_in_silence_whatever_the_environment(tmp_path, changes):
    (tmp_path / "m.csv").write_text(MOTION)
    done = subprocess.run(
        [sys.executable, "-m", "mfd_bayes", "inspect", "m.csv"],
        env={**os.environ, **changes},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "m_inspect.png").is_file()
