"""A hash of all that arrays and frozen records hold, by which stages are kept."""

import hashlib
from dataclasses import fields, is_dataclass

import numpy as np


def content_hash(*contents: object) -> str:
    """SHA-256 of arrays, dataclasses and sequences of them, down to each number; of anything else its repr.

    >>> content_hash(np.arange(3), "pad") == content_hash(np.arange(3), "pad") != content_hash(np.arange(4))
    True
    """
    digest = hashlib.sha256()
    for content in contents:
        if isinstance(content, np.ndarray):
            digest.update(f"{content.dtype} {content.shape}".encode())
            digest.update(np.ascontiguousarray(content).tobytes())
        elif isinstance(content, list | tuple):
            digest.update(content_hash(*content).encode())
        elif is_dataclass(content):
            held = (getattr(content, field.name) for field in fields(content))
            digest.update(content_hash(*held).encode())
        else:
            digest.update(repr(content).encode())
        digest.update(b";")
    return digest.hexdigest()
