"""The covariance that a trained model predicts from the submap alone: PointNetKL, the paper's method, and `network`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pointnetkl import model, model_file, voxel
from pointnetkl.model_file import Stored
from pointnetkl.submap import Submap


@dataclass(frozen=True)
class Trained:
    """A trained model, by the name that its file has."""

    name: str
    stored: Stored

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (M, M) in m^2 and radians, in the submap's frame.

        Raises:
            VoxelError, MeanFieldError: the submap has no extent, or a coordinate that is not a number.
        """
        origin = f"{submap.survey}, submap {submap.number}"
        return model.predict(self.stored.model, inputs(self.stored, submap.points, origin))[0]


def inputs(stored: Stored, points: np.ndarray, origin: str) -> tuple[np.ndarray, ...]:
    """Return what a stored model takes of one submap's points (n, 3), metres: every preprocessing step.

    Raises:
        VoxelError, MeanFieldError: as Trained.covariance; VoxelError begins with `origin`.
    """
    if describe := stored.model.describe:
        return (describe(points)[None],)
    cloud = voxel.canonical(points, stored.voxel, origin)
    return cloud.points[None], np.array([cloud.radius], np.float32)


def load(path: Path) -> Trained:
    """Read a trained model, and give torch one thread: submaps run in parallel, and sums keep their order.

    Raises:
        ModelFileError: the file is missing, damaged or holds something else.
    """
    stored = model_file.read(path)
    torch.set_num_threads(1)
    return Trained(path.stem, stored)
