"""The demo's test surveys, sailed as stage `simulate` does, cut into submaps of a stretch of track each."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drifts import of_vehicle
from pointnetkl import simulation
from pointnetkl.simulation import vehicle
from pointnetkl.slam.closing import drift
from pointnetkl.surveys import pose
from pointnetkl.workflow import parameters, study
from simulated_survey import PARAMS


@dataclass(frozen=True)
class Demo:
    """A survey's submaps."""

    clouds: list[np.ndarray]  # of (n, 3)
    navigation: np.ndarray  # (n, 4, 4)
    truth: np.ndarray  # (n, 4, 4)
    covariance: np.ndarray  # (3 n, 3 n) of navigation
    spacing_m: float


def sail(name: str) -> Demo:
    """Return a survey of params.yaml."""
    settings = parameters.read(PARAMS, f"simulate.{name}", simulation.Settings)
    sailing = parameters.read(PARAMS, f"vehicles.{settings.vehicle}", vehicle.Settings)
    entry = study.survey(PARAMS, name)
    lines = list(simulation.survey(settings, sailing, simulation.ground(settings)))
    cut = [submap for line in lines for submap in _submaps(line, entry.submap_length_m, entry.point_spacing_m)]
    clouds, navigation, truth, times = zip(*cut, strict=True)
    start = lines[0].truth.iloc[0]
    fix = drift.Fix(float(start["time_s"]), float(start["x_m"]), float(start["y_m"]))
    poses = np.array(navigation)
    covariance = drift.covariance(np.array(times), poses[:, :2, 3], of_vehicle(sailing.navigation), fix)
    return Demo(list(clouds), poses, np.array(truth), covariance, entry.point_spacing_m)


def _submaps(
    line: simulation.Line, length_m: float, spacing_m: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    raw, truth = line.raw[line.raw["quality"] == 0], line.truth
    north, east = np.cos(raw["heading_rad"]), np.sin(raw["heading_rad"])
    x = raw["x_m"] + east * raw["along_m"] + north * raw["across_m"]
    y = raw["y_m"] + north * raw["along_m"] - east * raw["across_m"]
    points = np.column_stack([x, y, -raw["depth_m"] - raw["down_m"]])
    pings = raw.drop_duplicates("time_s")
    reckoned = pings.assign(yaw_rad=np.pi / 2 - np.unwrap(pings["heading_rad"]), z_m=-pings["depth_m"])
    true = truth.assign(yaw_rad=np.unwrap(truth["yaw_rad"]))
    sailed = np.concatenate([[0], np.cumsum(np.hypot(np.diff(truth["x_m"]), np.diff(truth["y_m"])))])
    stretch = np.interp(raw["time_s"], truth["time_s"], sailed) // length_m
    for number in range(int(sailed[-1] // length_m)):
        time = float(np.interp((number + 0.5) * length_m, sailed, truth["time_s"]))
        T, T_true = (
            pose.matrix(np.array(at[:3]), at[3])
            for at in (
                [float(np.interp(time, poses["time_s"], poses[name])) for name in ("x_m", "y_m", "z_m", "yaw_rad")]
                for poses in (reckoned, true)
            )
        )
        own = pose.transform(np.linalg.inv(T), points[stretch == number])
        yield own[np.unique(np.floor(own[:, :2] / spacing_m), axis=0, return_index=True)[1]], T, T_true, time
