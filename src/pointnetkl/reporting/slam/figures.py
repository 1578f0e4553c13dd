"""The SLAM benchmark's figures: what of the results each one shows."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pointnetkl.reporting.covariances import cases, method_plots
from pointnetkl.reporting.drawing import maps, sheet
from pointnetkl.reporting.results import Test
from pointnetkl.reporting.slam import along_track, closure_maps, trajectories
from pointnetkl.reporting.slam import maps as slam_maps
from pointnetkl.reporting.slam import numbers as slam_numbers
from pointnetkl.reporting.slam.closure_maps import Closures
from pointnetkl.reporting.slam.maps import Seabed
from pointnetkl.reporting.slam.trajectories import Tracks
from pointnetkl.surveys import pose, submap

_SOLVED = ("network", "pointnetkl", "monte_carlo")  # whose map is shown: the first that is there
_ELLIPSES = ("network", "monte_carlo")
_FIGURES = ("trajectories", "bathymetry", "closures", "error_along_track", "slam_differences", "slam_both_ways")
_MOST_POINTS = 400_000  # of a map: more only take time, its cells hold dozens each


def every(
    surveys: Sequence[cases.Survey], spacing_m: Mapping[str, float], numbers: Mapping[str, Any]
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of the test surveys' solved graphs, by name.

    `spacing_m` is the point spacing by survey; `numbers` are the report's. Surveys without a track have no graph to
    solve and are not drawn.
    """
    surveys = [each for each in surveys if each.test.track]
    if not surveys:
        yield from ((name, sheet.no_track()) for name in _FIGURES)
        return
    tracks = {each.name: _tracks(each.test) for each in surveys}
    seabeds = {each.name: _seabed(each, spacing_m[each.name]) for each in surveys}
    closing = {each.name: _closures(each, seabeds[each.name]) for each in surveys if len(each.test.registered)}
    yield "trajectories", trajectories.trajectories(tracks)
    yield "bathymetry", slam_maps.bathymetry(seabeds)
    yield "closures", closure_maps.closures(closing)
    yield "error_along_track", along_track.along(tracks)
    yield "slam_differences", method_plots.slam_differences(slam_numbers.differences(numbers["slam"]))
    both = slam_numbers.both_ways(numbers["slam"], numbers["slam_authors"])
    yield "slam_both_ways", method_plots.slam_both_ways(both)


def poses_of(test: Test, which: str) -> np.ndarray:
    """Return a trajectory's poses T_map_submap (n, 4, 4), in the order of the submaps' numbers."""
    return submap.poses_from_table(test.trajectories[test.trajectories["which"] == which].sort_values("submap"))


def _tracks(test: Test) -> Tracks:
    there = test.trajectories["which"].unique()
    return Tracks({str(which): poses_of(test, which)[:, :3, 3] for which in there}, test.loop_closures)


def _seabed(survey: cases.Survey, spacing_m: float) -> Seabed:
    there = set(survey.test.trajectories["which"])
    solved = [which for which in _SOLVED if which in there][:1]
    best = "truth" if "truth" in there else "gt"
    step = max(1, sum(map(len, survey.clouds)) // _MOST_POINTS)
    shown = {which: _placed(survey, which, step) for which in ("corrupted", *solved, best)}
    return Seabed(shown, spacing_m * float(np.sqrt(step)))


def _placed(survey: cases.Survey, which: str, step: int) -> np.ndarray:
    placed = zip(poses_of(survey.test, which), survey.clouds, strict=True)
    return np.concatenate([pose.transform(T, cloud[::step]) for T, cloud in placed])


def _closures(survey: cases.Survey, seabed: Seabed) -> Closures:
    points = seabed.points[seabed.best]
    at = np.searchsorted(survey.labels.submap, survey.test.registered)
    T = poses_of(survey.test, seabed.best)[at]
    shown = {name: survey.test.covariances[name] for name in _ELLIPSES if name in survey.test.covariances}
    corners = np.array([points.min(axis=0), points.max(axis=0)])[:, :2]
    return Closures(
        submap=survey.test.registered,
        place=T[:, :2, 3],
        yaw=np.arctan2(T[:, 1, 0], T[:, 0, 0]),
        error=survey.test.registration_errors[:, :2],
        covariances={name: q[at][:, :2, :2] for name, q in shown.items()},
        seabed=maps.raster(points, seabed.spacing_m, corners),
    )
