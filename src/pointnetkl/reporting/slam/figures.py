"""The SLAM benchmark's figures, and the parts of the results that each one draws."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from pointnetkl.registration.covariance.catalogue import CORRUPTED, GT, MONTE_CARLO, NETWORK, POINTNETKL, TRUTH
from pointnetkl.reporting.covariances import cases, method_plots
from pointnetkl.reporting.drawing import maps, sheet
from pointnetkl.reporting.results import Test
from pointnetkl.reporting.slam import along_track, closure_maps, trajectories
from pointnetkl.reporting.slam import maps as slam_maps
from pointnetkl.reporting.slam import numbers as slam_numbers
from pointnetkl.reporting.slam.closure_maps import ClosureMap
from pointnetkl.reporting.slam.maps import Seabed
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.reporting.text_table import Numbers
from pointnetkl.surveys import pose, submap

_SOLVED = (NETWORK, POINTNETKL, MONTE_CARLO)  # the first of these that a survey has gives the solved map
_ELLIPSES = (NETWORK, MONTE_CARLO)
_FIGURES = ("trajectories", "bathymetry", "closures", "error_along_track", "slam_differences", "slam_both_ways")
_MOST_POINTS = 400_000  # of a map: more only take time, because each cell holds dozens


def every(
    surveys: Sequence[cases.Survey], spacing_m: Mapping[str, float], numbers: Numbers
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of the test surveys' solved graphs, by name.

    `spacing_m` is the point spacing by survey; `numbers` are the report's. Surveys without a track have no graph to
    solve and are not drawn.
    """
    surveys = [survey for survey in surveys if survey.test.track]
    if not surveys:
        yield from ((name, sheet.no_track()) for name in _FIGURES)
        return
    tracks = {survey.name: _tracks(survey.test) for survey in surveys}
    seabeds = {survey.name: _seabed(survey, spacing_m[survey.name]) for survey in surveys}
    closures = {
        survey.name: _closures(survey, seabeds[survey.name]) for survey in surveys if len(survey.test.registered)
    }
    yield "trajectories", trajectories.trajectories(tracks)
    yield "bathymetry", slam_maps.bathymetry(seabeds)
    yield "closures", closure_maps.closure_ellipses(closures)
    yield "error_along_track", along_track.along(tracks)
    yield "slam_differences", method_plots.slam_differences(slam_numbers.differences(numbers["slam"]))
    both = slam_numbers.both_ways(numbers["slam"], numbers["slam_authors"])
    yield "slam_both_ways", method_plots.slam_both_ways(both)


def trajectory_poses(test: Test, name: str) -> np.ndarray:
    """Return a trajectory's poses T_map_submap (n, 4, 4), in the order of the submaps' numbers."""
    return submap.poses_from_table(test.trajectories[test.trajectories["which"] == name].sort_values("submap"))


def _tracks(test: Test) -> Tracks:
    names = test.trajectories["which"].unique()
    return Tracks({str(name): trajectory_poses(test, name)[:, :3, 3] for name in names}, test.loop_closures)


def _seabed(survey: cases.Survey, spacing_m: float) -> Seabed:
    names = set(survey.test.trajectories["which"])
    solved = [name for name in _SOLVED if name in names][:1]
    best = TRUTH if TRUTH in names else GT
    step = max(1, sum(map(len, survey.clouds)) // _MOST_POINTS)
    points = {name: _placed(survey, name, step) for name in (CORRUPTED, *solved, best)}
    return Seabed(points, spacing_m * float(np.sqrt(step)))


def _placed(survey: cases.Survey, trajectory: str, step: int) -> np.ndarray:
    """Return every step-th point of a survey at the poses of a trajectory, (n, 3) metres in the map frame."""
    submaps = zip(trajectory_poses(survey.test, trajectory), survey.clouds, strict=True)
    return np.concatenate([pose.transform(T_map_submap, cloud[::step]) for T_map_submap, cloud in submaps])


def _closures(survey: cases.Survey, seabed: Seabed) -> ClosureMap:
    points = seabed.points[seabed.best]
    index = np.searchsorted(survey.labels.submap, survey.test.registered)
    T_map_submap = trajectory_poses(survey.test, seabed.best)[index]
    covariances = {name: survey.test.covariances[name] for name in _ELLIPSES if name in survey.test.covariances}
    corners = np.array([points.min(axis=0), points.max(axis=0)])[:, :2]
    return ClosureMap(
        submap=survey.test.registered,
        position=T_map_submap[:, :2, 3],
        yaw=np.arctan2(T_map_submap[:, 1, 0], T_map_submap[:, 0, 0]),
        error=survey.test.registration_errors[:, :2],
        covariances={name: q[index][:, :2, :2] for name, q in covariances.items()},
        seabed=maps.raster(points, seabed.spacing_m, corners),
    )
