"""The paper's method: the covariance that a trained PointNetKL predicts from the submap alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from pointnetkl import model_file, network, voxel
from pointnetkl.submap import Submap
from pointnetkl.voxel import Clouds


@dataclass(frozen=True)
class PointNetKL:
    """A trained network, with the voxels of the clouds that it was trained on."""

    name: ClassVar[str] = "pointnetkl"

    model: network.PointNetKL  # in evaluation mode
    voxel: float  # edge, as a share of the unit sphere's radius

    def covariance(self, submap: Submap) -> np.ndarray:
        """Return Q, (2, 2) in m^2, in the submap's frame; normalising and voxelising included.

        Raises:
            VoxelError: the submap has no extent, or a coordinate that is not a number.
        """
        cloud = voxel.canonical(submap.points, self.voxel, f"{submap.survey}, submap {submap.number}")
        return network.predict(self.model, cloud.points, cloud.radius)

    def predict(self, clouds: Clouds) -> np.ndarray:
        """Return Q (k, 2, 2) of clouds that are canonical already, in their order; each is judged alone."""
        each = (clouds.cloud(i) for i in range(len(clouds)))
        return np.stack([network.predict(self.model, cloud.points, cloud.radius) for cloud in each])


def load(path: Path) -> PointNetKL:
    """Read a trained network, and give torch one thread: submaps run in parallel, and sums keep their order.

    Raises:
        ModelFileError: the file is missing, damaged or holds something else.
    """
    stored = model_file.read(path)
    torch.set_num_threads(1)
    return PointNetKL(stored.model, stored.voxel)
