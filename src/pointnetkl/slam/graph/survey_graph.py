"""The pose graph of one survey, which every method optimises, and its arrays on disk.

It has poses by navigation, by "GT" (navigation optimised with the Monte Carlo covariances, which stands for the truth
in the paper) and by the truth where it is known. Its edges are dead reckoning between neighbours, taken from GT, and
the loop closures of Algorithm 1, registered from perturbed GT poses. There are several draws of the closures, each with
its own perturbations, because all closures of one draw depend on the same ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pointnetkl.slam.graph import pose_graph, trajectory_error
from pointnetkl.slam.graph.pose_graph import ClosureNoise, DeadReckoningNoise, Edges
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow.errors import PointNetKLError

_KINDS = ("edge", "registration", "rejected")  # of rows in each draw


class SurveyGraphError(PointNetKLError):
    """A survey's graph cannot be made, or its file is damaged."""


@dataclass(frozen=True)
class Closures:
    """Edges from each registered submap to every submap that it was registered to; nodes count from 0."""

    edges: Edges  # e of them, from target k to source i > k
    registration: np.ndarray  # (e,) the registration that an edge comes from
    node: np.ndarray  # (r,) node i of each registration
    start: np.ndarray  # (r, M) start of the registration relative to the node's pose: metres in the map frame, and yaw
    correction: np.ndarray  # (r, M) its end, likewise
    converged: np.ndarray  # (r,) bool; the others stopped at the last iteration, as some of the labels' do
    rejected: np.ndarray  # nodes that returned to mapped ground but had no point to match: no edge
    centroid: np.ndarray | None = None  # (n, 2) of each node's points, in its frame; only with yaw (M = 3)

    @property
    def levers(self) -> np.ndarray | None:
        """Return the centroids (e, 2) of the edges' sources, the origins of their Q and errors; None for M = 2."""
        return None if self.centroid is None else self.centroid[self.edges.source]


@dataclass(frozen=True)
class SurveyGraph:
    """One survey's nodes (its n submaps, in the order of the track) and edges."""

    survey: str
    number: np.ndarray  # (n,) of the submap at each node
    navigation: np.ndarray  # (n, 4, 4) T_map_submap
    gt: np.ndarray  # (n, 4, 4)
    truth: np.ndarray  # (n, 4, 4), NaN where it is not known
    draws: tuple[Closures, ...]
    dead_reckoning_noise: DeadReckoningNoise
    closure_noise: ClosureNoise
    track: bool = True  # whether a vehicle went from node to node; if not, there are no edges to optimise

    @property
    def closures(self) -> Closures:
        """Return the loop closures of the first draw: the paper's graph."""
        return self.draws[0]


def edge_covariances(
    numbers: Sequence[int] | np.ndarray, q: Mapping[int, np.ndarray], closures: Closures, origin: str
) -> np.ndarray:
    """Return each edge's Q_i (e, M, M), the covariance of its source, which is the registered submap.

    Raises:
        SurveyGraphError: a submap that closes a loop has no covariance, or one of other dimensions.
    """
    m = 2 if closures.centroid is None else 3
    sources = [int(numbers[i]) for i in closures.edges.source]
    if missing := [number for number in sources if number not in q]:
        raise SurveyGraphError(f"{origin}: submap {missing[0]} closes a loop and has no covariance; run dvc repro")
    if wrong := [number for number in sources if q[number].shape != (m, m)]:
        raise SurveyGraphError(
            f"{origin}: the covariance of submap {wrong[0]} has the shape {q[wrong[0]].shape}, and the graph's"
            f" registrations have {m} dimensions; run dvc repro"
        )
    return np.array([q[number] for number in sources]).reshape(-1, m, m)


def full_covariances(
    numbers: Sequence[int] | np.ndarray,
    q: Mapping[int, np.ndarray],
    closures: Closures,
    noise: ClosureNoise,
    origin: str,
    edges: str = "all",
) -> np.ndarray:
    """Return the covariances (e, 6, 6) of closures with Q (M, M) by submap, as pose_graph takes them.

    With `edges` "all" a registration counts once for each of its edges (the paper); with "shared" Q is multiplied by
    the number of edges, so that the registration counts once.

    Raises:
        SurveyGraphError: as edge_covariances.
    """
    edge_q = edge_covariances(numbers, q, closures, origin)
    if edges == "shared":
        edge_q = edge_q * np.bincount(closures.registration)[closures.registration, None, None]
    return pose_graph.closure_covariances(edge_q, noise, closures.levers)


def errors(closures: Closures, poses: np.ndarray) -> np.ndarray:
    """Return each edge's error (e, M) against poses T_map_submap (n, 4, 4), in the source's frame.

    Metres, and with yaw the logarithm of the residual about the centroid of the source's points, as the labels' errors.
    """
    edges, centroid = closures.edges, closures.levers
    expected = np.linalg.inv(poses[edges.target]) @ poses[edges.source]
    return residual_errors(np.linalg.inv(edges.T_target_source) @ expected, centroid)


def residual_errors(residual: np.ndarray, centroid: np.ndarray | None) -> np.ndarray:
    """Return residuals (n, 4, 4), identity at best, as errors (n, M): M = 2, or 3 with the centroids (n, 2)."""
    if centroid is None:
        return np.asarray(residual[:, :2, 3])
    return SE2.from_matrix(residual).from_centre(-centroid).log()


def registration_errors(closures: Closures, poses: np.ndarray) -> np.ndarray:
    """Return each registration's error (r, M), the mean of its edges' errors."""
    e = errors(closures, poses)
    count = np.bincount(closures.registration, minlength=len(closures.node))
    sums = [np.bincount(closures.registration, e[:, axis], len(count)) for axis in range(e.shape[1])]
    return np.stack(sums, -1) / count[:, None]


def summary(graph: SurveyGraph) -> dict[str, Any]:
    """Return counts of the paper's graph, and the distances between navigation, GT and the truth."""
    closures = graph.closures

    def error(a: np.ndarray, b: np.ndarray) -> float | None:
        return None if np.isnan(b).any() else trajectory_error.rmse(a[:, :3, 3], b[:, :3, 3])

    return {
        "submaps": len(graph.number),
        "dead_reckoning_edges": len(graph.number) - 1 if graph.track else 0,
        "loop_closures": len(closures.edges.source),
        "registrations": len(closures.node),
        "registrations_converged": int(closures.converged.sum()),
        "registrations_rejected": len(closures.rejected),
        "loop_closures_by_draw": [len(closures.edges.source) for closures in graph.draws],
        "navigation_rmse_xyz_m": error(graph.navigation, graph.gt),
        "navigation_truth_rmse_xyz_m": error(graph.navigation, graph.truth),
        "gt_truth_rmse_xyz_m": error(graph.gt, graph.truth),
    }


def to_arrays(graph: SurveyGraph) -> dict[str, np.ndarray]:
    """Return the graph as named arrays, with the errors of its loop closures against GT and against the truth.

    Rows of `edge_*`, `registration_*` and `rejected_*` are those of all draws, one after the other; `*_draw` holds a
    row's draw.
    """
    draws = [_draw_arrays(closures, graph.gt, graph.truth) for closures in graph.draws]
    rows = {name: np.concatenate([arrays[name] for arrays in draws]) for name in draws[0]}
    for kind in _KINDS:
        counts = [len(arrays[f"{kind}_node" if kind != "edge" else "edge_source"]) for arrays in draws]
        rows[f"{kind}_draw"] = np.repeat(np.arange(len(draws)), counts)
    centroid = graph.closures.centroid
    return {
        "survey": np.array(graph.survey),
        "number": graph.number,
        "navigation": graph.navigation,
        "gt": graph.gt,
        "truth": graph.truth,
        "dead_reckoning": pose_graph.between(graph.gt if graph.track else graph.gt[:1]),
        "dead_reckoning_sigmas": pose_graph.sigmas(graph.dead_reckoning_noise),
        "closure_sigmas": pose_graph.sigmas(graph.closure_noise),
        "draws": np.array(len(graph.draws)),
        **({} if centroid is None else {"node_centroid_m": centroid}),
        **({} if graph.track else {"track": np.array(False)}),
        **rows,
    }


def from_arrays(arrays: Mapping[str, np.ndarray]) -> SurveyGraph:
    """Return the graph that `to_arrays` wrote.

    Raises:
        SurveyGraphError: an array is missing.
    """
    try:
        return SurveyGraph(
            survey=str(arrays["survey"]),
            number=arrays["number"],
            navigation=arrays["navigation"],
            gt=arrays["gt"],
            truth=arrays["truth"],
            draws=tuple(_closures(arrays, draw) for draw in range(int(arrays["draws"]))),
            dead_reckoning_noise=DeadReckoningNoise(*arrays["dead_reckoning_sigmas"].tolist()),
            closure_noise=ClosureNoise(*arrays["closure_sigmas"].tolist()),
            track=bool(arrays.get("track", True)),
        )
    except KeyError as error:
        raise SurveyGraphError(f"the graph lacks {error}; delete it and run dvc repro") from error


def _draw_arrays(closures: Closures, gt: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "edge_target": closures.edges.target,
        "edge_source": closures.edges.source,
        "edge_measured": closures.edges.T_target_source,
        "edge_registration": closures.registration,
        "edge_error_gt_m": errors(closures, gt),
        "edge_error_truth_m": errors(closures, truth),
        "registration_node": closures.node,
        "registration_start_m": closures.start,
        "registration_correction_m": closures.correction,
        "registration_error_gt_m": registration_errors(closures, gt),
        "registration_error_truth_m": registration_errors(closures, truth),
        "registration_converged": closures.converged,
        "rejected_node": closures.rejected,
    }


def _closures(arrays: Mapping[str, np.ndarray], draw: int) -> Closures:
    edge, registration, rejected = (arrays[f"{kind}_draw"] == draw for kind in _KINDS)
    return Closures(
        edges=Edges(*(arrays[f"edge_{name}"][edge] for name in ("target", "source", "measured"))),
        registration=arrays["edge_registration"][edge],
        node=arrays["registration_node"][registration],
        start=arrays["registration_start_m"][registration],
        correction=arrays["registration_correction_m"][registration],
        converged=arrays["registration_converged"][registration],
        rejected=arrays["rejected_node"][rejected],
        centroid=arrays.get("node_centroid_m"),
    )
