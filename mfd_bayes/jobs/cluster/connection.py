"""The connection to a scheduler, and the errors where there is none or it is lost."""

from __future__ import annotations

import logging
import re
import warnings
from asyncio import CancelledError
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from distributed import Client
from distributed.versions import VersionMismatchWarning

from mfd_bayes.errors import FitError

PATIENCE = 5.0
"""Seconds in which a scheduler must answer."""

FAULTS = (OSError, TimeoutError, CancelledError, RuntimeError)
"""Errors that dask.distributed raises when the scheduler is lost, depending on the moment."""

_LOGS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Connection to a scheduler; the library's own log messages are suppressed."""
    if not re.fullmatch(r"(tcp|tls)://.+:\d+", address):
        raise FitError(f"--scheduler must be like tcp://host:8786, got {address!r}")
    before = {name: logging.getLogger(name).level for name in _LOGS}
    for name in _LOGS:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `differences` reports it
            client = Client(address, timeout=PATIENCE, name="mfd-bayes", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise FitError(
            f"no scheduler answers at {address} ({in_a_line(error)}); start one: dask scheduler"
        ) from error
    else:
        try:
            yield client
        finally:
            with suppress(*FAULTS):
                client.close(timeout=PATIENCE)
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def losses(address: str) -> Iterator[None]:
    """Turn every error of a lost scheduler into a FitError."""
    try:
        yield
    except FAULTS as error:
        raise lost(address) from error


def lost(address: str) -> FitError:
    """Error that ends a run whose scheduler is lost."""
    return FitError(
        f"the scheduler at {address} was lost: what is finished is kept; go on with --resume, "
        "with a scheduler or without"
    )


def in_a_line(error: BaseException) -> str:
    """Message of an error in one line, with the kind of the error unless it is an OSError."""
    text = " ".join(str(error).split()) or "no reason given"
    return text if isinstance(error, OSError) else f"{type(error).__name__}: {text}"
