"""Limits on the size and the structure of an HDF5 file, checked before its data are read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import h5py

OBJECTS = 20_000  # most groups and data sets of a file
_NAMED = 60  # characters of a name that are shown
# Only the filters of MATLAB and NetCDF files are allowed: a plugin would be foreign code.
_DEFLATE, _SHUFFLE, _CHECKSUM = 1, 2, 3


class UnsafeError(Exception):
    """Raised for every file that is refused here; the message follows the file's name."""


def check_objects(file: h5py.File, most: int, *, plain: bool = False) -> None:
    """Refuse a file that refers to other files, has circular links or declares too much.

    At most `most` bytes of numbers may be declared; with `plain`, nothing but unpacked numbers,
    as this program writes them. The heaps are checked first: the library reads texts from them
    when it looks at objects.
    """
    check_heaps(file)
    declared = 0
    for dataset in _datasets(file):
        shown = repr(str(dataset.name)[-_NAMED:])
        layout = dataset.id.get_create_plist()
        if layout.get_external_count() or dataset.is_virtual:
            raise UnsafeError(f"takes {shown} from another file")
        packed = [layout.get_filter(i)[0] for i in range(layout.get_nfilters())]
        if packed.count(_DEFLATE) > 1 or set(packed) - {_DEFLATE, _SHUFFLE, _CHECKSUM}:
            raise UnsafeError(f"packs {shown} in a way that is not read")
        if plain and (packed or dataset.dtype.kind not in "fiub"):
            raise UnsafeError(f"holds {shown}, which is packed or no numbers")
        size = dataset.dtype.itemsize
        chunk = math.prod(map(int, dataset.chunks or ())) * size
        declared += max(math.prod(map(int, dataset.shape or ())) * size, chunk)
        if declared > most:
            raise UnsafeError(
                f"declares {declared / 1e6:,.0f} MB of numbers, {shown} among them; at most "
                f"{most / 1e6:,.0f} MB are read"
            )


def check_heaps(file: h5py.File) -> None:
    """Refuse a file with a heap of texts in which the HDF5 library would never stop reading.

    A global heap is a header of 16 bytes, then one object after another, each behind its number
    and size. The library steps from one to the next by these sizes alone, and does not move on
    where one is 0 (HDF5 File Format Specification, III.E).
    """
    if file.id.get_create_plist().get_sizes() != (8, 8):
        raise UnsafeError("has sizes of other than 8 bytes")
    path = Path(file.filename)
    if not path.stat().st_size:
        return
    with path.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as content:
        for found in re.finditer(rb"GCOL\x01\0\0\0", content):
            _check_heap(content, found.start())


def _check_heap(content: mmap, begin: int) -> None:
    """Step through a global heap as the library does, and refuse one that does not end."""
    end = begin + int.from_bytes(content[begin + 8 : begin + 16], "little")
    if end > len(content):
        raise UnsafeError("has a heap of texts that goes on beyond its end")
    at = begin + 16
    while at + 16 <= end:
        number = int.from_bytes(content[at : at + 2], "little")
        size = int.from_bytes(content[at + 8 : at + 16], "little")
        step = 16 + (size + 7) // 8 * 8 if number else size  # number 0 is free space
        if not 0 < step <= end - at:
            raise UnsafeError("has a heap of texts whose sizes do not fit")
        at += step


def _datasets(file: h5py.File) -> Iterator[h5py.Dataset]:
    """Every data set of a file in which no object has two places and no link leads elsewhere."""
    import h5py

    seen: set[int] = set()
    groups: list[h5py.Group] = [file]
    while groups:
        group = groups.pop()
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise UnsafeError(f"has a link to elsewhere, {name[:_NAMED]!r}")
            item = group[name]
            address = h5py.h5o.get_info(item.id).addr
            if address in seen or address == h5py.h5o.get_info(file.id).addr:
                raise UnsafeError(f"holds {name[:_NAMED]!r} in two places")
            seen.add(address)
            if len(seen) > OBJECTS:
                raise UnsafeError(f"has more than {OBJECTS:,} parts")
            if isinstance(item, h5py.Group):
                groups.append(item)
            elif isinstance(item, h5py.Dataset):
                yield item
