"""The SLAM benchmark: one graph, corrupted many times, optimised with every method's covariances (Table IV)."""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyarrow as pa
from tqdm import tqdm

from pointnetkl import metrics, pose, pose_graph, survey_graph
from pointnetkl.covariance import gaussian, table
from pointnetkl.errors import PointNetKLError
from pointnetkl.survey_graph import SurveyGraph

# A row per method and repetition; `navigation` has one row, all repetitions of it would be the same.
ROWS = pa.schema(
    [
        ("survey", pa.string()),
        ("method", pa.string()),
        ("repetition", pa.int32()),
        ("rmse_xyz_m", pa.float64()),  # against GT, not aligned
        ("rmse_se2_m", pa.float64()),  # against GT, turned and moved in the plane to fit best
        ("truth_rmse_xyz_m", pa.float64()),  # against the truth; null where it is not known
        ("truth_rmse_se2_m", pa.float64()),
        ("map_to_map_m", pa.float64()),  # null in the repetitions that do not measure it
    ]
)
# Of repetition 0, for figures; `which` is truth, navigation, gt, corrupted or a method.
TRAJECTORIES = pa.schema(
    [("survey", pa.string()), ("which", pa.string()), ("submap", pa.int32())]
    + [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "yaw_rad")]
)
MapError = Callable[[np.ndarray], float]


class SlamError(PointNetKLError):
    """The benchmark cannot run on these settings or covariances."""


@dataclass(frozen=True)
class Settings:
    """Section `slam` of the parameters."""

    seed: int
    repetitions: int
    yaw_sigma_rad: float
    edges: str
    map_to_map_repetitions: int
    map_cell_m: float
    map_thinning: int

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            SlamError: a setting is out of its range.
        """
        if self.edges not in ("all", "shared"):
            raise SlamError(f"slam.edges is {self.edges!r}, must be all or shared")
        if self.repetitions < 1 or self.yaw_sigma_rad < 0:
            raise SlamError(
                f"slam.repetitions is {self.repetitions} and yaw_sigma_rad {self.yaw_sigma_rad};"
                " they must be at least 1 and not negative"
            )


def corrupt(graph: SurveyGraph, repetition: int, settings: Settings) -> np.ndarray:
    """Return dead reckoning (n - 1, 4, 4) with noise on each edge's yaw, the same whatever the method."""
    seed = [settings.seed, zlib.crc32(graph.survey.encode()), repetition]
    exact = pose_graph.between(graph.gt)
    noise = np.random.default_rng(seed).normal(0.0, settings.yaw_sigma_rad, len(exact))
    turns = [pose.matrix(np.zeros(3), yaw) for yaw in noise]
    return exact @ np.array(turns).reshape(-1, 4, 4)


def weights(registration: np.ndarray, edges: str) -> np.ndarray:
    """Return what each edge's Q is multiplied by, (e,), given its registration (e,).

    `all`: 1, so that a registration counts once an edge (the paper); `shared`: its number of edges, so that it
    counts once.
    """
    if edges == "all" or len(registration) == 0:
        return np.ones(len(registration))
    return np.bincount(registration)[registration].astype(np.float64)


def by_method(covariances: pd.DataFrame) -> dict[str, dict[int, np.ndarray]]:
    """Return Q (M, M) by method and submap, of covariance tables joined; methods in their order there.

    Raises:
        CovarianceError: a Q is not a covariance.
        SlamError: there are two for one submap and method.
    """
    twice = covariances.duplicated(["method", "submap"])
    if twice.any():
        row = covariances[twice].iloc[0]
        raise SlamError(f"{row['method']} has two covariances for submap {row['submap']}; rename one of the methods")
    found: dict[str, dict[int, np.ndarray]] = {}
    rows = covariances[["method", "submap"]].itertuples(index=False)
    for (method, number), q in zip(rows, table.to_matrices(covariances), strict=True):
        found.setdefault(method, {})[int(number)] = gaussian.check(q, f"submap {number}, {method}")
    return found


def pose_graphs(
    graph: SurveyGraph, methods: Mapping[str, Mapping[int, np.ndarray]], edges: str
) -> dict[str, pose_graph.PoseGraph]:
    """Return each method's factors that no repetition changes: the held first node and the loop closures."""
    weight = weights(graph.closures.registration, edges)[:, None, None]
    made = {}
    for name, q in methods.items():
        edge_q = survey_graph.edge_covariances(graph.number, q, graph.closures, f"{graph.survey}, {name}")
        full = pose_graph.closure_covariances(edge_q * weight, graph.closure_noise, graph.closures.levers)
        made[name] = pose_graph.PoseGraph(graph.gt[0], graph.closures.edges, full)
    return made


def estimates(
    graph: SurveyGraph, methods: Mapping[str, Mapping[int, np.ndarray]], settings: Settings
) -> Iterator[tuple[str, int, np.ndarray]]:
    """Yield method, repetition and its poses (n, 4, 4); `navigation` first, and `corrupted` before its remedies."""
    yield "navigation", 0, graph.navigation
    graphs = pose_graphs(graph, methods, settings.edges)
    for repetition in tqdm(range(settings.repetitions), "slam", unit="repetition", mininterval=0.5):
        dead_reckoning = corrupt(graph, repetition, settings)
        corrupted = pose_graph.chain(graph.gt[0], dead_reckoning)
        yield "corrupted", repetition, corrupted
        for name, factors in graphs.items():
            yield name, repetition, factors.optimise(dead_reckoning, graph.dead_reckoning_noise, corrupted)


def benchmark(
    graph: SurveyGraph,
    methods: Mapping[str, Mapping[int, np.ndarray]],
    map_error: MapError,
    settings: Settings,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the benchmark's tables (ROWS, TRAJECTORIES) for covariances by method and submap.

    `map_error` gives the map-to-map error of poses (n, 4, 4) in metres. Progress is shown.
    """
    known = {"truth": graph.truth, "gt": graph.gt}
    trajectories = [_trajectory(graph, which, poses) for which, poses in known.items() if np.isfinite(poses).all()]
    rows = []
    for method, repetition, poses in estimates(graph, methods, settings):
        measured = repetition < settings.map_to_map_repetitions
        row = {"survey": graph.survey, "method": method, "repetition": repetition, **_errors(graph, poses)}
        rows.append({**row, "map_to_map_m": map_error(poses) if measured else np.nan})
        if repetition == 0:
            trajectories.append(_trajectory(graph, method, poses))
    return pd.DataFrame(rows), pd.concat(trajectories, ignore_index=True)


def clouds_of(graph: SurveyGraph, clouds: Mapping[int, np.ndarray]) -> Sequence[np.ndarray]:
    """Return the nodes' clouds, by submap number, in the nodes' order.

    Raises:
        SlamError: a node's submap has no cloud.
    """
    if missing := [int(number) for number in graph.number if int(number) not in clouds]:
        raise SlamError(f"{graph.survey}: submap {missing[0]} of the graph has no points; run dvc repro")
    return [clouds[int(number)] for number in graph.number]


def _errors(graph: SurveyGraph, poses: np.ndarray) -> dict[str, float]:
    position, gt, truth = (T[:, :3, 3] for T in (poses, graph.gt, graph.truth))
    return {
        "rmse_xyz_m": metrics.rmse(position, gt),
        "rmse_se2_m": metrics.rmse(metrics.align_se2(position, gt), gt),
        "truth_rmse_xyz_m": metrics.rmse(position, truth),
        "truth_rmse_se2_m": metrics.rmse(metrics.align_se2(position, truth), truth),
    }


def _trajectory(graph: SurveyGraph, which: str, poses: np.ndarray) -> pd.DataFrame:
    x, y, z = poses[:, :3, 3].T
    yaw = [pose.yaw_of(T) for T in poses]
    columns = {"submap": graph.number, "x_m": x, "y_m": y, "z_m": z, "yaw_rad": yaw}
    return pd.DataFrame({"survey": graph.survey, "which": which, **columns})
