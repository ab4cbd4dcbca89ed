"""What a command does when it is interrupted or told to end: one sentence, at once."""

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
    """End the process on Ctrl-C and its like, with exit code 128 + signal; not after the block."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, _end)
    try:
        yield
    finally:  # all is done and said: Python's own end is not to be disturbed
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def hinting(hint: str) -> Iterator[None]:
    """Say how to go on, too, where this process ends on signals."""

    def end(number: int, _frame: FrameType | None) -> NoReturn:
        _end(number, hint=hint)

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
    """Do something first where this process ends on signals, such as to clear the terminal."""
    main = threading.current_thread() is threading.main_thread()  # no other gets signals
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
    """End every process that this one has started, at once; what they have stored is whole."""
    children = multiprocessing.active_children()
    for child in children:
        child.kill()
    for child in children:
        child.join()


def _end(number: int, _frame: FrameType | None = None, *, hint: str = "") -> NoReturn:
    """End without unwinding.

    An exception could arise in the middle of an import or of a destructor, where it is lost or
    turned into another. Nothing needs to be unwound, for files are whole at every moment.
    """
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    end_children()
    by = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
    with suppress(OSError, AttributeError):
        if sys.stdout.isatty():
            os.write(1, b"\x1b[0m\x1b[?25h\n")  # the table of what goes on hides the cursor
        os.write(2, f"mfd-bayes: interrupted{by}{hint}\n".encode(errors="backslashreplace"))
    os._exit(128 + number)
