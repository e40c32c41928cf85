"""Whether the HDF5 library comes to an end on a file's texts: one changed byte can make it loop for ever.

A text is kept in a heap whose entries tell where the next one begins; the library follows them without a
limit, in native code that no exception and no signal handler of Python's interrupts.
"""

import os
import signal
import time
import warnings
from pathlib import Path
from typing import Any

import h5py

PATIENCE_S = 10.0
"""A sound recording's attributes are read in 0.005 s."""


def texts_can_be_read(path: Path, *, patience_s: float = PATIENCE_S) -> bool:
    """Whether a process that reads the attributes of the file and of its groups ends within `patience_s`.

    Ends with an error counts too: the reader will say which. True where processes cannot be forked.
    """
    if not hasattr(os, "fork"):
        return True
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child touches none of them
        child = os.fork()
    if child == 0:
        try:
            _read(path)
        finally:
            os._exit(0)
    end = time.monotonic() + patience_s
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return False
        time.sleep(0.002)
    return True


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
