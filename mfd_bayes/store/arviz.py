"""The import of ArviZ, which takes long, announces itself and writes a file."""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def import_arviz() -> Any:
    """ArviZ, imported without its announcements and also where no cache folder is writable.

    Where numba has not been imported before, ArviZ works without it in this process. Its own
    `arviz.Numba.enable_numba()` lets it use numba again.
    """
    with warnings.catch_warnings(), _hidden("bokeh.plotting", "bokeh.models", "numba"):
        # 0.23 announces its refactoring on the first import of a day
        warnings.simplefilter("ignore", FutureWarning)
        try:
            import arviz
        except OSError:  # it writes to the user's cache, which may be read-only
            os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="mfd_bayes-cache-")
            import arviz
    return arviz


@contextmanager
def _hidden(*modules: str) -> Iterator[None]:
    """Make modules that are not loaded yet seem to be missing.

    ArviZ 0.x imports bokeh for three docstrings, which takes three quarters of the time. It also
    imports numba, which takes 100 MB and is not needed for what is computed here.
    """
    loaded: dict[str, Any] = sys.modules
    hidden = [name for name in modules if name not in loaded]
    loaded |= dict.fromkeys(hidden)
    try:
        yield
    finally:
        for name in hidden:
            del loaded[name]
