"""Matplotlib, imported so that neither the environment's backend nor its home matters.

A notebook gives its programs a backend that other environments do not have, and Matplotlib writes
to stderr where it cannot write to its home. Figures here are drawn by Agg and need neither.
"""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _quiet_agg() -> Iterator[None]:
    """Import with the backend Agg and without log lines; both are put back."""
    log, backend = logging.getLogger("matplotlib"), os.environ.get("MPLBACKEND")
    level = log.level
    log.setLevel(logging.ERROR)
    os.environ["MPLBACKEND"] = "agg"
    try:
        yield
    finally:
        log.setLevel(level)
        del os.environ["MPLBACKEND"]
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


with _quiet_agg():
    import matplotlib as mpl
    import matplotlib.font_manager as fonts  # which may have to be made first

__all__ = ["fonts", "mpl"]
