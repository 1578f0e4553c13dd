"""Command `predict`: covariances of submaps in files, by a trained model."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointnetkl.commands import shared
from pointnetkl.workflow.errors import PointNetKLError

if TYPE_CHECKING:
    from pointnetkl.estimator import Prediction

_DESCRIPTION = """\
Print the covariance Q of each submap's registration (GICP), by a trained model.

A file holds one submap of bathymetry in metres, z up, thinned like the submaps that the model was trained on:
  PCD   ascii, binary or compressed; VIEWPOINT is not applied
  PLY   ascii or binary; the vertices
  NPZ   an array `points` (n, 3)
  text  x, y, z in the first three columns, separated by commas or blanks; # and // begin comments
The format is recognised by the content, whatever the name. Q has the axes of the file's own frame.
"""
_EPILOG = """\
columns:
  points            number of points
  major_m, minor_m  standard deviations along the axes of Q's ellipse
  angle_deg         angle of the major axis, from x towards y
  q_...             entries of Q, in m^2 (with yaw also m rad and rad^2)
  novelty           distance to the training submaps; 1 is the limit (- if the model's file does not have it)
  far               whether the novelty is above 1: the covariance is then a guess

A file that cannot be used is reported on stderr; the others are printed, and the exit status is 1.
"""


def add(commands: Any) -> None:
    """Add the command's parser."""
    command = shared.parser(
        commands, "predict", "print covariances of submaps in files, by a trained model", _DESCRIPTION, _EPILOG
    )
    command.add_argument("model", type=Path, metavar="MODEL", help=shared.MODEL)
    command.add_argument("submaps", type=Path, nargs="+", metavar="SUBMAP", help="files of one submap each")
    command.add_argument("--json", action="store_true", help="print a JSON list with an object for each file")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a row for each file; return 1 if one of them could not be used."""
    # these imports take seconds, and --help does not need them
    from pointnetkl import estimator
    from pointnetkl.readers.formats import clouds

    model = estimator.CovarianceEstimator.load(arguments.model)
    rows = []
    for path in arguments.submaps:
        try:
            points = clouds.read(path)
            rows.append({"file": str(path), "points": len(points), **_numbers(model.judge(points))})
        except PointNetKLError as error:
            sentence = str(error) if str(path) in str(error) else f"{path}: {error}"
            print(f"error: {sentence}", file=sys.stderr)
    if rows or arguments.json:
        print(json.dumps(rows, indent=2) if arguments.json else shared.in_columns(rows))
    shared.warn_of_novelty(sum(bool(row["far"]) for row in rows), len(rows))
    return int(len(rows) < len(arguments.submaps))


def _numbers(prediction: "Prediction") -> dict[str, Any]:
    """Return the numbers of a prediction's row."""
    from pointnetkl.registration.covariance import table

    q = prediction.covariance
    major, minor, angle = shared.ellipse(q[:2, :2])
    entries = {name: float(value) for name, value in table.to_columns(q).items()}
    far = None if prediction.novelty is None else prediction.is_novel
    return {
        "major_m": major,
        "minor_m": minor,
        "angle_deg": angle,
        **entries,
        "novelty": prediction.novelty,
        "far": far,
    }
