"""The lock on a run folder: one process at a time works in it; a second one is refused.

The lock is the operating system's, on the folder itself: however the owner ends, the lock ends with
it, and no lock file is left. The owner also writes a file with its name into the folder. A process
that is refused reports that name; and where machines share the folder, the system's lock may not
reach from one machine to another, but the name does.

`filelock.FileLock` would leave a lock file in the folder, and raise where the file system has no
locks.
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
"""File in a run folder that names the owner of the lock."""

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Owner:
    """The owner of a lock: a process that works in a run folder."""

    host: str
    """Name of its machine."""
    boot: str
    """Linux's id of the running system, the same in each container of a machine; or ""."""
    pid: int
    command: str
    since: str
    """Date and time, UTC."""

    def __str__(self) -> str:
        """Sentence part that a process is shown when it is refused."""
        return f"{self.command!r}, process {self.pid} on {self.host} since {self.since}"

    @classmethod
    def here(cls) -> Owner:
        """Owner that this process is."""
        return cls(
            host=socket.gethostname(),
            boot=_BOOT.read_text(encoding="ascii").strip() if _BOOT.is_file() else "",
            pid=os.getpid(),
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            since=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        )

    @property
    def on_this_machine(self) -> bool:
        """Whether it is, or was, a process of this machine, in whatever container."""
        here = Owner.here()
        return self.host == here.host or (self.boot != "" and self.boot == here.boot)

    @property
    def alive(self) -> bool:
        """Whether this machine has a process with its number."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:  # another user's process
            return True
        return True


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Make the folder and keep other processes from working in it until the end.

    Raises
    ------
    StoreError
        When the folder cannot be made, or another process works in it, or may do so.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot make the run folder {out}: {error.strerror}") from error
    handle = _lock(out)
    name = out / OWNER
    try:
        with suppress(StoreError):  # a full disk: the first result reports it
            write_json(name, asdict(Owner.here()))
        with before_end(lambda: _remove(name)):
            yield
    finally:
        _remove(name)
        if handle is not None:
            os.close(handle)


def _remove(name: Path) -> None:
    with suppress(OSError):  # the disk is read-only: a name that is left behind is no lock
        name.unlink(missing_ok=True)


def _lock(out: Path) -> int | None:
    """Handle of the locked folder; None where the system has no such locks."""
    owner = _owner_of(out)
    handle = None if fcntl is None else os.open(out, os.O_RDONLY)
    try:
        locked = handle is not None and _locked(handle, out, owner)
        if owner is not None and not owner.on_this_machine:
            raise StoreError(
                f"{out} may be in use: its owner is {owner}, and this machine cannot see whether "
                f"that still runs; let it end, or, if it has ended, remove {out / OWNER}"
            )
        if owner is not None and not locked and owner.pid != os.getpid() and owner.alive:
            raise StoreError(_refusal(out, owner))
    except StoreError:
        if handle is not None:
            os.close(handle)
        raise
    return handle


def _locked(handle: int, out: Path, owner: Owner | None) -> bool:
    """Whether this process got the system's lock; False where the file system has no locks.

    Raises
    ------
    StoreError
        When another process has the lock.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno == errno.EWOULDBLOCK:
            raise StoreError(_refusal(out, owner)) from None
        return False
    return True


def _refusal(out: Path, owner: Owner | None) -> str:
    """Sentence that refuses a second process; it names the owner unless that has ended."""
    alive = owner is not None and (not owner.on_this_machine or owner.alive)
    named = f": {owner}" if alive else ""
    return f"another process is working in {out}{named}: let it end"


def worker_in(out: Path) -> str:
    """Words that name another process which works in a folder: ": …"; "" where none is known."""
    owner = _owner_of(out)
    known = owner is not None and owner.pid != os.getpid()
    return f": {owner}" if known and owner is not None else ""


def _owner_of(out: Path) -> Owner | None:
    """Owner that a folder names; None where it names none, or the name cannot be read."""
    try:
        owner = Owner(**read_json(out / OWNER))
    except (StoreError, TypeError):
        return None
    texts = (owner.host, owner.boot, owner.command, owner.since)
    valid = isinstance(owner.pid, int) and 0 < owner.pid < 2**31
    return owner if valid and all(isinstance(text, str) for text in texts) else None
