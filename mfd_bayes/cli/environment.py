"""The environment of a command: what a library would ask of it, and not be given."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

_FOLDERS = {"MPLCONFIGDIR": ".config/matplotlib", "XDG_CACHE_HOME": ".cache"}
"""Variables of the folders that Matplotlib and ArviZ write to, and where these are by default."""


def settle_environment() -> None:
    """Make what libraries read from the environment the same for everybody.

    One thread for each matrix, for those here are small; figures without a screen, for a notebook
    may have set a backend of its own; and a folder for caches where the home cannot be written to.
    Processes that are started inherit it.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is imported
    os.environ["MPLBACKEND"] = "agg"
    needed = [name for name, default in _FOLDERS.items() if not _is_writable(name, default)]
    if needed:
        own = tempfile.mkdtemp(prefix="mfd-bayes-")
        atexit.register(shutil.rmtree, own, ignore_errors=True)
        os.environ.update(dict.fromkeys(needed, own))


def _is_writable(name: str, default: str) -> bool:
    """Whether the folder of a variable, or the nearest above it that is there, can be written."""
    try:
        folder = Path(os.environ.get(name) or Path.home() / default)
        there = next(path for path in (folder, *folder.parents) if path.exists())
        return there.is_dir() and os.access(there, os.W_OK) and not _is_kernels(there)
    except (OSError, RuntimeError, StopIteration):  # no home is known
        return False


def _is_kernels(folder: Path) -> bool:
    """Whether a folder is the kernel's, in which root may write and nothing can be made."""
    return str(folder.resolve()).startswith(("/proc", "/sys"))
