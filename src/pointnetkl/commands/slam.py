"""Command `slam`: submaps in files with their poses, registered to each other and optimised."""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.commands import shared, solve
from pointnetkl.workflow.errors import PointNetKLError

_DESCRIPTION = """\
The pose graph of submaps in PCD files with their poses, and its solution: the front end of the pipeline (Algorithm 1 of
the paper), the covariances of a trained model, GTSAM.

A file holds one submap, metres, z up, in the frame whose pose in the map its VIEWPOINT is (x y z qw qx qy qz); any name
will do. Files are given in the order of the track (`ls -v` sorts numbers in names), and become vertices 0, 1, ... Roll
and pitch of a pose go into the points, so that frames are level. A submap closes a loop where earlier ones, but for the
one just before, cover enough of it (--coverage); it is registered to those in x and y (with registration.dof: xyyaw in
yaw too), from where dead reckoning has it. Height and yaw of a loop closure are those of the poses given. Sections
`graph` and `registration` of the parameters hold the rest; their unit of spacing is measured: the square of one point.
"""
_EPILOG = f"""\
FOLDER gets graph.g2o, the solution with all edges, and trajectory.tum, in which a submap's number stands for its time.

columns: closures, the earlier submaps that it was registered to; moved_m, from the pose given to the solution; major_m
and minor_m, standard deviations along the axes of Q's ellipse; novelty and far, how unlike the submaps that the model
was trained on it is: beyond 1 Q is a guess.

{shared.DIALECTS}"""


def add(commands: Any) -> None:
    """Add the command's words."""
    command = shared.parser(commands, "slam", "submaps with poses, as an optimised graph", _DESCRIPTION, _EPILOG)
    command.add_argument("model", type=Path, metavar="MODEL", help="a trained model, as models/network.pt")
    command.add_argument("submaps", type=Path, nargs="+", metavar="SUBMAP", help="PCD files, in the order of the track")
    command.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder to write to")
    command.add_argument("--coverage", type=float, help="share that must be covered, instead of graph.coverage")
    command.add_argument(
        "--edges", choices=("all", "shared"), default="all", help="as slam.edges (default: %(default)s)"
    )
    command.add_argument("--dialect", choices=("g2o", "gtsam"), default="g2o", help="default: %(default)s")
    command.add_argument("--params", type=Path, default=Path("params.yaml"), help="default: %(default)s")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the optimised graph; print a row for each submap."""
    # some seconds, which --help need not take
    from pointnetkl import estimator
    from pointnetkl.exchange import graph_solver, posed_submaps
    from pointnetkl.registration import gicp
    from pointnetkl.slam.closures import loop_closure
    from pointnetkl.workflow import parameters

    how = _covered(parameters.read(arguments.params, "graph", loop_closure.Settings), arguments.coverage)
    registration = parameters.read(arguments.params, "registration", gicp.Settings)
    model = estimator.CovarianceEstimator.load(arguments.model)
    submaps, poses = posed_submaps.read(arguments.submaps)
    judged = [_judge(model, path, s.points) for path, s in zip(arguments.submaps, submaps, strict=True)]
    _require_dimensions(arguments, judged[0].covariance, registration)
    q = {s.number: each.covariance for s, each in zip(submaps, judged, strict=True)}
    graph, closures = posed_submaps.connect(submaps, poses, q, arguments.edges, how, registration)
    solved = graph_solver.solve(graph)
    solve.write(arguments.out / "graph.g2o", arguments.out / "trajectory.tum", graph, solved.poses, arguments.dialect)
    moved = np.linalg.norm((solved.poses - poses)[:, :3, 3], axis=1)
    targets = np.bincount(closures.edges.source, minlength=len(submaps))
    columns = zip(arguments.submaps, submaps, judged, targets.tolist(), moved.tolist(), strict=True)
    print(shared.in_columns([_row(*each) for each in columns]))
    print(
        f"\n{len(submaps)} submaps, a point in each square of {posed_submaps.spacing(submaps):.3g} m;"
        f" registrations: {len(closures.node)}, loop closures: {len(closures.edges.source)};"
        f" chi2 {solved.chi2_before:.4g} before, {solved.chi2_after:.4g} after"
    )
    _warn(judged, len(closures.node), how.coverage)
    return 0


def _covered(how: Any, coverage: float | None) -> Any:
    """Return settings of the graph with another coverage."""
    try:
        return how if coverage is None else dataclasses.replace(how, coverage=coverage)
    except ValueError as error:
        raise shared.CommandError(f"--{error}") from error


def _judge(model: Any, path: Path, points: np.ndarray) -> Any:
    try:
        return model.judge(points)
    except PointNetKLError as error:
        raise shared.CommandError(f"{path}: {error}") from error


def _require_dimensions(arguments: argparse.Namespace, q: np.ndarray, registration: Any) -> None:
    if len(q) != registration.dimensions:
        raise shared.CommandError(
            f"{arguments.model} is a model of {len(q)} dimensions, and registration.dof in {arguments.params} is"
            f" {registration.dof}; take a model that was trained with it"
        )


def _row(path: Path, submap: Any, judged: Any, closures: int, moved: float) -> dict[str, Any]:
    major, minor, _ = shared.ellipse(judged.covariance[:2, :2])
    return {
        "file": path.name,
        "points": len(submap.points),
        "closures": closures,
        "moved_m": round(moved, 4),
        "major_m": major,
        "minor_m": minor,
        "novelty": judged.novelty,
        "far": None if judged.novelty is None else judged.is_novel,
    }


def _warn(judged: list[Any], registrations: int, coverage: float) -> None:
    """Say on stderr what makes the answer worth little."""
    if not registrations:
        print(
            f"warning: no submap returns to ground of which earlier ones cover {coverage:g};"
            " without loop closures the poses stay as they were (--coverage asks for less)",
            file=sys.stderr,
        )
    if far := sum(each.is_novel for each in judged):
        print(
            f"warning: {far} of {len(judged)} submaps are unlike those that the model was trained on:"
            " their Q is a guess",
            file=sys.stderr,
        )
