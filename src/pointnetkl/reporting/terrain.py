"""Terrain classes: what a submap's ground is like, from what made it or, where nobody knows that, from its points.

Each feature of a drawn seabed contributes a slope; in x and y registration holds on to slopes alone. A submap is
named after the feature that contributes most, or by how steep it is. Features that no training submap has name every
submap in which they could hold a registration, so that the unseen stands in rows of its own.
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
_STEP_M = 0.25  # of the differences that slopes are made of: far below any feature's length
_POINTS = 1000  # of a submap, at least half as many: fewer may miss its one outcrop
_NEIGHBOURS = 20  # whose plane has a point's slope


@dataclass(frozen=True)
class Settings:
    """Where one class ends and the next begins.

    Raises:
        ValueError: the slopes are not positive and in rising order.
    """

    flat_slope: float  # rms; below it registration finds nothing to hold on to
    rugged_slope: float  # above it two axes are held; between the two the ground is smooth

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        parameters.require_positive(self, "flat_slope")
        if not self.rugged_slope > self.flat_slope:
            raise ValueError(f"rugged_slope is {self.rugged_slope:g}, must be above flat_slope, {self.flat_slope:g}")


def slopes(
    clouds: Sequence[np.ndarray], poses: pd.DataFrame, origin: np.ndarray, crs: str, chosen: simulation.Settings | None
) -> pd.DataFrame:
    """Return the rms slopes of a survey's submaps, a row each: `drawn` where a simulation drew them, else `measured`.

    Clouds are (n_i, 3) in submap frames, poses submap.POSES in a map frame whose origin (2,) is in `crs`; `chosen` is
    the simulation, if the survey is of one.
    """
    # a grid replaces the terrain; and what was drawn in one CRS is not found by another's coordinates
    if chosen is None or chosen.terrain is None or PurePath(chosen.grid).name != "none" or chosen.crs != crs:
        return measured(clouds)
    shift = origin - np.array(chosen.centre_m)
    places = [
        pose.transform(pose.matrix(np.array([row.x_m, row.y_m, 0.0]), row.yaw_rad), _some(points))[:, :2] + shift
        for row, points in zip(poses.itertuples(), clouds, strict=True)
    ]
    return drawn(chosen.terrain, chosen.seed, places)


def drawn(terrain: seabed.Settings, seed: int, places: Sequence[np.ndarray]) -> pd.DataFrame:
    """Return the rms slope of each feature and of their sum (`total`), a row a submap.

    `places` are a submap's points (n, 2) in metres from the terrain's centre. A feature that does not occur has no
    column.
    """
    x, y = np.concatenate(list(places)).T
    slopes = _gradients(terrain, seed, x, y)
    slopes[TOTAL] = sum(slopes.values(), np.zeros((len(x), 2)))
    ends = np.cumsum([len(each) for each in places])[:-1]
    return pd.DataFrame({name: [_rms(part) for part in np.split(each, ends)] for name, each in slopes.items()})


def measured(clouds: Iterable[np.ndarray]) -> pd.DataFrame:
    """Return the rms slope (`total`) of clouds (n, 3) in metres, a row each, from planes through neighbours."""
    return pd.DataFrame({TOTAL: [_measured(points) for points in clouds]})


def of_surveys(
    slopes_of: Mapping[str, pd.DataFrame], training: Collection[str], limits: Settings
) -> tuple[dict[str, np.ndarray], set[str]]:
    """Return the classes (k,) of every survey's submaps, and the classes that the training surveys have."""
    new = unseen([slopes_of[name] for name in training], limits)
    found = {name: classes(of, new, limits) for name, of in slopes_of.items()}
    return found, {each for name in training for each in found[name]}


def unseen(training: Iterable[pd.DataFrame], limits: Settings) -> set[str]:
    """Return the special features that reach `flat_slope` in no submap of the training surveys' slopes."""
    steepest = pd.concat([of.max() for of in training], axis=1).max(axis=1)
    return {name for name in SPECIAL if not steepest.get(name, 0.0) >= limits.flat_slope}


def classes(slopes_of: pd.DataFrame, new: Collection[str], limits: Settings) -> np.ndarray:
    """Return the class of each row of slopes, (k,) text; `new` are the features that training has not seen."""
    return np.array([_class(row, new, limits) for row in slopes_of.to_dict("records")], dtype=object)


def counts(of: np.ndarray, slopes_of: pd.DataFrame, labels: np.ndarray, trained: Collection[str]) -> dict[str, Any]:
    """Return for each of a survey's classes (k,) how many submaps it has, its slope, and its labels' size.

    `slope` is the mean of their rms slopes; label_smaller_m2 and label_larger_m2 the medians of the eigenvalues of
    labels (k, M, M) in x, y; in_training tells whether a training submap is of that class.
    """
    variances, total = np.linalg.eigvalsh(labels[:, :2, :2]), slopes_of[TOTAL].to_numpy()
    return {
        name: {
            "submaps": int(np.sum(of == name)),
            "in_training": name in trained,
            "slope": float(total[of == name].mean()),
            "label_smaller_m2": float(np.median(variances[of == name, 0])),
            "label_larger_m2": float(np.median(variances[of == name, 1])),
        }
        for name in CLASSES
        if np.any(of == name)
    }


def _some(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // _POINTS)]


def _class(slope: Mapping[str, float], new: Collection[str], limits: Settings) -> str:
    rare = {name: slope[name] for name in SPECIAL if name in new and slope.get(name, 0.0) >= limits.flat_slope}
    if rare:
        return max(rare, key=lambda name: rare[name])
    if slope[TOTAL] < limits.flat_slope:
        return "flat"
    most = max((name for name in slope if name != TOTAL), key=lambda name: slope[name], default=TOTAL)
    if most in SPECIAL:
        return str(most)
    return "smooth" if slope[TOTAL] < limits.rugged_slope else "rugged"


def _gradients(terrain: seabed.Settings, seed: int, x: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
    h = _STEP_M
    sides = [dict(seabed.features(terrain, seed, x + dx, y + dy)) for dx, dy in ((h, 0), (-h, 0), (0, h), (0, -h))]
    right, left, up, down = sides
    return {n: np.stack([right[n] - left[n], up[n] - down[n]], axis=1) / (2 * h) for n in right}


def _measured(points: np.ndarray) -> float:
    some = _some(points)
    near = points[cKDTree(points[:, :2]).query(some[:, :2], min(_NEIGHBOURS, len(points)))[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    across, z = centred[..., :2], centred[..., 2]
    inverse = np.linalg.pinv(np.swapaxes(across, 1, 2) @ across, hermitian=True)
    slope = np.einsum("nij,nkj,nk->ni", inverse, across, z)
    left = z - np.einsum("nkj,nj->nk", across, slope)
    # the soundings' noise tilts planes too: what it adds on average is taken off
    noise = (left**2).sum(axis=1) / max(near.shape[1] - 3, 1) * np.trace(inverse, axis1=1, axis2=2)
    return float(np.sqrt(max(np.mean((slope**2).sum(axis=1) - noise), 0.0)))


def _rms(gradients: np.ndarray) -> float:
    return float(np.sqrt((gradients**2).sum(axis=1).mean()))
