"""Some points of a prepared cloud as the source of a registration, for a fraction of the time of preparing them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration.gicp import kernel, normals
from pointnetkl.registration.gicp.registration import Cloud, Settings

_NO_NEIGHBOURS = np.empty(0, np.float32), np.empty((0, 0), np.uint32)  # which only noisy copies ask for


@dataclass(frozen=True)
class Part:
    """Points of a cloud with the normals that they have without its others; a source for `register` alone."""

    points: np.ndarray  # (n, 3) float64, metres
    normals: np.ndarray  # (n, 3) float32, unit, upwards

    def as_source(self, target: Cloud, move: np.ndarray) -> kernel.Source:
        """Return the points, moved by (3,) metres, as the kernel takes them, in the axes of the target's centre."""
        points = np.ascontiguousarray((self.points - target.centre + move).T, np.float32)
        return kernel.Source(points, self.normals.reshape(-1), *_NO_NEIGHBOURS)


def part(cloud: Cloud, keep: np.ndarray, settings: Settings) -> Part:
    """Return the points of a cloud that `keep` (n,) names, at least settings.neighbours of them.

    Their normals are those that `prepare` would give them: of a point whose neighbours are kept, the cloud's own.
    """
    points, found = cloud.points[keep], cloud.normals[keep]
    changed = np.flatnonzero(~keep[cloud.lists[keep]].all(axis=1))
    if len(changed):
        _, lists = cKDTree(points).query(points[changed], np.arange(1, settings.neighbours + 1))
        around = normals.neighbourhoods(points - cloud.centre, lists)
        found[changed] = normals.of_neighbourhoods(around, len(changed))
    return Part(points, found)
