"""Files are whole or not there, and JSON is valid."""

import errno
import json
import os

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.store.files import read_json, write_bytes, write_json, write_text


def test_a_write_that_fails_leaves_the_old_file_and_no_part(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    write_text(path, "old")
    for error, raised, words in (
        (OSError(errno.ENOSPC, "No space left on device"), StoreError, "html: No space left"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
    ):

        def full(_, error=error):
            raise error

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(raised, match=words):
            write_text(path, "half of the new")
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]


def test_folders_are_made_and_files_keep_the_umask(tmp_path):
    path = tmp_path / "a" / "b" / "x.bin"
    umask = os.umask(0o077)
    try:
        write_bytes(path, b"\x00\xff")
    finally:
        os.umask(umask)
    assert path.read_bytes() == b"\x00\xff"
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.parent.stat().st_mode & 0o777 == 0o700


def test_json_is_valid_though_a_figure_is_not_finite(tmp_path):
    path = tmp_path / "manifest.json"
    numbers = {"inf": [np.inf, np.nan, 1.5], "f": np.float32("nan"), "i": np.int64(3)}
    objects = {"t": (1, np.bool_(True)), "path": tmp_path, 4: None, "µ": "Größe \U0001f600"}
    write_json(path, numbers | objects)
    expected = {"inf": [None, None, 1.5], "f": None, "i": 3, "t": [1, True]}
    expected |= {"path": str(tmp_path), "4": None, "µ": "Größe \U0001f600"}
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == read_json(path) == expected


def test_a_file_that_holds_no_json_object_is_named(tmp_path):
    path = tmp_path / "manifest.json"
    for content in (None, b"{", b"[1, 2]", b"\xff\xfe", b"[" * 100_000):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(StoreError, match=r"manifest\.json"):
            read_json(path)
