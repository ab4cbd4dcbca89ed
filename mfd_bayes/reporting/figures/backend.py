"""Matplotlib, imported so that neither the environment's backend nor its home matters.

A notebook gives its programs a backend that other environments do not have, and Matplotlib tells
on stderr of a home that it cannot write to. Figures here are drawn by Agg and need neither.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager

_NAME = "MPLBACKEND"


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Import without the environment's backend, which is put back, and without log lines."""
    log, given = logging.getLogger("matplotlib"), os.environ.get(_NAME)
    before = log.level
    log.setLevel(logging.ERROR)
    os.environ[_NAME] = "agg"
    try:
        yield
    finally:
        log.setLevel(before)
        del os.environ[_NAME]
        if given is not None:
            os.environ[_NAME] = given


with _undisturbed():
    import matplotlib as mpl
    import matplotlib.font_manager as fonts  # which may have to be found first

__all__ = ["fonts", "mpl"]
