"""Tells before any photo is read whether drupe can use a model of the user's own."""

from collections.abc import Sequence
from pathlib import Path

from recon.learned.fruit_model import fruit_model, is_fruit_model
from recon.learned.geometry_model import geometry_session


def require_usable(model: Path, *, providers: Sequence[str]) -> None:
    """Opens the model and checks its inputs and outputs; does not run it.

    Raises ReconFailure (bad-geometry-model) that names the file and its fault.
    """
    if is_fruit_model(model, providers=providers):
        fruit_model(model, providers=providers)
    else:
        geometry_session(model, providers)
