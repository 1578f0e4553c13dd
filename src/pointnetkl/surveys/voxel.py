"""Canonical clouds, the network's input: zero-mean, in the unit sphere, one point a voxel."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError


class VoxelError(PointNetKLError):
    """A cloud cannot be normalised, or stored clouds do not fit together."""


@dataclass(frozen=True)
class Settings:
    """Section `voxelise` of the parameters.

    Raises:
        ValueError: the voxel's edge is not between 0.0001 and 1.
    """

    voxel: float  # edge, as a share of the unit sphere's radius

    def __post_init__(self) -> None:
        """Refuse a voxel that would hold the whole sphere, or whose number in a grid would overflow."""
        if not 1e-4 <= self.voxel <= 1:
            raise ValueError(f"voxel is {self.voxel:g}, must be between 0.0001 and 1: a share of the radius")


@dataclass(frozen=True)
class Canonical:
    """A normalised, voxelised cloud: points (n, 3) float32 in the unit sphere, which had `radius` metres (rho)."""

    points: np.ndarray
    radius: float


@dataclass(frozen=True)
class Clouds:
    """The canonical clouds of one survey, end to end."""

    submap: np.ndarray  # (k,) int32
    offset: np.ndarray  # (k + 1,) int64: cloud i is points[offset[i]:offset[i + 1]]
    points: np.ndarray  # (n, 3) float32
    radius: np.ndarray  # (k,) float64, metres

    def __len__(self) -> int:
        """Return the number of clouds."""
        return len(self.submap)

    def cloud(self, index: int) -> Canonical:
        """Return the cloud at an index in the survey's order, which is not its submap's number."""
        return Canonical(self.points[self.offset[index] : self.offset[index + 1]], float(self.radius[index]))

    @classmethod
    def join(cls, numbers: Sequence[int], clouds: Sequence[Canonical]) -> "Clouds":
        """Return the clouds of submaps with these numbers, end to end."""
        sizes = [0, *(len(cloud.points) for cloud in clouds)]
        return cls(
            np.array(numbers, np.int32),
            np.cumsum(sizes, dtype=np.int64),
            np.concatenate([np.empty((0, 3), np.float32), *(cloud.points for cloud in clouds)]),
            np.array([cloud.radius for cloud in clouds], np.float64),
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that artifacts.write_arrays stores."""
        return {"submap": self.submap, "offset": self.offset, "points": self.points, "radius": self.radius}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], origin: str = "clouds") -> "Clouds":
        """Return the clouds of arrays read by artifacts.read_arrays; `origin` is named in the error.

        Raises:
            VoxelError: an array is missing, or they do not fit together.
        """
        if missing := [name for name in ("submap", "offset", "points", "radius") if name not in arrays]:
            raise VoxelError(f"{origin}: lacks the array {missing[0]}; was it made by another stage?")
        clouds = cls(arrays["submap"], arrays["offset"], arrays["points"], arrays["radius"])
        if not _fit_together(clouds):
            raise VoxelError(f"{origin}: its arrays do not fit together; delete it and run voxelise again")
        return clouds


def canonical(points: np.ndarray, voxel: float, origin: str = "a submap") -> Canonical:
    """Return points (n, 3), in metres, moved to zero mean, scaled into the unit sphere and voxelised.

    The points of a voxel are replaced by their mean; rows are sorted. `origin` is named in the error.

    Raises:
        VoxelError: a coordinate is not a number, or all points are in one place.
    """
    import open3d  # imported here, because it takes 1.7 s and reading clouds does not need it

    unit, radius = normalised(points, origin)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(unit))
    rows = np.asarray(cloud.voxel_down_sample(voxel).points).astype(np.float32)
    # sorted, because open3d returns voxels in the order of a hash map
    return Canonical(rows[np.lexsort(rows.T[::-1])], radius)


def normalised(points: np.ndarray, origin: str = "a submap") -> tuple[np.ndarray, float]:
    """Return points (n, 3) scaled to zero mean and a largest norm of 1, float64, and their radius before, metres.

    Raises:
        VoxelError: a coordinate is not a number, or all points are in one place.
    """
    if not len(points) or not np.isfinite(points).all():
        raise VoxelError(f"{origin}: has no points, or one that is not a number; run segment again")
    centred = np.asarray(points - points.mean(axis=0), np.float64)
    radius = float(np.linalg.norm(centred, axis=1).max())
    if radius <= 0:
        raise VoxelError(f"{origin}: all its {len(points)} points are in one place; drop the submap")
    return centred / radius, radius


def sigma_z(clouds: Clouds) -> float:
    """Return the standard deviation of z over all normalised points of a survey (sigma_z of Table I)."""
    return float(np.std(clouds.points[:, 2], dtype=np.float64))


def _fit_together(clouds: Clouds) -> bool:
    count, offset = clouds.submap.size, clouds.offset
    shapes = [array.shape for array in (clouds.submap, offset, clouds.radius)] == [(count,), (count + 1,), (count,)]
    points = clouds.points.ndim == 2 and clouds.points.shape[1] == 3
    return bool(
        shapes and points and offset[0] == 0 and offset[-1] == len(clouds.points) and np.all(np.diff(offset) > 0)
    )
