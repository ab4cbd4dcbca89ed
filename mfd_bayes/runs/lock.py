"""The lock on a run folder: one process at a time works in it; a second one is refused.

The lock is the operating system's, on the folder itself, and ends with its owner. The owner also
writes its name into the folder: a process that is refused reports it; and where machines share
the folder, the system's lock may not reach from one to another, but the name does.
(`filelock.FileLock` leaves a file behind, and raises where the file system has no locks.)
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
_BOOT = Path("/proc/sys/kernel/random/boot_id")  # the same in each container of a machine


@dataclass(frozen=True)
class Owner:
    """A process that works in a run folder; `boot` is the id of the running system, or ""."""

    host: str
    boot: str
    pid: int
    command: str
    since: str

    def __str__(self) -> str:
        """Its name in messages."""
        return f"{self.command!r}, process {self.pid} on {self.host} since {self.since}"

    @classmethod
    def here(cls) -> Owner:
        """The process that asks."""
        boot = _BOOT.read_text(encoding="ascii").strip() if _BOOT.is_file() else ""
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        since = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        return cls(socket.gethostname(), boot, os.getpid(), command, since)

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
        except PermissionError:  # another user's
            pass
        return True


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Make the folder and keep other processes from working in it until the end."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot make the run folder {out}: {error.strerror}") from error
    name = out / OWNER

    def leave() -> None:
        with suppress(OSError):  # a read-only disk: a name that is left behind is no lock
            name.unlink(missing_ok=True)

    handle = None if fcntl is None else os.open(out, os.O_RDONLY)
    try:
        _take(handle, out)
        try:
            with suppress(StoreError):  # a full disk: the first result reports it
                write_json(name, asdict(Owner.here()))
            with before_end(leave):
                yield
        finally:
            leave()
    finally:
        if handle is not None:
            os.close(handle)


def _take(handle: int | None, out: Path) -> None:
    """Take the system's lock, where it has one; refuse a folder that another process may hold."""
    owner, locked = _owner_of(out), False
    elsewhere = owner is not None and not owner.on_this_machine
    lives = owner is not None and (elsewhere or owner.alive)
    refusal = f"another process is working in {out}{f': {owner}' if lives else ''}: let it end"
    if handle is not None:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            locked = True
        except OSError as error:  # any other: the file system has no locks
            if error.errno == errno.EWOULDBLOCK:
                raise StoreError(refusal) from None
    if elsewhere:
        raise StoreError(
            f"{out} may be in use: its owner is {owner}, and this machine cannot see whether "
            f"that still runs; let it end, or, if it has ended, remove {out / OWNER}"
        )
    if not locked and lives and owner is not None and owner.pid != os.getpid():
        raise StoreError(refusal)


def other_owner(out: Path) -> str:
    """Words that name another process which works in a folder: ": …"; "" where none is known."""
    owner = _owner_of(out)
    return "" if owner is None or owner.pid == os.getpid() else f": {owner}"


def _owner_of(out: Path) -> Owner | None:
    """Owner that a folder names; None where it names none, or the name cannot be read."""
    try:
        owner = Owner(**read_json(out / OWNER))
    except (StoreError, TypeError):
        return None
    texts = (owner.host, owner.boot, owner.command, owner.since)
    valid = isinstance(owner.pid, int) and 0 < owner.pid < 2**31
    return owner if valid and all(isinstance(text, str) for text in texts) else None
