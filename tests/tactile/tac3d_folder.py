"""A Tac3D folder as the maker's recorder writes it, of a press that is known."""

from pathlib import Path

import numpy as np

FRAMES = 40
X, Y = np.meshgrid(np.arange(6.0) - 2.5, np.arange(6.0) - 2.5)
REST = np.stack([X.ravel() + 0.4, Y.ravel() - 0.3, 11.0 - 0.03 * (X**2 + Y**2).ravel()], axis=1)
KN, KT = 0.5, 0.2


def press_of(time_s: np.ndarray) -> np.ndarray:
    """Depth over time: air, a ramp, a hold with a wobble."""
    return np.clip((time_s - 0.4) / 0.4, 0, 1) * (0.5 + 0.08 * np.sin(9 * time_s))


def write_sensor(
    folder: Path, *, clock_s: float = 0.0, starts_s: float = 0.0, lost: tuple[int, ...] = ()
) -> Path:
    rng = np.random.default_rng(7)
    time_s = starts_s + np.arange(FRAMES) / 30
    near = np.exp(-(REST[:, 0] ** 2 + REST[:, 1] ** 2) / 4)
    moved = press_of(time_s)[:, None, None] * near[:, None] * [0.3, 0.1, -1.0]
    touched = press_of(time_s) > 0
    moved = moved + rng.normal(scale=0.001, size=moved.shape) * touched[:, None, None]
    force = moved * [KT, KT, KN]
    kept = np.setdiff1d(np.arange(FRAMES), lost)
    arrays = {
        "index": 500 + kept,
        "sendTimestamp": clock_s + time_s[kept],
        "3D_Positions": (REST + moved)[kept],
        "3D_Displacements": moved[kept],
        "3D_Forces": force[kept],
    }
    folder.mkdir(parents=True)
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", values)
    return folder
