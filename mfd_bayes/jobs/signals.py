"""How a command ends on Ctrl-C and other signals: at once, with one sentence."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, NoReturn

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


@contextmanager
def end_on_signals() -> Iterator[None]:
    """End the process on Ctrl-C, SIGTERM and SIGHUP, with exit code 128 + signal.

    After the block these signals are ignored: the process must end with its own exit code.
    """
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, _end)
    try:
        yield
    finally:
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def _handled(handlers: Mapping[int, Any]) -> Iterator[None]:
    saved = {number: signal.getsignal(number) for number in handlers}
    for number, handler in handlers.items():
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, handler in saved.items():
            signal.signal(number, handler)


@contextmanager
def hinting(hint: Callable[[], str]) -> Iterator[None]:
    """Add a hint to the sentence, such as how to resume, where this process ends on a signal."""
    end = partial(_end, hint=hint)
    with _handled({number: end for number in _SIGNALS if signal.getsignal(number) is _end}):
        yield


@contextmanager
def before_end(prepare: Callable[[], object]) -> Iterator[None]:
    """Call a function before this process ends on a signal, such as to remove a file."""
    main = threading.current_thread() is threading.main_thread()  # others get no signals
    handlers = {number: signal.getsignal(number) for number in _SIGNALS if main}
    ours: dict[int, Any] = {number: h for number, h in handlers.items() if callable(h)}

    def end(number: int, frame: object) -> None:
        prepare()
        ours[number](number, frame)

    with _handled(dict.fromkeys(ours, end)):
        yield


def _end(number: int, _frame: object = None, *, hint: Callable[[], str] = str) -> NoReturn:
    """End the process without an exception, which an import or a destructor could lose.

    Nothing needs to be cleaned up: files are whole at every moment.
    """
    for signum in _SIGNALS:
        signal.signal(signum, signal.SIG_IGN)
    children = multiprocessing.active_children()
    for child in children:
        child.kill()
    for child in children:
        child.join()
    cause = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
    with suppress(OSError, AttributeError):
        if sys.stdout.isatty():
            os.write(1, b"\x1b[0m\x1b[?25h\n")  # progress.py hides the cursor
        os.write(2, f"mfd-bayes: interrupted{cause}{hint()}\n".encode(errors="backslashreplace"))
    os._exit(128 + number)
