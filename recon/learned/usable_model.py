"""Tells before any photo is read whether drupe can use a model of the user's own."""

from collections.abc import Sequence
from pathlib import Path

from recon.learned.fruit_model import fruit_model_of, has_fruit_output
from recon.learned.geometry_model import require_geometry_model
from recon.learned.onnx_session import opened


def require_usable(model: Path, *, providers: Sequence[str]) -> None:
    """Opens the model and checks its inputs and outputs; does not run it.

    Raises ReconFailure (bad-geometry-model) that names the file and its fault.
    """
    session = opened(model, providers)
    if has_fruit_output(session):
        fruit_model_of(model, session)
    else:
        require_geometry_model(model, session)
