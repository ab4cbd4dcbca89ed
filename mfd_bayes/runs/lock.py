"""The lock on a run folder: one process at a time works in it, and a second is told whose it is.

The lock itself is the system's, so that no way to end leaves it behind. Beside it the owner leaves
its name in the folder, for whom it refuses, and for a folder that machines share, where the
system's lock may not reach from one to another.
"""

from __future__ import annotations

import errno
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.store.files import read_json, write_json

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

OWNER = ".owner.json"
"""Name of the owner in a run folder, as long as it is at work."""

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Owner:
    """A process that works in a run folder.

    Attributes
    ----------
    host : str
        Name of its machine.
    boot : str
        What tells this machine, since it was started, from all others; the same in each of its
        containers. "" where the system has no such name.
    pid : int
    command : str
    since : str
        Date and time, UTC.
    """

    host: str
    boot: str
    pid: int
    command: str
    since: str

    def __str__(self) -> str:
        """Whom a second process is told of."""
        return f"{self.command!r}, process {self.pid} on {self.host} since {self.since}"

    @classmethod
    def here(cls) -> Owner:
        """Name of this process."""
        return cls(
            host=socket.gethostname(),
            boot=_BOOT.read_text(encoding="ascii").strip() if _BOOT.is_file() else "",
            pid=os.getpid(),
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            since=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        )

    @property
    def near(self) -> bool:
        """Whether it is, or was, a process of this machine."""
        us = Owner.here()
        return self.host == us.host or (self.boot != "" and self.boot == us.boot)

    @property
    def alive(self) -> bool:
        """Whether there is a process of its number, on this machine."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # it is another user's
            return True
        return True


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Make the folder and keep other processes from working in it until the end.

    Raises
    ------
    StoreError
        When the folder cannot be made, or another process works in it, or may.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot make the run folder {out}: {error.strerror}") from error
    handle = _lock(out)
    named = out / OWNER
    try:
        with suppress(StoreError):  # a full disk: what is worth saying of it will be said
            write_json(named, asdict(Owner.here()))
        with before_end(lambda: _remove(named)):
            yield
    finally:
        _remove(named)
        if handle is not None:
            os.close(handle)


def _remove(named: Path) -> None:
    with suppress(OSError):  # read-only by now: a name that is left is no lock
        named.unlink(missing_ok=True)


def _lock(out: Path) -> int | None:
    """Take the system's lock, where it has one, and say what holds it; its handle."""
    owner = _owner_of(out)
    handle = None if fcntl is None else os.open(out, os.O_RDONLY)
    try:
        sure = handle is not None and _locked(handle, out, owner)
        if owner is not None and not owner.near:
            raise StoreError(
                f"{out} may be in use: it bears the name of {owner}, and this machine cannot see "
                f"whether that still runs; let it end, or, where it is dead, remove {out / OWNER}"
            )
        if owner is not None and not sure and owner.pid != os.getpid() and owner.alive:
            raise StoreError(_refusal(out, owner))
    except StoreError:
        if handle is not None:
            os.close(handle)
        raise
    return handle


def _locked(handle: int, out: Path, owner: Owner | None) -> bool:
    """Whether the system has locked the folder for this process.

    It has not where its file system knows no locks; then the owner's name is all there is.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno == errno.EWOULDBLOCK:
            raise StoreError(_refusal(out, owner)) from None
        return False
    return True


def _refusal(out: Path, owner: Owner | None) -> str:
    alive = owner is not None and (not owner.near or owner.alive)  # and no name that was left
    named = f": {owner}" if alive else ""
    return f"another process is calibrating into {out}{named}: let it end"


def _owner_of(out: Path) -> Owner | None:
    """Who left its name in a folder; None where nobody did, or what is left cannot be read."""
    try:
        owner = Owner(**read_json(out / OWNER))
    except (StoreError, TypeError):
        return None
    texts = (owner.host, owner.boot, owner.command, owner.since)
    named = all(isinstance(text, str) for text in texts)
    known = isinstance(owner.pid, int) and 0 < owner.pid < 2**31
    return owner if named and known else None
