"""Figures depend neither on the environment's backend of Matplotlib nor on its home."""

import os
import subprocess
import sys

import pytest

DRAW = """\
import numpy as np
from mfd_bayes.reporting.figures.style import new_figure, to_png

figure = new_figure(3, 3)
figure.subplots().plot(np.arange(9), label="2 \u00b5")
assert to_png(figure).startswith(b"\\x89PNG")
"""

MOTION = "time_s,displacement_in\n" + "".join(
    f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100)
)


@pytest.mark.parametrize(
    "changes",
    [
        {"MPLBACKEND": "module://matplotlib_inline.backend_inline"},
        {"MPLBACKEND": "nonsense"},
        {"MPLBACKEND": "TkAgg"},
        {"MPLCONFIGDIR": "/proc/none", "HOME": "/proc/none", "XDG_CONFIG_HOME": "/proc/none"},
    ],
    ids=str,
)
def test_figures_are_drawn_in_silence_whatever_the_environment(changes):
    done = subprocess.run(
        [sys.executable, "-c", DRAW],
        env={**os.environ, **changes},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(
    "changes",
    [
        {"MPLBACKEND": "module://matplotlib_inline.backend_inline"},
        {"MPLCONFIGDIR": "/proc/none", "HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none"},
        {"HOME": ""},
    ],
    ids=str,
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


def test_the_environments_backend_is_left_to_others():
    code = "import os; import mfd_bayes.reporting.figures; print(os.environ['MPLBACKEND'])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "MPLBACKEND": "svg"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "svg\n"
