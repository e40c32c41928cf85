"""The file of devices that may open the page of `drupe watch` over a network, with the hash of each token.

A token has 256 random bits, so its SHA-256 needs neither salt nor stretching.
"""

import hashlib
import hmac
import secrets
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline.files.plain_file import NotReadable, printable, read_text
from pipeline.files.whole_file import NotWritten, lock_of, put
from pipeline.problem import nearest, refused

MOST_BYTES = 1_000_000
"""Largest file of devices: 5,000 devices."""
MOST_NAME = 80
"""Most characters of a device's name."""


class KnownDevice(BaseModel):
    """A device by name, with the SHA-256 (hex) of its token."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    added_utc: datetime


class _Devices(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    devices: tuple[KnownDevice, ...] = ()


def read_devices(path: Path) -> tuple[KnownDevice, ...]:
    """The devices of a file. Raises BatchRefused if it is missing, unreadable or no file of devices."""
    try:
        return _Devices.model_validate_json(read_text(path, most_bytes=MOST_BYTES)).devices
    except NotReadable as fault:
        raise refused(path, f"{fault}; add a device with `drupe device add {path} NAME`.") from None
    except ValidationError:
        raise refused(path, "is no file of devices; name another file.") from None


def add_device(path: Path, name: str, *, now: datetime) -> str:
    """Adds a device and returns its token, which no file stores. Only the owner can read a new file. Raises
    BatchRefused for an invalid name, one in use, or as `read_devices`; NotWritten.
    """
    if not 0 < len(name) <= MOST_NAME or printable(name) != name:
        raise refused("NAME", f"must have 1 to {MOST_NAME} printable characters.")
    token = secrets.token_urlsafe(32)
    with _alone(path):
        devices = read_devices(path) if path.is_symlink() or path.exists() else ()
        if any(device.name == name for device in devices):
            raise refused("NAME", f'"{name}" has a token already; revoke it, or choose another name.')
        _write(path, (*devices, KnownDevice(name=name, sha256=hash_of(token), added_utc=now)))
    return token


def revoke_device(path: Path, name: str) -> None:
    """Removes a device; its token and sessions end at once. Raises BatchRefused for an unknown device."""
    read_devices(path)  # refuses before `_alone` creates the folder
    with _alone(path):
        devices = read_devices(path)
        left = tuple(device for device in devices if device.name != name)
        if len(left) == len(devices):
            names = [device.name for device in devices]
            raise refused("NAME", f'found "{name}"; {nearest(name, names, "the file has no such device.")}')
        _write(path, left)


def device_with(devices: Sequence[KnownDevice], token: str) -> KnownDevice | None:
    """The device with this token; None if unknown. The run time does not depend on matching characters."""
    given, owner = hash_of(token), None
    for device in devices:
        if hmac.compare_digest(device.sha256, given):
            owner = device
    return owner


def hash_of(token: str) -> str:
    """SHA-256 in hex."""
    return hashlib.sha256(token.encode()).hexdigest()


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Holds the file's lock in the block. Raises BatchRefused if another process holds it; NotWritten."""
    lock = path.with_name(f".{path.name}.lock")
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            held = stack.enter_context(lock_of(lock))
        except OSError as fault:
            raise NotWritten(path, fault) from fault
        if not held:
            raise refused(path, f"another process holds {lock.name}; end it, and try again.")
        yield


def _write(path: Path, devices: tuple[KnownDevice, ...]) -> None:
    """Only the owner can read a new file. An existing file keeps its mode, and under root its owner."""
    text = _Devices(devices=devices).model_dump_json(indent=1) + "\n"
    put(path, text.encode(), like=path.stat() if path.exists() else None, mode=0o600)
