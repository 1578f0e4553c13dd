"""A training survey's files, as the stages before training write them."""

from pathlib import Path

import numpy as np
import pandas as pd

from pointnetkl.surveys import submap, voxel
from pointnetkl.training import dataset
from pointnetkl.workflow import artifacts, parameters
from toy_submaps import LABEL, REGISTRATION

MADE_WITH = {"label": parameters.as_metadata(LABEL), "registration": parameters.as_metadata(REGISTRATION)}


def write(folder: Path, name: str, count: int = 20, edge: float = 0.01, first: int = 0) -> None:
    """Write a survey's submaps, clouds and labels as the stages before training do."""
    rng = np.random.default_rng(count)
    clouds = [voxel.Canonical(rng.uniform(-0.5, 0.5, (30 + i, 3)).astype(np.float32), 100.0 + i) for i in range(count)]
    numbers = list(range(first, first + count))
    submaps = [submap.Submap(name, i, *3 * [c.points * c.radius]) for i, c in zip(numbers, clouds, strict=True)]
    artifacts.write_table(folder / name / "submaps.parquet", submap.to_table(submaps), submap.POINTS, {})
    metadata = {"survey": name, "params": {"voxelise": {"voxel": edge}}}
    artifacts.write_arrays(folder / name / "clouds.npz", voxel.Clouds.join(numbers, clouds).to_arrays(), metadata)
    labels = pd.DataFrame({"submap": numbers, "q_xx_m2": 2.0, "q_xy_m2": 0.1, "q_yy_m2": np.arange(count) + 1.0})
    artifacts.write_table(folder / name / "labels.parquet", labels, dataset.LABEL, MADE_WITH)
