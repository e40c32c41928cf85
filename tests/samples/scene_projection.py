"""Where points of a scene lie in its photos, by what cameras_truth.json says."""

import numpy as np


def projected(points: np.ndarray, cameras: dict, k: int) -> np.ndarray:
    """Pixels (centre of the first pixel (0, 0)) from what cameras_truth.json holds."""
    view = cameras["views"][k]
    seen = points @ np.array(view["R"]).T + view["t"]
    middle = np.array([cameras["width"] - 1, cameras["height"] - 1]) / 2
    return np.asarray(view["f"] * seen[:, :2] / seen[:, 2:] + middle)
