"""Identifies equal recordings: the same displacements and forces, whatever file they are in."""

import hashlib

import numpy as np

from tactile.readers.recording import GelPad, Recording


def recording_digest(recording: Recording) -> str:
    """SHA-256 of all pads' displacements and forces; two recordings share it only if every value agrees.

    Values count in single precision, as `write_recording` stores them, and pads in any order. A file that was
    written again has the same digest, even with other attributes or with its pads' names exchanged.
    """
    pads = []
    for pad in recording.pads:
        felt = (pad.displacement_mm, pad.force_N) if isinstance(pad, GelPad) else (pad.force_z_N,)
        digest = hashlib.sha256()
        for values in felt:
            digest.update(repr(values.shape).encode())
            digest.update((np.ascontiguousarray(values, dtype=np.float32) + np.float32(0)).tobytes())
        pads.append(digest.digest())
    return hashlib.sha256(b"".join(sorted(pads))).hexdigest()
