"""Lines above a table: the machine and the versions that it was measured with."""

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path


def processor() -> str:
    """Name of the processor and its number of cores (Linux)."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    model = next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    return f"{model}, {os.cpu_count()} cores"


def load() -> str:
    """How busy the machine is, averaged over the last minute."""
    return f"load {os.getloadavg()[0]:.1f}"


def platform_line() -> str:
    """Operating system and version of Python."""
    return f"{platform.platform()}, Python {platform.python_version()}"


def versions(*libraries: str) -> str:
    """Version of Python, and of the libraries named."""
    named = (f"{library} {version(library)}" for library in libraries)
    return ", ".join((f"Python {sys.version.split()[0]}", *named))


def print_bars(failed: list[str]) -> None:
    """Print that all limits are kept, or one line for each that is not."""
    print("\nall bars hold" if not failed else "\n" + "\n".join(f"FAILED: {bar}" for bar in failed))
