"""The machine that computes a run, as far as the last digits of its draws depend on it."""

from __future__ import annotations

import platform
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np


def this_machine() -> dict[str, str]:
    """Name of the processor, the instructions that NumPy uses of it, and each BLAS, in words."""
    found = {"processor": _processor(), "instructions": _instructions()}
    return found | _blas()


def _processor() -> str:
    """Name of the processor; elsewhere than on Linux what the system tells of it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _instructions() -> str:
    """Sets of instructions that NumPy uses, by its own names."""
    told: dict[str, Any] = np.show_config(mode="dicts") or {}  # type: ignore[assignment]
    sets = told.get("SIMD Extensions", {})
    return " ".join([*sets.get("baseline", []), *sets.get("found", [])])


def _blas() -> dict[str, str]:
    """Name, version and kernel of the BLAS of NumPy and of SciPy, where they can be seen."""
    import scipy.linalg  # noqa: F401  (loads its BLAS)
    from threadpoolctl import threadpool_info

    found: dict[str, str] = {}
    for library in sorted(threadpool_info(), key=lambda one: str(one["filepath"])):
        if library["user_api"] == "blas":
            whose = [name for name in ("numpy", "scipy") if f"{name}.libs" in library["filepath"]]
            words = (library["internal_api"], library.get("version"), library.get("architecture"))
            text = " ".join(str(word) for word in words if word)
            found.setdefault(f"BLAS of {whose[0]}" if whose else "BLAS", text)
    return found
