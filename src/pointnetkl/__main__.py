"""`python -m pointnetkl`: what a trained model says of submaps in files."""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pointnetkl.errors import PointNetKLError

_PREDICT = """\
Covariance of the registration (GICP) of each submap, by a trained model.

A file holds one submap of bathymetry, metres, z up, thinned as those that the model was trained on:
  PCD   ascii, binary or compressed; VIEWPOINT is not applied
  PLY   ascii or binary; the vertices
  NPZ   an array `points` (n, 3)
  text  x, y, z in the first three columns, between commas or blanks; # and // begin comments
Files are known by their content, whatever their name. Q has the axes of the file's own frame.
"""
_COLUMNS = """\
columns: points; major_m and minor_m, standard deviations along the axes of Q's ellipse; angle_deg, of the major axis
from x towards y; Q's entries, in m^2 (and m rad, rad^2 for a model with yaw); novelty, the distance to the training
submaps, 1 at the limit; far, whether it is beyond: the covariance is then a guess (- where the model does not say).

A file that cannot be used is named on stderr; the others are printed, and the exit status is 1.
"""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command line; return the exit status."""
    arguments = _parser().parse_args(words)
    try:
        return int(arguments.run(arguments))
    except PointNetKLError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130  # as a shell counts it


def predict(arguments: argparse.Namespace) -> int:
    """Print a row for each file; return 1 if one of them could not be used."""
    # some seconds, which --help need not take
    from pointnetkl import cloud_files, estimator

    model = estimator.CovarianceEstimator.load(arguments.model)
    rows = []
    for path in arguments.submaps:
        try:
            points = cloud_files.read(path)
            rows.append({"file": str(path), "points": len(points), **_numbers(model.judge(points))})
        except PointNetKLError as error:
            sentence = str(error) if str(path) in str(error) else f"{path}: {error}"
            print(f"error: {sentence}", file=sys.stderr)
    print(json.dumps(rows, indent=2) if arguments.json else _table(rows))
    return int(len(rows) < len(arguments.submaps))


def _numbers(prediction: Any) -> dict[str, Any]:
    """Return a prediction as a row's numbers."""
    from pointnetkl.covariance import table

    q = prediction.covariance
    major, minor, angle = _ellipse(q[:2, :2])
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


def _ellipse(q: Any) -> tuple[float, float, float]:
    """Return the standard deviations along the axes of Q (2, 2), the larger one first and its angle in (-90, 90]."""
    largest = (q[0, 0] + q[1, 1]) / 2 + math.hypot((q[0, 0] - q[1, 1]) / 2, q[0, 1])
    smallest = (q[0, 0] * q[1, 1] - q[0, 1] ** 2) / largest
    angle = math.degrees(math.atan2(2 * q[0, 1], q[0, 0] - q[1, 1]) / 2)
    return math.sqrt(largest), math.sqrt(smallest), angle


def _table(rows: Sequence[dict[str, Any]]) -> str:
    from pointnetkl import text_table

    if not rows:
        return ""
    lines = [list(rows[0]), *([text_table.cell(value) for value in row.values()] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(word.rjust(w) for word, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m pointnetkl", description=__doc__)
    commands = parser.add_subparsers(title="commands", required=True)
    command = commands.add_parser(
        "predict",
        help="the covariance of submaps in files",
        description=_PREDICT,
        epilog=_COLUMNS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("model", type=Path, metavar="MODEL", help="a trained model, as models/network.pt")
    command.add_argument("submaps", type=Path, nargs="+", metavar="SUBMAP", help="files of one submap each")
    command.add_argument("--json", action="store_true", help="a JSON list with an object for each file")
    command.set_defaults(run=predict)
    return parser


if __name__ == "__main__":
    sys.exit(main())
