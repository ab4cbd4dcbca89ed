"""Files of binary formats are read in a child process, with a limit of memory and of time.

Their libraries build what a file declares, some of them in a form that ends the process. Only
numbers and texts come back.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import json
import os
import signal
import subprocess
import sys
import threading
import warnings
import zipfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

Content = tuple[dict[str, Any], Mapping[str, NDArray[np.generic]]]
"""Texts and numbers of a file, and its arrays by name."""

MEMORY, SECONDS = 2 * 2**30, 120.0
"""Bytes beyond what the process has already, and seconds, that the reading of a file may take."""

_ADVICE = "save only the test's own columns, or as .csv"


class UnreadableError(Exception):
    """Raised by a reader whose message follows the file's name."""


def read_in_child(
    read: Callable[[Path], Content], path: Path, kind: str, *, library: str, extra: str = ""
) -> Content:
    """What a reader returns of a file, from a process of its own.

    `kind` names the format, `library` and `extra` what it needs. Refused where the file is none of
    its format, or reading it takes more than is allowed.
    """
    path.open("rb").close()
    try:
        import_module(library.lower())  # so that a copy of this process has it
    except ImportError as error:
        raise RecordError(
            f"reading {path} needs {library}, which is not installed: "
            f'pip install "mfd_bayes[{extra}]"'
        ) from error
    forks = hasattr(os, "fork") and threading.active_count() == 1
    try:
        content = (_fork if forks else _spawn)(read, path)
        with np.load(io.BytesIO(content)) as stored:
            arrays = {name: stored[name] for name in stored.files}
        facts = json.loads(str(arrays.pop("facts")))
    except subprocess.TimeoutExpired as error:
        raise RecordError(f"{path} takes more than {SECONDS:g} s to read: {_ADVICE}") from error
    except (ValueError, EOFError, zipfile.BadZipFile):  # the process ended before it wrote all
        facts, arrays = {"error": ""}, {}
    error_text = facts.pop("error", None)
    if error_text is None:
        return facts, arrays
    if error_text == "memory":
        raise RecordError(f"{path} needs more than {MEMORY >> 30} GB to be read: {_ADVICE}")
    raise RecordError(f"{path} {error_text or f'is not {kind} that can be read'}")


def _fork(read: Callable[[Path], Content], path: Path) -> bytes:
    """What a copy of this process writes, which has the libraries already."""
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
    alarm = threading.Timer(SECONDS, os.kill, (pid, signal.SIGKILL))
    alarm.start()
    try:
        with os.fdopen(source, "rb") as stream:
            content = stream.read()
    finally:
        late = not alarm.is_alive()
        alarm.cancel()
        alarm.join()
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    if late:
        raise subprocess.TimeoutExpired(str(path), SECONDS)
    return content


def _spawn(read: Callable[[Path], Content], path: Path) -> bytes:
    """As `_fork`, of a new interpreter: a copy of a process with threads may wait for ever."""
    code = (
        "import sys; sys.path[:] = sys.argv[4:]\n"
        "from importlib import import_module\nfrom pathlib import Path\n"
        "from mfd_bayes.records.readers.child import serve\n"
        "serve(getattr(import_module(sys.argv[1]), sys.argv[2]), Path(sys.argv[3]), 1)"
    )
    words = [sys.executable, "-c", code, read.__module__, read.__name__, str(path), *sys.path]
    return subprocess.run(words, capture_output=True, timeout=SECONDS, check=False).stdout


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
        arrays: Mapping[str, NDArray[np.generic]] = {}
        try:
            facts, arrays = read(path)
        except UnreadableError as error:
            facts = {"error": str(error)}
        except MemoryError:
            facts = {"error": "memory"}
        except BaseException:  # the libraries raise dozens of kinds
            facts = {"error": ""}
        contents: dict[str, Any] = {"facts": np.array(json.dumps(facts)), **arrays}
        np.savez(stream, **contents)
