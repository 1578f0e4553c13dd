"""Shared by commands: arguments, covariances from tables, Q as an ellipse, and rows as text."""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError

EDGES = ("all", "shared")  # ways to count edges, as slam.edges of the parameters
DIALECTS = ("g2o", "gtsam")  # as exchange.g2o.DIALECTS, whose import takes seconds
MODEL = (
    "network or pointnetkl, which come with the package and know submaps of 140 to 500 m with a point every 3.2 to"
    " 6.7 m, or a trained model's file, such as models/network.pt"
)
DIALECTS_HELP = """\
dialects of a g2o file:
  gtsam  metres and radians, as GTSAM reads and writes files
  g2o    that of g2o itself, where the error of a rotation is the vector part of a quaternion: the information's block
         of the rotation is 4 times that in radians, its blocks between rotation and translation 2 times
The first line of a file that we write, a comment, states its dialect.
"""


class CommandError(PointNetKLError):
    """The arguments of a command do not go together."""


def parser(commands: Any, name: str, summary: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a new command; the line breaks of its texts are kept."""
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    return command


def require_apart(*paths: Path | None) -> None:
    """Refuse to write two files to one path; None stands for no file.

    Raises:
        CommandError: two of the paths are the same.
    """
    resolved = [path.resolve() for path in paths if path is not None]
    if twice := [path for i, path in enumerate(resolved) if path in resolved[:i]]:
        raise CommandError(f"{twice[0]}: two files are to be written there; give each a name of its own")


def covariances(
    paths: Sequence[Path], method: str, floor: float = 0.0, survey: str | None = None
) -> dict[int, np.ndarray]:
    """Return a method's Q (M, M) by submap from tables, with a floor, m^2, added to each.

    Raises:
        CommandError: no table has the method, or the tables are of several surveys.
        ArtifactError: a table is missing, damaged or of another survey.
        CovarianceError: a Q is not a covariance.
        SlamError: a submap has two covariances.
    """
    from pointnetkl.registration.covariance import table
    from pointnetkl.slam.benchmark import protocol

    named = ", ".join(map(str, paths))
    rows = table.read(paths, survey)
    if method not in (methods := sorted(set(rows["method"]))):
        raise CommandError(f"{named}: has no method {method}, but {', '.join(methods) or 'nothing'}")
    rows = rows[rows["method"] == method]
    if len(surveys := sorted(set(rows["survey"]))) > 1:
        raise CommandError(f"{named}: has covariances of {', '.join(surveys)}; give tables of one survey")
    return protocol.by_method(rows, floor)[method]


def ellipse(q: np.ndarray) -> tuple[float, float, float]:
    """Return the standard deviations along Q's axes, Q (2, 2), the larger first, and its angle in (-90, 90] degrees."""
    largest = (q[0, 0] + q[1, 1]) / 2 + math.hypot((q[0, 0] - q[1, 1]) / 2, q[0, 1])
    smallest = (q[0, 0] * q[1, 1] - q[0, 1] ** 2) / largest
    angle = math.degrees(math.atan2(2 * q[0, 1], q[0, 0] - q[1, 1]) / 2)
    return math.sqrt(largest), math.sqrt(smallest), angle


def warn_of_novelty(novel: int, submaps: int) -> None:
    """Say on stderr how many submaps are unlike those that the model was trained on."""
    if novel:
        print(
            f"warning: {novel} of {submaps} submaps are unlike those that the model was trained on: their Q is a guess",
            file=sys.stderr,
        )


def in_columns(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as aligned text under the names of their columns; empty text without rows."""
    from pointnetkl.reporting import text_table

    if not rows:
        return ""
    lines = [list(rows[0]), *([text_table.cell(value) for value in row.values()] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(word.rjust(w) for word, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )
