"""Files of binary formats are read in a child process, with a limit of memory and of time.

Their libraries build what a file declares, some of them in a form that ends the process. Only
numbers and texts come back.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

Content = tuple[dict[str, Any], list[NDArray[np.generic]]]
"""Texts and numbers of a file, and its arrays."""

MEMORY, SECONDS = 2 * 2**30, 120.0
"""Bytes beyond what the process has already, and seconds, that the reading of a file may take."""


class UnreadableError(Exception):
    """Raised by a reader whose message follows the file's name."""


def read_in_child(read: Callable[[Path], Content], path: Path, kind: str) -> Content:
    """What a reader returns of a file, from a process of its own; `kind` names the format.

    Raises
    ------
    RecordError
        When the file is none of its format, or reading it takes more than is allowed.
    """
    path.open("rb").close()
    with contextlib.ExitStack() as stack:
        pid, stream = _fork(read, path) if _may_fork() else _start(read, path)
        stack.callback(_end, pid)
        stack.enter_context(stream)
        content = _receive(stream)
        if content is None:
            raise RecordError(f"{path} takes more than {SECONDS:g} s to read: {_LESS}")
    if not content:
        raise RecordError(f"{path} is not {kind} that can be read")
    facts, arrays = _unpacked(content)
    match facts.pop("error", None):
        case None:
            return facts, arrays
        case "memory":
            raise RecordError(f"{path} needs more than {MEMORY >> 30} GB to be read: {_LESS}")
        case [message]:
            raise RecordError(f"{path} {message}")
    raise RecordError(f"{path} is not {kind} that can be read")


_LESS = "save only the test's own columns, or as .csv"


def _may_fork() -> bool:
    return hasattr(os, "fork") and threading.active_count() == 1


def _fork(read: Callable[[Path], Content], path: Path) -> tuple[int, BinaryIO]:
    """Start a copy of this process, which has the libraries already."""
    source, target = os.pipe()
    pid = os.fork()
    if pid:
        os.close(target)
        return pid, os.fdopen(source, "rb")
    try:
        os.close(source)
        with os.fdopen(target, "wb") as stream:
            _serve(read, path, stream)
    finally:
        os._exit(0)


def _start(read: Callable[[Path], Content], path: Path) -> tuple[int, BinaryIO]:
    """Start a new interpreter, where a copy of a process with threads could wait for ever."""
    code = (
        "import sys; sys.path[:] = sys.argv[4:]\n"
        "from mfd_bayes.records.readers import child\n"
        "child.serve(*sys.argv[1:4])"
    )
    words = [read.__module__, read.__name__, str(path), *sys.path]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    _CHILDREN[process.pid] = process
    return process.pid, process.stdout  # type: ignore[return-value]  # a buffered reader is one


_CHILDREN: dict[int, subprocess.Popen[bytes]] = {}


def serve(module: str, name: str, path: str) -> None:
    """Read a file, and write what is read to the output; called in a new interpreter."""
    with os.fdopen(os.dup(1), "wb") as stream:
        _serve(getattr(import_module(module), name), Path(path), stream)


def _serve(read: Callable[[Path], Content], path: Path, stream: BinaryIO) -> None:
    """Read a file within limits, and write what is read."""
    with contextlib.suppress(Exception):
        nowhere = os.open(os.devnull, os.O_RDWR)
        for output in (0, 1, 2):
            os.dup2(nowhere, output)
    with contextlib.suppress(Exception):
        import resource

        has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = has + MEMORY if most == resource.RLIM_INFINITY else min(has + MEMORY, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        facts, arrays = read(path)
    except UnreadableError as error:
        facts, arrays = {"error": [str(error)]}, []
    except MemoryError:
        facts, arrays = {"error": "memory"}, []
    except BaseException:  # the libraries raise dozens of kinds
        facts, arrays = {"error": "other"}, []
    facts["arrays"] = [(array.dtype.str, array.size) for array in arrays]
    head = json.dumps(facts).encode("ascii")
    stream.write(len(head).to_bytes(8, "little") + head)
    for array in arrays:
        stream.write(np.ascontiguousarray(array).data.cast("B") if array.size else b"")


def _receive(stream: BinaryIO) -> bytes | None:
    """All that a child writes; None where it takes too long."""
    end = time.monotonic() + SECONDS
    pieces: list[bytes] = []
    number = stream.fileno()
    while True:
        if sys.platform != "win32":
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([number], [], [], left)[0]:
                return None
        piece = os.read(number, 2**20)
        if not piece:
            return b"".join(pieces)
        pieces.append(piece)


def _end(pid: int) -> None:
    """End a child that is there no longer, or is waited for no longer."""
    process = _CHILDREN.pop(pid, None)
    if process is not None:
        process.kill()
        process.wait()
        return
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def _unpacked(content: bytes) -> Content:
    """Facts and arrays of what a child has written; no facts where it was ended amid it."""
    size = 8 + int.from_bytes(content[:8], "little")
    try:
        facts = json.loads(content[8:size])
        arrays, at = [], size
        for kind, count in facts.pop("arrays"):
            array = np.frombuffer(content, kind, count, at)
            arrays.append(array)
            at += array.nbytes
    except ValueError:
        return {"error": "other"}, []
    return facts, arrays
