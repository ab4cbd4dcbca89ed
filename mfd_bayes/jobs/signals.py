"""How a command ends on Ctrl-C and other signals: at once, with one sentence."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


@contextmanager
def end_on_signals() -> Iterator[None]:
    """End the process on Ctrl-C, SIGTERM and SIGHUP, with exit code 128 + signal.

    After the block these signals are ignored.
    """
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, _end)
    try:
        yield
    finally:  # the command has ended: Python must exit with its exit code
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def hinting(hint: Callable[[], str]) -> Iterator[None]:
    """Add a hint to the sentence, such as how to resume, where this process ends on a signal."""

    def end(number: int, _frame: FrameType | None) -> NoReturn:
        _end(number, hint=hint())

    ours = [number for number in _SIGNALS if signal.getsignal(number) is _end]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, _end)


@contextmanager
def before_end(prepare: Callable[[], object]) -> Iterator[None]:
    """Call a function before this process ends on a signal, such as to remove a file."""
    main = threading.current_thread() is threading.main_thread()  # others get no signals
    handlers = {number: signal.getsignal(number) for number in _SIGNALS if main}
    ours = {number: handler for number, handler in handlers.items() if callable(handler)}

    def end(number: int, frame: FrameType | None) -> None:
        prepare()
        ours[number](number, frame)

    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)


def end_children() -> None:
    """Kill every process that this one has started; files that they have stored are whole."""
    children = multiprocessing.active_children()
    for child in children:
        child.kill()
    for child in children:
        child.join()


def _end(number: int, _frame: FrameType | None = None, *, hint: str = "") -> NoReturn:
    """End the process without an exception.

    An exception in the middle of an import or a destructor would be lost or turned into another.
    Nothing needs to be cleaned up: files are whole at every moment.
    """
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    end_children()
    by = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
    with suppress(OSError, AttributeError):
        if sys.stdout.isatty():
            os.write(1, b"\x1b[0m\x1b[?25h\n")  # progress.py hides the cursor
        os.write(2, f"mfd-bayes: interrupted{by}{hint}\n".encode(errors="backslashreplace"))
    os._exit(128 + number)
