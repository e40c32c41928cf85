"""A grasp model with two markers whose fields are placeholders."""

import numpy as np

from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import Sensitivity

BARE_MODEL = GraspModel(
    place_mm=np.zeros((2, 3)),
    normal=np.zeros((2, 3)),
    compliance=np.zeros((6, 6)),
    sensitivity=Sensitivity(causes=(), values=np.zeros((0, 3, 2, 3))),
    discretisation=0.01,
    fruit_moves=True,
)
