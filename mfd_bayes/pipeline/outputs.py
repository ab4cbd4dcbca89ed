"""Guards what a command writes where its user says: nothing else is replaced."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import is_of_run, name_in_run
from mfd_bayes.store.files import cannot_remove, check_place, write_bytes

_PNG = b"\x89PNG\r\n\x1a\n"
_MARK = b"Software\0mfd-bayes"
_HEAD = 64 * 1024  # bytes of a file in which it shows what wrote it


@dataclass(frozen=True)
class Output:
    """A file that a command writes where its user says.

    Attributes
    ----------
    path : Path
    ours : callable
        Whether the beginning of a file is that of one which this program wrote here before.
    """

    path: Path
    ours: Callable[[bytes], bool]


def table_with(*columns: str) -> Callable[[bytes], bool]:
    """Function that knows a CSV table by its first columns, behind any lines of comments."""
    head = ",".join(columns).encode()

    def ours(content: bytes) -> bool:
        lines = content.splitlines()
        first = next((line for line in lines if not line.startswith(b"#")), b"")
        return first.startswith(head)

    return ours


def is_picture(content: bytes) -> bool:
    """Whether a PNG is marked, or bare with a table of colours, as older versions wrote it."""
    kinds = dict(_chunks(content))
    bare = content[25:26] == b"\x03" and set(kinds) <= {b"IHDR", b"PLTE", b"IDAT", b"IEND"}
    return is_marked(content) or (bool(kinds) and bare)


def is_marked(content: bytes) -> bool:
    """Whether a PNG has the mark of `write_picture`."""
    return (b"tEXt", _MARK) in _chunks(content)


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kinds and contents of the chunks of a PNG; none where it is no PNG."""
    at = len(_PNG) if content.startswith(_PNG) else len(content)
    while at + 8 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        yield kind, content[at + 8 : at + 8 + size]
        at += 12 + size


def write_picture(path: Path, png: bytes) -> None:
    """Write a PNG with a mark by which it is known when it is written again."""
    end = len(_PNG) + 25  # of the header, which is always first
    chunk = b"tEXt" + _MARK
    packed = struct.pack(">I", len(_MARK)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    write_bytes(path, png[:end] + packed + png[end:])


def check_outputs(outputs: Sequence[Output], inputs: Iterable[Path], *, force: bool) -> None:
    """Refuse outputs that would replace what this command did not write.

    Parameters
    ----------
    outputs : sequence of Output
    inputs : iterable of Path
        Files that the command reads.
    force : bool
        Whether a file of another program may be replaced.

    Raises
    ------
    StoreError
        When an output names no file, is an input, a file of a run, a device, a pipe or a link out
        of its folder; or exists, is not of this program, and `force` is not given.
    """
    read = list(inputs)
    for output in outputs:
        path = output.path
        if path.name in ("", ".."):
            raise StoreError(f"cannot write {path}: give the name of a file")
        check_place(path)
        try:
            if path.is_dir():
                raise StoreError(f"cannot write {path}: it is a folder; give the name of a file")
            _check_free(output, read, force=force)
        except (OSError, RuntimeError, ValueError) as error:
            raise StoreError(f"cannot write {path}: {error}") from error


def known(output: Output) -> bool:
    """Whether an output exists and is one that this program wrote there."""
    return output.path.is_file() and output.ours(_beginning(output.path))


def remove_known(output: Output) -> None:
    """Remove an output that this program wrote there, if there is one.

    Raises
    ------
    StoreError
        When it cannot be removed.
    """
    try:
        if known(output):
            output.path.unlink()
    except OSError as error:
        raise cannot_remove(output.path, error) from error


def _check_free(output: Output, inputs: Iterable[Path], *, force: bool) -> None:
    path = output.path
    for read in inputs:
        both = path.exists() and read.exists()
        if path.resolve() == read.resolve() or (both and path.samefile(read)):
            raise StoreError(f"cannot write {path}: it is an input of this command, {read}")
    ours = known(output)
    name = name_in_run(path)
    if name is not None and is_of_run(name) and not ours and (path.exists() or len(name.parts) < 2):
        raise StoreError(f"cannot write {path}: it is a file of the run in that folder")
    if path.is_file() and not ours and not force:
        raise StoreError(
            f"{path} exists, and this command did not write it: give another name, or --force "
            "to replace it"
        )


def _beginning(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD)
