"""The graph of a corrected survey as g2o: its submaps, their dead reckoning, and what accepted closures measure."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pointnetkl.correction.products.accepted import LESS, REFERENCE, Measurement, counted, measurements
from pointnetkl.correction.result import Corrected, CorrectionError, Submaps
from pointnetkl.exchange import g2o
from pointnetkl.slam.graph import pose_graph
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise, Edges
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import rotate

# Of what a closure does not measure, so that optimisers accept it: roll, pitch (1/rad^2) and z (1/m^2). That of yaw is
# larger, because a lever of 100 m weighs 1e10 times as much beside it, and nothing smaller would outlast rounding.
_WEAK, _WEAK_YAW = 1e-6, 1.0


def write(path: Path, corrected: Corrected, submaps: Submaps, edge_noise: Sequence[DeadReckoningNoise]) -> list[str]:
    """Write the graph in dialect g2o, at the corrected poses; return which closures it lacks.

    Raises:
        CorrectionError: there is not one noise for each pair of consecutive submaps.
        ArtifactError: the file cannot be written.
    """
    if len(edge_noise) != max(len(submaps.number) - 1, 0):
        raise CorrectionError(
            f"{path}: there are {len(edge_noise)} noises of dead reckoning for {len(submaps.number)} submaps, must be"
            " one between each two; give those of the survey's drift"
        )
    found, less = measurements(corrected, submaps)
    closures = [closure for closure in found if closure.target != REFERENCE]
    g2o.write(path, graph(submaps, closures, edge_noise), "g2o")
    on_reference = len(found) - len(closures)
    lacking = [counted(less, LESS)] * bool(less) + [counted(on_reference, "on a reference")] * bool(on_reference)
    return [f"{path.name} lacks {' and '.join(lacking)}"] if lacking else []


def graph(submaps: Submaps, closures: Sequence[Measurement], edge_noise: Sequence[DeadReckoningNoise]) -> g2o.Graph:
    """Return the graph of submaps and closures on submaps; its first node is held."""
    node = np.arange(len(submaps.number))
    odometry = [np.diag(pose_graph.sigmas(noise) ** -2.0) for noise in edge_noise]
    information = np.array([*odometry, *(_information(submaps, closure) for closure in closures)]).reshape(-1, 6, 6)
    measured = [_relative(submaps, closure) for closure in closures]
    edges = Edges(
        np.concatenate([node[:-1], np.array([closure.target for closure in closures], int)]),
        np.concatenate([node[1:], np.array([closure.source for closure in closures], int)]),
        np.concatenate([pose_graph.between(submaps.before), np.array(measured).reshape(-1, 4, 4)]),
    )
    return g2o.Graph(submaps.number, submaps.after, edges, information, node[:1])


def _relative(submaps: Submaps, closure: Measurement) -> np.ndarray:
    """Return the measured T_target_source: of the corrected poses, with the source where it registers."""
    moved = submaps.after[closure.source].copy()
    moved[:2, 3] += closure.residual
    return np.asarray(np.linalg.inv(submaps.after[closure.target]) @ moved)


def _information(submaps: Submaps, closure: Measurement) -> np.ndarray:
    """Return the information (6, 6), rotation first, in the source's frame: of the place of the overlap's middle."""
    to_source = rotate(np.eye(2), -pose.yaw_of(submaps.after[closure.source])).T
    held = np.linalg.inv(to_source @ closure.V @ to_source.T)
    # that place moves with x, y of the source's origin, and with yaw by the lever
    J = np.zeros((2, 6))
    J[:, 3:5], J[:, 2] = np.eye(2), (-closure.lever[1], closure.lever[0])
    information = J.T @ held @ J + np.diag([_WEAK, _WEAK, _WEAK_YAW, 0.0, 0.0, _WEAK])
    return np.asarray((information + information.T) / 2)
