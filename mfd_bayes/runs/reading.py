"""Reading of a run folder in which another process may begin to work meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import MANIFEST
from mfd_bayes.runs.lock import worker_in
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.store.files import read_json

_SAME = ("status", "started", "finished", "seed", "files")
"""Keys of the manifest that differ where what is stored is not that of the same run."""


@contextmanager
def reading(folder: Path, manifest: Manifest) -> Iterator[None]:
    """Say where a run was changed while it was read; what was read may be of two runs then.

    Parameters
    ----------
    folder : Path
    manifest : Manifest
        Of the run, as it was read first.

    Raises
    ------
    StoreError
        When the manifest in the folder is no longer that of the same run.
    """
    try:
        yield
    except StoreError as error:
        _check_same(folder, manifest, error)
        raise
    _check_same(folder, manifest)


def _check_same(folder: Path, manifest: Manifest, error: StoreError | None = None) -> None:
    try:
        now = read_json(folder / MANIFEST)
    except StoreError:
        now = {}
    before = manifest.content
    if any(_plain(before.get(key)) != now.get(key) for key in _SAME):
        raise StoreError(
            f"the run in {folder} was changed by another process while it was read"
            f"{worker_in(folder)}; wait until that has ended, and try again"
        ) from error


def _plain(value: object) -> object:
    """Value as JSON gives it back."""
    return dict(value) if isinstance(value, Mapping) else value
