"""Processes of this machine: how they start, and what they may use.

On Linux they are forked from a server, which has imported the libraries that they need: each then
starts in some hundredths of a second instead of two or three seconds. Elsewhere each starts anew,
and also where the path of the folder of temporary files is too long for the server's socket.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext, SpawnContext

WATCH = 0.1
"""Seconds between looks at whether the parent lives."""

LONGEST = 107 - len("/pymp-12345678/listener-12345678")
"""Most bytes of the path of the folder in which the server has its socket; of the socket's own path
Linux takes 107."""

_ENVIRONMENT = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "MPLBACKEND": "agg",
}
"""Numpy uses one thread, for the number could change the draws; Matplotlib needs no screen."""

_TIDIED = "ignore:resource_tracker"
"""Where a signal ends this process, the tracker removes its semaphores; it need not say so."""


def context() -> ForkServerContext | SpawnContext:
    """What starts processes; they must be started within `started_alike`."""
    if sys.platform == "linux" and len(os.fsencode(tempfile.gettempdir())) <= LONGEST:
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def get_ready(*modules: str) -> None:
    """Let the server of processes start and import modules meanwhile, if it is not there yet."""
    kind = context()
    if isinstance(kind, ForkServerContext):
        from multiprocessing import forkserver

        kind.set_forkserver_preload(list(modules))
        with started_alike():
            forkserver.ensure_running()


@contextmanager
def started_alike() -> Iterator[None]:
    """Let processes that are started have one environment, and ignore Ctrl-C.

    This process gets Ctrl-C and ends the others.
    """
    warnings = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), _TIDIED)))
    environment = _ENVIRONMENT | {"PYTHONWARNINGS": warnings}
    before = {name: os.environ.get(name) for name in environment}
    os.environ |= environment
    try:
        with _interrupts_blocked():
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Start processes that ignore Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock Ctrl-C again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def follow_parent() -> None:
    """Let this process end when its parent does, however it does: a run may follow."""
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def importing() -> Iterator[None]:
    """Let the server of processes end with its parent also while it imports libraries.

    What it has imported stays for good: no collection of garbage looks at it, here or in the
    processes that are forked.
    """
    parent, done = os.getppid(), threading.Event()

    def watch() -> None:
        while not done.wait(WATCH):
            if os.getppid() != parent:
                os._exit(1)

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
        done.set()
        watching.join()  # a process with threads must not be forked
