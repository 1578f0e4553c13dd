"""Accepted closures as what they measure: how far a source lies from where its targets want it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.correction.result import Corrected, CorrectionError, Submaps
from pointnetkl.slam.closing.estimate import Tie, from_matrices
from pointnetkl.slam.closing.schemas import State
from pointnetkl.surveys.se2 import rotate

LESS = "that ground holds in less than two directions"
REFERENCE = -1  # the target of a closure on ground that is not of the survey


@dataclass(frozen=True)
class Measurement:
    """A closure that the ground holds in both directions, between nodes (rows of Submaps)."""

    source: int  # node
    target: int  # node of which most of the overlap is; REFERENCE
    shift: np.ndarray  # (2,) metres, from where navigation has the source on its targets to where it registers
    V: np.ndarray  # (2, 2) m^2, of the shift, and so of the residual
    lever: np.ndarray  # (2,) metres, middle of the overlap in the source's frame
    residual: np.ndarray  # (2,) metres in the map, from the corrected place of the source to the measured one


def measurements(corrected: Corrected, submaps: Submaps) -> tuple[list[Measurement], int]:
    """Return what the accepted closures of rank 2 measure, and the number of accepted ones of less.

    With one target all is exact. With several the shift is a mean over them whose shares CLOSURES does not keep: they
    count the same here, and the result as one on the target with most of the overlap.

    Raises:
        CorrectionError: a closure names a submap that is not of the survey.
    """
    rows = corrected.closures[corrected.closures["state"] == State.ACCEPTED]
    V = rows[["v_xx_m2", "v_xy_m2", "v_xy_m2", "v_yy_m2"]].to_numpy(np.float64)
    whole = (rows["rank"].to_numpy() == 2) & np.isfinite(V).all(axis=1)
    node = {number: row for row, number in enumerate(submaps.number.tolist())} | {REFERENCE: REFERENCE}
    before, after = from_matrices(submaps.before), from_matrices(submaps.after)
    try:
        found = [
            _measurement(node, before, after, row, V[k].reshape(2, 2))
            for k, (_, row) in enumerate(rows.iterrows())
            if whole[k]
        ]
    except (KeyError, ValueError) as error:
        raise CorrectionError(
            f"{corrected.name}: a closure names submap {error}, which is not of the survey; give the closures of this"
            " survey"
        ) from error
    return found, int((~whole).sum())


def _measurement(
    node: dict[int, int], before: np.ndarray, after: np.ndarray, row: pd.Series, V: np.ndarray
) -> Measurement:
    source, target = node[int(row["source"])], node[int(row["target"])]
    shift = row[["shift_x_m", "shift_y_m"]].to_numpy(np.float64)
    at = after[source]
    lever = rotate(row[["x_m", "y_m"]].to_numpy(np.float64) - at[:2], -at[2])
    back = _back(before, after, source, _targets(node, row, target), lever)
    return Measurement(source, target, shift, V, lever, shift + back)


def _targets(node: dict[int, int], row: pd.Series, target: int) -> list[int]:
    """Return the nodes of all targets that are of the survey, first that with most of the overlap."""
    others = [node[int(word)] for word in str(row["targets"]).split()]
    return [target, *(other for other in others if other not in (target, REFERENCE))]


def _back(before: np.ndarray, after: np.ndarray, source: int, targets: Sequence[int], lever: np.ndarray) -> np.ndarray:
    """Return how far (2,) a source lies on its targets by navigation from where it lies after the correction.

    It is in the axes of the corrected targets, as the shift is: a closure is searched from the corrected poses.
    """
    if targets[0] == REFERENCE:
        there, here = (poses[source, :2] + rotate(lever, poses[source, 2]) for poses in (before, after))
        return there - here
    return Tie.at(after, source, targets, None, lever).offset(before)


def counted(count: int, what: str) -> str:
    """Return so many accepted closures of a kind, in words."""
    return f"{count} accepted {'closure' if count == 1 else 'closures'} {what}"
