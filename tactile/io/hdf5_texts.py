"""Whether the HDF5 library comes to an end on a file's texts: one changed byte can make it loop for ever.

A text is kept in a heap whose entries tell where the next one begins; the library follows them without a
limit, in native code that no exception and no signal handler of Python's interrupts.
"""

import ctypes
import math
import os
import signal
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py

try:
    import resource
except ModuleNotFoundError:  # where processes cannot be forked either
    resource = None  # type: ignore[assignment]

PATIENCE_S = 10.0
"""A sound recording's attributes are read in 0.005 s."""
PR_SET_PDEATHSIG = 1
"""Of prctl(2): the signal that a process gets when the thread that made it ends."""
LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
"""Opened here, since a forked process should open nothing but the file."""


def texts_can_be_read(path: Path, *, patience_s: float = PATIENCE_S) -> bool:
    """Whether a process that reads the attributes of the file and of its groups ends within `patience_s`.

    Ends with an error counts too: the reader will say which. True where processes cannot be forked. The
    process ends with this one, however that ends: at an exception here, by the kernel when this process is
    killed (Linux), and after `patience_s` of processor time in any case.
    """
    if not hasattr(os, "fork"):
        return True
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child touches none of them
        child = os.fork()
    if child == 0:
        try:
            _end_with(parent, patience_s)
            _read(path)
        finally:
            os._exit(0)
    ended = False
    try:
        end = time.monotonic() + patience_s
        while not (ended := _has_ended(child)) and time.monotonic() < end:
            time.sleep(0.002)
    finally:
        if not ended:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
    return ended


def _has_ended(child: int) -> bool:
    """Also where the kernel has forgotten it already, since this process ignores SIGCHLD."""
    try:
        return os.waitpid(child, os.WNOHANG)[0] != 0
    except ChildProcessError:
        return True


def _end_with(parent: int, patience_s: float) -> None:
    """This process, the child, ends when its parent does, and when its time is up."""
    limit_s = math.ceil(patience_s) + 1
    hard_s = resource.getrlimit(resource.RLIMIT_CPU)[1]
    if hard_s == resource.RLIM_INFINITY or hard_s > limit_s:
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    if LIBC is not None:
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it ended before the kernel was told
            os._exit(1)


def _read(path: Path) -> None:
    """Every text of unstated length; links are not followed, and other values are small or refused unread."""
    with h5py.File(path, "r") as file:
        for group in (file, *_groups(file)):
            for name in group.attrs:
                text = h5py.check_string_dtype(group.attrs.get_id(name).dtype)
                if text is not None and text.length is None:
                    group.attrs[name]


def _groups(file: h5py.File) -> list[Any]:
    pads = _child(file, "pads")
    return [] if pads is None else [pads, *(one for name in pads if (one := _child(pads, name)) is not None)]


def _child(group: Any, name: str) -> Any:
    """The group of that name in `group`; None where there is none, or a link to one."""
    held = isinstance(group.get(name, getlink=True), h5py.HardLink)
    return group[name] if held and group.get(name, getclass=True) is h5py.Group else None
