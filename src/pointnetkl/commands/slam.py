"""Command `slam`: registers submaps in files with poses to each other, and optimises their pose graph."""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pointnetkl.commands import shared, solve
from pointnetkl.workflow.errors import PointNetKLError

if TYPE_CHECKING:
    from pointnetkl.estimator import CovarianceEstimator, Prediction
    from pointnetkl.registration import gicp
    from pointnetkl.slam.closures import loop_closure
    from pointnetkl.surveys.submap import Submap

_DESCRIPTION = """\
Build the pose graph of submaps in PCD files, and optimise it: with the pipeline's search for loop closures (Algorithm 1
of the paper), the covariances of a trained model, and GTSAM.

A file holds one submap in metres, z up; its VIEWPOINT (x y z qw qx qy qz) is the pose of its frame in the map. The name
does not matter. Give the files in the order of the track (`ls -v` sorts numbers in names); they become vertices 0, 1,
and so on. Roll and pitch of a pose go into the points, so that frames are level.

A submap closes a loop where earlier submaps, except the one just before, cover enough of it (--coverage). It is
registered to those, starting at dead reckoning: in x and y, and with registration.dof: xyyaw also in yaw. The rest of a
loop closure comes from the poses in the files. Sections `graph` and `registration` of the parameters have the other
settings: graph.method: map registers to the most probable place, with a prior of graph.prior_variance_m2 about where
dead reckoning has the submap. Their unit, the spacing of points, is measured: the side of a square that holds one
point.
"""
_EPILOG = f"""\
FOLDER gets graph.g2o, the solution with all edges, and trajectory.tum, with a submap's number as its time.

columns:
  points            number of points
  closures          number of earlier submaps that it was registered to
  moved_m           distance from the pose in the file to the solution
  major_m, minor_m  standard deviations along the axes of Q's ellipse
  novelty           distance to the training submaps of the model; 1 is the limit
  far               whether the novelty is above 1: Q is then a guess

{shared.DIALECTS_HELP}"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(
        commands, "slam", "build and optimise the pose graph of submaps in files", _DESCRIPTION, _EPILOG
    )
    command.add_argument("model", type=Path, metavar="MODEL", help=shared.MODEL)
    command.add_argument("submaps", type=Path, nargs="+", metavar="SUBMAP", help="PCD files, in the order of the track")
    command.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder to write to")
    command.add_argument(
        "--coverage", type=float, help="share of a submap that must be covered (default: graph.coverage)"
    )
    command.add_argument(
        "--edges",
        choices=shared.EDGES,
        default="all",
        help="how to count edges, as slam.edges (default: %(default)s)",
    )
    command.add_argument(
        "--dialect", choices=shared.DIALECTS, default="g2o", help="of graph.g2o (default: %(default)s)"
    )
    command.add_argument("--params", type=Path, default=Path("params.yaml"), help="parameters (default: %(default)s)")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the optimised graph; print a row for each submap."""
    # these imports take seconds, and --help does not need them
    from pointnetkl import estimator
    from pointnetkl.exchange import graph_solver, posed_submaps
    from pointnetkl.registration import gicp
    from pointnetkl.slam.closures import loop_closure
    from pointnetkl.workflow import parameters

    settings = _with_coverage(parameters.read(arguments.params, "graph", loop_closure.Settings), arguments.coverage)
    registration_settings = parameters.read(arguments.params, "registration", gicp.Settings)
    model = estimator.CovarianceEstimator.load(arguments.model)
    submaps, poses = posed_submaps.read(arguments.submaps)
    predictions = [_predict(model, path, s.points) for path, s in zip(arguments.submaps, submaps, strict=True)]
    _require_dimensions(arguments, predictions[0].covariance, registration_settings)
    q = {s.number: prediction.covariance for s, prediction in zip(submaps, predictions, strict=True)}
    graph, closures = posed_submaps.connect(submaps, poses, q, arguments.edges, settings, registration_settings)
    solved = graph_solver.solve(graph)
    solve.write(arguments.out / "graph.g2o", arguments.out / "trajectory.tum", graph, solved.poses, arguments.dialect)
    moved = np.linalg.norm((solved.poses - poses)[:, :3, 3], axis=1)
    targets = np.bincount(closures.edges.source, minlength=len(submaps))
    columns = (arguments.submaps, submaps, predictions, targets.tolist(), moved.tolist())
    print(shared.in_columns([_row(*fields) for fields in zip(*columns, strict=True)]))
    print(
        f"\n{len(submaps)} submaps, a point in each square of {posed_submaps.spacing(submaps):.3g} m;"
        f" registrations: {len(closures.node)}, loop closures: {len(closures.edges.source)};"
        f" chi2 {solved.chi2_before:.4g} before, {solved.chi2_after:.4g} after"
    )
    _warn(predictions, len(closures.node), settings.coverage)
    return 0


def _with_coverage(settings: "loop_closure.Settings", coverage: float | None) -> "loop_closure.Settings":
    """Return settings of the graph with another coverage, if one is given."""
    try:
        return settings if coverage is None else dataclasses.replace(settings, coverage=coverage)
    except ValueError as error:
        raise shared.CommandError(f"--{error}") from error


def _predict(model: "CovarianceEstimator", path: Path, points: np.ndarray) -> "Prediction":
    try:
        return model.judge(points)
    except PointNetKLError as error:
        raise shared.CommandError(f"{path}: {error}") from error


def _require_dimensions(arguments: argparse.Namespace, q: np.ndarray, registration: "gicp.Settings") -> None:
    if len(q) != registration.dimensions:
        raise shared.CommandError(
            f"{arguments.model} is a model of {len(q)} dimensions, and registration.dof in {arguments.params} is"
            f" {registration.dof}; take a model that was trained with it"
        )


def _row(path: Path, submap: "Submap", prediction: "Prediction", closures: int, moved: float) -> dict[str, Any]:
    major, minor, _ = shared.ellipse(prediction.covariance[:2, :2])
    return {
        "file": path.name,
        "points": len(submap.points),
        "closures": closures,
        "moved_m": round(moved, 4),
        "major_m": major,
        "minor_m": minor,
        "novelty": prediction.novelty,
        "far": None if prediction.novelty is None else prediction.is_novel,
    }


def _warn(predictions: "list[Prediction]", registrations: int, coverage: float) -> None:
    """Print on stderr why the result may be of little use."""
    if not registrations:
        print(
            f"warning: no submap returns to ground of which earlier ones cover {coverage:g};"
            " without loop closures the poses stay as they were; --coverage can ask for less",
            file=sys.stderr,
        )
    shared.warn_of_novelty(sum(prediction.is_novel for prediction in predictions), len(predictions))
