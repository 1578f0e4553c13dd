"""The training data: canonical clouds and Monte Carlo labels of the training surveys."""

import dataclasses
import itertools
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from pointnetkl.models import trained
from pointnetkl.models.samples import Samples
from pointnetkl.registration import gicp, monte_carlo
from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.surveys import submap, voxel
from pointnetkl.workflow import artifacts, compute, parameters
from pointnetkl.workflow.errors import PointNetKLError

# The columns of a label table that training reads.
LABEL = pa.schema([("submap", pa.int32())] + [(f"q_{axes}_m2", pa.float64()) for axes in ("xx", "xy", "yy")])


class DatasetError(PointNetKLError):
    """Files of the training surveys are missing, or do not belong together."""


def read(folder: Path, surveys: Sequence[str]) -> tuple[Samples, float]:
    """Return the submaps of every training survey, and the voxel's edge that all their clouds have.

    `folder` has a folder for each survey, with clouds.npz and labels.parquet.

    Raises:
        DatasetError: a file is missing, one survey's files are of different submaps, or voxels differ.
        ArtifactError, VoxelError, CovarianceError: a file is damaged, or holds what is no cloud or no label.
    """
    if not surveys:
        raise DatasetError("study.train names no survey; there is nothing to train on")
    parts, voxels = zip(*(_read_survey(folder / name, name) for name in surveys), strict=True)
    for name, edge in zip(surveys, voxels, strict=True):
        if edge != voxels[0]:
            raise DatasetError(
                f"{folder / name}: voxels of {edge:g}, but {surveys[0]} has {voxels[0]:g}; run voxelise on both again"
            )
    return _join(parts), voxels[0]


def made_with(folder: Path, surveys: Sequence[str]) -> tuple[monte_carlo.Settings, gicp.Settings]:
    """Return the sections `label` and `registration` of the parameters that made the training labels.

    Raises:
        SettingsError: a survey's labels do not say it.
        DatasetError: the labels of two surveys are of different covariances.
        ArtifactError: a survey's labels are missing or damaged.
    """
    paths = [folder / name / "labels.parquet" for name in surveys]
    first, *others = (artifacts.table_metadata(path) for path in paths)
    label = parameters.from_metadata(first, "label", monte_carlo.Settings, paths[0])
    registration = parameters.from_metadata(first, "registration", gicp.Settings, paths[0])
    for path, metadata in zip(paths[1:], others, strict=True):
        for setting, value, value_of_first in trained.differences(metadata, label, registration):
            raise DatasetError(
                f"{path}: was made with {setting} {value}, but {paths[0]} with {value_of_first};"
                " run dvc repro, which labels both alike"
            )
    return label, registration


def with_descriptions(folder: Path, samples: Samples, describe: Callable[[np.ndarray], np.ndarray]) -> Samples:
    """Return samples described by `describe`, of each submap's own points (n, 3), metres, in its frame.

    Raises:
        DatasetError, ArtifactError: a survey's submaps.parquet is missing, damaged or of other submaps.
    """
    described = compute.in_threads(describe, _points(folder, samples), "describe", total=len(samples))
    return dataclasses.replace(samples, described=np.stack(described))


def split(samples: Samples, share: float, blocks: int, seed: int) -> tuple[Samples, Samples]:
    """Return submaps to train on and to validate on, the latter in blocks along each survey's track.

    Neighbours overlap, so a random split would put the same ground on both sides. Each survey is cut into `blocks`
    equal stretches, and one run of consecutive submaps is drawn in each, `share` of the survey in all.

    Raises:
        DatasetError: a survey is too short to give to both sides.
    """
    held_back = np.concatenate(
        [
            _held_back(str(name), int((samples.survey == name).sum()), share, blocks, seed)
            for name in dict.fromkeys(samples.survey)
        ]
    )
    return samples.take(np.flatnonzero(~held_back)), samples.take(np.flatnonzero(held_back))


def _read_survey(folder: Path, name: str) -> tuple[Samples, float]:
    clouds_path, labels_path = folder / "clouds.npz", folder / "labels.parquet"
    for path in (clouds_path, labels_path):
        if not path.exists():
            raise DatasetError(f"{path}: is missing, but study.train names {name}; run dvc repro")
    arrays, metadata = artifacts.read_arrays(clouds_path)
    clouds = voxel.Clouds.from_arrays(arrays, str(clouds_path))
    labels = artifacts.read_table(labels_path, LABEL, also=table.YAW)
    if clouds.submap.tolist() != labels["submap"].tolist():
        raise DatasetError(
            f"{folder}: clouds.npz has {len(clouds)} submaps, not those of the {len(labels)} labels in"
            f" labels.parquet; run dvc repro"
        )
    covariances = table.to_matrices(labels)
    for number, q in zip(clouds.submap, covariances, strict=True):
        gaussian.check(q, f"{labels_path}, submap {number}")
    points = [clouds.cloud(i).points for i in range(len(clouds))]
    samples = Samples(np.full(len(clouds), name), clouds.submap, points, clouds.radius, covariances)
    return samples, _voxel(metadata, clouds_path)


def _voxel(metadata: dict[str, object], path: Path) -> float:
    try:
        return float(metadata["params"]["voxelise"]["voxel"])  # type: ignore[index]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: does not say which voxels made it; run voxelise again") from error


def _join(parts: Sequence[Samples]) -> Samples:
    return Samples(
        np.concatenate([part.survey for part in parts]),
        np.concatenate([part.submap for part in parts]),
        [cloud for part in parts for cloud in part.clouds],
        np.concatenate([part.radius for part in parts]),
        np.concatenate([part.label for part in parts]),
    )


def _points(folder: Path, samples: Samples) -> Iterator[np.ndarray]:
    """Yield every submap's own points; those of a large survey do not fit in memory."""
    for name in dict.fromkeys(map(str, samples.survey)):
        path = folder / name / "submaps.parquet"
        numbers = samples.submap[samples.survey == name].tolist()
        for cloud, number in itertools.zip_longest(submap.stream(name, path), numbers):
            if cloud is None or cloud.number != number:
                raise DatasetError(f"{path}: its submaps are not those of labels.parquet; run dvc repro")
            yield cloud.points


def _held_back(name: str, count: int, share: float, blocks: int, seed: int) -> np.ndarray:
    """Return which of a survey's submaps are validated on, (count,) bool."""
    if count < 2:
        raise DatasetError(f"{name}: has {count} submap, too few to train on some and validate on others; drop it")
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    total = min(max(1, round(share * count)), count - 1)
    held_back = np.zeros(count, bool)
    stretches = np.array_split(np.arange(count), min(blocks, total))
    for stretch, size in zip(stretches, _equal_parts(total, len(stretches)), strict=True):
        start = rng.integers(stretch[0], stretch[-1] - size + 2)
        held_back[start : start + size] = True
    return held_back


def _equal_parts(total: int, parts: int) -> list[int]:
    return [total // parts + (i < total % parts) for i in range(parts)]
