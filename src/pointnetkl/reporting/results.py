"""What the report is made from: every stage's artifacts, found by survey, read and brought together.

Only the columns that a report needs are asked of a table, so that a stage may add to its own.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pointnetkl.registration.covariance import table
from pointnetkl.reporting import terrain
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.surveys import submap, survey, voxel
from pointnetkl.workflow import artifacts
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.study import Study

GOLD = "monte_carlo"  # the labels themselves, as a method: their KL to themselves says nothing
OURS = "network"  # whom the others are compared with, pair by pair

_COVARIANCE = [(name, pa.float64()) for name in ("q_xx_m2", "q_xy_m2", "q_yy_m2")]
_WENT = [  # how a label's registrations went
    *[(name, pa.float64()) for name in ("relative_error", "mean_x_m", "mean_y_m")],
    *[(name, pa.float64()) for name in ("converged_share", "main_basin_share", "iterations_mean")],
]
_LABEL = [("submap", pa.int32()), ("runs", pa.int32()), ("spacing_m", pa.float64()), *_COVARIANCE, *_WENT]
LABELS = pa.schema([*_LABEL, ("self_matching", pa.bool_())])
_VARIED = [("noise_sigma_m", pa.float64()), ("cell_m", pa.float64()), ("points", pa.int32())]
VARIATIONS = pa.schema([*((name, pa.string()) for name in ("survey", "study", "copy")), *_VARIED, *_LABEL])
_RMSES = [f"{against}rmse_{aligned}_m" for against in ("", "truth_") for aligned in ("xyz", "se2", "4dof")]
SLAM_ERRORS = (*_RMSES, "map_to_map_m", "map_to_map_auvlib_m", "pose_nees")  # of one solution
_RUN = [("variant", pa.string()), ("method", pa.string()), ("draw", pa.int32()), ("repetition", pa.int32())]
SLAM = pa.schema([*_RUN, *((name, pa.float64()) for name in (*SLAM_ERRORS, "truth_relative_m"))])
TRAJECTORIES = pa.schema(
    [("which", pa.string()), ("submap", pa.int32()), *((n, pa.float64()) for n in ("x_m", "y_m", "z_m", "yaw_rad"))]
)
_EVERY = (
    "surveys/{}/pings.parquet",
    "surveys/{}/soundings.parquet",
    "submaps/{}.parquet",
    "submaps/{}_poses.parquet",
    "clouds/{}.npz",
    "labels/{}.parquet",
    "labels/{}_errors.npz",
)
_TESTED = (
    "variations/{}.parquet",
    "covariances/{}_estimated.parquet",
    "covariances/{}_predicted.parquet",
    "graphs/{}.npz",
    "closures/{}.parquet",
    "closures/{}_covariances.parquet",
)
_SLAM = (
    "slam/{}.parquet",
    "slam/{}_trajectories.parquet",
    "slam/{}_consistency.tif",
    "slam/{}_map_thinning.parquet",
    "robustness/{}.parquet",
    "robustness/{}_gate.parquet",
)
_TRAINED = ("train/{}.csv", "train/{}.json")


class ResultsError(PointNetKLError):
    """An artifact that the report needs is missing, or does not belong to the others."""


@dataclass(frozen=True)
class Settings:
    """Section `report` of the parameters."""

    seed: int  # of the bootstrap
    kl_floor_m2: float  # added to label and estimate wherever KL is judged
    cell_factor: float  # a footprint's cell, in point spacings: fewer and a swath has holes
    block_submaps: int  # neighbours that the bootstrap draws together
    terrain_classes: terrain.Settings


@dataclass(frozen=True)
class Folders:
    """Where the stages' artifacts are."""

    data: Path
    models: Path
    reports: Path

    def expected(self, study: Study) -> Iterator[Path]:
        """Yield every file that a report of the study is made from."""
        for name in study.surveys:
            yield from (self.data / each.format(name) for each in _EVERY)
        for name in study.test:
            yield from (self.data / each.format(name) for each in _TESTED)
            yield from (self.reports / each.format(name) for each in _SLAM)
        for name in study.models:
            yield from (self.reports / each.format(name) for each in _TRAINED)
        yield self.reports / "runtime.json"
        yield self.models / "fits.json"

    def demand(self, study: Study) -> None:
        """Refuse to begin while an artifact is missing.

        Raises:
            ResultsError: names the first one.
        """
        missing = [path for path in self.expected(study) if not path.is_file()]
        if missing:
            raise ResultsError(
                f"{missing[0]}: is missing, and {len(missing) - 1} more of the files that the surveys of"
                " study in params.yaml must have; run dvc repro, or take the survey out of study"
            )


@dataclass(frozen=True)
class Labels:
    """A survey's Monte Carlo labels, by submap."""

    submap: np.ndarray  # (k,)
    q: np.ndarray  # (k, M, M) in m and rad
    spacing_m: np.ndarray  # (k,) median distance of a point to its nearest
    self_matching: np.ndarray  # (k,) whether the points lie too far apart for the copy to be a fair one
    rows: pd.DataFrame  # schema LABELS, all of the above and how the registrations went
    parameters: dict[str, Any]

    @property
    def eigenvalues(self) -> np.ndarray:
        """The eigenvalues (k, 2) of the labels in x, y, m^2, the smaller first."""
        return np.asarray(np.linalg.eigvalsh(self.q[:, :2, :2]))


@dataclass(frozen=True)
class Test:
    """What a test survey adds: every method's covariances, errors to judge them by, and SLAM."""

    covariances: Mapping[str, np.ndarray]  # by method: (k, M, M), in the order of the labels
    held_out: np.ndarray  # (k, H, M) registration errors, metres and radians, that no label has seen
    slam: pd.DataFrame  # schema SLAM
    trajectories: pd.DataFrame  # schema TRAJECTORIES
    gt: np.ndarray  # (n, 4, 4) T_map_submap of navigation optimised with the labels
    loop_closures: np.ndarray  # (e, 2) nodes k and i of each edge
    registered: np.ndarray  # (r,) submaps whose registrations the edges come from
    registration_errors: np.ndarray  # (r, M) against the truth in the submap's frame, metres; NaN where not known
    track: bool = True  # tiles of points have none: no edges, and no row or trajectory of SLAM


def read_labels(folders: Folders, name: str) -> Labels:
    """Read a survey's labels."""
    path = folders.data / f"labels/{name}.parquet"
    rows = artifacts.read_table(path, LABELS, also=table.YAW)
    number, spacing, matching = (rows[column].to_numpy() for column in ("submap", "spacing_m", "self_matching"))
    return Labels(number, table.to_matrices(rows), spacing, matching, rows, artifacts.table_metadata(path))


def read_test(folders: Folders, name: str, labels: Labels) -> Test:
    """Read what a test survey adds to its labels.

    Raises:
        ResultsError: a method or the held-out errors are of other submaps than the labels.
    """
    covariances = {}
    for stage in ("estimated", "predicted"):
        path = folders.data / f"covariances/{name}_{stage}.parquet"
        for method, rows in artifacts.read_table(path, table.SCHEMA, also=table.YAW).groupby("method", sort=False):
            rows = rows.sort_values("submap")
            _same_submaps(path, rows["submap"].to_numpy(), labels, str(method))
            covariances[str(method)] = table.to_matrices(rows)
    path = folders.data / f"labels/{name}_errors.npz"
    errors, _ = artifacts.read_arrays(path)  # `errors` of it, the labels' own, ends in NaN where a label stopped early
    _same_submaps(path, errors["submap"], labels, "the held-out errors")
    graph, _ = artifacts.read_arrays(folders.data / f"graphs/{name}.npz")
    first = graph["registration_draw"] == 0
    return Test(
        covariances=covariances,
        held_out=errors["held_out"],
        slam=artifacts.read_table(folders.reports / f"slam/{name}.parquet", SLAM),
        trajectories=artifacts.read_table(folders.reports / f"slam/{name}_trajectories.parquet", TRAJECTORIES),
        gt=graph["gt"],
        loop_closures=np.stack([graph["edge_target"], graph["edge_source"]], -1)[graph["edge_draw"] == 0],
        registered=graph["number"][graph["registration_node"][first]],
        registration_errors=graph["registration_error_truth_m"][first],
        track=bool(graph.get("track", True)),
    )


def read_canonical(folders: Folders, name: str) -> voxel.Clouds:
    """Read a survey's normalised clouds."""
    path = folders.data / f"clouds/{name}.npz"
    return voxel.Clouds.from_arrays(artifacts.read_arrays(path)[0], str(path))


def read_variations(folders: Folders, study: Study) -> pd.DataFrame:
    """Read the test surveys' labels under varied conditions, one table of schema VARIATIONS."""
    paths = (folders.data / f"variations/{name}.parquet" for name in study.test)
    every = [artifacts.read_table(path, VARIATIONS, also=table.YAW) for path in paths]
    return pd.concat([VARIATIONS.empty_table().to_pandas(), *every], ignore_index=True)


def read_points(folders: Folders, name: str) -> tuple[list[np.ndarray], pd.DataFrame]:
    """Read a survey's registration clouds, (n_i, 3) metres in submap frames, and its poses (submap.POSES)."""
    path = folders.data / f"submaps/{name}.parquet"
    rows = artifacts.read_table(path, submap.POINTS, [("part", "==", submap.WHOLE)])
    poses = artifacts.read_table(folders.data / f"submaps/{name}_poses.parquet", submap.POSES)
    number, points = rows["submap"].to_numpy(), rows[["x_m", "y_m", "z_m"]].to_numpy(np.float64)
    order = np.argsort(number, kind="stable")
    found, starts = np.unique(number[order], return_index=True)
    if not np.array_equal(found, poses["submap"].to_numpy()):
        raise ResultsError(f"{path}: its submaps are not those of their poses; run dvc repro segment@{name}")
    return np.split(points[order], starts[1:]), poses


def read_frame(folders: Folders, name: str) -> tuple[np.ndarray, str]:
    """Read the origin (2,) of a survey's map frame, and the CRS that it is given in."""
    origin, crs = consistency_map.read_origin(folders.data / f"surveys/{name}/pings.parquet")
    return np.array(origin), crs


def read_pings(folders: Folders, name: str) -> pd.DataFrame:
    """Read a survey's pings (survey.PINGS)."""
    return artifacts.read_table(folders.data / f"surveys/{name}/pings.parquet", survey.PINGS)


def read_soundings(folders: Folders, name: str, first: int, last: int) -> np.ndarray:
    """Read the good soundings (n, 3) of the pings first to last, metres in the map frame."""
    path = folders.data / f"surveys/{name}/soundings.parquet"
    only = [("ping", ">=", first), ("ping", "<=", last), ("quality", "==", 0)]
    return artifacts.read_table(path, survey.SOUNDINGS, only)[["x_m", "y_m", "z_m"]].to_numpy(np.float64)


def read_training(folders: Folders, models: Iterable[str], floor_m2: float) -> dict[str, dict[str, float]]:
    """Read the mean KL divergence (nats) of what learns, models and fits, in training and validation, at this floor.

    What was measured at another floor is left out: it does not compare.

    Raises:
        ResultsError: a model's are missing.
    """
    found, at = {}, {}
    for name in models:
        path = folders.reports / f"train/{name}.json"
        content = artifacts.read_json(path)
        kl, at[name] = content.get("kl"), content.get("floor_m2")
        if not isinstance(kl, dict) or not {"training", "validation"} <= set(kl) or at[name] is None:
            raise ResultsError(f"{path}: must have kl.training, kl.validation and floor_m2; run dvc repro train@{name}")
        found[name] = {which: float(kl[which]) for which in ("training", "validation")}
    fits = artifacts.read_json(folders.models / "fits.json")
    for name, fit in fits.items():
        if isinstance(fit, dict) and "mean_kl" in fit:
            found[name], at[name] = {"training": float(fit["mean_kl"])}, fits["params"]["fit"]["floor_m2"]
    return {name: each for name, each in found.items() if at[name] == floor_m2}


def read_losses(folders: Folders, models: Iterable[str]) -> dict[str, pd.DataFrame]:
    """Read each model's KL divergence by training step.

    Raises:
        ResultsError: a column is missing.
    """
    return {name: _loss(folders.reports / f"train/{name}.csv") for name in models}


def _loss(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path)[["step", "training", "validation"]]
    except (KeyError, ValueError) as error:
        raise ResultsError(f"{path}: must have the columns step, training, validation; run dvc repro train") from error


def _same_submaps(path: Path, found: np.ndarray, labels: Labels, what: str) -> None:
    if not np.array_equal(found, labels.submap):
        raise ResultsError(
            f"{path}: {what} has {len(found)} submaps, not those of the {len(labels.submap)} labels; run dvc repro"
        )
