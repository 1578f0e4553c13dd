"""What several commands share: covariances from tables, Q as an ellipse, and rows as people read them."""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pointnetkl.workflow.errors import PointNetKLError

DIALECTS = """\
dialects of a g2o file: gtsam, all in metres and radians, as GTSAM's reader and writer have it; g2o, g2o's own, where a
rotation is the vector part of a quaternion (the rotation's block of the information times 4, its blocks with the
translation times 2). A file begins with a comment that says which.
"""


class CommandError(PointNetKLError):
    """What a command was given does not go together."""


def parser(commands: Any, name: str, says: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a new command, with the line breaks of its texts kept."""
    made: argparse.ArgumentParser = commands.add_parser(
        name, help=says, description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    return made


def require_apart(*paths: Path | None) -> None:
    """Refuse to write one file over another; None is no file.

    Raises:
        CommandError: two of the paths are one.
    """
    given = [path.resolve() for path in paths if path is not None]
    if twice := [path for i, path in enumerate(given) if path in given[:i]]:
        raise CommandError(f"{twice[0]}: two files are to be written there; give each a name of its own")


def covariances(
    paths: Sequence[Path], method: str, floor: float = 0.0, survey: str | None = None
) -> dict[int, np.ndarray]:
    """Return a method's Q (M, M) by submap, of the tables that have it, with a floor, m^2, on each.

    Raises:
        CommandError: no table has the method, or the tables are of several surveys.
        ArtifactError, CovarianceError, SlamError: a table is damaged or not of the survey, or has a Q that is none, or
            one twice.
    """
    from pointnetkl.registration.covariance import table
    from pointnetkl.slam.benchmark import protocol

    named = ", ".join(map(str, paths))
    rows = table.read(paths, survey)
    if method not in (known := sorted(set(rows["method"]))):
        raise CommandError(f"{named}: has no method {method}, but {', '.join(known) or 'nothing'}")
    rows = rows[rows["method"] == method]
    if len(surveys := sorted(set(rows["survey"]))) > 1:
        raise CommandError(f"{named}: has covariances of {', '.join(surveys)}; give tables of one survey")
    return protocol.by_method(rows, floor)[method]


def ellipse(q: np.ndarray) -> tuple[float, float, float]:
    """Return the standard deviations along the axes of Q (2, 2), the larger one first and its angle in (-90, 90]."""
    largest = (q[0, 0] + q[1, 1]) / 2 + math.hypot((q[0, 0] - q[1, 1]) / 2, q[0, 1])
    smallest = (q[0, 0] * q[1, 1] - q[0, 1] ** 2) / largest
    angle = math.degrees(math.atan2(2 * q[0, 1], q[0, 0] - q[1, 1]) / 2)
    return math.sqrt(largest), math.sqrt(smallest), angle


def in_columns(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows under their names, numbers to the right; nothing where there is none."""
    from pointnetkl.reporting import text_table

    if not rows:
        return ""
    lines = [list(rows[0]), *([text_table.cell(value) for value in row.values()] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(word.rjust(w) for word, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )
