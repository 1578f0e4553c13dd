"""A survey cut into submaps, whose points stay on disk: a long survey's do not fit in memory twice."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from pointnetkl import segmentation
from pointnetkl.correction.preparation import sampling
from pointnetkl.correction.preparation.sampling import Sampling
from pointnetkl.correction.result import CorrectionError
from pointnetkl.correction.settings import Settings
from pointnetkl.exchange import posed_submaps
from pointnetkl.segmentation import spacing, track
from pointnetkl.surveys import submap, survey
from pointnetkl.surveys.submap import Submap
from pointnetkl.workflow import artifacts

_SAMPLED = 24  # row groups of soundings that the sampling is chosen from


class Clouds(Sequence[np.ndarray]):
    """Points (n_i, 3) of submaps, metres, in a file of float32: each is read when it is asked for."""

    def __init__(self, path: Path, counts: Sequence[int]) -> None:
        """Open a file of so many points a submap."""
        self.path, self.counts = path, list(counts)
        self._edges = np.concatenate([[0], np.cumsum(self.counts)])
        self._points = np.memmap(path, "<f4", "r", shape=(int(self._edges[-1]), 3))

    def __reduce__(self) -> tuple[type["Clouds"], tuple[Path, list[int]]]:
        """Return how another process opens the same file."""
        return Clouds, (self.path, self.counts)

    def __len__(self) -> int:
        """Return the number of submaps."""
        return len(self.counts)

    def __getitem__(self, k):  # type: ignore[no-untyped-def]
        """Return the points of submap k."""
        if not 0 <= k < len(self):
            raise IndexError(k)
        return np.asarray(self._points[self._edges[k] : self._edges[k + 1]], np.float64)


@dataclass(frozen=True)
class Cut:
    """A survey's submaps, and what it was cut by."""

    clouds: Clouds
    poses: pd.DataFrame  # surveys.submap.POSES
    sampling: Sampling
    spacing_m: float  # of the points, as it came out
    passes: np.ndarray  # (n,) the line that each is of; each of another program's submaps is a pass of its own


def cut(name: str, tables: Path, kind: str, settings: Settings, folder: Path) -> None:
    """Cut the survey of a folder's pings.parquet and soundings.parquet, and write its submaps to another folder.

    Raises:
        SegmentationError, SoundingsError: no submap can be cut.
    """
    pings = artifacts.read_table(tables / "pings.parquet", survey.PINGS)
    chosen = _sampling(pings, tables / "soundings.parquet", kind, settings)
    print(f"{name}: {chosen.reason}")
    counts: list[int] = []
    spacings: list[float] = []
    with (folder / "points.f32").open("wb") as file:
        segments = _segment(name, pings, tables, kind, chosen, settings, _taker(file, counts, spacings))
    median = float(np.median(spacings)) if spacings else chosen.spacing_m
    artifacts.write_table(folder / "poses.parquet", segments.poses, submap.POSES, {"dropped": segments.dropped})
    artifacts.write_json(
        folder / "cut.json",
        {"counts": counts, "spacing_m": median, "sampling": asdict(chosen), "lines": kind != survey.SUBMAPS},
    )


def reason(error: segmentation.SegmentationError) -> str:
    """Return in words why a survey cannot be cut; its error speaks of parameters that the command does not have."""
    cause = str(error).split(": ", 1)[-1].split("; lower study.", 1)[0]
    return f"it cannot be cut into submaps, because {cause} (see --length and --spacing)"


def read(folder: Path) -> Cut:
    """Return the submaps that `cut` has written to a folder."""
    facts = artifacts.read_json(folder / "cut.json")
    clouds = Clouds(folder / "points.f32", facts["counts"])
    poses = artifacts.read_table(folder / "poses.parquet", submap.POSES)
    passes = poses["line"].to_numpy() if facts["lines"] else np.arange(len(poses))
    return Cut(clouds, poses, Sampling(**facts["sampling"]), facts["spacing_m"], passes)


def from_stage(submaps: Path, poses: Path, folder: Path) -> None:
    """Write the submaps that stage `segment` has cut in the form that `read` takes."""
    sizes, counts = submap.read_sampling(submaps), []
    with (folder / "points.f32").open("wb") as file:
        for cloud in submap.stream("", submaps):
            cloud.points.astype("<f4").tofile(file)
            counts.append(len(cloud.points))
    params = artifacts.table_metadata(submaps)["params"]
    length, spacing_m = float(params["submap_length_m"]), float(params["point_spacing_m"])
    reason = f"as stage segment cut it: submaps of {length:g} m with a point every {spacing_m:g} m"
    chosen = Sampling(length, spacing_m, float(params["segment"]["max_gap_m"]), reason)
    artifacts.write_table(folder / "poses.parquet", artifacts.read_table(poses, submap.POSES), submap.POSES, {})
    facts = {"counts": counts, "spacing_m": sizes.spacing_m, "sampling": asdict(chosen)}
    facts["lines"] = sizes.kind != survey.SUBMAPS
    artifacts.write_json(folder / "cut.json", facts)


def _segment(
    name: str,
    pings: pd.DataFrame,
    tables: Path,
    kind: str,
    chosen: Sampling,
    settings: Settings,
    take: Callable[[Submap], None],
) -> segmentation.Segmentation:
    parts = artifacts.read_groups(tables / "soundings.parquet", survey.SOUNDINGS)
    by = segmentation.Settings(settings.seed, chosen.max_gap_m, settings.max_turn_rad)
    if kind == survey.SUBMAPS:
        return segmentation.keep(name, pings, parts, chosen.spacing_m, by, take)
    return segmentation.segment(name, pings, parts, chosen.length_m, chosen.spacing_m, by, take)


def _taker(file: IO[bytes], counts: list[int], spacings: list[float]) -> Callable[[Submap], None]:
    def take(cloud: Submap) -> None:
        cloud.points.astype("<f4").tofile(file)
        counts.append(len(cloud.points))
        spacings.append(spacing.between_neighbours(cloud.points))

    return take


def _sampling(pings: pd.DataFrame, soundings: Path, kind: str, settings: Settings) -> Sampling:
    """Return how to cut: as asked for, and where nothing is, as the data suggest."""
    if kind == survey.SUBMAPS:
        own = settings.point_spacing_m or _spacing_of_submaps(soundings)
        length = (
            float(np.median(np.hypot(*np.diff(pings[["x_m", "y_m"]].to_numpy(), axis=0).T))) if len(pings) > 1 else 1.0
        )
        return Sampling(length, own, 1.0, f"submaps as another program has cut them, with a point every {own:.3g} m")
    xy, yaw = pings[["x_m", "y_m"]].to_numpy(np.float64), pings["yaw_rad"].to_numpy()
    free = sampling.choose(pings, _sample(soundings), np.inf)
    gap = settings.max_gap_m or free.max_gap_m
    lines = track.cut(xy, yaw, max(settings.submap_length_m or free.length_m, 1e-3), gap, settings.max_turn_rad)
    chosen = sampling.choose(pings, _sample(soundings), lines.longest_m)
    length, spacing_m = settings.submap_length_m or chosen.length_m, settings.point_spacing_m or chosen.spacing_m
    if (length, spacing_m) == (chosen.length_m, chosen.spacing_m):
        return Sampling(length, spacing_m, gap, chosen.reason)
    return Sampling(length, spacing_m, gap, f"as asked for: submaps of {length:g} m with a point every {spacing_m:g} m")


def _sample(soundings: Path) -> Iterator[pd.DataFrame]:
    with pq.ParquetFile(soundings) as file:
        groups = np.unique(np.linspace(0, file.num_row_groups - 1, _SAMPLED).astype(int)).tolist()
        for group in groups:
            yield file.read_row_group(group).slice(0, artifacts.GROUP_ROWS // 4).to_pandas()


def _spacing_of_submaps(soundings: Path) -> float:
    """Return the side of a square that holds one point of the first submaps, metres."""
    part = next(artifacts.read_groups(soundings, survey.SOUNDINGS))
    clouds = [rows[["x_m", "y_m", "z_m"]].to_numpy(np.float64) for _, rows in part.groupby("ping")]
    if not clouds:
        raise CorrectionError(f"{soundings}: holds no sounding; is it the table of another survey?")
    return posed_submaps.spacing([Submap("", k, points, points, points) for k, points in enumerate(clouds)])
