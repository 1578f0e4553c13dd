"""What the report is made from: every stage's artifacts, read and brought together by survey."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pointnetkl import simulation
from pointnetkl.registration.covariance import catalogue, table
from pointnetkl.registration.covariance.label_table import LABELS, VARIATIONS
from pointnetkl.reporting import terrain
from pointnetkl.slam.benchmark.schemas import ROWS, TRAJECTORIES
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.surveys import submap, survey, voxel
from pointnetkl.workflow import artifacts, parameters
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.study import Study

GOLD = catalogue.MONTE_CARLO  # the labels themselves, as a method: their KL to themselves says nothing
OURS = catalogue.NETWORK  # the method with which the others are compared, pair by pair

_SURVEY = ("pings.parquet", "soundings.parquet", "truth.parquet")
_CUT = ("submaps.parquet", "poses.parquet", "clouds.npz", "labels.parquet", "errors.npz")
_TESTED = (
    *("variations.parquet", "estimated.parquet", "predicted.parquet"),
    *("graph.npz", "closures.parquet", "closure_covariances.parquet", "closure_ends.parquet"),
)
_SOLVED = (
    *("slam/{}.parquet", "slam/{}_trajectories.parquet", "slam/{}_consistency.tif", "slam/{}_map_thinning.parquet"),
    *("closing/{}.parquet", "closing/{}_closed.parquet", "closing/{}_closures.parquet"),
    *("robustness/{}.parquet", "robustness/{}_gate.parquet"),
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
    """A study, and the folders that its stages write to."""

    data: Path
    models: Path
    reports: Path
    study: Study

    def survey(self, name: str, file: str) -> Path:
        """Return where stage ingest writes a file of a survey."""
        return self.data / "surveys" / name / file

    def product(self, name: str, file: str) -> Path:
        """Return where the stages after it write a file of a survey of the study."""
        return self.data / self.study.surveys[name].group / name / file

    def expected(self) -> Iterator[Path]:
        """Yield every file that a report of the study is made from."""
        for name in self.study.surveys:
            yield from (self.survey(name, file) for file in _SURVEY)
            yield from (self.product(name, file) for file in _CUT)
        for name in self.study.test:
            yield from (self.product(name, file) for file in _TESTED)
            yield from (self.reports / file.format(name) for file in _SOLVED)
        for name in self.study.models:
            yield from (self.reports / file.format(name) for file in _TRAINED)
        yield self.reports / "runtime.json"
        yield self.models / "fits.json"

    def demand(self) -> None:
        """Refuse to begin while an artifact is missing.

        Raises:
            ResultsError: names the first one; or there is no test survey.
        """
        if not self.study.test:
            raise ResultsError("study.test in params.yaml names no survey; a report needs one at least")
        missing = [path for path in self.expected() if not path.is_file()]
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
    self_matching: np.ndarray  # (k,) whether points lie so far apart that a copy registers to itself
    rows: pd.DataFrame  # schema label_table.LABELS: the same, and how the registrations converged
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
    slam: pd.DataFrame  # schema slam.benchmark.schemas.ROWS
    trajectories: pd.DataFrame  # schema slam.benchmark.schemas.TRAJECTORIES
    gt: np.ndarray  # (n, 4, 4) T_map_submap of navigation optimised with the labels
    loop_closures: np.ndarray  # (e, 2) nodes k and i of each edge
    registered: np.ndarray  # (r,) submaps whose registrations the edges come from
    registration_errors: np.ndarray  # (r, M) against the truth in the submap's frame, metres; NaN where not known
    track: bool = True  # tiles of points have none: no edges, and no row or trajectory of SLAM


def read_labels(folders: Folders, name: str) -> Labels:
    """Read a survey's labels."""
    path = folders.product(name, "labels.parquet")
    rows = artifacts.read_table(path, LABELS, also=table.YAW)
    submaps, spacing, matching = (rows[column].to_numpy() for column in ("submap", "spacing_m", "self_matching"))
    return Labels(submaps, table.to_matrices(rows), spacing, matching, rows, artifacts.table_metadata(path))


def read_test(folders: Folders, name: str, labels: Labels) -> Test:
    """Read what a test survey adds to its labels.

    Raises:
        ResultsError: a method or the held-out errors are of other submaps than the labels.
    """
    covariances = {}
    for stage in ("estimated", "predicted"):
        path = folders.product(name, f"{stage}.parquet")
        for method, rows in artifacts.read_table(path, table.SCHEMA, also=table.YAW).groupby("method", sort=False):
            rows = rows.sort_values("submap")
            _same_submaps(path, rows["submap"].to_numpy(), labels, str(method))
            covariances[str(method)] = table.to_matrices(rows)
    path = folders.product(name, "errors.npz")
    errors, _ = artifacts.read_arrays(path)  # `errors` of it, the labels' own, ends in NaN where a label stopped early
    _same_submaps(path, errors["submap"], labels, "the held-out errors")
    graph, _ = artifacts.read_arrays(folders.product(name, "graph.npz"))
    first = graph["registration_draw"] == 0
    return Test(
        covariances=covariances,
        held_out=errors["held_out"],
        slam=artifacts.read_table(folders.reports / f"slam/{name}.parquet", ROWS),
        trajectories=artifacts.read_table(folders.reports / f"slam/{name}_trajectories.parquet", TRAJECTORIES),
        gt=graph["gt"],
        loop_closures=np.stack([graph["edge_target"], graph["edge_source"]], -1)[graph["edge_draw"] == 0],
        registered=graph["number"][graph["registration_node"][first]],
        registration_errors=graph["registration_error_truth_m"][first],
        track=bool(graph.get("track", True)),
    )


def read_canonical(folders: Folders, name: str) -> voxel.Clouds:
    """Read a survey's normalised clouds."""
    path = folders.product(name, "clouds.npz")
    return voxel.Clouds.from_arrays(artifacts.read_arrays(path)[0], str(path))


def read_variations(folders: Folders) -> pd.DataFrame:
    """Read the test surveys' labels under varied conditions, one table of schema label_table.VARIATIONS."""
    paths = (folders.product(name, "variations.parquet") for name in folders.study.test)
    tables = [artifacts.read_table(path, VARIATIONS, also=table.YAW) for path in paths]
    return pd.concat([VARIATIONS.empty_table().to_pandas(), *tables], ignore_index=True)


def read_points(folders: Folders, name: str) -> tuple[list[np.ndarray], pd.DataFrame]:
    """Read a survey's registration clouds, (n_i, 3) metres in submap frames, and its poses (submap.POSES)."""
    path = folders.product(name, "submaps.parquet")
    rows = artifacts.read_table(path, submap.POINTS, [("part", "==", submap.WHOLE)])
    poses = artifacts.read_table(folders.product(name, "poses.parquet"), submap.POSES)
    number, points = rows["submap"].to_numpy(), rows[["x_m", "y_m", "z_m"]].to_numpy(np.float64)
    order = np.argsort(number, kind="stable")
    submaps, starts = np.unique(number[order], return_index=True)
    if not np.array_equal(submaps, poses["submap"].to_numpy()):
        raise ResultsError(f"{path}: its submaps are not those of their poses; run dvc repro segment@{name}")
    return np.split(points[order], starts[1:]), poses


def read_simulation(folders: Folders, name: str) -> simulation.Settings | None:
    """Read what a survey was simulated with, which its truth says; None where it was measured, or no truth is known.

    Raises:
        SettingsError: the settings are not those of a simulation.
    """
    path = folders.survey(name, "truth.parquet")
    metadata = artifacts.table_metadata(path)
    if "simulate" not in metadata:
        return None
    return parameters.from_metadata(metadata, "simulate", simulation.Settings, path)


def read_frame(folders: Folders, name: str) -> tuple[np.ndarray, str]:
    """Read the origin (2,) of a survey's map frame, and the CRS that it is given in."""
    origin, crs = consistency_map.read_origin(folders.survey(name, "pings.parquet"))
    return np.array(origin), crs


def read_pings(folders: Folders, name: str) -> pd.DataFrame:
    """Read a survey's pings (survey.PINGS)."""
    return artifacts.read_table(folders.survey(name, "pings.parquet"), survey.PINGS)


def read_soundings(folders: Folders, name: str, first: int, last: int) -> np.ndarray:
    """Read the good soundings (n, 3) of the pings first to last, metres in the map frame."""
    path = folders.survey(name, "soundings.parquet")
    only = [("ping", ">=", first), ("ping", "<=", last), ("quality", "==", 0)]
    return artifacts.read_table(path, survey.SOUNDINGS, only)[["x_m", "y_m", "z_m"]].to_numpy(np.float64)


def _same_submaps(path: Path, submaps: np.ndarray, labels: Labels, subject: str) -> None:
    if not np.array_equal(submaps, labels.submap):
        raise ResultsError(
            f"{path}: {subject} has {len(submaps)} submaps, not those of the {len(labels.submap)} labels; run dvc repro"
        )
