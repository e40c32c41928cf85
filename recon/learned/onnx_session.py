"""ONNX sessions with one thread, on the first provider that the machine has."""

import difflib
import os
from collections.abc import Sequence
from pathlib import Path

os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # before the import, which would store and send a device ID
import numpy as np
import onnxruntime

from pipeline.files.limited_memory import free_memory_MiB, limited_memory
from recon.learned.onnx_file import bad_model, model_files, require_onnx

INPUT = "images"
SIZES, MOST_MORE_BYTES = 3, 1_000_000_000
"""Memory to load a model: this multiple of its files (constants are copied), plus this many bytes."""
SHARE_OF_FREE = 0.75
"""Share of the free memory that one run of a model may take. Set by hand."""
UNKNOWN_MIB = 1e6
"""Assumed free memory (MiB) if the system reports none: practically no limit."""


def providers_fault(providers: Sequence[str]) -> str:
    """The fault of a list of providers, as "found ...; expected ..."; empty for a valid list.

    ONNX Runtime must know each provider, and this machine must have one of them.
    """
    known, here = onnxruntime.get_all_providers(), onnxruntime.get_available_providers()
    for name in providers:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"this machine has {', '.join(here)}."
            return f'found "{name}"; expected names of ONNX Runtime\'s providers: {hint}'
    if not set(providers) & set(here):
        fault = f"found {', '.join(providers)}" if providers else "found an empty list"
        return f"{fault}; expected one that this machine has: {', '.join(here)}."
    return ""


def opened(model: Path, providers: Sequence[str]) -> onnxruntime.InferenceSession:
    """A session on the first of `providers` that this machine has and that starts.

    Raises ReconFailure (bad-geometry-model) for a missing file, a file that is no ONNX model, or if the
    machine has no such provider.
    """
    require_onnx(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    known = onnxruntime.get_available_providers()
    usable = [name for name in providers if name in known]
    if not usable:
        raise bad_model(
            model,
            f"was asked to run on {', '.join(providers) or 'no provider'}, which this machine's "
            "onnxruntime does not offer",
            f"one of {', '.join(known)} in providers",
        )
    most = SIZES * sum(path.stat().st_size for path in model_files(model)) + MOST_MORE_BYTES
    try:
        with limited_memory(most):
            # onnxruntime's own fallback prints
            return onnxruntime.InferenceSession(str(model), options, providers=usable, enable_fallback=0)
    except Exception as error:  # onnxruntime raises its own classes, all straight from Exception
        if len(usable) > 1:  # a graphics processor that does not start, for example
            return opened(model, usable[1:])
        raise bad_model(
            model,
            f"is damaged, of a kind that onnxruntime cannot load, or takes more than {most / 1e6:.0f} MB",
            "an ONNX model",
        ) from error


def ran(
    model: Path,
    session: onnxruntime.InferenceSession,
    outputs: Sequence[str],
    images: np.ndarray,
    *,
    signature: str,
    most_bytes: int | None = None,
) -> list[np.ndarray]:
    """Outputs of the model for `images`, its one input, with at most `most_bytes` more memory.

    None: SHARE_OF_FREE of the memory that is free in this machine or control group. Raises ReconFailure
    (bad-geometry-model) that states `signature`, the expected shape of `images`.
    """
    if most_bytes is None:
        free_MiB = free_memory_MiB()
        most_bytes = int(SHARE_OF_FREE * (UNKNOWN_MIB if free_MiB is None else free_MiB) * 2**20)
    try:
        with limited_memory(most_bytes):
            return list(session.run(list(outputs), {INPUT: images}))
    except Exception as error:  # onnxruntime raises its own classes, all straight from Exception
        raise bad_model(
            model, f"failed while it ran ({error})", f"a model that runs on images {signature}"
        ) from error
