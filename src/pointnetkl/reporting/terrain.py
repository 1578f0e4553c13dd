"""Terrain classes: what a submap's ground is like, from its simulation or, where it was measured, from its points.

Each feature of a simulated seabed contributes a slope, and slopes alone constrain a registration in x and y. A submap
is named after the feature that contributes most, or by how steep it is. A feature that no training submap has names
every submap in which it could constrain a registration, so that unseen ground has rows of its own.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from pointnetkl import simulation
from pointnetkl.simulation import seabed
from pointnetkl.surveys import pose
from pointnetkl.workflow import parameters

TOTAL = "total"
# hills and texture are the ground that every place has: it is flat, smooth or rugged
SPECIAL = ("relief", "ridges", "ripples", "outcrops", "ploughmarks", "wall")
CLASSES = ("flat", "smooth", "rugged", *SPECIAL)
_STEP_M = 0.25  # of the differences that give slopes: far below any feature's length
_POINTS = 1000  # of a submap, at least half as many: fewer may miss its one outcrop
_NEIGHBOURS = 20  # of a point: their plane has its slope


@dataclass(frozen=True)
class Settings:
    """Where one class ends and the next begins.

    Raises:
        ValueError: the slopes are not positive and in rising order.
    """

    flat_slope: float  # rms; flatter ground does not constrain a registration
    rugged_slope: float  # steeper ground constrains both axes; between the two the ground is smooth

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        parameters.require_positive(self, "flat_slope")
        if not self.rugged_slope > self.flat_slope:
            raise ValueError(f"rugged_slope is {self.rugged_slope:g}, must be above flat_slope, {self.flat_slope:g}")


def slopes(
    clouds: Sequence[np.ndarray], poses: pd.DataFrame, origin: np.ndarray, crs: str, model: simulation.Settings | None
) -> pd.DataFrame:
    """Return the rms slopes of a survey's submaps, a row each: `drawn` of a simulated terrain, else `measured`.

    Clouds are (n_i, 3) in submap frames, poses submap.POSES in a map frame whose origin (2,) is in `crs`; `model` is
    the simulation, if the survey is simulated.
    """
    # a grid replaces the terrain; and a terrain of one CRS cannot be looked up by the coordinates of another
    if model is None or model.terrain is None or PurePath(model.grid).name != "none" or model.crs != crs:
        return measured(clouds)
    shift = origin - np.array(model.centre_m)
    places = [
        pose.transform(pose.matrix(np.array([row.x_m, row.y_m, 0.0]), row.yaw_rad), _sample(points))[:, :2] + shift
        for row, points in zip(poses.itertuples(), clouds, strict=True)
    ]
    return drawn(model.terrain, model.seed, places)


def drawn(terrain: seabed.Settings, seed: int, places: Sequence[np.ndarray]) -> pd.DataFrame:
    """Return the rms slope of each feature and of their sum (`total`), a row a submap.

    `places` are a submap's points (n, 2) in metres from the terrain's centre. A feature that does not occur has no
    column.
    """
    x, y = np.concatenate(list(places)).T
    slopes = _gradients(terrain, seed, x, y)
    slopes[TOTAL] = sum(slopes.values(), np.zeros((len(x), 2)))
    ends = np.cumsum([len(points) for points in places])[:-1]
    return pd.DataFrame({name: [_rms(part) for part in np.split(slope, ends)] for name, slope in slopes.items()})


def measured(clouds: Iterable[np.ndarray]) -> pd.DataFrame:
    """Return the rms slope (`total`) of clouds (n, 3) in metres, a row each, from planes through neighbours."""
    return pd.DataFrame({TOTAL: [_measured(points) for points in clouds]})


def by_survey(
    slopes: Mapping[str, pd.DataFrame], training: Collection[str], settings: Settings
) -> tuple[dict[str, np.ndarray], set[str]]:
    """Return the classes (k,) of every survey's submaps, and the classes that the training surveys have."""
    rare = unseen([slopes[name] for name in training], settings)
    survey_classes = {name: classes(survey_slopes, rare, settings) for name, survey_slopes in slopes.items()}
    return survey_classes, {terrain_class for name in training for terrain_class in survey_classes[name]}


def unseen(training: Iterable[pd.DataFrame], settings: Settings) -> set[str]:
    """Return the special features that reach `flat_slope` in no submap of the training surveys' slopes."""
    steepest = pd.concat([slopes.max() for slopes in training], axis=1).max(axis=1)
    return {name for name in SPECIAL if not steepest.get(name, 0.0) >= settings.flat_slope}


def classes(slopes: pd.DataFrame, rare: Collection[str], settings: Settings) -> np.ndarray:
    """Return the class of each row of slopes, (k,) text; `rare` are the features that training has not seen."""
    return np.array([_class(row, rare, settings) for row in slopes.to_dict("records")], dtype=object)


def counts(
    submap_classes: np.ndarray, slopes: pd.DataFrame, labels: np.ndarray, trained: Collection[str]
) -> dict[str, Any]:
    """Return for each of a survey's classes (k,) how many submaps it has, its slope, and its labels' size.

    `slope` is the mean of their rms slopes; label_smaller_m2 and label_larger_m2 the medians of the eigenvalues of
    labels (k, M, M) in x, y; in_training says whether a training submap is of that class.
    """
    variances, total = np.linalg.eigvalsh(labels[:, :2, :2]), slopes[TOTAL].to_numpy()
    return {
        name: {
            "submaps": int(np.sum(submap_classes == name)),
            "in_training": name in trained,
            "slope": float(total[submap_classes == name].mean()),
            "label_smaller_m2": float(np.median(variances[submap_classes == name, 0])),
            "label_larger_m2": float(np.median(variances[submap_classes == name, 1])),
        }
        for name in CLASSES
        if np.any(submap_classes == name)
    }


def _sample(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // _POINTS)]


def _class(slope: Mapping[str, float], rare: Collection[str], settings: Settings) -> str:
    present = {name: slope[name] for name in SPECIAL if name in rare and slope.get(name, 0.0) >= settings.flat_slope}
    if present:
        return max(present, key=lambda name: present[name])
    if slope[TOTAL] < settings.flat_slope:
        return "flat"
    most = max((name for name in slope if name != TOTAL), key=lambda name: slope[name], default=TOTAL)
    if most in SPECIAL:
        return str(most)
    return "smooth" if slope[TOTAL] < settings.rugged_slope else "rugged"


def _gradients(terrain: seabed.Settings, seed: int, x: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
    h = _STEP_M
    sides = [dict(seabed.features(terrain, seed, x + dx, y + dy)) for dx, dy in ((h, 0), (-h, 0), (0, h), (0, -h))]
    right, left, up, down = sides
    return {n: np.stack([right[n] - left[n], up[n] - down[n]], axis=1) / (2 * h) for n in right}


def _measured(points: np.ndarray) -> float:
    sample = _sample(points)
    near = points[cKDTree(points[:, :2]).query(sample[:, :2], min(_NEIGHBOURS, len(points)))[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    across, z = centred[..., :2], centred[..., 2]
    inverse = np.linalg.pinv(np.swapaxes(across, 1, 2) @ across, hermitian=True)
    slope = np.einsum("nij,nkj,nk->ni", inverse, across, z)
    residual = z - np.einsum("nkj,nj->nk", across, slope)
    # noise of the soundings tilts planes too: subtract what it adds on average
    noise = (residual**2).sum(axis=1) / max(near.shape[1] - 3, 1) * np.trace(inverse, axis1=1, axis2=2)
    return float(np.sqrt(max(np.mean((slope**2).sum(axis=1) - noise), 0.0)))


def _rms(gradients: np.ndarray) -> float:
    return float(np.sqrt((gradients**2).sum(axis=1).mean()))
