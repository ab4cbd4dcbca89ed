"""Text, JSON and bytes: a file is written completely or not at all."""

from __future__ import annotations

import json
import os
import secrets
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import StoreError
from mfd_bayes.records.inputs import why_invalid, why_no_file

PART = ".part"
_LARGEST_JSON = 64 * 2**20


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file under a temporary name in its folder, which is made, then rename it."""
    check_place(path)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}{PART}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("xb") as file:  # with the modes that the umask leaves
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # the folder became read-only; the next run removes it
            part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: object) -> None:
    """Write valid JSON atomically; numbers that are not finite become null."""
    write_text(path, json_text(content, indent=2) + "\n")


def json_text(content: object, indent: int | None = None) -> str:
    """Valid JSON; numbers that are not finite become null."""
    return json.dumps(_to_json(content), indent=indent, allow_nan=False)


def _to_json(content: object) -> object:
    if isinstance(content, Mapping):
        return {str(key): _to_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_to_json(value) for value in content]
    if isinstance(content, np.ndarray | np.generic):
        return _to_json(content.tolist())
    if isinstance(content, float):
        return content if np.isfinite(content) else None
    return str(content) if isinstance(content, Path) else content


def read_json(path: Path) -> dict[str, Any]:
    """Object of a JSON file."""
    try:
        if reason := why_no_file(path):
            raise StoreError(f"{path} {reason}")
        if path.stat().st_size > _LARGEST_JSON:
            raise StoreError(f"{path} is larger than {_LARGEST_JSON >> 20} MB: not of this program")
        content = json.loads(path.read_text(encoding="utf-8"))
        json.dumps(_to_json(content), ensure_ascii=False).encode()  # it can be written again
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is not valid JSON: {why_invalid(error)}") from error
    if not isinstance(content, dict):
        raise StoreError(f"{path} must hold a JSON object")
    return content


def check_place(path: Path) -> None:
    """Refuse a place in which a file would replace something that is no file of its folder."""
    try:
        if path.is_symlink() and not path.resolve().is_relative_to(path.parent.resolve()):
            raise StoreError(f"cannot write {path}: it is a link out of its folder")
        mode = path.stat().st_mode if path.exists() else stat.S_IFREG
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, too long a name
        reason = getattr(error, "strerror", None) or str(error)
        raise StoreError(f"cannot write {path}: {reason}") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # a folder is refused by the system
        raise StoreError(f"cannot write {path}: it is a device or a pipe, and would be replaced")


def is_part(path: Path, name: str) -> bool:
    """Whether a file is a temporary one of `name` that a killed process left."""
    return path.name.startswith(f".{name}.") and path.suffix == PART


def remove_file(path: Path) -> None:
    """Remove a file if it is there."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_remove(path, error) from error


def cannot_remove(path: Path, error: OSError) -> StoreError:
    """Error that says what cannot be removed, and why."""
    return StoreError(f"cannot remove {error.filename or path}: {error.strerror or error}")
