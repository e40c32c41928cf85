"""Writes files whole or not at all; the error on a place that cannot be written names cause and remedy."""

import errno
import fcntl
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

WAIT_S = 30.0
"""Seconds that a process waits for the lock; writing one file takes less than one. Set by hand."""
LOOK_S = 0.01
"""Seconds between two attempts to lock the file."""


@contextmanager
def lock_of(path: Path, *, wait_s: float = WAIT_S) -> Iterator[bool]:
    """Inside the block this process holds the lock of the file at `path`; creates the file if it is missing.

    Yields False if another process still holds the lock after `wait_s`, else True. A file system without
    locks yields True at once. Raises OSError if the file cannot be created, or if `path` is a link.
    """
    until = time.monotonic() + wait_s
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o660)
        try:
            held = locked(lock)
            if held and not _is_at(lock, path):
                continue  # another process removed the file before this lock: it excludes nobody
            if held or time.monotonic() > until:
                yield held
                return
        finally:
            os.close(lock)
        time.sleep(LOOK_S)


def locked(lock: int) -> bool:
    """Locks an open file. False if another process holds it; True if the file system has no locks."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _is_at(lock: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(lock), path.lstat())
    except OSError:
        return False


MARK = ".drupe-part-"
"""Part of the name of every unfinished file, so that drupe recognises those that killed runs left."""
_UNFINISHED = re.compile(r"\..+" + re.escape(MARK) + r"[a-z0-9_]{8}")
_ELSEWHERE = "or choose another place"
_ADVICE = {
    errno.ENOSPC: f"free space on that disk, {_ELSEWHERE}.",
    errno.EDQUOT: f"your share of that disk is used up; free some of it, {_ELSEWHERE}.",
    errno.EROFS: "choose another place.",
    errno.EACCES: f"ask for the right to write there, {_ELSEWHERE}.",
    errno.EPERM: f"ask for the right to write there, {_ELSEWHERE}.",
    errno.EFBIG: f"raise the limit on the size of files (ulimit -f), {_ELSEWHERE}.",
    errno.EIO: f"the disk may be failing; {_ELSEWHERE[3:]}.",
}
"""Advice on a failed write, by the system's error number."""
MACHINE_FAULTS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EIO})
"""Error numbers of failed writes that the machine causes, not the input or the program."""


class NotWritten(OSError):
    """Raised if a file cannot be written; the text names the file, the cause and the remedy."""

    def __init__(self, path: Path, cause: OSError) -> None:
        self._path, self._cause = path, cause
        super().__init__(cause.errno, cause.strerror or str(cause), str(path))

    def __str__(self) -> str:
        advice = _ADVICE.get(self.errno or 0, "choose another place.")
        return f"{self._path}: cannot be written ({self.strerror}); {advice}"

    def __reduce__(self) -> tuple[type["NotWritten"], tuple[Path, OSError]]:
        """Pickles path and cause, so that the error passes between processes."""
        return type(self), (self._path, OSError(self.errno, self.strerror))


def put(path: Path, data: bytes, *, mode: int = 0o666, like: os.stat_result | None = None) -> None:
    """Writes `data` to `path` so that a reader, or a run killed meanwhile, never sees half a file.

    A link at `path` is replaced, not followed. `mode`: the file's permissions, less the umask. `like`: a file
    whose permissions it takes instead, and also the owner if root writes it. Raises NotWritten.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path.parent, name=path.name)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}{MARK}")
        try:
            with os.fdopen(handle, "wb") as file:
                with suppress(OSError):  # without locks, `sweep` removes nothing either
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
                umask = os.umask(0)
                os.umask(umask)
                if like is not None and os.geteuid() == 0:
                    os.chown(name, like.st_uid, like.st_gid)
                Path(name).chmod(mode & ~umask if like is None else like.st_mode & 0o777)
                Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise NotWritten(path, error) from error


def sweep(folder: Path, *, name: str = "") -> None:
    """Removes unfinished files (of the file `name`, or all) that killed runs left in `folder`.

    Such a file has the name of an unfinished file; see `remove_unless_held`.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            if _UNFINISHED.fullmatch(path.name) and path.name.startswith(f".{name}{MARK}" if name else "."):
                remove_unless_held(path)


def remove_unless_held(path: Path, *, folder: bool = False) -> None:
    """Removes a plain file, or a `folder`, that belongs to this user and that no process locks."""
    of_kind, access = (stat.S_ISDIR, os.O_RDONLY) if folder else (stat.S_ISREG, os.O_RDWR)
    with suppress(OSError):
        handle = os.open(path, access | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(handle)
            if of_kind(status.st_mode) and status.st_uid == os.geteuid():
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True) if folder else path.unlink()
        finally:
            os.close(handle)
