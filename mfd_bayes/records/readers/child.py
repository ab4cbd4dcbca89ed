"""Files of binary formats are read in a child process, with a limit of memory and of time.

Their libraries build what a file declares, some of them in a form that ends the process. Only
numbers and texts come back.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

Content = tuple[dict[str, Any], list[NDArray[np.generic]]]
"""Texts and numbers of a file, and its arrays."""

MEMORY, SECONDS = 2 * 2**30, 120.0
"""Bytes beyond what the process has already, and seconds, that the reading of a file may take."""


_LESS = "save only the test's own columns, or as .csv"


class UnreadableError(Exception):
    """Raised by a reader whose message follows the file's name."""


def import_library(path: Path, module: str, name: str, extra: str) -> None:
    """Import what a format needs, so that a copy of this process has it."""
    try:
        import_module(module)
    except ImportError as error:
        raise RecordError(
            f'reading {path} needs {name}, which is not installed: pip install "mfd_bayes[{extra}]"'
        ) from error


def read_in_child(read: Callable[[Path], Content], path: Path, kind: str) -> Content:
    """What a reader returns of a file, from a process of its own; `kind` names the format.

    Refused where the file is none of its format, or reading it takes more than is allowed.
    """
    path.open("rb").close()
    forks = hasattr(os, "fork") and threading.active_count() == 1
    content = (_forked if forks else _spawned)(read, path)
    if content is None:
        raise RecordError(f"{path} takes more than {SECONDS:g} s to read: {_LESS}")
    try:
        size = 8 + int.from_bytes(content[:8], "little")
        facts, at = json.loads(content[8:size]), size
        arrays: list[NDArray[np.generic]] = []
        for code, count in facts.pop("arrays"):
            arrays.append(np.frombuffer(content, code, count, at))
            at += arrays[-1].nbytes
    except ValueError:  # the process ended before it had written all
        facts, arrays = {"error": ""}, []
    error = facts.pop("error", None)
    if error is None:
        return facts, arrays
    if error == "memory":
        raise RecordError(f"{path} needs more than {MEMORY >> 30} GB to be read: {_LESS}")
    raise RecordError(f"{path} {error or f'is not {kind} that can be read'}")


def _forked(read: Callable[[Path], Content], path: Path) -> bytes | None:
    """What a copy of this process writes, which has the libraries already; None if it is late."""
    source, target = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about threads of other libraries, which wait
        pid = os.fork()
    if not pid:
        try:
            os.close(source)
            faulthandler.disable()
            serve(read, path, target)
        finally:
            os._exit(0)
    os.close(target)
    end, pieces = time.monotonic() + SECONDS, [b" "]
    try:
        while pieces[-1]:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([source], [], [], left)[0]:
                return None
            pieces.append(os.read(source, 2**20))
        return b"".join(pieces[1:])
    finally:
        os.close(source)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def _spawned(read: Callable[[Path], Content], path: Path) -> bytes | None:
    """As `_forked`, of a new interpreter: a copy of a process with threads may wait for ever."""
    code = (
        "import sys; sys.path[:] = sys.argv[4:]\n"
        "from importlib import import_module\nfrom pathlib import Path\n"
        "from mfd_bayes.records.readers.child import serve\n"
        "serve(getattr(import_module(sys.argv[1]), sys.argv[2]), Path(sys.argv[3]), 1)"
    )
    words = [sys.executable, "-c", code, read.__module__, read.__name__, str(path), *sys.path]
    try:
        done = subprocess.run(words, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return None
    return done.stdout


def serve(read: Callable[[Path], Content], path: Path, number: int) -> None:
    """Read a file within limits, and write what is read to a descriptor."""
    with os.fdopen(os.dup(number), "wb") as stream:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for output in (1, 2):
            os.dup2(nowhere, output)
        with contextlib.suppress(ImportError, OSError, ValueError):  # as on Windows
            import resource

            has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            most = resource.getrlimit(resource.RLIMIT_AS)[1]
            limit = has + MEMORY if most == resource.RLIM_INFINITY else min(has + MEMORY, most)
            resource.setrlimit(resource.RLIMIT_AS, (limit, most))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        arrays: list[NDArray[np.generic]] = []
        try:
            facts, arrays = read(path)
        except UnreadableError as error:
            facts = {"error": str(error)}
        except MemoryError:
            facts = {"error": "memory"}
        except BaseException:  # the libraries raise dozens of kinds
            facts = {"error": ""}
        facts["arrays"] = [(array.dtype.str, array.size) for array in arrays]
        head = json.dumps(facts).encode("ascii")
        stream.write(len(head).to_bytes(8, "little") + head)
        for array in arrays:
            stream.write(np.ascontiguousarray(array).tobytes())
