"""One step of Algorithm 1 as the paper writes it, in plain NumPy: `loop_closure.close` takes the same step, faster.

This module is for reading; a test compares the two.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pointnetkl.registration import gicp, reference
from pointnetkl.slam.closures.loop_closure import Settings
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2


@dataclass(frozen=True)
class Node:
    """A submap of S_graph."""

    points: np.ndarray  # (n, 3) metres, in its own frame
    T_map_submap: np.ndarray  # (4, 4), corrected

    @property
    def cloud(self) -> np.ndarray:
        """The points in the map frame (n, 3)."""
        return pose.transform(self.T_map_submap, self.points)


def add(
    graph: list[Node], submap: Node, perturbation: SE2, spacing: float, settings: Settings, registration: gicp.Settings
) -> list[tuple[int, np.ndarray]]:
    """Add S_i to S_graph; return its loop closure edges, each k and T_k_i (4, 4) (Algorithm 1, lines 5 to 15).

    `perturbation` is a draw from O about the middle of S_i; `spacing` is that of neighbouring points, in metres.
    """
    cloud, cell, reach = submap.cloud, settings.cell_factor * spacing, (settings.overlap_factor or np.inf) * spacing
    # DetectLC: the earlier submaps that cover enough of S_i, but for the one just before it
    S_LC = [k for k, earlier in enumerate(graph[:-1]) if _covered(cloud, earlier.cloud, cell) >= settings.coverage]
    if not S_LC:
        graph.append(submap)
        return []
    origin = cloud.mean(axis=0)
    fused = np.concatenate([graph[k].cloud for k in S_LC]) - origin
    S_j = perturbation.act(cloud - origin)  # Perturb
    S_j = S_j[cKDTree(fused[:, :2]).query(S_j[:, :2])[0] < reach]  # points beyond would match the edge of the targets
    source, target = (reference.prepare(points, registration) for points in (S_j, fused))
    z_j, _, _ = reference.register(source, target, registration)  # GICP
    correction = (z_j @ perturbation).from_centre(origin[:2])
    corrected = Node(submap.points, correction.act_on_pose(submap.T_map_submap))  # Correct: S'_i
    graph.append(corrected)
    return [(k, np.linalg.inv(graph[k].T_map_submap) @ corrected.T_map_submap) for k in S_LC]  # AddLCedge


def _covered(cloud: np.ndarray, by: np.ndarray, cell_m: float) -> float:
    own, other = ({tuple(cell) for cell in np.floor(points[:, :2] / cell_m)} for points in (cloud, by))
    return len(own & other) / len(own)
